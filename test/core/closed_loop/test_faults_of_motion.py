# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Faults of loops in motion that were measured once; each docstring names its fault."""

from collections.abc import Iterator
from dataclasses import replace
import math

from loop_bench import answers, control, K, leg, MS, S
import numpy as np
from obc_ros.core.closed_loop.control import Control, Leg, Reference, Rules
from obc_ros.core.closed_loop.feedback import (
    convert_rows,
    convert_vector,
    InputLimits,
    ReferencePoint,
    Region,
    StateFeedback,
)
from obc_ros.core.closed_loop.laws import PlanLaw
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.closed_loop.modes import Mode
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.systems import registry
from obc_ros.core.systems.equilibrium import find_equilibrium, linearize
import pytest

HEADINGS = [0.0, math.radians(1.0), math.pi / 4, math.pi / 2, math.pi, -math.pi / 2]
NARROW = ((-3.0, 3.0), (-math.inf, math.inf))


def push(stamp: int, x: tuple[float, float], u: float = 1.0) -> PlanLaw:
    """Return a plan whose first sample is at a stamp [ns] in a state (2,), with a constant u."""
    return PlanLaw(stamp - 10 * MS, 20 * MS, (x,) * 51, ((u,),) * 50, K)


class Steady:
    """The reference px = 0 with an input."""

    def __init__(self, u: float) -> None:
        self.u = u

    def at(self, t: float) -> ReferencePoint:
        """Return its point, the same at all times."""
        return ReferencePoint((0.0, 0.0), (self.u,), K)


# Transitions


def test_a_new_plan_restarts_no_transition() -> None:
    """Fault 1: a plan u = 1 at each sample reaches 1 within transition_time, and not in 16 s."""
    loop = ControlLoop(control(rules=Rules(transition_time=1.0)))
    answers(loop, (0.0, [0.0, 0.0]))
    given = []
    for k in range(1, 101):
        assert loop.add_plan(push(k * 20 * MS, (0.0, 0.0)), loop.run)
        given += answers(loop, (k * 0.02, [0.0, 0.0]))
    u = np.ravel(given)
    assert u[0] == 0.0
    assert (np.diff(u) >= 0.0).all()
    assert u[25] == pytest.approx(0.5)
    assert (u[50:] == 1.0).all()


def test_a_reference_sent_again_restarts_no_transition() -> None:
    """Fault 1: a reference with u = 1 that is sent at 10 Hz reaches 1 within transition_time."""
    loop = ControlLoop(control(rules=Rules(transition_time=1.0)))
    answers(loop, (0.0, [0.0, 0.0]))
    u = []
    for k in range(1, 151):
        if k % 10 == 1:
            new = Leg(Reference(None, 5.0), Steady(1.0), StateFeedback(
                (0.0, 0.0), (0.0,), K, (0.0, 0.0)))
            assert not loop.offer(control(
                rules=loop.control.rules, legs=(*loop.control.legs[-1:], new)))
        u += answers(loop, (k * 0.01, [0.0, 0.0]))[0]
    assert u[0] == 0.0
    assert u[50] == pytest.approx(0.5)
    assert u[100:] == [1.0] * 50


# Lanes


def drive(theta: float, v: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the track of the vehicle from 0.4 m beside its lane, in the lane's coordinates."""
    vehicle = registry.get_system('vehicle')
    at = find_equilibrium(vehicle, [0.0, 0.0, theta], [v, 0.0])
    A, B = linearize(vehicle, at.x, at.u)
    gain = lqr(A, B, np.eye(3), np.eye(2)).K
    loop = ControlLoop(Control(
        StateFeedback(convert_vector(at.x), convert_vector(at.u), convert_rows(gain),
                      convert_vector(at.drift)),
        InputLimits((0.0, -0.6), (8.0, 0.6), angles=(2,)), convert_vector(0.0 * at.u),
        vehicle.state_names))

    def f(x: np.ndarray, u: list[float]) -> np.ndarray:
        return np.array([u[0] * math.cos(x[2]), u[0] * math.sin(x[2]),
                         u[0] / 2.0 * math.tan(u[1])])   # Example 1.1, with a wheelbase of 2 m

    c, s, dt = math.cos(theta), math.sin(theta), 0.02
    x, track, given = np.array([-0.4 * s, 0.4 * c, theta]), [], []
    for k in range(600):
        track.append([c * x[0] + s * x[1], -s * x[0] + c * x[1], x[2] - theta])
        u = loop.answer(round(k * dt * S), x.tolist(), k * dt)
        assert u is not None
        given.append(u)
        k1 = f(x, u)
        k2 = f(x + dt / 2 * k1, u)
        k3 = f(x + dt / 2 * k2, u)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + dt * k3, u))
    return np.array(track), np.array(given)


