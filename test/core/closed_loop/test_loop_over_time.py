# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the loop does over time: references, hand-overs, horizons, schedules, integrals."""

from dataclasses import replace
import math

from loop_bench import answers, control, K, leg, MS, Ramp, S
import numpy as np
from obc_ros.core.closed_loop.control import (
    Control,
    Horizon,
    Leg,
    Prediction,
    Reference,
    Rules,
    Schedule,
)
from obc_ros.core.closed_loop.feedback import Gains, InputLimits, ReferencePoint, StateFeedback
from obc_ros.core.closed_loop.loop import ControlLoop
import pytest

# Set points that move, references


def test_a_moving_set_point_moves_on() -> None:
    """It starts where the plant is, moves with the stamps, and changes of the gain leave it."""
    moving = control(u=10.0, drift=(10.0, 0.0), gain=((1.0, 0.0),))
    loop = ControlLoop(moving)
    assert answers(loop, (100.0, [500.0, 0.0]), (100.5, [505.0, 0.0]), (101.0, [509.0, 0.0])) == [
        [10.0], [10.0], [11.0]]
    loop.adopt(replace(moving, regulator=replace(moving.regulator, K=((2.0, 0.0),))))
    assert answers(loop, (101.0, [509.0, 0.0]), (102.0, [520.0, 0.0])) == [[12.0], [10.0]]
    faster = StateFeedback((0.0, 0.0), (20.0,), ((1.0, 0.0),), (20.0, 0.0))
    loop.adopt(replace(moving, regulator=faster))
    assert answers(loop, (102.0, [520.0, 0.0]), (103.0, [540.0, 0.0])) == [[20.0], [20.0]]
    loop.adopt(replace(moving, regulator=replace(faster, x=(600.0, 0.0))))
    assert answers(loop, (103.0, [540.0, 0.0])) == [[80.0]]  # what was asked for


def test_a_moving_set_point_does_not_run_away() -> None:
    """After a stop it goes on from where the plant is."""
    loop = ControlLoop(control(u=10.0, drift=(10.0, 0.0), rest=(0.0,)))
    answers(loop, (0.0, [0.0, 0.0]), (1.0, [10.0, 0.0]))
    loop.stop('by test')
    assert answers(loop, (2.0, [12.0, 0.0]), (50.0, [12.0, 0.0])) == [[0.0], [0.0]]
    loop.start()
    assert answers(loop, (51.0, [12.0, 0.0]), (52.0, [22.0, 0.0])) == [[10.0], [10.0]]


def test_a_reference_is_followed_to_its_end() -> None:
    """Before it the set point, along it the reference, after it its end; without a state none."""
    still = control()
    loop = ControlLoop(still)
    answers(loop, (9.0, [0.0, 0.0]))
    loop.adopt(replace(still, legs=(leg(10 * S),)))
    given = answers(loop, (9.5, [0.0, 0.0]), (10.0, [0.0, 1.0]), (11.0, [0.5, 1.0]),
                    (12.0, [2.0, 0.0]), (20.0, [2.0, 0.0]))
    assert given == [[0.0], [0.0], [0.5], [0.5], [0.5]]


def test_a_reference_can_begin_in_the_middle() -> None:
    """A stamp in the past joins the reference where it is now."""
    loop = ControlLoop(control(legs=(leg(10 * S),)))
    assert answers(loop, (11.5, [1.5, 1.0])) == [[0.0]]


def test_a_reference_without_stamp_begins_at_once() -> None:
    """At the first state after it; a change of the gain leaves its beginning."""
    still = control()
    loop = ControlLoop(still)
    answers(loop, (5.0, [0.0, 0.0]))
    following = replace(still, legs=(leg(None),))
    loop.adopt(following)
    assert answers(loop, (6.0, [0.0, 1.0]), (7.0, [1.0, 1.0])) == [[0.0], [0.0]]
    loop.adopt(replace(following))
    assert answers(loop, (7.5, [1.5, 1.0])) == [[0.0]]


def test_a_reference_that_came_before_the_loop_begins_with_it() -> None:
    """As one that an inactive node was given, without a stamp."""
    loop = ControlLoop(control(legs=(leg(None),)))
    assert answers(loop, (6.0, [0.0, 1.0]), (7.0, [1.0, 1.0]), (9.0, [2.0, 0.0])) == [
        [0.0], [0.0], [0.5]]


def test_a_reference_is_replaced_when_the_next_begins() -> None:
    """Until then the one before is followed."""
    first, second = leg(10 * S), leg(11 * S)
    loop = ControlLoop(control(legs=(first, second)))
    assert answers(loop, (10.5, [0.5, 1.0]), (11.0, [0.0, 1.0])) == [[0.0], [0.0]]


