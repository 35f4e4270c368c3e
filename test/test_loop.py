# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The control loop without ROS: the law, and everything that a robot needs around it."""

from dataclasses import replace
import math

from hypothesis import given, settings, strategies
import numpy as np
from obc_ros.core.control import Control, Horizon, Leg, Prediction, Reference, Rules, Schedule
from obc_ros.core.loop import Loop
from obc_ros.core.regulator import feedback, Gains, Limits, Point, Regulator, rows, vector
import pytest

MS = 1_000_000
S = 1_000_000_000
FREE = (-math.inf,), (math.inf,)
K = ((1.0, 2.0),)


def control(x: tuple[float, ...] = (0.0, 0.0), u: float = 0.0, drift: tuple[float, ...] = (0, 0),
            gain: tuple[tuple[float, ...], ...] = K, limits: tuple[tuple[float], ...] = FREE,
            Ki: tuple[tuple[float, ...], ...] = (), **options: object) -> Control:
    """Return a control of a plant with two states and an input."""
    rules = options.pop('rules', Rules())
    return Control(Regulator(x, (u,), gain, drift, Ki), Limits(*limits), options.pop('rest', (u,)),
                   ('px', 'vx'), rules, **options)  # type: ignore[arg-type]


def answers(loop: Loop, *states: tuple[float, list[float]]) -> list[list[float] | None]:
    """Return the answers to states at stamps [s], each told at its stamp."""
    return [loop.answer(round(t * S), x, t) for t, x in states]


# The law


@settings(max_examples=100, deadline=None)
@given(strategies.integers(1, 6), strategies.integers(1, 3), strategies.integers(0, 2**32 - 1))
def test_law_is_the_matrix_product(n: int, m: int, seed: int) -> None:
    """U = ur - K (x - xr), within the limits."""
    rng = np.random.default_rng(seed)
    x, xr, ur, gain = (rng.normal(size=size) for size in (n, n, m, (m, n)))
    limits = Limits((-1.0,) * m, (0.5,) * m)
    e = limits.error(x.tolist(), vector(xr))
    u = feedback(Point(vector(xr), vector(ur), rows(gain)), e)
    expected = ur - gain @ (x - xr)
    np.testing.assert_allclose(u, expected, rtol=1e-13, atol=1e-13)
    clipped = limits.clip(u)
    np.testing.assert_allclose(u, np.clip(expected, -1.0, 0.5), rtol=1e-13, atol=1e-13)
    assert clipped == np.count_nonzero((expected < -1.0) | (expected > 0.5))


@given(strategies.floats(-1e6, 1e6), strategies.floats(-10.0, 10.0))
def test_angles_wrap(theta: float, wanted: float) -> None:
    """The error of an angle is the short way round, and a length does not wrap."""
    error = Limits((), (), angles=(1,)).error([theta, theta], (wanted, wanted))
    assert error[0] == theta - wanted
    assert -math.pi <= error[1] <= math.pi
    assert math.cos(error[1]) == pytest.approx(math.cos(theta - wanted), abs=1e-9)
    assert math.sin(error[1]) == pytest.approx(math.sin(theta - wanted), abs=1e-9)


def test_answers_a_state() -> None:
    """The plain case."""
    loop = Loop(control(x=(1.0, 0.0), u=3.0))
    assert loop.answer(5, [2.0, 0.5], 0.0) == [3.0 - 1.0 - 1.0]
    assert loop.counts == {'answered': 1, 'saturated': 0}
    assert loop.error == [1.0, 0.5] and loop.command == [1.0]


def test_clips_and_counts() -> None:
    """A clipped input is at its limit and counted."""
    loop = Loop(control(limits=((-1.0,), (0.5,))))
    assert answers(loop, (0, [9.0, 0.0]), (1, [-9.0, 0.0]), (2, [0.1, 0.0])) == [
        [-1.0], [0.5], [-0.1]]
    assert loop.counts['saturated'] == 2


# What comes in