@pytest.mark.slow
@pytest.mark.parametrize('theta', HEADINGS)
def test_a_vehicle_comes_to_its_lane_at_any_heading(theta: float) -> None:
    """Fault 2: with a heading of 1 deg, 45 deg, pi/2 or pi it stayed 0.4 m beside for ever."""
    track, u = drive(theta)
    assert track[0, 1] == pytest.approx(0.4)
    assert abs(track[-1, 1]) < 1e-3
    assert track[-1, 0] == pytest.approx(600 * 0.02 * 5.0, abs=0.5)
    straight, wanted = drive(0.0)
    np.testing.assert_allclose(track, straight, atol=1e-9)
    np.testing.assert_allclose(u, wanted, atol=1e-9)


@pytest.mark.parametrize(('theta', 'still'), [
    (0.0, [1, 2]), (math.pi, [1, 2]), (math.pi / 2, [0, 2]), (-math.pi / 2, [0, 2])])
def test_a_rounding_error_is_no_drift(theta: float, still: list[int]) -> None:
    """Fault 2: 10 cos(pi / 2) = 6e-16 m/s counted as motion along px."""
    drift = find_equilibrium(
        registry.get_system('vehicle'), [0.0, 0.0, theta], [10.0, 0.0]).drift
    assert drift[still].tolist() == [0.0] * len(still)
    assert np.hypot(*drift[:2]) == pytest.approx(10.0)


# The envelope


@pytest.mark.parametrize('action', ['stop', 'equilibrium', 'hold', 'silent'])
def test_the_envelope_counts_from_the_set_point_and_not_from_a_plan(action: str) -> None:
    """Fault 3: every plan begins at the measured state, and 963 m were inside 3 m."""
    loop = ControlLoop(control(
        rest=(0.25,), rules=Rules(x_limits=NARROW, on_envelope=action)))
    answers(loop, (0.0, [0.0, 0.0]))
    given = {}
    for k in range(1, 60):
        x = (0.1 * k, 5.0)
        loop.add_plan(push(k * 20 * MS, x), loop.run)
        given[k] = answers(loop, (k * 0.02, list(x)))[0]
        assert loop.error == [x[0] if loop.mode is not Mode.STOPPED else 0.1 * 31, 5.0]
    assert given[29] == [1.0]
    assert given[31] == {'stop': [0.25], 'equilibrium': [0.25], 'hold': [1.0], 'silent': None}[
        action]
    assert loop.mode is (Mode.STOPPED if action == 'stop' else Mode.RESTING)
    assert loop.counts['outside'] == 1
    assert 'the error of px is 3.1, outside [-3, 3]' in loop.news[0]


@pytest.mark.parametrize('action', ['stop', 'equilibrium', 'silent'])
def test_states_that_are_too_slow_for_the_gain_are_told(action: str) -> None:
    """Fault 12: with states at 1 Hz and a gain for 20 Hz, 0.1 m grew to 78 m, with level OK."""
    loop = ControlLoop(control(rest=(0.25,), gain=((100.0, 14.0),), longest_period=0.14,
                               rules=Rules(state_timeout=5.0, on_envelope=action)))
    x, v, worst = 0.1, 0.0, 0.0
    for k in range(30):
        u = (answers(loop, (float(k), [x, v]))[0] or [0.0])[0]
        u *= loop.mode is not Mode.STOPPED
        x, v = x + v + u / 2, v + u
        worst = max(worst, abs(x) if k < 3 else 0.0)
        if k > 3:
            assert loop.mode is (Mode.STOPPED if action == 'stop' else Mode.RESTING)
    assert worst > 1.0   # until the rate is known
    assert 'states were 1 s apart or more: held longer than 0.14 s the gain is unstable' in (
        loop.news[0])
    assert loop.counts['slow']
    answers(loop, *((30.0 + 0.05 * k, [0.0, 0.0]) for k in range(4)))
    assert loop.mode is (Mode.STOPPED if action == 'stop' else Mode.SET_POINT)