# Changes without a jump


def test_transition_is_smooth() -> None:
    """The command goes on from where it was, and ends at the new law."""
    rules = Rules(transition_time=1.0)
    loop = ControlLoop(control(rules=rules))
    assert answers(loop, (0.0, [1.0, 0.0])) == [[-1.0]]
    loop.adopt(control(gain=((5.0, 0.0),), rules=rules))
    times = np.linspace(0.0, 1.2, 121)
    u = np.array([loop.answer(round(t * S), [1.0, 0.0], t) for t in times]).ravel()
    assert u[0] == -1.0
    assert (u[times >= 1.0] == -5.0).all()
    assert (np.diff(u) <= 0.0).all()
    assert np.abs(np.diff(u)).max() < 4.0 * 1.5 * 0.01 * 1.01
    assert u[50] == pytest.approx(-3.0)


def test_transition_in_a_transition() -> None:
    """A further change goes on from the command as it is."""
    rules = Rules(transition_time=1.0)
    loop = ControlLoop(control(rules=rules))
    answers(loop, (0.0, [1.0, 0.0]))
    loop.adopt(control(gain=((5.0, 0.0),), rules=rules))
    half = answers(loop, (0.0, [1.0, 0.0]), (0.5, [1.0, 0.0]))[-1]
    loop.adopt(control(gain=((-5.0, 0.0),), rules=rules))
    assert answers(loop, (0.5, [1.0, 0.0])) == [half]
    assert answers(loop, (1.5, [1.0, 0.0])) == [[5.0]]


def test_transition_after_a_stop() -> None:
    """The law takes over from the input at rest."""
    loop = ControlLoop(control(rest=(0.3,), rules=Rules(transition_time=1.0)))
    answers(loop, (0.0, [1.0, 0.0]))
    loop.stop('by test')
    answers(loop, (1.0, [1.0, 0.0]))
    loop.start()
    assert answers(loop, (2.0, [1.0, 0.0]), (3.0, [1.0, 0.0])) == [[pytest.approx(0.3)], [-1.0]]


def test_preview_is_the_jump() -> None:
    """What a change would do to the command is known before, and nothing is changed by asking."""
    loop = ControlLoop(control())
    wanted = control(gain=((5.0, 0.0),), x=(0.5, 0.0), u=1.0)
    assert loop.preview(wanted) is None
    before = answers(loop, (0.0, [1.0, 0.0]))[0]
    jump = loop.preview(wanted)
    assert answers(loop, (0.0, [1.0, 0.0])) == [before]
    loop.adopt(wanted)
    after = answers(loop, (0.0, [1.0, 0.0]))[0]
    assert before
    assert after
    assert jump == [after[0] - before[0]] == [-0.5]


class Still:
    """The reference px = 5, with a gain of its own."""

    def at(self, t: float) -> ReferencePoint:
        """Return it."""
        return ReferencePoint((5.0, 0.0), (0.0,), ((3.0, 0.0),))


@pytest.mark.parametrize('delay', [0, 200 * MS])
def test_hand_overs_between_references_are_smooth(delay: int) -> None:
    """Where a reference begins, gives way to another and ends, the command does not jump."""
    rules = Rules(transition_time=0.5)
    legs = (Leg(Reference(1 * S, 4.0), Ramp(), StateFeedback((4.0, 0.0), (0.5,), K, (0.0, 0.0))),
            Leg(Reference(3 * S, 2.0), Still(), StateFeedback((5.0, 0.0), (2.0,), K, (0.0, 0.0))))
    moves = ((1.0, delay / S), (0.0, 1.0))
    prediction = Prediction(moves, (((0.0,), (0.0,)),) * 2, 100 * MS, delay) if delay else None
    times, dt = np.arange(0.0, 7.0, 0.01), 0.01
    u = {}
    for smooth in (True, False):
        loop = ControlLoop(
            control(rules=rules if smooth else Rules(), legs=legs, prediction=prediction))
        u[smooth] = np.array([loop.answer(round(t * S), [1.0, 0.0], t) for t in times]).ravel()
    jumps = np.abs(np.diff(u[False]))
    at = np.array([1.0, 3.0, 5.0]) - delay * 1e-9
    assert sorted(times[1:][jumps > 0.5]) == pytest.approx(at)
    assert np.abs(np.diff(u[True])).max() < 1.5 * jumps.max() * dt / 0.5 + 1.1 * dt
    settled = np.all(np.abs(times[:, None] - (at + 0.25)) > 0.26, axis=1)
    np.testing.assert_allclose(u[True][settled], u[False][settled], atol=1e-12)


# A horizon


