# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The steps of a receding horizon as the process answers them, without a process."""

import numpy as np
from obc_ros.core.text.errors import DynamicsError
from obc_ros.workers.steps.receding_steps import prepare, RecedingSteps
from obc_ros.workers.wire import Packet
import pytest

pytestmark = pytest.mark.slow   # it compiles the functions of the steps
PERIOD = 20_000_000   # [ns]
FAR = np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.0])
STAMP = 1_700_000_000_000_000_000   # a clock of today


@pytest.fixture(scope='module')
def steps() -> RecedingSteps:
    """Return the steps of the aircraft with a bound of its speed."""
    none = np.full(6, np.inf)
    upper = np.where(np.arange(6) == 3, 0.4, none)
    return prepare(Packet(
        {'system': 'aircraft', 'parameters': {}, 'setpoint': [], 'setpoint_input': [],
         'period': 0.02, 'steps': 20, 'path_constraints': [], 'deadline': 10.0},
        {'Qx': np.eye(6), 'Qu': np.eye(2), 'cross': np.zeros(0), 'u_lower': np.array([-6.0, 20.0]),
         'u_upper': np.array([6.0, 60.0]), 'x_lower': -upper, 'x_upper': upper}))


@pytest.fixture(scope='module')
def moving() -> RecedingSteps:
    """Return the steps of the vehicle at 10 m/s with bounds of its angle and steering."""
    upper = np.array([np.inf, np.inf, 0.15])
    return prepare(Packet(
        {'system': 'vehicle', 'parameters': {}, 'setpoint': [0.0, 0.0, 0.0],
         'setpoint_input': [10.0, 0.0], 'period': 0.02, 'steps': 30, 'path_constraints': [],
         'deadline': 10.0},
        {'Qx': np.eye(3), 'Qu': np.eye(2), 'cross': np.zeros(0), 'u_lower': np.array([5.0, -0.1]),
         'u_upper': np.array([15.0, 0.1]), 'x_lower': -upper, 'x_upper': upper}))


def follow(steps: RecedingSteps, x: np.ndarray, u: np.ndarray, stamp: int) -> Packet:
    """Return the plan of the instant a period after a stamp."""
    return steps.answer(Packet({'kind': 'step', 'stamp': stamp + PERIOD}, {'x': x, 'u': u}))


@pytest.mark.parametrize(('x', 'where', 'value'), [
    (np.zeros(6), 'inside', 0.0), (FAR, 'outside', None)])
def test_the_first_plan_tells_where_it_ends(steps: RecedingSteps, x: np.ndarray, where: str,
                                            value: float | None) -> None:
    """V(x_N) over the level, with the set that the process has published."""
    reply = steps.answer(Packet({'kind': 'first'}, {'x': x}))
    end, ready = reply.arrays['x'][-1], steps.ready
    found = end @ ready.arrays['P'] @ end / ready.plain['level']
    assert f'ends {where} of the set' in reply.plain['words']
    told = float(reply.plain['words'].rsplit('= ', 1)[1])
    assert told == pytest.approx(found, rel=5e-3, abs=1e-9)
    assert value is None or told == pytest.approx(value, abs=1e-9)


def test_the_step_after_the_first_plan_continues_it(steps: RecedingSteps) -> None:
    """From the state that the first plan reaches, its rest is nearly optimal, at any stamp."""
    first = steps.answer(Packet({'kind': 'first'}, {'x': FAR}))
    reply = follow(steps, FAR, first.arrays['u'][0], STAMP)
    assert reply.plain['stamp'] == STAMP + PERIOD and reply.plain['status'] == 'optimal'
    np.testing.assert_allclose(reply.arrays['x'][0], first.arrays['x'][1], atol=1e-9)
    # Both minimise the same cost; their horizons end a period apart.
    np.testing.assert_allclose(reply.arrays['u'][0], first.arrays['u'][1], atol=0.2)
    assert steps._last is not None and steps._last.stamp == pytest.approx(0.02)


def test_a_step_without_a_first_plan_is_answered(steps: RecedingSteps) -> None:
    """A process that replaces another one begins with a step."""
    steps._last = steps._origin = None
    reply = follow(steps, FAR, np.array([0.0, 39.2]), STAMP)
    assert reply.plain['status'] == 'optimal'


def test_a_first_plan_that_exceeds_a_limit_is_refused(steps: RecedingSteps) -> None:
    """The limit is named with its excess."""
    x = FAR + np.array([0.0, 0.0, 0.0, 0.9, 0.0, 0.0])
    with pytest.raises(DynamicsError, match='vx is exceeded by 0.5'):
        steps.answer(Packet({'kind': 'first'}, {'x': x}))


def test_a_moving_set_point_begins_at_the_plant(moving: RecedingSteps) -> None:
    """The vehicle goes back to its lane within the bounds, wherever on the road it begins."""
    x, u = np.array([5000.0, 1.5, 0.0]), np.array([10.0, 0.0])
    first = moving.answer(Packet({'kind': 'first'}, {'x': x}))
    np.testing.assert_allclose(first.arrays['x'][0], x, atol=1e-9)
    x[0] += 3.0   # it drives on between the first plan and the first step
    states, inputs = [x], []
    for k in range(300):
        reply = follow(moving, x, u, STAMP + k * PERIOD)
        assert reply.plain['status'] == 'optimal'
        x, u = reply.arrays['x'][0], reply.arrays['u'][0]
        states.append(x)
        inputs.append(u)
    path, held = np.array(states), np.array(inputs)
    assert np.abs(path[:, 2]).max() <= 0.15 + 1e-6 and np.abs(held[:, 1]).max() <= 0.1
    assert np.abs(path[-1, 1:]).max() < 0.02
    np.testing.assert_allclose(held[-1], [10.0, 0.0], atol=0.02)
    # The set point has moved at 10 m/s from where the vehicle was at the first step.
    assert path[-1, 0] == pytest.approx(5003.0 + 10.0 * 0.02 * 300, abs=0.2)


def test_after_a_pause_the_set_point_begins_at_the_plant_again(moving: RecedingSteps) -> None:
    """A plan that has ended says nothing of where the vehicle is now."""
    x, u = np.array([-7.0, 0.0, 0.0]), np.array([10.0, 0.0])
    for stamp, px in ((STAMP, -7.0), (STAMP + 10**11, 4.0)):
        x[0] = px
        reply = follow(moving, x, u, stamp)
        np.testing.assert_allclose(reply.arrays['u'], np.tile(u, (30, 1)), atol=1e-6)
        assert reply.arrays['x'][0] == pytest.approx([px + 0.2, 0.0, 0.0], abs=1e-6)