@pytest.mark.parametrize(('x', 'kind', 'words'), [
    ([1.0], 'size', 'a state with 1 numbers was dropped: wanted 2 (px, vx)'),
    ([1.0, 2.0, 3.0], 'size', 'a state with 3 numbers was dropped'),
    ([], 'size', 'a state with 0 numbers was dropped'),
    ([math.nan, 0.0], 'finite', 'a state with px = nan was dropped'),
    ([0.0, -math.inf], 'finite', 'a state with vx = -inf was dropped'),
    ([1e308, 1e308], 'command', 'a command that is not finite'),
])
def test_bad_states_are_dropped(x: list[float], kind: str, words: str) -> None:
    """What cannot be answered is dropped, counted, told; the next state is answered."""
    loop = Loop(control(gain=((10.0, 10.0),)))
    assert loop.answer(0, x, 0.0) is None
    assert loop.counts[kind] == 1 and not loop.counts['answered']
    assert loop.news[0].startswith(words)
    assert loop.answer(1, [0.0, 0.0], 0.0) == [0.0]


def test_the_same_is_told_once_a_second() -> None:
    """A flood of bad states does not become a flood of words."""
    loop = Loop(control())
    for k in range(2_500):
        loop.answer(k * MS, [math.nan, 0.0], k * 1e-3)
    assert loop.counts['finite'] == 2_500 and len(loop.news) == 3


def test_a_late_state_is_dropped() -> None:
    """A state that another has overtaken is not answered."""
    loop = Loop(control())
    given = answers(loop, (1.00, [1.0, 0.0]), (0.99, [9.0, 0.0]), (1.01, [2.0, 0.0]),
                    (1.0, [9.0, 0.0]), (1.02, [3.0, 0.0]))
    assert given == [[-1.0], None, [-2.0], None, [-3.0]]
    assert loop.counts['late'] == 2 and loop.counts['restarted'] == 0


def test_a_repeated_stamp_is_answered_alike() -> None:
    """A plant that asks again gets the same answer; nothing is integrated twice."""
    loop = Loop(control(C=((1.0, 0.0),), Ki=((5.0,),)))
    first = answers(loop, (0.0, [1.0, 0.0]), (0.1, [1.0, 0.0]))[-1]
    assert answers(loop, (0.1, [1.0, 0.0]), (0.1, [1.0, 0.0])) == [first, first]
    assert loop.counts['repeated'] == 2


@pytest.mark.parametrize('stamps', [(100.0, 0.0), (0.3, 0.0, 0.005)])
def test_time_that_goes_back_starts_again(stamps: tuple[float, ...]) -> None:
    """A plant that was reset is answered; two states in a row are not out of order."""
    loop = Loop(control(C=((1.0, 0.0),), Ki=((1.0,),)))
    assert answers(loop, (stamps[0] - 0.1, [1.0, 0.0]), (stamps[0], [1.0, 0.0]))[-1] == [-1.1]
    given = answers(loop, *((t, [1.0, 0.0]) for t in stamps[1:]))
    assert given[-1] == [-1.0]  # without the integral of before
    assert loop.counts['restarted'] == 1
    assert any('time went back' in sentence for sentence in loop.news)


def test_stamps_that_do_not_advance() -> None:
    """A source that does not stamp its states is answered."""
    loop = Loop(control())
    assert [loop.answer(0, [float(k), 0.0], k * 0.01) for k in range(3)] == [[0.0], [-1.0], [-2.0]]


def test_rate() -> None:
    """At most one answer in a period of the stamps, on its grid."""
    loop = Loop(control(rules=Rules(period=50 * MS)))
    answered = [k for k in range(100) if loop.answer(k * 5 * MS, [0.0, 0.0], k * 5e-3)]
    assert answered == list(range(0, 100, 10))
    assert loop.counts['skipped'] == 90
    # a stamp that is early by rounding is in time; a gap begins a new grid
    assert loop.answer(500 * MS - 10, [0.0, 0.0], 0.5)
    assert loop.answer(933 * MS, [0.0, 0.0], 1.0)
    assert not loop.answer(980 * MS, [0.0, 0.0], 1.0)
    assert loop.answer(983 * MS, [0.0, 0.0], 1.0)


