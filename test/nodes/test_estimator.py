# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The estimator in the loop: late and lost measurements, malformed messages, refusals."""

import math
import signal
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from obc_ros.msg import Estimate, LqrDesign, Measurement, State
from obc_ros.srv import SuggestNoise
from probes import Probe
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from support import DEADLINE, DEMO

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


class Feed:
    """A sensor of all outputs every 10 ms, whose clock has an offset [s] to that of the node."""

    def __init__(self, spawn: Any, probe: Probe, **parameters: Any) -> None:
        self._probe = probe
        self.states = probe.listen(State, 'state', 1000)
        self.estimates = probe.listen(Estimate, '/estimator_node/estimate', 1000)
        self.arrays = probe.listen(DiagnosticArray, '/diagnostics')
        self.process = spawn('estimator_node', {**SYSTEM, **NOISE, **parameters})
        self._publisher = probe.publisher(Measurement, 'measurement')

    def send(self, gps: float, count: int, offset: float | None = 0.0,
             pause: float = 0.01) -> None:
        """Publish measurements; without an offset their stamps are 0."""
        for _ in range(count):
            message = measurement(self._probe, NAMES, [gps, 0.0, 0.0, 0.0], -(offset or 0.0))
            if offset is None:
                message.header.stamp.sec = message.header.stamp.nanosec = 0
            self._publisher.publish(message)
            due = time.monotonic() + pause
            self._probe.wait_for(lambda due=due: time.monotonic() >= due)

    def find_status(self, words: str, gps: float = 0.0, offset: float | None = 0.0
                    ) -> dict[str, str]:
        """Send measurements until the diagnostics contain some words; return these."""
        deadline = time.monotonic() + DEADLINE
        self.arrays.clear()
        while True:
            self.send(gps, 10, offset)
            known = [each for array in self.arrays for each in array.status
                     if each.name.endswith('estimate')]
            for status in known:
                if words in status.message:
                    return {'level': status.level, 'message': status.message,
                            **{each.key: each.value for each in status.values}}
            assert time.monotonic() < deadline, [each.message for each in known]


def test_a_publisher_whose_messages_do_not_arrive_is_named(spawn, probe):
    process = spawn('estimator_node', SYSTEM)
    probe.node.create_publisher(
        Measurement, 'measurement', QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    process.wait_for_output('probe publishes /measurement with best effort')


def test_a_burst_of_outliers_moves_no_state(spawn, probe):
    feed = Feed(spawn, probe)
    feed.send(0.0, 100)
    feed.send(1000.0, 20, pause=0.0)
    feed.send(0.0, 100)
    found = feed.find_status('95 % band')
    assert int(found['measurements outliers']) >= 20 and found['measurements restarts'] == '0'
    assert max(abs(state.x[0]) for state in feed.states) < 1.0
    assert {state.restarts for state in feed.states} == {0}
    assert all(state.names == ['px', 'py', 'theta', 'vx', 'vy', 'omega'] for state in feed.states)


def test_a_restart_is_announced_everywhere(spawn, probe):
    """The plant was carried away: all measurements agree for longer than 2 s."""
    feed = Feed(spawn, probe)
    feed.send(0.0, 100)
    found = feed.find_status('the filter was restarted', gps=50.0)
    assert found['level'] == DiagnosticStatus.WARN and found['measurements restarts'] == '1'
    assert 'outliers have agreed with each other for 2' in found['message']
    feed.process.wait_for_output('restart 1 of the filter: ')
    for messages in (feed.states, feed.estimates):
        jumped = [bool(each.restarts) for each in messages]
        assert jumped == [abs(each.x[0] - 50.0) < 1.0 for each in messages]
        assert any(jumped) and not all(jumped)


def test_invalid_numbers_are_dropped_and_said(spawn, probe):
    feed = Feed(spawn, probe)
    for value in (1e155, 1.7976931348623157e308, math.inf, math.nan):
        feed.send(value, 25)
    found = feed.find_status('', gps=0.3)
    assert int(found['measurements out of range']) == 50
    assert int(found['measurements not finite']) == 50
    assert found['measurements restarts'] == found['measurements faults'] == '0'
    feed.process.wait_for_output('beyond the precision of double numbers, were dropped')
    feed.send(0.3, 50)
    assert feed.states[-1].x[0] == pytest.approx(0.3, abs=0.1)


def test_time_that_goes_back_is_no_silence(spawn, probe):
    """A source whose clock is set back by 10 s, to a node that does not compare the clocks."""
    feed = Feed(spawn, probe, stamp_timeout=0.0)
    feed.send(0.0, 50)
    feed.states.clear()
    feed.send(0.0, 20, offset=-10.0)
    probe.wait_for(lambda: feed.states and feed.states[-1].restarts == 1)
    feed.process.wait_for_output('time went back by ')
    assert feed.find_status('95 % band', offset=-10.0)['level'] == DiagnosticStatus.OK


def test_stamps_of_another_clock_are_called_that(spawn, probe):
    """A driver without stamps, a recording of yesterday, clocks that differ."""
    feed = Feed(spawn, probe)
    feed.send(0.0, 50)
    for offset in (None, -86400.0, -6.66, 100.0):
        found = feed.find_status('measurements arrive with stamps', offset=offset)
        assert found['level'] == DiagnosticStatus.ERROR
        assert 'set stamp_timeout to 0' in found['message']
        feed.states.clear()
        feed.send(0.0, 50, offset)
        assert not feed.states
        feed.send(0.0, 50)
        probe.wait_for(lambda: feed.states)
        assert feed.find_status('95 % band')['level'] == DiagnosticStatus.OK


def test_clocks_need_not_be_synchronised(spawn, probe):
    feed = Feed(spawn, probe, stamp_timeout=0.0)
    found = feed.find_status('95 % band', offset=-86400.0)
    assert found['level'] == DiagnosticStatus.OK
    assert 0.0 <= float(found['age of the newest measurement [s]']) < 0.5
    assert float(found['stamp minus local time [s]']) == pytest.approx(-86400.0, abs=1.0)
    feed.states.clear()
    found = probe.wait_for(lambda: [each for array in feed.arrays for each in array.status
                                    if 'no measurement for' in each.message])[-1]
    assert found.level == DiagnosticStatus.ERROR


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


def suggest(probe: Any, name: str = 'suggest_noise', **request: Any) -> Any:
    return probe.call(SuggestNoise, f'/estimator_node/{name}', SuggestNoise.Request(**request))


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
    again = suggest(probe, 'suggest_weights', k=DOYLE_GAIN)   # the former name
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


def test_a_suggestion_is_refused_with_the_reason(spawn, probe):
    spawn('estimator_node', DOYLE_FILTER)
    for request, words in (
            ({'k': [1.0]}, 'k has 1 numbers: wanted 1 x 2'),
            ({'k': [0.0, 0.0]}, 'does not stabilise'), ({'k': [math.nan, 1.0]}, 'K'),
            ({'k': DOYLE_GAIN, 'share': 2.0}, 'share = 2'),
            ({'k': DOYLE_GAIN, 'share': math.nan}, 'share = nan'), ({'k': [1e308] * 2}, ''),
            ({'k': DOYLE_GAIN, 'share': -1.0}, 'share = -1')):
        answer = suggest(probe, **request)
        assert not answer.success and answer.message and words in answer.message, request
        assert not len(answer.qw)
