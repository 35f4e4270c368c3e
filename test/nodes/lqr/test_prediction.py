# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Predictions of lqr_node: a forked loop on the model is where the loop itself will be."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.closed_loop.modes import Mode
from obc_ros.core.lqr.design.reference_tracking import read_course
from obc_ros.core.text.errors import StatementError
from obc_ros.nodes.lqr.prediction import explain_idleness, explain_miss, foresee
from obc_ros.nodes.lqr.settings import judge_lqr_settings, LqrCandidate, Settings
import pytest
from scipy.linalg import expm

Array = NDArray[np.float64]

PERIOD = 20_000_000   # [ns]
A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
WHOLE = expm(np.block([[A, B], [np.zeros((1, 3))]]) * PERIOD * 1e-9)
PLANT = {'system': 'double_integrator', 'state_timeout': 0.5}


class Run:
    """A loop on the exactly sampled double integrator; a command acts `delay` periods later."""

    def __init__(self, candidate: LqrCandidate, x: tuple[float, float], delay: int = 0) -> None:
        self.candidate, self.x, self.k = candidate, np.array(x), 0
        self.loop = ControlLoop(candidate.control)
        self.last = [0.0]
        self.waiting = [self.last] * delay

    @property
    def stamp(self) -> int:
        """Return the stamp of the next state [ns]."""
        return 10**9 + self.k * PERIOD

    def take(self, steps: int) -> Array:
        """Answer that many states; return the next state."""
        for _ in range(steps):
            u = self.loop.answer(self.stamp, self.x.tolist(), self.stamp * 1e-9)
            self.last = u or self.last   # without a command the last one acts on
            self.waiting.append(self.last)
            self.x = WHOLE[:2, :2] @ self.x + WHOLE[:2, 2:] @ np.array(self.waiting.pop(0))
            self.k += 1
        return self.x


def follow(candidate: LqrCandidate, begin: int) -> LqrCandidate:
    """Return the candidate with a reference: x1 = 1 - cos(t) for half a turn."""
    t = np.linspace(0.0, np.pi, 401)
    course = read_course(
        candidate.design.plant.system, ((), ()), t.tolist(),
        np.column_stack([1 - np.cos(t), np.sin(t)]).ravel().tolist(), np.cos(t).tolist(), '',
        begin)
    return judge_lqr_settings(candidate.settings, (course,))


@pytest.mark.parametrize(('changes', 'delay'), [
    ({}, 0), ({'transition_time': 1.0}, 0), ({'u_limits': [-0.3, 0.3]}, 0),
    ({'integral': ('x1',)}, 0), ({'delay': 0.06, 'rate': 50.0}, 3), ({'horizon': 1.5}, 0),
    ({'rate': 12.5}, 0), ({'x_limits': [-0.4, 0.4, -9.0, 9.0], 'on_envelope': 'equilibrium'}, 0)])
@pytest.mark.parametrize('has_reference', [False, True])
def test_the_prediction_is_where_the_loop_will_be(
        changes: dict[str, Any], delay: int, has_reference: bool) -> None:
    """The reference begins before the fork and ends before the stamp of the prediction."""
    candidate = judge_lqr_settings(Settings(**PLANT, **changes))
    if has_reference:
        candidate = follow(candidate, 10**9 + 3 * PERIOD)
    run = Run(candidate, (0.3 if not has_reference else 0.01, 0.0), delay)
    run.take(50)
    counts, stamp = dict(run.loop.counts), run.stamp + 149 * PERIOD
    found = foresee(run.loop, candidate, stamp)
    assert dict(run.loop.counts) == counts   # the loop has not noticed
    expected = run.take(149)
    assert found.x == pytest.approx(expected, abs=1e-7)
    assert found.stamp == stamp


def test_a_moving_plant_does_not_rest_and_a_held_one_does() -> None:
    """On the reference it moves; at a set point that moves it does, too."""
    settings = Settings(**PLANT)
    run = Run(follow(judge_lqr_settings(settings), 10**9), (0.0, 0.0))
    run.take(20)
    assert not foresee(run.loop, run.candidate, run.stamp + 10 * PERIOD).at_rest
    assert foresee(run.loop, run.candidate, run.stamp + 500 * PERIOD).at_rest
    moving = judge_lqr_settings(Settings(
        system='vehicle', setpoint=(0.0, 0.0, 0.0), setpoint_input=(1.0, 0.0),
        state_timeout=0.5))
    loop = ControlLoop(moving.control)
    for k in range(5):
        loop.answer(k * PERIOD, [k * PERIOD * 1e-9, 0.0, 0.0], k * PERIOD * 1e-9)
    found = foresee(loop, moving, 4 * PERIOD + 10**9)
    assert not found.at_rest
    assert found.x == pytest.approx([1.08, 0.0, 0.0], abs=1e-6)
    run.loop.stop('by ~/stop')
    assert explain_idleness(run.loop) == 'the loop is stopped: by ~/stop'


def test_what_a_prediction_lacks_is_said_in_words() -> None:
    candidate = judge_lqr_settings(Settings(**PLANT))
    for loop, words in ((ControlLoop(candidate.control, Mode.INACTIVE), 'inactive'),
                        (ControlLoop(candidate.control), 'no state has arrived')):
        with pytest.raises(StatementError, match=words):
            foresee(loop, candidate, 0)
    run = Run(candidate, (0.1, 0.0))
    run.take(2)
    with pytest.raises(StatementError, match='fewer than four states'):
        foresee(run.loop, candidate, run.stamp)
    run.take(5)
    last = run.stamp - PERIOD
    assert foresee(run.loop, candidate, 0).stamp == last
    with pytest.raises(StatementError, match='after the last state'):
        foresee(run.loop, candidate, 2**62)
    run.loop.overdue(last * 1e-9 + 9.0)
    with pytest.raises(StatementError, match='no recent state'):
        foresee(run.loop, candidate, last)


def test_a_reference_is_judged_where_the_plant_will_be() -> None:
    """Its start is met at its stamp only: the plant moves from 1 to 0 until then."""
    candidate = judge_lqr_settings(replace(Settings(**PLANT), start_tolerance=(0.01, 0.01)))
    run = Run(candidate, (1.0, 0.0))
    run.take(20)
    begin = run.stamp + 30 * PERIOD
    x = np.array(foresee(run.loop, candidate, begin).x)

    def offered(start: Array) -> LqrCandidate:
        t = np.linspace(0.0, 1.0, 101)
        path = np.column_stack([start[0] + start[1] * t, start[1] + 0 * t])
        return judge_lqr_settings(candidate.settings, (read_course(
            candidate.design.plant.system, ((), ()), t.tolist(), path.ravel().tolist(),
            [0.0] * 101, '', begin),))

    assert not explain_miss(run.loop, offered(x))
    words = explain_miss(run.loop, offered(x + [0.0100001, 0.0]))
    assert words.startswith("x1 is 0.0100001 m from the plan's start "), words
    assert words.endswith('allowed 0.01 m')
    assert 'x1 is' in explain_miss(run.loop, offered(run.x))   # where it is now