@pytest.mark.parametrize(('lag', 'kind'), [
    (0.0, ''), (0.4, ''), (0.6, 'old'), (3599.0, 'old'), (-0.4, ''), (-0.6, 'ahead'),
    (3601.0, ''), (-3601.0, ''), (1.7e9, '')])
def test_stamps_against_the_clock(lag: float, kind: str) -> None:
    """A state stamped long ago, or in the future, is dropped, unless of another clock."""
    loop = Loop(control(rules=Rules(stamp_timeout=0.5)))
    stamp = 2_000_000_000 * S
    u = loop.answer(stamp, [1.0, 0.0], 0.0, stamp + round(lag * S))
    assert (u is None) == bool(kind) and loop.counts[kind] == bool(kind)
    if kind:
        words = {'old': 'before', 'ahead': 'after'}[kind]
        assert f's {words} the time here was dropped' in loop.news[0]
        assert loop.lag == pytest.approx(lag)
        # it neither is a state that came, nor puts the next one out of order
        assert loop.overdue(1e9) is None and loop.stamp is None
    unchecked = Loop(control())
    assert unchecked.answer(stamp, [1.0, 0.0], 0.0, stamp + round(lag * S)) == [-1.0]


def test_late_stamps_are_stale() -> None:
    """States that all come late are as good as none: on_stale acts."""
    loop = Loop(control(u=7.0, rules=Rules(stamp_timeout=0.5)))
    assert loop.answer(10 * S, [1.0, 0.0], 10.0, 10 * S) == [6.0]
    for k in range(1, 10):
        assert loop.answer(10 * S + k * 100 * MS, [1.0, 0.0], 10.0 + 0.1 * k, 20 * S) is None
    assert loop.overdue(10.9) == [7.0] and loop.is_stale


# When states stay away


@pytest.mark.parametrize(('action', 'commanded'), [
    ('equilibrium', [7.0]), ('hold', [6.0]), ('silent', None)])
def test_stale(action: str, commanded: list[float] | None) -> None:
    """After state_timeout on_stale acts, again each time; a state ends it."""
    loop = Loop(control(u=7.0, rules=Rules(state_timeout=0.2, on_stale=action)))
    assert loop.wake() == math.inf and loop.overdue(1e9) is None  # nothing has come yet
    assert loop.answer(0, [1.0, 0.0], 10.0) == [6.0]
    assert loop.wake() == 10.2
    assert loop.overdue(10.19) is None and not loop.is_stale
    assert loop.overdue(10.2) == commanded and loop.is_stale
    assert loop.overdue(10.3) is None
    assert loop.overdue(10.4) == commanded
    assert loop.counts['stale'] == 1 and f'on_stale: {action}' in loop.news[0]
    assert loop.answer(1, [2.0, 0.0], 11.0) == [5.0] and not loop.is_stale
    assert loop.age(11.5) == 0.5


def test_bad_states_do_not_count_as_states() -> None:
    """A NaN at full rate is as good as no state."""
    loop = Loop(control(rules=Rules(state_timeout=0.2)))
    loop.answer(0, [0.0, 0.0], 0.0)
    for k in range(1, 100):
        loop.answer(k * MS, [math.nan, 0.0], k * 0.01)
    assert loop.overdue(0.2) == [0.0]


def test_no_timeout() -> None:
    """With state_timeout = 0 nothing is ever stale."""
    loop = Loop(control(rules=Rules(state_timeout=0.0)))
    loop.answer(0, [0.0, 0.0], 0.0)
    assert loop.wake() == math.inf and loop.overdue(1e9) is None


# Stop, envelope


