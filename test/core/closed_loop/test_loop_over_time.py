# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The control loop over time: references, transitions, horizons, schedules, integrals, delays."""

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

# Moving set points and references


def test_a_moving_set_point_starts_at_the_plant() -> None:
    """It starts at the plant, moves with the stamps, and continues when only the gain changes."""
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
    assert answers(loop, (103.0, [540.0, 0.0])) == [[20.0]]  # another one begins at the plant


@pytest.mark.parametrize('begin', [lambda loop: None, lambda loop: (
    answers(loop, (0.0, [0.0, 0.0])), loop.stop('by test'), loop.start())])
def test_a_set_point_changed_before_the_law_begins_is_where_it_was_given(begin) -> None:
    """Until the law begins, the set point has not moved: a new lane is not ahead of the plant."""
    rules = Rules(state_timeout=0.0)
    loop = ControlLoop(control(u=1.0, drift=(1.0, 0.0), gain=((1.0, 1.0),), rules=rules))
    begin(loop)
    loop.adopt(control(u=1.0, drift=(0.0, 1.0), gain=((1.0, 1.0),), rules=rules))
    assert answers(loop, (1e9, [0.25, 7.0])) == [[0.75]]   # 0.25 beside the lane px = 0


def test_a_set_point_changed_while_the_law_rests_is_where_it_was_given() -> None:
    """The new lane runs through the point of the parameters."""
    loop = ControlLoop(control(u=1.0, drift=(1.0, 0.0), gain=((1.0, 1.0),)))
    answers(loop, (0.0, [0.0, 0.0]))
    loop.overdue(0.5)
    loop.adopt(control(u=1.0, drift=(0.0, 1.0), gain=((1.0, 1.0),)))
    assert answers(loop, (60.0, [0.25, 7.0])) == [[0.75]]


def test_a_moving_set_point_restarts_at_the_plant_after_a_stop() -> None:
    """The set point does not move while the loop is stopped."""
    loop = ControlLoop(control(u=10.0, drift=(10.0, 0.0), rest=(0.0,)))
    answers(loop, (0.0, [0.0, 0.0]), (1.0, [10.0, 0.0]))
    loop.stop('by test')
    assert answers(loop, (2.0, [12.0, 0.0]), (50.0, [12.0, 0.0])) == [[0.0], [0.0]]
    loop.start()
    assert answers(loop, (51.0, [12.0, 0.0]), (52.0, [22.0, 0.0])) == [[10.0], [10.0]]


def test_a_reference_is_followed_and_its_end_is_held() -> None:
    """The set point applies before the reference, its last sample after it."""
    still = control()
    loop = ControlLoop(still)
    answers(loop, (9.0, [0.0, 0.0]))
    loop.adopt(replace(still, legs=(leg(10 * S),)))
    given = answers(loop, (9.5, [0.0, 0.0]), (10.0, [0.0, 1.0]), (11.0, [0.5, 1.0]),
                    (12.0, [2.0, 0.0]), (20.0, [2.0, 0.0]))
    assert given == [[0.0], [0.0], [0.5], [0.5], [0.5]]


def test_a_reference_stamped_in_the_past_is_joined_midway() -> None:
    """The reference is joined at the point of the present time."""
    loop = ControlLoop(control(legs=(leg(10 * S),)))
    assert answers(loop, (11.5, [1.5, 1.0])) == [[0.0]]


def test_a_reference_without_stamp_begins_at_the_next_state() -> None:
    """A later change of the gain does not move its beginning."""
    still = control()
    loop = ControlLoop(still)
    answers(loop, (5.0, [0.0, 0.0]))
    following = replace(still, legs=(leg(None),))
    loop.adopt(following)
    assert answers(loop, (6.0, [0.0, 1.0]), (7.0, [1.0, 1.0])) == [[0.0], [0.0]]
    loop.adopt(replace(following))
    assert answers(loop, (7.5, [1.5, 1.0])) == [[0.0]]