# Time


def test_a_jump_of_the_stamps_does_not_move_the_set_point_away() -> None:
    """Fault 5: after a jump of 100 s the lane was 100 s ahead: full speed for the whole run."""
    loop = ControlLoop(control(u=2.0, drift=(2.0, 0.0), limits=((-9.0,), (9.0,))))
    answers(loop, (10.0, [0.0, 0.0]), (10.1, [0.2, 0.0]))
    assert loop.answer(110 * S, [0.4, 0.0], 10.2) == [pytest.approx(2.0)]
    assert loop.answer(110 * S + 100 * MS, [0.6, 0.0], 10.3) == [pytest.approx(2.0)]
    assert 'after 99.9 s without a state the control law begins anew' in loop.news


@pytest.mark.parametrize(('ahead', 'x', 'mode'), [
    (1.5, [1.55, 1.0], Mode.REFERENCE), (1.5, [0.1, 1.0], Mode.STOPPED),
    (100.0, [3.9, 0.1], Mode.SET_POINT), (100.0, [0.1, 1.0], Mode.STOPPED)])
def test_a_jump_of_the_stamps_lets_a_reference_be_judged(ahead: float, x: list[float], mode: Mode
                                                         ) -> None:
    """Fault 5: after a jump it had ended, and the plant drove to its end at the limit."""
    judged = replace(leg(0, 4.0), allowed=((-0.2, 0.2), (-0.2, 0.2)), units=('m', 'm/s'))
    loop = ControlLoop(control(rest=(0.25,), legs=(judged,)))
    answers(loop, (0.0, [0.0, 1.0]), (0.1, [0.1, 1.0]))
    u = loop.answer(round(ahead * S), x, 0.2)
    assert loop.mode is mode
    said = [*loop.news, *loop.events]
    if mode is Mode.STOPPED:
        assert u == [0.25]
        assert any('stopped until ~/start' in sentence for sentence in said)
        assert 'px is ' in loop.reason
    elif mode is Mode.SET_POINT:
        assert 'the reference of 4 s has ended' in said
    assert any(f'after {ahead - 0.1:.3g} s without a state' in sentence for sentence in said)


def test_what_has_ended_does_not_begin_again_when_its_stamps_come_by() -> None:
    """Fault 6: in a recording that is played again the references flew again by themselves."""
    loop = ControlLoop(control(legs=(leg(10 * S, 1.0), leg(13 * S, 1.0))))
    first = [(9.5 + 0.1 * k, [0.0, 0.0]) for k in range(60)]
    answers(loop, *first)
    begun = [each for each in loop.events if 'begins' in each and 'reference' in each]
    assert len(begun) == 2
    loop.events.clear()
    assert answers(loop, *first) == [[0.0]] * 60
    assert not any('reference' in each for each in loop.events)
    assert loop.reference is None


@pytest.mark.parametrize('announce', ['restarts', 'publisher'])
@pytest.mark.parametrize('back', [0.2, 8.0])
def test_stamps_of_a_new_source_may_be_behind(announce: str, back: float) -> None:
    """Fault 6: its states are neither late nor skipped; far behind, time has begun anew."""
    loop = ControlLoop(control(legs=(leg(9 * S, 4.0),), rules=Rules(period=50 * MS)))
    answers(loop, *((9.0 + 0.05 * k, [0.05 * k, 1.0]) for k in range(21)))
    if announce == 'publisher':
        loop.replace_source()
    begin = 10.0 - back
    given = [loop.answer(round((begin + 0.05 * k) * S), [1.0 - 0.2 + 0.05 * k, 1.0], 10.1,
                         restarts=announce == 'restarts') for k in range(10)]
    assert None not in given
    if back > 1.0:
        assert loop.mode is Mode.SET_POINT
        assert loop.refused[0].startswith('time went back by 8 s')
    else:
        assert loop.mode is Mode.REFERENCE
        assert given == [[pytest.approx(0.0)]] * 10
    assert loop.counts['late'] == loop.counts['skipped'] == 0