def test_stop_is_latched() -> None:
    """While stopped, the input at rest answers every state."""
    loop = Loop(control(u=3.0, rest=(0.5,)))
    loop.answer(0, [1.0, 0.0], 0.0)
    loop.stop('by test')
    assert answers(loop, (1, [1.0, 0.0]), (2, [1.0, 0.0])) == [[0.5], [0.5]]
    assert loop.overdue(99.0) == [0.5]
    loop.start()
    assert answers(loop, (100, [1.0, 0.0])) == [[2.0]]


@pytest.mark.parametrize(('action', 'outside', 'back'), [
    ('stop', [7.0], [7.0]), ('equilibrium', [7.0], [6.5]), ('hold', [6.2], [6.5]),
    ('silent', None, [6.5])])
def test_envelope(action: str, outside: list[float] | None, back: list[float]) -> None:
    """Outside x_limits on_envelope acts; only a stop is latched."""
    rules = Rules(x_limits=((-1.0, 2.0), (-math.inf, math.inf)), on_envelope=action)
    loop = Loop(control(u=7.0, rules=rules))
    assert answers(loop, (0, [0.8, 0.0]), (1, [2.1, 0.0]), (2, [0.5, 0.0])) == [
        [6.2], outside, back]
    assert loop.counts['outside'] == 1
    assert 'the error of px is 2.1, outside [-1, 2]' in loop.news[0]
    assert loop.stopped == ('' if action != 'stop' else 'the error of px is 2.1, outside [-1, 2]')


# Set points that move, references


def test_a_moving_set_point_moves_on() -> None:
    """It starts where the plant is, moves with the stamps, and changes of the gain leave it."""
    moving = control(u=10.0, drift=(10.0, 0.0), gain=((1.0, 0.0),))
    loop = Loop(moving)
    assert answers(loop, (100.0, [500.0, 0.0]), (100.5, [505.0, 0.0]), (101.0, [509.0, 0.0])) == [
        [10.0], [10.0], [11.0]]
    loop.adopt(replace(moving, regulator=replace(moving.regulator, K=((2.0, 0.0),))))
    assert answers(loop, (101.0, [509.0, 0.0]), (102.0, [520.0, 0.0])) == [[12.0], [10.0]]
    faster = Regulator((0.0, 0.0), (20.0,), ((1.0, 0.0),), (20.0, 0.0))
    loop.adopt(replace(moving, regulator=faster))
    assert answers(loop, (102.0, [520.0, 0.0]), (103.0, [540.0, 0.0])) == [[20.0], [20.0]]
    loop.adopt(replace(moving, regulator=replace(faster, x=(600.0, 0.0))))
    assert answers(loop, (103.0, [540.0, 0.0])) == [[80.0]]  # what was asked for


def test_a_moving_set_point_does_not_run_away() -> None:
    """After a stop it goes on from where the plant is."""
    loop = Loop(control(u=10.0, drift=(10.0, 0.0), rest=(0.0,)))
    answers(loop, (0.0, [0.0, 0.0]), (1.0, [10.0, 0.0]))
    loop.stop('by test')
    assert answers(loop, (2.0, [12.0, 0.0]), (50.0, [12.0, 0.0])) == [[0.0], [0.0]]
    loop.start()
    assert answers(loop, (51.0, [12.0, 0.0]), (52.0, [22.0, 0.0])) == [[10.0], [10.0]]


class Ramp:
    """The reference px = t."""

    def at(self, t: float) -> Point:
        """Return it."""
        return Point((t, 1.0), (0.0,), K)


def leg(begin: int | None, end: float = 2.0) -> Leg:
    """Return a ramp, and what holds its end."""
    return Leg(Reference(begin, end), Ramp(), Regulator((end, 0.0), (0.5,), K, (0.0, 0.0)))