def test_a_reference_given_before_the_loop_begins_with_it() -> None:
    """An inactive node may receive an unstamped reference; it begins at the first state."""
    loop = ControlLoop(control(legs=(leg(None),)))
    assert answers(loop, (6.0, [0.0, 1.0]), (7.0, [1.0, 1.0]), (9.0, [2.0, 0.0])) == [
        [0.0], [0.0], [0.5]]


def test_a_reference_is_followed_until_the_next_begins() -> None:
    """The second reference replaces the first at its own beginning."""
    first, second = leg(10 * S), leg(11 * S)
    loop = ControlLoop(control(legs=(first, second)))
    assert answers(loop, (10.5, [0.5, 1.0]), (11.0, [0.0, 1.0])) == [[0.0], [0.0]]


def test_a_withdrawn_reference_never_begins_again() -> None:
    """A reference that has ended or was withdrawn stays over, also if it is given once more."""
    still, once = control(), leg(0)
    following = replace(still, legs=(once,))
    loop = ControlLoop(following)
    answers(loop, (0.0, [0.0, 1.0]), (0.4, [0.4, 1.0]))
    loop.adopt(still)
    answers(loop, (0.5, [0.5, 1.0]))
    loop.adopt(following)
    assert answers(loop, (0.6, [0.6, 1.0])) == [[-2.6]]
    assert loop.reference is None


# Transitions without a jump


def test_a_transition_is_smooth_and_ends_at_the_new_law() -> None:
    """The command starts at its previous value and ends at that of the new control law."""
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


def test_a_second_change_during_a_transition_is_smooth() -> None:
    """A second change starts from the present command."""
    rules = Rules(transition_time=1.0, state_timeout=5.0)
    loop = ControlLoop(control(rules=rules))
    answers(loop, (0.0, [1.0, 0.0]))
    loop.adopt(control(gain=((5.0, 0.0),), rules=rules))
    half = answers(loop, (0.0, [1.0, 0.0]), (0.5, [1.0, 0.0]))[-1]
    loop.adopt(control(gain=((-5.0, 0.0),), rules=rules))
    assert answers(loop, (0.5, [1.0, 0.0])) == [half]
    assert answers(loop, (1.5, [1.0, 0.0])) == [[5.0]]


def test_a_transition_after_a_stop_begins_at_the_rest_input() -> None:
    """After a start the command moves from the input at rest to the control law."""
    loop = ControlLoop(control(
        rest=(0.3,), rules=Rules(transition_time=1.0, state_timeout=5.0)))
    answers(loop, (0.0, [1.0, 0.0]))
    loop.stop('by test')
    answers(loop, (1.0, [1.0, 0.0]))
    loop.start()
    assert answers(loop, (2.0, [1.0, 0.0]), (3.0, [1.0, 0.0])) == [[pytest.approx(0.3)], [-1.0]]


@pytest.mark.parametrize('time', [0.0, 0.5, 9.0])
def test_a_transition_keeps_its_own_time(time: float) -> None:
    """A change of transition_time during a transition does not let the command jump."""
    loop = ControlLoop(control(rules=Rules(transition_time=1.0)))
    answers(loop, (0.0, [1.0, 0.0]))
    loop.adopt(control(gain=((5.0, 0.0),), rules=Rules(transition_time=1.0)))
    half = answers(loop, (0.0, [1.0, 0.0]), (0.4, [1.0, 0.0]))[-1]
    loop.adopt(control(gain=((5.0, 0.0),), rules=Rules(transition_time=time)))
    assert answers(loop, (0.4, [1.0, 0.0]), (0.8, [1.0, 0.0]), (1.0, [1.0, 0.0])) == [
        half, [pytest.approx(-5.0 + 4.0 * (1.0 - 0.64 * 1.4))], [-5.0]]


