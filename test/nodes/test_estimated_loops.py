# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The launch file with an estimator: other plants and controllers follow their set points.

The loops are in simulated time at a fifth of its speed, so that a busy machine keeps up.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from launched import ROOT
import numpy as np
from obc_ros.msg import Estimate, State
from probes import Probe
import pytest
import support

LAUNCHED = 180.0   # [s] in which a loop follows its set point, also on a busy machine


@pytest.fixture
def launch(domain: int, tmp_path: Path) -> Any:
    """Yield a function that launches a loop with an estimator; it ends with the test."""
    begun: list[support.Process] = []

    def begin(*arguments: str) -> support.Process:
        begun.append(support.Process(
            [support.find('obc'), 'launch', 'obc_ros', 'loop.launch.py', 'estimator:=true',
             'server:=false', 'use_sim_time:=true', 'speed:=0.2', *arguments],
            tmp_path / 'log', domain))
        return begun[-1]

    yield begin
    wrong = [each.end() for each in begun]
    assert wrong == [None] * len(begun), begun[-1].output()


def follow(probe: Probe, controller: str, setpoint: list[float],
           is_there: Callable[[list[float]], bool]) -> None:
    """
    Change the set point, and wait until the true state is there.

    Where plans come late, a state may be outside of the limits for a while. No plan begins there,
    and mpc_node refuses the change with that reason.
    """
    truth = probe.listen(State, 'true_state')
    probe.wait_for(lambda: truth, LAUNCHED, 'the plant')
    assert not is_there(truth[-1].x)

    def is_accepted() -> bool:
        result, = probe.set_parameters(f'/{controller}', setpoint=setpoint)
        assert result.successful or 'no plan from the present state' in result.reason
        return result.successful

    probe.wait_for(is_accepted, LAUNCHED, f'the acceptance of {setpoint}')
    probe.wait_for(lambda: is_there(truth[-1].x), LAUNCHED, f'the set point {setpoint}')


def check_estimate(probe: Probe) -> None:
    """Check covariance and counts of the estimator."""
    truth = probe.listen(State, 'true_state')
    estimates = probe.listen(Estimate, '/estimator_node/estimate')
    arrays = probe.listen(DiagnosticArray, '/diagnostics')
    values: dict[str, str] = {}

    def has_used_many() -> bool:
        values.update({each.key: each.value for array in arrays for status in array.status
                       if status.name == 'estimator_node: estimate' for each in status.values})
        return int(values.get('measurements used', 0)) > 100

    probe.wait_for(lambda: has_used_many() and truth and estimates, LAUNCHED, 'measurements')
    assert values['measurements malformed'] == values['measurements faults'] == '0'
    n = len(estimates[-1].x)
    P = np.array(estimates[-1].covariance).reshape(n, n)
    assert (P == P.T).all() and np.linalg.eigvalsh(P)[0] > 0


def test_the_vehicle_is_found_wherever_it_has_driven(spawn: Any, probe: Probe) -> None:
    """The simulator drives at 10 m/s until the estimator starts."""
    truth = probe.listen(State, 'true_state')
    estimates = probe.listen(Estimate, '/estimator_node/estimate')
    files = [word for file in ('vehicle.yaml', 'sensors/vehicle.yaml')
             for word in ('--params-file', str(ROOT / 'config' / file))]
    given = ['--ros-args', *files]
    driving = ['lockstep:=false', 'publish_clock:=false', 'speed:=1.0',
               'hold_until_command:=false']
    spawn('plant_simulator', remappings={'state': 'true_state'}, arguments=[
        *given, *(word for each in driving for word in ('-p', each)), '--'])
    probe.wait_for(lambda: truth and truth[-1].x[0] > 30.0)
    spawn('estimator_node', arguments=['--ros-args', *files[2:], '--'])
    probe.wait_for(lambda: estimates and (np.abs(np.subtract(
        estimates[-1].x, truth[-1].x)) < (5.0, 0.5, 0.2)).all(), LAUNCHED, 'the vehicle')


def test_the_vehicle_changes_its_lane_with_an_estimate(launch: Any, probe: Probe) -> None:
    loop = launch('scenario:=vehicle')
    loop.wait_for_output('slowest pole')
    loop.wait_for_output('revision 1: vehicle')
    follow(probe, 'lqr_node', [0.0, 0.0, 0.0],
           lambda x: abs(x[1]) < 0.3 and abs(x[2]) < 0.1)
    check_estimate(probe)


def test_mpc_node_plans_from_the_estimate(launch: Any, probe: Probe) -> None:
    loop = launch('scenario:=aircraft_limits', 'controller:=mpc')
    loop.wait_for_output('slowest pole')
    loop.wait_for_output('activated', LAUNCHED)
    follow(probe, 'mpc_node', [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0],
           lambda x: abs(x[0] + 0.5) < 0.4 and abs(x[1]) < 0.4)
    check_estimate(probe)