def test_a_reference_is_followed_to_its_end() -> None:
    """Before it the set point, along it the reference, after it its end; without a state none."""
    still = control()
    loop = Loop(still)
    answers(loop, (9.0, [0.0, 0.0]))
    loop.adopt(replace(still, legs=(leg(10 * S),)))
    given = answers(loop, (9.5, [0.0, 0.0]), (10.0, [0.0, 1.0]), (11.0, [0.5, 1.0]),
                    (12.0, [2.0, 0.0]), (20.0, [2.0, 0.0]))
    assert given == [[0.0], [0.0], [0.5], [0.5], [0.5]]


def test_a_reference_can_begin_in_the_middle() -> None:
    """A stamp in the past joins the reference where it is now."""
    loop = Loop(control(legs=(leg(10 * S),)))
    assert answers(loop, (11.5, [1.5, 1.0])) == [[0.0]]


def test_a_reference_without_stamp_begins_at_once() -> None:
    """At the first state after it; a change of the gain leaves its beginning."""
    still = control()
    loop = Loop(still)
    answers(loop, (5.0, [0.0, 0.0]))
    following = replace(still, legs=(leg(None),))
    loop.adopt(following)
    assert answers(loop, (6.0, [0.0, 1.0]), (7.0, [1.0, 1.0])) == [[0.0], [0.0]]
    loop.adopt(replace(following))
    assert answers(loop, (7.5, [1.5, 1.0])) == [[0.0]]


def test_a_reference_is_replaced_when_the_next_begins() -> None:
    """Until then the one before is followed."""
    first, second = leg(10 * S), leg(11 * S)
    loop = Loop(control(legs=(first, second)))
    assert answers(loop, (10.5, [0.5, 1.0]), (11.0, [0.0, 1.0])) == [[0.0], [0.0]]


# Changes without a jump


def test_transition_is_smooth() -> None:
    """The command goes on from where it was, and ends at the new law."""
    rules = Rules(transition_time=1.0)
    loop = Loop(control(rules=rules))
    assert answers(loop, (0.0, [1.0, 0.0])) == [[-1.0]]
    loop.adopt(control(gain=((5.0, 0.0),), rules=rules))
    times = np.linspace(0.0, 1.2, 121)
    u = np.array([loop.answer(round(t * S), [1.0, 0.0], t) for t in times]).ravel()
    assert u[0] == -1.0 and (u[times >= 1.0] == -5.0).all()
    assert (np.diff(u) <= 0.0).all() and np.abs(np.diff(u)).max() < 4.0 * 1.5 * 0.01 * 1.01
    assert u[50] == pytest.approx(-3.0)


def test_transition_in_a_transition() -> None:
    """A further change goes on from the command as it is."""
    rules = Rules(transition_time=1.0)
    loop = Loop(control(rules=rules))
    answers(loop, (0.0, [1.0, 0.0]))
    loop.adopt(control(gain=((5.0, 0.0),), rules=rules))
    half = answers(loop, (0.0, [1.0, 0.0]), (0.5, [1.0, 0.0]))[-1]
    loop.adopt(control(gain=((-5.0, 0.0),), rules=rules))
    assert answers(loop, (0.5, [1.0, 0.0])) == [half]
    assert answers(loop, (1.5, [1.0, 0.0])) == [[5.0]]


def test_transition_after_a_stop() -> None:
    """The law takes over from the input at rest."""
    loop = Loop(control(rest=(0.3,), rules=Rules(transition_time=1.0)))
    answers(loop, (0.0, [1.0, 0.0]))
    loop.stop('by test')
    answers(loop, (1.0, [1.0, 0.0]))
    loop.start()
    assert answers(loop, (2.0, [1.0, 0.0]), (3.0, [1.0, 0.0])) == [[pytest.approx(0.3)], [-1.0]]


def test_preview_is_the_jump() -> None:
    """What a change would do to the command is known before, and nothing is changed by asking."""
    loop = Loop(control())
    wanted = control(gain=((5.0, 0.0),), x=(0.5, 0.0), u=1.0)
    assert loop.preview(wanted) is None
    before = answers(loop, (0.0, [1.0, 0.0]))[0]
    jump = loop.preview(wanted)
    assert answers(loop, (0.0, [1.0, 0.0])) == [before]
    loop.adopt(wanted)
    after = answers(loop, (0.0, [1.0, 0.0]))[0]
    assert before and after and jump == [after[0] - before[0]] == [-0.5]