def within(time: float, K: float = 10.0, **options: object) -> Control:
    """Return a control that reaches its set point within a time: a gain that grows, and a rest."""
    gains = Gains((0.0, time, time + 0.1), (((0.0, 0.0),), ((K, 0.0),), ((1.0, 2.0),)), ((),) * 3)
    return control(horizon=Horizon(time, gains), **options)


def test_a_horizon_begins_with_the_law() -> None:
    """Its gain follows the time since the first state, and ends in the steady one."""
    loop = ControlLoop(within(2.0))
    given = answers(loop, *((t, [1.0, 0.0]) for t in (7.0, 8.0, 9.0, 9.05, 9.1, 20.0)))
    np.testing.assert_allclose(np.ravel(given), [0.0, -5.0, -10.0, -5.5, -1.0, -1.0])


def test_a_horizon_goes_on_through_changes_of_the_weights() -> None:
    """Only another set point or horizon begins it anew; so does a start after a stop."""
    loop = ControlLoop(within(2.0))
    answers(loop, (0.0, [1.0, 0.0]))
    loop.adopt(within(2.0, K=20.0))
    assert answers(loop, (1.0, [1.0, 0.0])) == [[-10.0]]
    loop.adopt(within(2.0, K=20.0, x=(1.0, 0.0)))
    assert answers(loop, (1.5, [2.0, 0.0]), (2.5, [2.0, 0.0])) == [[0.0], [-10.0]]
    loop.adopt(within(4.0, K=20.0, x=(1.0, 0.0)))
    assert answers(loop, (3.0, [2.0, 0.0]), (4.0, [2.0, 0.0])) == [[0.0], [-5.0]]
    assert loop.preview(control(x=(1.0, 0.0))) == [5.0 - 1.0]
    loop.stop('by test')
    answers(loop, (5.0, [2.0, 0.0]))
    loop.start()
    assert answers(loop, (6.0, [2.0, 0.0]), (7.0, [2.0, 0.0])) == [[0.0], [-5.0]]


def test_a_horizon_and_a_delay() -> None:
    """The gain is that of the time at which the command acts."""
    prediction = Prediction(((1.0, 0.0), (0.0, 1.0)), (((0.0,), (0.0,)),), S, S)
    loop = ControlLoop(within(2.0, prediction=prediction))
    assert answers(loop, (7.0, [1.0, 0.0]), (8.0, [1.0, 0.0])) == [[-5.0], [-10.0]]


def test_a_horizon_of_a_set_point_that_moves() -> None:
    """It moves on from where the plant was when the law began, whatever changes meanwhile."""
    moving = within(2.0, u=10.0, drift=(10.0, 0.0))
    loop = ControlLoop(moving)
    assert answers(loop, (100.0, [500.0, 0.0]), (101.0, [511.0, 0.0])) == [[10.0], [5.0]]
    loop.adopt(within(2.0, K=20.0, u=10.0, drift=(10.0, 0.0)))
    assert answers(loop, (101.0, [511.0, 0.0]), (102.0, [521.0, 0.0])) == [[0.0], [-10.0]]


# A schedule


def test_gains_follow_what_is_measured_or_was_commanded() -> None:
    """Between the grid straight, beyond it the nearest; before the first answer the set point."""
    gains = Gains((1.0, 3.0), (((10.0, 0.0),), ((30.0, 0.0),)), ((),) * 2)
    loop = ControlLoop(control(schedule=Schedule(gains, -1)))
    speeds = (0.0, 1.0, 2.0, 3.0, 99.0)
    given = [loop.answer(k, [1.0, 0.0], 0.0, None, v) for k, v in enumerate(speeds)]
    assert given == [[-10.0], [-10.0], [-20.0], [-30.0], [-30.0]]
    assert loop.answer(9, [1.0, 0.0], 0.0, None, math.nan) is None
    assert loop.counts['finite'] == 1
    loop = ControlLoop(control(u=2.0, schedule=Schedule(gains, 0)))
    assert answers(loop, (0.0, [-0.01, 0.0]), (0.1, [-0.01, 0.0])) == [
        [pytest.approx(2.2)], [pytest.approx(2.22)]]


def test_a_schedule_and_a_reference() -> None:
    """What is measured counts along a reference, too; there an input has its gain in time."""
    gains = Gains((1.0, 3.0), (((10.0, 0.0),), ((30.0, 0.0),)), ((),) * 2)
    for index, wanted in ((-1, -20.0), (0, -1.0)):
        loop = ControlLoop(control(schedule=Schedule(gains, index), legs=(leg(0),)))
        assert loop.answer(1 * S, [2.0, 1.0], 0.0, None, 2.0) == [wanted]


