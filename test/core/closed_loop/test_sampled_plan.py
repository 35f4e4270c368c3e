# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plans at equal instants as references, and the region of a feedback."""

from dataclasses import replace

from hypothesis import given, strategies
import numpy as np
from obc_ros.core.closed_loop.control import Control, Rules
from obc_ros.core.closed_loop.feedback import convert_rows, InputLimits, Region, StateFeedback
from obc_ros.core.closed_loop.laws import PlanLaw
from obc_ros.core.closed_loop.loop import ControlLoop
import pytest

PERIOD = 20_000_000   # [ns]
X, U = np.array([[0.0], [1.0], [3.0], [4.0]]), np.array([[10.0], [20.0], [30.0]])
PLAN = PlanLaw(-PERIOD // 2, PERIOD, convert_rows(X), convert_rows(U), ((2.0,),))


@given(k=strategies.integers(0, 2), jitter=strategies.floats(-0.49, 0.49))
def test_a_stamp_selects_the_nearest_sample(k, jitter):
    point = PLAN.at(round((k + jitter) * PERIOD))
    assert point.u == (U[k, 0],)
    states = np.interp(k + jitter, range(4), X[:, 0])
    if k + jitter >= 0.0:
        assert point.x[0] == pytest.approx(states, abs=1e-7)   # stamps are in ns


def test_before_and_after_its_samples_a_plan_goes_on_in_a_line_and_rests():
    assert PLAN.at(PLAN.begin).x[0] == pytest.approx(-0.5)
    assert PLAN.at(450 * PERIOD).x == (4.0,)
    assert PLAN.at(450 * PERIOD).u == (30.0,)


def make_control(level):
    """Return u = -x within x'x <= level."""
    regulator = StateFeedback((0.0,), (0.0,), ((1.0,),), (0.0,), region=Region(((1.0,),), level))
    return Control(regulator, InputLimits((-50.0,), (50.0,)), rest=(7.0,), names=('x',),
                   rules=Rules(on_stale='equilibrium'))


@pytest.mark.parametrize(('action', 'outside'), [('equilibrium', 7.0), ('regulator', -3.0)])
def test_a_plan_then_the_feedback_in_its_region_then_the_rule(action, outside):
    control = make_control(4.0)
    loop = ControlLoop(replace(control, rules=Rules(on_unplanned=action)))
    assert loop.add_plan(PLAN, 0)
    given = [0.1, 1.0, 3.5, 1.5, 3.0, 1.0]
    sent = [loop.answer(k * PERIOD, (x,), 0.02 * k)[0] for k, x in enumerate(given)]
    along = [U[k, 0] - 2.0 * (given[k] - X[k, 0]) for k in range(3)]
    assert sent == pytest.approx([*along, -1.5, outside, -1.0])
    assert loop.counts['unplanned'] == 1
    assert 'outside the terminal set (its value is 9, the level 4)' in loop.news[-1]
    assert loop.events[1] == 'the plan is followed'
    assert loop.events[-1] == 'the state can be controlled again' or action == 'equilibrium'


def test_without_a_region_the_feedback_is_used_everywhere():
    control = make_control(1.0)
    loop = ControlLoop(replace(control, regulator=replace(control.regulator, region=None)))
    assert loop.answer(0, (30.0,), 0.0) == [-30.0]
