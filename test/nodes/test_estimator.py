# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The estimator in the loop: late and lost measurements, malformed messages, refusals."""

import math
import signal
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from obc_ros.msg import Estimate, LqrDesign, Measurement, State
from obc_ros.srv import SuggestNoise
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from support import DEMO

SYSTEM = {'system': 'aircraft'}
SIMULATED = {'use_sim_time': True}
NOISE = {'Qw': [0.0, 0.0, 0.0, 0.1, 0.1, 0.5], 'Rv': [0.01, 0.01, 1e-4, 1e-4],
         'x0_deviation': [0.5]}
GPS = {'rate': 10.0, 'noise': 0.1, 'delay': 0.05, 'dropout': 0.05}
IMU = {'rate': 100.0, 'noise': 0.01, 'delay': 0.05, 'dropout': 0.05}
SENSORS = {f'measurement.{name}.{key}': value
           for name, conditions in (('gps_x', GPS), ('gps_y', GPS), ('attitude', IMU),
                                    ('gyro', IMU))
           for key, value in conditions.items()}
NAMES = ['gps_x', 'gps_y', 'attitude', 'gyro']


def measurement(probe: Any, names: list[str], y: list[float], earlier: float = 0.0
                ) -> Measurement:
    message = Measurement(names=names, y=y)
    now = probe.node.get_clock().now().nanoseconds - round(earlier * 1e9)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
    return message


def values(arrays: list[Any], probe: Any) -> dict[str, str]:
    """Return the next diagnostics of the estimator."""
    arrays.clear()
    status = probe.wait_for(lambda: [each for array in arrays for each in array.status
                                     if each.name.endswith('estimate')])[-1]
    return {'level': status.level, 'message': status.message,
            **{each.key: each.value for each in status.values}}


def test_the_loop_with_late_and_lost_measurements_is_stable(spawn, probe):
    """Gps at 10 Hz, imu at 100 Hz, 50 ms late, 5 % lost; the estimator stops and continues."""
    truth = probe.listen(State, 'true_state', 1000)
    estimates = probe.listen(Estimate, '/estimator_node/estimate', 1000)
    arrays = probe.listen(DiagnosticArray, '/diagnostics')
    # A quarter of real time: a busy machine must not make the measurements later than they are.
    spawn('plant_simulator', {**SYSTEM, **SENSORS, 'x0': [0.3, -0.3, 0.0, 0.0, 0.0, 0.0],
                              'publish_rate': 100.0, 'speed': 0.25, 'publish_clock': True},
          remappings={'state': 'true_state'})
    estimator = spawn('estimator_node', {**SYSTEM, **NOISE, **SIMULATED})
    spawn('lqr_node', {**DEMO, **SYSTEM, **SIMULATED})

    def is_near() -> bool:
        true = np.abs([each.x for each in truth[-200:]])
        return bool(true[:, :2].max() < 0.5 and true[:, 2].max() < 0.3)

    probe.wait_for(lambda: len(estimates) > 300, 120.0, 'estimates')
    assert is_near()
    found = values(arrays, probe)
    assert int(found['measurements missing']) > 0
    assert found['measurements malformed'] == found['measurements faults'] == '0'
    last = estimates[-1]
    P = np.array(last.covariance).reshape(6, 6)
    assert (P == P.T).all() and np.linalg.eigvalsh(P)[0] > 0

    estimator.popen.send_signal(signal.SIGSTOP)   # for 0.6 s of the plant
    probe.spin_for(2.5)
    estimator.popen.send_signal(signal.SIGCONT)
    truth.clear()
    probe.wait_for(lambda: len(truth) > 200 and is_near(), 120.0, 'the loop to recover')


def test_bad_messages_are_counted_and_the_node_goes_on(spawn, probe):
    states = probe.listen(State, 'state')
    arrays = probe.listen(DiagnosticArray, '/diagnostics')
    spawn('estimator_node', {**SYSTEM, **NOISE})
    publisher = probe.publisher(Measurement, 'measurement')
    for names, y in ((['px'], [1.0]), (NAMES, [1.0]), ([], []), (['gyro', 'gyro'], [1.0, 1.0])):
        publisher.publish(measurement(probe, names, y))
    publisher.publish(measurement(probe, NAMES, [math.nan] * 4))
    publisher.publish(measurement(probe, NAMES, [0.0] * 4, earlier=-60.0))
    probe.spin_for(0.5)
    assert not states
    for _ in range(20):
        publisher.publish(measurement(probe, NAMES, [0.2, math.nan, 0.0, 0.0]))
        probe.spin_for(0.02)
    found = values(arrays, probe)
    assert found['measurements malformed'] == '4'
    assert found['measurements not finite'] == '24'
    assert found['measurements future'] == '1'
    assert states[-1].x[0] == pytest.approx(0.2, abs=0.1)