def test_a_command_that_is_not_finite_leaves_nothing_behind() -> None:
    """The next state begins the law: with a transition from the input at rest, integral at 0."""
    loop = ControlLoop(control(
        gain=((10.0, 10.0),), rest=(0.5,), C=((1.0, 0.0),), Ki=((1e9,),),
        rules=Rules(transition_time=1.0, from_rest=True, state_timeout=5.0)))
    assert answers(loop, (0.0, [1e308, 1e308]), (0.1, [0.0, 0.0])) == [None, [0.5]]
    assert answers(loop, (0.2, [1e307, 0.0]), (1.1, [0.0, 0.0])) == [None, [0.0]]
    assert loop.counts['command'] == 2


def test_states_without_a_finite_command_are_missing_states() -> None:
    """A plant is not left with its last command for ever."""
    loop = ControlLoop(control(gain=((10.0, 10.0),), rest=(0.5,), rules=Rules(
        state_timeout=0.5, on_stale='equilibrium')))
    assert loop.answer(0, [0.1, 0.0], 0.0) == [-1.0]
    for k in range(1, 5):
        assert loop.answer(k * S // 10, [1e308, 1e308], 0.1 * k) is None
        assert loop.overdue(0.1 * k) is None
    assert loop.overdue(0.5) == [0.5]
    assert loop.x == [0.1, 0.0]


def test_preview_returns_the_jump_without_changing_the_loop() -> None:
    """`preview` returns the change of the command and leaves the loop unchanged."""
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


class ConstantReference:
    """The constant reference px = 5 with its own gain."""

    def at(self, t: float) -> ReferencePoint:
        """Return its point, which is the same at all times."""
        return ReferencePoint((5.0, 0.0), (0.0,), ((3.0, 0.0),))


@pytest.mark.parametrize('delay', [0, 200 * MS])
def test_commands_do_not_jump_where_references_change(delay: int) -> None:
    """The command is continuous where a reference begins, is replaced and ends."""
    rules = Rules(transition_time=0.5)
    legs = (Leg(Reference(1 * S, 4.0), Ramp(), StateFeedback((4.0, 0.0), (0.5,), K, (0.0, 0.0))),
            Leg(Reference(3 * S, 2.0), ConstantReference(),
                StateFeedback((5.0, 0.0), (2.0,), K, (0.0, 0.0))))
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


# Finite horizons


def within(time: float, K: float = 10.0, **options: object) -> Control:
    """Return a control with a growing gain that reaches its set point within `time`."""
    gains = Gains((0.0, time, time + 0.1), (((0.0, 0.0),), ((K, 0.0),), ((1.0, 2.0),)), ((),) * 3)
    return control(horizon=Horizon(time, gains), **options)


def test_a_horizon_starts_at_the_first_state() -> None:
    """The gain is a function of the time since the first state and ends in the steady gain."""
    loop = ControlLoop(within(2.0))
    given = answers(loop, *((t, [1.0, 0.0]) for t in (7.0, 8.0, 9.0, 9.05, 9.1, 20.0)))
    np.testing.assert_allclose(np.ravel(given), [0.0, -5.0, -10.0, -5.5, -1.0, -1.0])


def test_a_horizon_restarts_only_for_a_new_set_point_or_horizon() -> None:
    """A change of the weights does not restart it; a start after a stop does."""
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


def test_a_horizon_uses_the_gain_at_the_time_the_command_acts() -> None:
    """The delay is added to the time since the first state."""
    prediction = Prediction(((1.0, 0.0), (0.0, 1.0)), (((0.0,), (0.0,)),), S, S)
    loop = ControlLoop(within(2.0, prediction=prediction))
    assert answers(loop, (7.0, [1.0, 0.0]), (8.0, [1.0, 0.0])) == [[-5.0], [-10.0]]


def test_a_horizon_with_a_moving_set_point_keeps_its_start() -> None:
    """The set point moves from the plant's initial position; later changes leave it."""
    rules = Rules(state_timeout=5.0)
    moving = within(2.0, u=10.0, drift=(10.0, 0.0), rules=rules)
    loop = ControlLoop(moving)
    assert answers(loop, (100.0, [500.0, 0.0]), (101.0, [511.0, 0.0])) == [[10.0], [5.0]]
    loop.adopt(within(2.0, K=20.0, u=10.0, drift=(10.0, 0.0), rules=rules))
    assert answers(loop, (101.0, [511.0, 0.0]), (102.0, [521.0, 0.0])) == [[0.0], [-10.0]]


# Gain schedules


def test_scheduled_gains_are_interpolated() -> None:
    """
    Gains are linear between grid values and constant beyond them.

    A schedule of an input uses the last command, and before the first command the set point.
    """
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


def test_scheduled_gains_apply_along_a_reference() -> None:
    """A schedule of a state uses the measured value, one of an input the gain in time."""
    gains = Gains((1.0, 3.0), (((10.0, 0.0),), ((30.0, 0.0),)), ((),) * 2)
    for index, wanted in ((-1, -20.0), (0, -1.0)):
        loop = ControlLoop(control(schedule=Schedule(gains, index), legs=(leg(0),)))
        assert loop.answer(1 * S, [2.0, 1.0], 0.0, None, 2.0) == [wanted]


# Integral action


def test_integral_action_removes_a_constant_error() -> None:
    """A double integrator under a constant force settles at the set point only with it."""
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


def test_the_integral_follows_the_trapezoidal_rule() -> None:
    """Integrate dz/dt = C (x - xr) for an error that is linear in time."""
    loop = ControlLoop(control(gain=((0.0, 0.0),), C=((2.0, 0.0),), Ki=((1.0,),)))
    t = np.linspace(0.0, 0.4, 41)
    u = [loop.answer(round(s * S), [s, 0.0], s) for s in t]
    np.testing.assert_allclose(np.ravel(u), -t**2, atol=1e-12)  # exact for linear errors


@pytest.mark.parametrize('push', [1.0, -1.0])
def test_the_integral_does_not_grow_at_an_input_limit(push: float) -> None:
    """Anti-windup: while the input is saturated, the integral does not push it further."""
    loop = ControlLoop(control(gain=((1.0, 0.0),), limits=((-2.0,), (2.0,)),
                               C=((1.0, 0.0),), Ki=((1.0,),)))
    for k in range(1_000):
        u = loop.answer(k * 10 * MS, [push * 3.0, 0.0], k * 0.01)
    assert u == [-2.0 * push]
    # When the error changes its sign, the input leaves the limit at once.
    u = loop.answer(10_000 * MS, [-push * 0.5, 0.0], 10.0)
    assert u is not None
    assert u[0] * push > 0.4


def test_the_integral_is_not_advanced_over_a_gap() -> None:
    """The error is unknown while no states arrive."""
    loop = ControlLoop(control(gain=((0.0, 0.0),), C=((1.0, 0.0),), Ki=((1.0,),)))
    given = answers(loop, (0.0, [1.0, 0.0]), (0.1, [1.0, 0.0]), (9.1, [1.0, 0.0]))
    np.testing.assert_allclose(given, [[0.0], [-0.1], [-0.1]], atol=1e-15)


def test_a_change_of_gains_keeps_the_integral_contribution() -> None:
    """Under a constant force the error stays 0 while K and Ki change."""
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
    assert worst < 1e-6  # -Ki z in place of -w would leave an error of 0.1


# Prediction over a delay


def test_the_predicted_state_equals_the_simulated_one() -> None:
    """The control law uses the state two periods ahead, given the commands already sent."""
    a, b, dt = 0.9, 0.5, 0.1  # x+ = a x + b u, where u acts two periods later
    prediction = Prediction(((a * a,),), (((b,),), ((a * b,),)), round(dt * S), 2 * round(dt * S))
    regulator = StateFeedback((0.2,), (0.02 / 0.5,), ((1.0,),), (0.0,))  # rest: 0.2 = a 0.2 + b ue
    loop = ControlLoop(Control(regulator, InputLimits((-9.0,), (9.0,)), (0.0,), ('x',),
                               prediction=prediction))
    x, sent = [1.0], [0.04, 0.04]
    for k in range(20):
        u = loop.answer(round(k * dt * S), [x[-1]], k * dt)
        assert u is not None
        ahead = a * (a * x[-1] + b * sent[-2]) + b * sent[-1]
        if k >= 2:  # Before that the loop does not know the commands already sent.
            assert u[0] == pytest.approx(0.04 - (ahead - 0.2), abs=1e-12)
        sent.append(u[0])
        x.append(a * x[-1] + b * sent[-3])


def delayed(x: float = 0.0) -> Control:
    """Return a control with a delay of two periods of 100 ms: e+ = e + 0.1 v, v+ = v + 0.1 u."""
    return control(x=(x, 0.0), prediction=Prediction(
        ((1.0, 0.2), (0.0, 1.0)), (((0.005,), (0.1,)), ((0.015,), (0.1,))), 100 * MS, 200 * MS))


def test_a_repeated_state_gets_the_same_command_over_a_delay() -> None:
    """The command for a state is none of those before it."""
    states = [(k / 10, [1.0, 0.1 * k]) for k in range(6)]
    once = answers(ControlLoop(delayed()), *states)
    twice = answers(ControlLoop(delayed()), *(each for each in states for _ in range(2)))
    assert twice == [u for u in once for _ in range(2)]


@pytest.mark.parametrize('event', ['outage', 'restart', 'jump', 'stop'])
def test_after_a_discontinuity_the_prediction_begins_anew(event: str) -> None:
    """What was sent before acts no longer: the loop answers like one that begins."""
    states = [(5.0 + k / 10, [1.0, 0.0]) for k in range(4)]
    loop = ControlLoop(delayed())
    before = {'outage': 1.0, 'restart': 9.0}.get(event, 4.5)
    answers(loop, *((before + k / 10, [3.0, 0.0]) for k in range(4)))
    if event == 'stop':
        loop.stop('by test')
        loop.start()
    given = [loop.answer(round(t * S), x, t, restarts=event == 'jump') for t, x in states]
    assert given == answers(ControlLoop(delayed()), *states)


def test_a_command_still_acts_in_a_missed_period() -> None:
    """A state that is missing is predicted with the command before it, also at the next state."""
    a, b = answers(ControlLoop(delayed()), *((k / 10, [1.0, 0.0]) for k in (0, 1, 2)))[:2]
    assert a is not None
    loop = ControlLoop(delayed())
    sent = [a[0], a[0]]   # without the second state the first command acts in both periods
    ahead = 1.0 + 0.005 * sent[0] + 0.015 * sent[1], 0.1 * sum(sent)
    given = answers(loop, (0.0, [1.0, 0.0]), (0.2, [1.0, 0.0]))[-1]
    assert given == [pytest.approx(-ahead[0] - 2.0 * ahead[1])]
    assert b != given


def test_a_lane_of_another_heading_is_the_one_that_was_given() -> None:
    """However far the vehicle is, the lane runs through the point of the parameters."""
    c, s = math.cos(0.3), math.sin(0.3)
    gain = ((1.0, 0.0), (0.0, 1.0))

    def lane(drift: tuple[float, float]) -> Control:
        return Control(StateFeedback((0.0, 0.0), (0.0, 0.0), gain, drift),
                       InputLimits((-math.inf,) * 2, (math.inf,) * 2), (0.0, 0.0), ('px', 'py'))

    loop = ControlLoop(lane((10.0, 0.0)))
    for k in range(1000):
        loop.answer(k * 100 * MS, [k, 0.0], 0.1 * k)
    loop.adopt(lane((10.0 * c, 10.0 * s)))
    x = [999.0 * c - 0.4 * s, 999.0 * s + 0.4 * c]   # 0.4 m beside the lane through (0, 0)
    u = loop.answer(1000 * 100 * MS, x, 100.0)
    assert u == pytest.approx([0.4 * s, -0.4 * c])