# Integral action


def test_integral_removes_a_constant_error() -> None:
    """A pushed double integrator comes to rest at the set point only with integral action."""
    def final_error(**integral: object) -> float:
        loop = ControlLoop(control(gain=((6.0, 4.0),), **integral))
        x, v, dt = 0.0, 0.0, 0.01
        for k in range(4_000):
            u = loop.answer(round(k * dt * S), [x, v], k * dt)
            assert u is not None
            acceleration = u[0] + 1.0
            x, v = x + v * dt + acceleration * dt**2 / 2, v + acceleration * dt
        return abs(x)

    assert final_error() == pytest.approx(1 / 6, rel=1e-3)
    assert final_error(C=((1.0, 0.0),), Ki=((3.0,),)) < 1e-6


def test_integral_is_the_trapezoidal_rule() -> None:
    """dz/dt = C (x - xr)."""
    loop = ControlLoop(control(gain=((0.0, 0.0),), C=((2.0, 0.0),), Ki=((1.0,),)))
    t = np.linspace(0.0, 0.4, 41)
    u = [loop.answer(round(s * S), [s, 0.0], s) for s in t]
    np.testing.assert_allclose(np.ravel(u), -t**2, atol=1e-12)  # exact for a straight line


@pytest.mark.parametrize('push', [1.0, -1.0])
def test_anti_windup(push: float) -> None:
    """While the input is at its limit, the integral does not grow what cannot be given."""
    loop = ControlLoop(control(gain=((1.0, 0.0),), limits=((-2.0,), (2.0,)),
                               C=((1.0, 0.0),), Ki=((1.0,),)))
    for k in range(1_000):
        u = loop.answer(k * 10 * MS, [push * 3.0, 0.0], k * 0.01)
    assert u == [-2.0 * push]
    # the error changes its sign: the input leaves the limit at once
    u = loop.answer(10_000 * MS, [-push * 0.5, 0.0], 10.0)
    assert u is not None
    assert u[0] * push > 0.4


def test_nothing_is_integrated_over_a_gap() -> None:
    """Nobody knows what the plant did while no state came."""
    loop = ControlLoop(control(gain=((0.0, 0.0),), C=((1.0, 0.0),), Ki=((1.0,),)))
    given = answers(loop, (0.0, [1.0, 0.0]), (0.1, [1.0, 0.0]), (9.1, [1.0, 0.0]))
    np.testing.assert_allclose(given, [[0.0], [-0.1], [-0.1]], atol=1e-15)


def test_a_gain_that_changes_leaves_what_was_learned() -> None:
    """With a constant push the error stays 0 while the gains, that of the integral too, change."""
    loop = ControlLoop(control(gain=((6.0, 4.0),), C=((1.0, 0.0),), Ki=((3.0,),)))
    x, v, dt, worst = 0.0, 0.0, 0.01, 0.0
    for k in range(8_000):
        u = loop.answer(round(k * dt * S), [x, v], k * dt)
        assert u is not None
        acceleration = u[0] + 1.0
        x, v = x + v * dt + acceleration * dt**2 / 2, v + acceleration * dt
        if k >= 4_000:
            worst = max(worst, abs(x))
            s = 1.0 + 0.5 * math.sin(k * dt)
            loop.adopt(control(gain=((6.0 * s, 4.0 * s),), C=((1.0, 0.0),), Ki=((3.0 * s * s,),)))
    assert worst < 1e-6  # -Ki z in place of -w would leave 0.1


# Prediction over a delay


def test_prediction_is_the_simulation() -> None:
    """What the law sees is the state in two periods, given the commands on their way."""
    a, b, dt = 0.9, 0.5, 0.1  # x+ = a x + b u, u acts two periods later
    prediction = Prediction(((a * a,),), (((b,),), ((a * b,),)), round(dt * S), 2 * round(dt * S))
    regulator = StateFeedback((0.2,), (0.02 / 0.5,), ((1.0,),), (0.0,))  # 0.2 = a 0.2 + b ue
    loop = ControlLoop(Control(regulator, InputLimits((-9.0,), (9.0,)), (0.0,), ('x',),
                               prediction=prediction))
    x, sent = [1.0], [0.04, 0.04]
    for k in range(20):
        u = loop.answer(round(k * dt * S), [x[-1]], k * dt)
        assert u is not None
        ahead = a * (a * x[-1] + b * sent[-2]) + b * sent[-1]
        if k >= 2:  # before, the loop does not know what was on its way
            assert u[0] == pytest.approx(0.04 - (ahead - 0.2), abs=1e-12)
        sent.append(u[0])
        x.append(a * x[-1] + b * sent[-3])