def test_without_measurements_the_estimate_ages_and_stops(spawn, probe):
    states = probe.listen(State, 'state')
    arrays = probe.listen(DiagnosticArray, '/diagnostics')
    spawn('estimator_node', {**SYSTEM, **NOISE, 'measurement_timeout': 0.3})
    publisher = probe.publisher(Measurement, 'measurement')
    publisher.publish(measurement(probe, NAMES, [0.0] * 4))
    probe.wait_for(lambda: states)
    probe.spin_for(1.5)
    states.clear()
    probe.spin_for(0.5)
    assert not states
    assert 'no estimate is published' in values(arrays, probe)['message']
    publisher.publish(measurement(probe, NAMES, [0.0] * 4))
    probe.wait_for(lambda: states)


def test_noise_is_judged_and_refused_with_the_reason(spawn, probe):
    spawn('estimator_node', {**SYSTEM, **NOISE}).wait_for_output('slowest pole')
    for given, words in (
            ({'Qw': [-1.0] * 6}, 'Qw[0] = -1: Qw must be positive semidefinite'),
            ({'Rv': [1.0, 1.0, 0.0, 1.0]}, 'Rv[2] = 0: Rv must be positive definite'),
            ({'Qw': [1.0]}, 'Qw has 1 number'),
            ({'outputs': ['attitude', 'gyro']}, 'cannot be seen in attitude, gyro'),
            ({'outputs': ['gps']}, "'gps' is not an output of aircraft"),
            ({'Qw': [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, ]}, '')):
        result, = probe.set_parameters('/estimator_node', **given)
        assert result.successful == (not words) and words in result.reason
    found = probe.get_parameters('/estimator_node', 'Rv', 'outputs')
    assert found['Rv'] == pytest.approx(NOISE['Rv'])


DOYLE = {'system': 'linear', 'system_parameters.A': [1.0, 1.0, 0.0, 1.0],
         'system_parameters.B': [0.0, 1.0]}
DOYLE_GAIN = [2.0 + math.sqrt(104.0)] * 2   # for Qx = 100 [1, 1]' [1, 1], Qu = 1
PERIOD = 0.002
DOYLE_FILTER = {**DOYLE, 'outputs': ['x1'], 'Qw': [100.0] * 4, 'Rv': [1.0 / PERIOD, 1.0],
                'sample_time': PERIOD}


def suggest(probe: Any, **request: Any) -> Any:
    return probe.call(SuggestNoise, '/estimator_node/suggest_weights',
                      SuggestNoise.Request(**request))


def test_suggested_noise_recovers_the_margins_when_it_is_used(spawn, probe):
    """Doyle 1978: the loop with this filter has nearly no margins."""
    spawn('estimator_node', DOYLE_FILTER)
    answer = suggest(probe, k=DOYLE_GAIN)
    assert answer.success, answer.message
    before, after, whole = answer.disk_margin
    assert before < 0.05 * whole and 0.5 * whole <= after
    assert 1.0 < answer.gain_margin[0] < 1.05 < answer.gain_margin[1]
    assert all(len(getattr(answer, name)) == 3 for name in (
        'gain_reduction_margin', 'phase_margin'))
    assert answer.qw == pytest.approx([100.0, 100.0, 100.0, 100.0 + answer.added])
    assert 'with qw' in answer.message
    assert probe.get_parameters('/estimator_node', 'Qw')['Qw'] == pytest.approx([100.0] * 4)
    assert probe.set_parameters('/estimator_node', Qw=list(answer.qw))[0].successful
    again = suggest(probe, k=DOYLE_GAIN)
    assert again.success and again.added == 0.0
    assert again.disk_margin[0] == pytest.approx(after)


def test_the_gain_of_a_suggestion_is_that_of_lqr_node(spawn, probe):
    designs = probe.listen(
        LqrDesign, 'lqr_node/design', QoSProfile(depth=1,
                                                 durability=DurabilityPolicy.TRANSIENT_LOCAL))
    spawn('estimator_node', DOYLE_FILTER)
    assert 'no lqr_node/design has been received' in suggest(probe).message
    spawn('lqr_node', {**DEMO, **DOYLE, 'Qx': [100.0] * 4, 'Qu': [1.0]})
    probe.wait_for(lambda: designs, 60.0)
    probe.wait_for(lambda: suggest(probe).success, 60.0)
    given = suggest(probe, k=list(designs[-1].k))
    assert suggest(probe).qw == given.qw


@pytest.mark.parametrize(('request_', 'words'), [
    ({'k': [1.0]}, 'k has 1 numbers: wanted 1 x 2'), ({'k': [0.0, 0.0]}, 'does not stabilise'),
    ({'k': [math.nan, 1.0]}, 'K'), ({'k': DOYLE_GAIN, 'share': 2.0}, 'share = 2'),
    ({'k': DOYLE_GAIN, 'share': math.nan}, 'share = nan'), ({'k': [1e308] * 2}, ''),
    ({'k': DOYLE_GAIN, 'share': -1.0}, 'share = -1')], ids=str)
def test_a_suggestion_is_refused_with_the_reason(spawn, probe, request_, words):
    spawn('estimator_node', DOYLE_FILTER)
    answer = suggest(probe, **request_)
    assert not answer.success and answer.message and words in answer.message
    assert not len(answer.qw)