class Still:
    """The reference px = 5, with a gain of its own."""

    def at(self, t: float) -> Point:
        """Return it."""
        return Point((5.0, 0.0), (0.0,), ((3.0, 0.0),))


@pytest.mark.parametrize('delay', [0, 200 * MS])
def test_hand_overs_between_references_are_smooth(delay: int) -> None:
    """Where a reference begins, gives way to another and ends, the command does not jump."""
    rules = Rules(transition_time=0.5)
    legs = (Leg(Reference(1 * S, 4.0), Ramp(), Regulator((4.0, 0.0), (0.5,), K, (0.0, 0.0))),
            Leg(Reference(3 * S, 2.0), Still(), Regulator((5.0, 0.0), (2.0,), K, (0.0, 0.0))))
    moves = ((1.0, delay / S), (0.0, 1.0))
    prediction = Prediction(moves, (((0.0,), (0.0,)),) * 2, 100 * MS, delay) if delay else None
    times, dt = np.arange(0.0, 7.0, 0.01), 0.01
    u = {}
    for smooth in (True, False):
        loop = Loop(control(rules=rules if smooth else Rules(), legs=legs, prediction=prediction))
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
    loop = Loop(within(2.0))
    given = answers(loop, *((t, [1.0, 0.0]) for t in (7.0, 8.0, 9.0, 9.05, 9.1, 20.0)))
    np.testing.assert_allclose(np.ravel(given), [0.0, -5.0, -10.0, -5.5, -1.0, -1.0])


def test_a_horizon_goes_on_through_changes_of_the_weights() -> None:
    """Only another set point or horizon begins it anew; so does a start after a stop."""
    loop = Loop(within(2.0))
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


def test_a_horizon_of_a_set_point_that_moves() -> None:
    """It moves on from where the plant was when the law began, whatever changes meanwhile."""
    moving = within(2.0, u=10.0, drift=(10.0, 0.0))
    loop = Loop(moving)
    assert answers(loop, (100.0, [500.0, 0.0]), (101.0, [511.0, 0.0])) == [[10.0], [5.0]]
    loop.adopt(within(2.0, K=20.0, u=10.0, drift=(10.0, 0.0)))
    assert answers(loop, (101.0, [511.0, 0.0]), (102.0, [521.0, 0.0])) == [[0.0], [-10.0]]


# A schedule


def test_gains_follow_what_is_measured_or_was_commanded() -> None:
    """Between the grid straight, beyond it the nearest; before the first answer the set point."""
    gains = Gains((1.0, 3.0), (((10.0, 0.0),), ((30.0, 0.0),)), ((),) * 2)
    loop = Loop(control(schedule=Schedule(gains, -1)))
    speeds = (0.0, 1.0, 2.0, 3.0, 99.0)
    given = [loop.answer(k, [1.0, 0.0], 0.0, None, v) for k, v in enumerate(speeds)]
    assert given == [[-10.0], [-10.0], [-20.0], [-30.0], [-30.0]]
    assert loop.answer(9, [1.0, 0.0], 0.0, None, math.nan) is None
    assert loop.counts['finite'] == 1
    loop = Loop(control(u=2.0, schedule=Schedule(gains, 0)))
    assert answers(loop, (0.0, [-0.01, 0.0]), (0.1, [-0.01, 0.0])) == [
        [pytest.approx(2.2)], [pytest.approx(2.22)]]


def test_a_schedule_and_a_reference() -> None:
    """What is measured counts along a reference, too; there an input has its gain in time."""
    gains = Gains((1.0, 3.0), (((10.0, 0.0),), ((30.0, 0.0),)), ((),) * 2)
    for index, wanted in ((-1, -20.0), (0, -1.0)):
        loop = Loop(control(schedule=Schedule(gains, index), legs=(leg(0),)))
        assert loop.answer(1 * S, [2.0, 1.0], 0.0, None, 2.0) == [wanted]