def test_old_states_move_nothing() -> None:
    """Fault 20: a recording of yesterday, on the topic of the states, gave 3381 commands."""
    now = 1_800_000_000 * S
    loop = ControlLoop(control(rules=Rules(stamp_timeout=0.5)))
    for k in range(100):
        assert loop.answer(now - 86_400 * S + k * 10 * MS, [1.0, 0.0], 0.01 * k,
                           now + k * 10 * MS) is None
    assert loop.counts['old'] == 100
    assert loop.x is None
    assert 'a state stamped 8.64e+04 s before the local time was dropped' in loop.news[0]
    assert loop.answer(now + S, [1.0, 0.0], 1.0, now + S) == [-1.0]


def test_commands_without_a_state_are_not_sent_without_pause() -> None:
    """Fault 25: with state_timeout: 1e-6 there were 3400 commands a second."""
    loop = ControlLoop(control(rules=Rules(state_timeout=1e-6)))
    answers(loop, (0.0, [1.0, 0.0]))
    assert len(list(wait(loop, 0.0, 1.0))) == pytest.approx(20, abs=1)


def wait(loop: ControlLoop, now: float, end: float) -> Iterator[list[float]]:
    """Yield the commands until a time [s], as a thread does that sleeps until `wake`."""
    for _ in range(10_000):
        now = max(now, loop.wake())
        if now >= end:
            return
        if (u := loop.overdue(now)) is not None:
            yield u
        now = math.nextafter(now, math.inf)
    raise AssertionError('it never sleeps')


@pytest.mark.parametrize(('rate', 'states'), [(100.0, 50.0), (50.0, 50.0), (20.0, 20.0)])
def test_jitter_of_the_stamps_skips_no_state(rate: float, states: float) -> None:
    """Fault 27: at the nominal rate 5 to 9 % were skipped; none is up to a sixth of a period."""
    loop = ControlLoop(control(rules=Rules(period=round(S / rate))))
    rng = np.random.default_rng(5)
    for t in np.arange(1000) / states + rng.uniform(-0.16, 0.16, 1000) / states:
        loop.answer(round((1.0 + t) * S), [0.0, 0.0], t)
    assert loop.counts['answered'] == 1000
    assert loop.counts['skipped'] == 0


# Stop, start, frame and limits


def test_a_reference_does_not_go_on_after_an_automatic_stop() -> None:
    """Fault 8: 10 s after its end a reference was resumed unjudged, the command jumped to 8.4."""
    loop = ControlLoop(control(legs=(leg(0, 4.0),), rules=Rules(x_limits=NARROW)))
    answers(loop, (0.0, [0.0, 1.0]), (0.1, [9.0, 1.0]))
    assert loop.mode is Mode.STOPPED
    assert loop.refused[0].startswith('stopped: the error of px is 8.9')
    assert answers(loop, (0.2, [0.1, 0.0]), (14.0, [0.1, 0.0])) == [[0.0], [0.0]]
    loop.start()
    assert answers(loop, (14.1, [0.1, 0.0])) == [[-0.1]]
    assert loop.mode is Mode.SET_POINT
    assert loop.reference is None


def test_a_reference_does_not_go_on_in_another_frame() -> None:
    """Fault 9: after a change of frame_id the reference was followed in the other frame."""
    loop = ControlLoop(control(legs=(leg(0, 4.0),)))
    answers(loop, (0.0, [0.0, 1.0]), (0.1, [0.1, 1.0]))
    loop.reframe()
    assert 'the frame of the states has changed' in loop.refused[0]
    assert answers(loop, (0.2, [0.2, 1.0])) == [[-2.2]]
    assert loop.reference is None


@pytest.mark.parametrize(('action', 'commanded'), [
    ('equilibrium', [[0.25]] * 2), ('hold', [[-2.0]] * 2), ('silent', [])])
def test_missing_states_after_a_change_of_the_frame_are_noticed(
        action: str, commanded: list[list[float]]) -> None:
    """Fault 9: without a state in the new frame the last command would act for ever."""
    loop = ControlLoop(control(rest=(0.25,), rules=Rules(on_stale=action)))
    answers(loop, (0.0, [2.0, 0.0]))
    loop.reframe()
    assert list(wait(loop, 0.0, 1.2)) == commanded
    assert loop.mode is Mode.RESTING
    assert answers(loop, (1.2, [1.0, 0.0])) == [[-1.0]]


def test_a_held_command_keeps_the_limits_in_force() -> None:
    """Fault 10: limits that were tightened while no state came did not hold for the command."""
    loose = control(limits=((-9.0,), (9.0,)), rules=Rules(on_stale='hold'))
    loop = ControlLoop(loose)
    answers(loop, (0.0, [8.0, 0.0]))
    assert loop.overdue(0.5) == [-8.0]
    loop.adopt(replace(loose, limits=InputLimits((-3.0,), (3.0,))))
    assert loop.overdue(1.0) == [-3.0]
    loop.stop('by test')
    loop.adopt(replace(loose, limits=InputLimits((1.0,), (3.0,))))
    assert loop.overdue(1.1) == [1.0]
    assert loop.deactivate() == [1.0]


# Without a plan


@pytest.mark.parametrize('timeout', [0.0, 0.5, 9.0])
def test_a_plan_of_before_an_outage_is_not_followed(timeout: float) -> None:
    """Whatever state_timeout becomes meanwhile, the plant is no longer where the plan begins."""
    loop = ControlLoop(control())
    answers(loop, (0.0, [0.0, 0.0]))
    run = loop.run
    assert loop.add_plan(push(20 * MS, (0.0, 0.0)), run)
    assert answers(loop, (0.02, [0.0, 0.0])) == [[1.0]]
    loop.overdue(0.6)
    loop.adopt(control(rules=Rules(state_timeout=timeout)))
    assert not loop.add_plan(push(40 * MS, (0.0, 0.0)), run)
    assert loop.answer(100 * MS, [0.5, 0.0], 0.7) == [-0.5]
    assert loop.mode is Mode.SET_POINT


@pytest.mark.parametrize(('action', 'wanted'), [
    ('regulator', [-2.0]), ('equilibrium', [0.25]), ('hold', [0.5]), ('silent', None)])
def test_without_a_plan_the_regulator_acts(action: str, wanted: list[float] | None) -> None:
    """Fault 31: the input rested, in open loop, though states were fresh."""
    regulator = StateFeedback((0.0, 0.0), (0.0,), K, (0.0, 0.0), (), Region(
        ((1.0, 0.0), (0.0, 1.0)), 1.0))
    loop = ControlLoop(replace(
        control(rest=(0.25,), limits=((-2.0,), (2.0,)), rules=Rules(on_unplanned=action)),
        regulator=regulator))
    loop.add_plan(push(0, (5.0, 0.0), 0.5), loop.run)
    assert answers(loop, (0.0, [5.0, 0.0])) == [[0.5]]
    states = [(0.1 * k, [5.0, 0.0]) for k in range(10, 14)]
    given = [loop.answer(round(t * S), x, 0.02 * k) for k, (t, x) in enumerate(states)]
    assert given == [wanted] * 4
    assert loop.counts['unplanned'] == 4
    assert loop.is_unplanned
    assert f'its value is 25, the level 1); on_unplanned: {action}' in loop.news[-1]
    inside = loop.answer(round(1.4 * S), [0.1, 0.0], 2.0)
    assert inside == [-0.1]
    assert not loop.is_unplanned