# Integral action


def test_integral_removes_a_constant_error() -> None:
    """A pushed double integrator comes to rest at the set point only with integral action."""
    def final_error(**integral: object) -> float:
        loop = Loop(control(gain=((6.0, 4.0),), **integral))
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
    loop = Loop(control(gain=((0.0, 0.0),), C=((2.0, 0.0),), Ki=((1.0,),)))
    t = np.linspace(0.0, 0.4, 41)
    u = [loop.answer(round(s * S), [s, 0.0], s) for s in t]
    np.testing.assert_allclose(np.ravel(u), -t**2, atol=1e-12)  # exact for a straight line


@pytest.mark.parametrize('push', [1.0, -1.0])
def test_anti_windup(push: float) -> None:
    """While the input is at its limit, the integral does not grow what cannot be given."""
    loop = Loop(control(gain=((1.0, 0.0),), limits=((-2.0,), (2.0,)),
                        C=((1.0, 0.0),), Ki=((1.0,),)))
    for k in range(1_000):
        u = loop.answer(k * 10 * MS, [push * 3.0, 0.0], k * 0.01)
    assert u == [-2.0 * push]
    # the error changes its sign: the input leaves the limit at once
    u = loop.answer(10_000 * MS, [-push * 0.5, 0.0], 10.0)
    assert u is not None and u[0] * push > 0.4


def test_nothing_is_integrated_over_a_gap() -> None:
    """Nobody knows what the plant did while no state came."""
    loop = Loop(control(gain=((0.0, 0.0),), C=((1.0, 0.0),), Ki=((1.0,),)))
    given = answers(loop, (0.0, [1.0, 0.0]), (0.1, [1.0, 0.0]), (9.1, [1.0, 0.0]))
    np.testing.assert_allclose(given, [[0.0], [-0.1], [-0.1]], atol=1e-15)


def test_a_gain_that_changes_leaves_what_was_learned() -> None:
    """With a constant push the error stays 0 while the gains, that of the integral too, change."""
    loop = Loop(control(gain=((6.0, 4.0),), C=((1.0, 0.0),), Ki=((3.0,),)))
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
    regulator = Regulator((0.2,), (0.02 / 0.5,), ((1.0,),), (0.0,))  # 0.2 = a 0.2 + b ue
    loop = Loop(Control(regulator, Limits((-9.0,), (9.0,)), (0.0,), ('x',),
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


# Everything at once


@settings(max_examples=200, deadline=None)
@given(strategies.lists(strategies.tuples(
    strategies.integers(-10**12, 10**18),
    strategies.lists(strategies.floats(), min_size=0, max_size=3),
    strategies.floats(0.0, 1e6),
    strategies.sampled_from(['state', 'overdue', 'stop', 'start', 'adopt', 'preview'])),
    max_size=40))
def test_no_command_is_ever_out_of_the_limits(
        events: list[tuple[int, list[float], float, str]]) -> None:
    """Whatever comes in whatever order, a command is finite and within the limits."""
    loop = Loop(control(limits=((-2.0,), (2.0,)), rest=(1.0,), drift=(1.0, 0.0),
                        rules=Rules(transition_time=0.5, on_stale='hold'),
                        C=((1.0, 0.0),), Ki=((1.0,),)))
    for stamp, x, now, what in events:
        u = None
        if what == 'state':
            u = loop.answer(stamp, x, now)
        elif what == 'overdue':
            u = loop.overdue(now)
        elif what == 'preview':
            loop.preview(control())
        elif what == 'adopt':
            loop.adopt(replace(loop.control, regulator=replace(
                loop.control.regulator, K=((now % 7, 1.0),)), legs=(leg(stamp),) * (stamp % 2)))
        else:
            loop.stop('by test' if what == 'stop' else '')
        assert u is None or len(u) == 1 and -2.0 <= u[0] <= 2.0
