# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The control loop without ROS: control law, input checks, timeouts, stop and envelope."""

from dataclasses import replace
import math

from hypothesis import given, settings, strategies
from loop_bench import answers, control, leg, MS, S
import numpy as np
from obc_ros.core.closed_loop.control import Rules
from obc_ros.core.closed_loop.feedback import (
    compute_feedback,
    convert_rows,
    convert_vector,
    InputLimits,
    ReferencePoint,
)
from obc_ros.core.closed_loop.loop import ControlLoop
import pytest

# Control law


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(strategies.integers(1, 6), strategies.integers(1, 3), strategies.integers(0, 2**32 - 1))
def test_control_law_is_the_clipped_matrix_product(n: int, m: int, seed: int) -> None:
    """Compare u = ur - K (x - xr), clipped to the limits, with numpy."""
    rng = np.random.default_rng(seed)
    x, xr, ur, gain = (rng.normal(size=size) for size in (n, n, m, (m, n)))
    limits = InputLimits((-1.0,) * m, (0.5,) * m)
    e = limits.error(x.tolist(), convert_vector(xr))
    u = compute_feedback(ReferencePoint(convert_vector(xr), convert_vector(ur),
                                        convert_rows(gain)), e)
    expected = ur - gain @ (x - xr)
    np.testing.assert_allclose(u, expected, rtol=1e-13, atol=1e-13)
    limits.clip(u)
    np.testing.assert_allclose(u, np.clip(expected, -1.0, 0.5), rtol=1e-13, atol=1e-13)


@given(strategies.floats(-1e6, 1e6), strategies.floats(-10.0, 10.0))
def test_errors_of_angles_wrap_and_others_do_not(theta: float, wanted: float) -> None:
    """The error of an angle lies in [-pi, pi]; the error of a length does not wrap."""
    error = InputLimits((), (), angles=(1,)).error([theta, theta], (wanted, wanted))
    assert error[0] == theta - wanted
    assert -math.pi <= error[1] <= math.pi
    assert math.cos(error[1]) == pytest.approx(math.cos(theta - wanted), abs=1e-9)
    assert math.sin(error[1]) == pytest.approx(math.sin(theta - wanted), abs=1e-9)


def test_a_state_is_answered_with_a_command() -> None:
    """Check the command u = 3 - 1 x_1 - 2 x_2 and what the loop records."""
    loop = ControlLoop(control(x=(1.0, 0.0), u=3.0))
    assert loop.answer(5, [2.0, 0.5], 0.0) == [3.0 - 1.0 - 1.0]
    assert loop.counts == {'answered': 1, 'saturated': 0}
    assert loop.error == [1.0, 0.5]
    assert loop.command == [1.0]


def test_commands_are_clipped_and_counted() -> None:
    """A clipped input is at its limit and is counted as saturated."""
    loop = ControlLoop(control(limits=((-1.0,), (0.5,))))
    assert answers(loop, (0, [9.0, 0.0]), (1, [-9.0, 0.0]), (2, [0.1, 0.0])) == [
        [-1.0], [0.5], [-0.1]]
    assert loop.counts['saturated'] == 2


# Checks of incoming states


@pytest.mark.parametrize(('x', 'kind', 'words'), [
    ([1.0], 'size', 'a state with 1 numbers was dropped: wanted 2 (px, vx)'),
    ([1.0, 2.0, 3.0], 'size', 'a state with 3 numbers was dropped'),
    ([], 'size', 'a state with 0 numbers was dropped'),
    ([math.nan, 0.0], 'finite', 'a state with px = nan was dropped'),
    ([0.0, -math.inf], 'finite', 'a state with vx = -inf was dropped'),
    ([1e308, 1e308], 'command', 'a command that is not finite'),
])
def test_invalid_states_are_dropped_and_reported(x: list[float], kind: str, words: str) -> None:
    """An invalid state is dropped, counted and reported; the next valid state is answered."""
    loop = ControlLoop(control(gain=((10.0, 10.0),)))
    assert loop.answer(0, x, 0.0) is None
    assert loop.counts[kind] == 1
    assert not loop.counts['answered']
    assert loop.news[0].startswith(words)
    assert loop.answer(1, [0.0, 0.0], 0.0) == [0.0]


def test_a_repeated_fault_is_reported_once_a_second() -> None:
    """2500 invalid states within 2.5 s give three reports."""
    loop = ControlLoop(control())
    for k in range(2_500):
        loop.answer(k * MS, [math.nan, 0.0], k * 1e-3)
    assert loop.counts['finite'] == 2_500
    assert len(loop.news) == 3


def test_a_state_older_than_the_last_one_is_dropped() -> None:
    """A state whose stamp precedes that of the last answered state is not answered."""
    loop = ControlLoop(control())
    given = answers(loop, (1.00, [1.0, 0.0]), (0.99, [9.0, 0.0]), (1.01, [2.0, 0.0]),
                    (1.0, [9.0, 0.0]), (1.02, [3.0, 0.0]))
    assert given == [[-1.0], None, [-2.0], None, [-3.0]]
    assert loop.counts['late'] == 2
    assert loop.counts['restarted'] == 0


def test_a_repeated_stamp_gets_the_same_command() -> None:
    """A repeated request gets the same command; the integral is not advanced twice."""
    loop = ControlLoop(control(C=((1.0, 0.0),), Ki=((5.0,),)))
    first = answers(loop, (0.0, [1.0, 0.0]), (0.1, [1.0, 0.0]))[-1]
    assert answers(loop, (0.1, [1.0, 0.0]), (0.1, [1.0, 0.0])) == [first, first]
    assert loop.counts['repeated'] == 2


@pytest.mark.parametrize('stamps', [(100.0, 0.0), (0.7, 0.0, 0.005)])
def test_stamps_that_jump_back_restart_the_loop(stamps: tuple[float, ...]) -> None:
    """A step back of more than state_timeout is a reset of the plant, not a wrong order."""
    loop = ControlLoop(control(C=((1.0, 0.0),), Ki=((1.0,),)))
    assert answers(loop, (stamps[0] - 0.1, [1.0, 0.0]), (stamps[0], [1.0, 0.0]))[-1] == [-1.1]
    given = answers(loop, *((t, [1.0, 0.0]) for t in stamps[1:]))
    assert given[0] == [-1.0]  # The integral starts at zero again.
    assert loop.counts['restarted'] == 1
    assert any('time went back' in sentence for sentence in loop.news)


def test_states_with_constant_stamps_are_answered() -> None:
    """A source may leave its states unstamped."""
    loop = ControlLoop(control())
    assert [loop.answer(0, [float(k), 0.0], k * 0.01) for k in range(3)] == [[0.0], [-1.0], [-2.0]]


def test_commands_are_at_most_one_per_period() -> None:
    """The loop gives at most one command per period of the stamps, on a grid of periods."""
    loop = ControlLoop(control(rules=Rules(period=50 * MS)))
    answered = [k for k in range(100) if loop.answer(k * 5 * MS, [0.0, 0.0], k * 5e-3)]
    assert answered == list(range(0, 100, 10))
    assert loop.counts['skipped'] == 90
    # The nearest stamp counts; a gap begins a new grid.
    assert loop.answer(500 * MS - 10, [0.0, 0.0], 0.5)
    assert loop.answer(933 * MS, [0.0, 0.0], 1.0)
    assert not loop.answer(951 * MS, [0.0, 0.0], 1.0)   # 983 is 32 ms away, the next one nearer
    assert loop.answer(980 * MS, [0.0, 0.0], 1.0)


@pytest.mark.parametrize('rate', [20.0, 26.0, 45.0, 100.0])
def test_jitter_skips_no_state_at_the_nominal_rate(rate: float) -> None:
    """States at 20 Hz with jitter are all answered; faster ones at 20 Hz on average."""
    loop = ControlLoop(control(rules=Rules(period=50 * MS)))
    rng = np.random.default_rng(1)
    stamps = np.arange(0.0, 50.0, 1.0 / rate)
    stamps += rng.uniform(-0.006, 0.006, stamps.size) if rate == 20.0 else 0.0
    answered = sum(loop.answer(round(t * S) + S, [0.0, 0.0], t) is not None for t in stamps)
    assert answered == pytest.approx(1000, abs=1)


@pytest.mark.parametrize(('lag', 'kind'), [
    (0.0, ''), (0.4, ''), (0.6, 'old'), (3599.0, 'old'), (-0.4, ''), (-0.6, 'ahead'),
    (3601.0, 'old'), (-3601.0, 'ahead'), (1.7e9, 'old')])
def test_stamps_far_from_the_local_time_are_dropped(lag: float, kind: str) -> None:
    """Stamps too far in the past or future are dropped at any age."""
    loop = ControlLoop(control(rules=Rules(stamp_timeout=0.5)))
    stamp = 2_000_000_000 * S
    u = loop.answer(stamp, [1.0, 0.0], 0.0, stamp + round(lag * S))
    assert (u is None) == bool(kind)
    assert loop.counts[kind] == bool(kind)
    if kind:
        words = {'old': 'before', 'ahead': 'after'}[kind]
        assert f's {words} the local time was dropped' in loop.news[0]
        assert loop.lag == pytest.approx(lag)
        # A dropped state neither counts as received nor sets the last stamp.
        assert loop.overdue(1e9) is None
        assert loop.stamp is None
    unchecked = ControlLoop(control())
    assert unchecked.answer(stamp, [1.0, 0.0], 0.0, stamp + round(lag * S)) == [-1.0]


def test_states_that_are_all_late_trigger_on_stale() -> None:
    """If all states are late, on_stale acts as if none were received."""
    loop = ControlLoop(control(u=7.0, rules=Rules(stamp_timeout=0.5)))
    assert loop.answer(10 * S, [1.0, 0.0], 10.0, 10 * S) == [6.0]
    for k in range(1, 10):
        assert loop.answer(10 * S + k * 100 * MS, [1.0, 0.0], 10.0 + 0.1 * k, 20 * S) is None
    assert loop.overdue(10.9) == [7.0]
    assert loop.is_stale


# Timeout of states


@pytest.mark.parametrize(('action', 'commanded'), [
    ('equilibrium', [7.0]), ('hold', [6.0]), ('silent', None)])
def test_on_stale_acts_at_each_timeout_until_a_state_arrives(
        action: str, commanded: list[float] | None) -> None:
    """on_stale acts after each state_timeout, until a state arrives."""
    loop = ControlLoop(control(u=7.0, rules=Rules(state_timeout=0.2, on_stale=action)))
    assert loop.wake() == math.inf
    assert loop.overdue(1e9) is None  # No state has been received yet.
    assert loop.answer(0, [1.0, 0.0], 10.0) == [6.0]
    assert loop.wake() == 10.2
    assert loop.overdue(10.19) is None
    assert not loop.is_stale
    assert loop.overdue(10.2) == commanded
    assert loop.is_stale
    assert loop.overdue(10.3) is None
    assert loop.overdue(10.4) == commanded
    assert loop.counts['stale'] == 1
    assert f'on_stale: {action}' in loop.news[0]
    assert loop.answer(1, [2.0, 0.0], 11.0) == [5.0]
    assert not loop.is_stale
    assert loop.age(11.5) == 0.5


def test_invalid_states_do_not_reset_the_timeout() -> None:
    """A stream of NaN states triggers on_stale like no states at all."""
    loop = ControlLoop(control(rules=Rules(state_timeout=0.2)))
    loop.answer(0, [0.0, 0.0], 0.0)
    for k in range(1, 100):
        loop.answer(k * MS, [math.nan, 0.0], k * 0.01)
    assert loop.overdue(0.2) == [0.0]


def test_a_zero_timeout_disables_on_stale() -> None:
    """With state_timeout = 0 the loop never becomes stale."""
    loop = ControlLoop(control(rules=Rules(state_timeout=0.0)))
    loop.answer(0, [0.0, 0.0], 0.0)
    assert loop.wake() == math.inf
    assert loop.overdue(1e9) is None


# Stop and envelope


def test_a_stop_is_latched_until_start() -> None:
    """While stopped, the loop answers every state with the input at rest."""
    loop = ControlLoop(control(u=3.0, rest=(0.5,)))
    loop.answer(0, [1.0, 0.0], 0.0)
    loop.stop('by test')
    assert answers(loop, (1, [1.0, 0.0]), (2, [1.0, 0.0])) == [[0.5], [0.5]]
    assert loop.overdue(99.0) == [0.5]
    loop.start()
    assert answers(loop, (100, [1.0, 0.0])) == [[2.0]]


@pytest.mark.parametrize(('action', 'outside', 'back'), [
    ('stop', [7.0], [7.0]), ('equilibrium', [7.0], [6.5]), ('hold', [6.2], [6.5]),
    ('silent', None, [6.5])])
def test_on_envelope_acts_outside_x_limits(
        action: str, outside: list[float] | None, back: list[float]) -> None:
    """Outside x_limits on_envelope acts; only its stop is latched."""
    rules = Rules(x_limits=((-1.0, 2.0), (-math.inf, math.inf)), on_envelope=action)
    loop = ControlLoop(control(u=7.0, rules=rules))
    assert answers(loop, (0.0, [0.8, 0.0]), (0.1, [2.1, 0.0]), (0.2, [0.5, 0.0])) == [
        [6.2], outside, back]
    assert loop.counts['outside'] == 1
    assert 'the error of px is 2.1, outside [-1, 2]' in loop.news[0]
    assert loop.is_stopped is (action == 'stop')
    assert not loop.is_stopped or loop.reason == 'the error of px is 2.1, outside [-1, 2]'


# Random sequences of events


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(strategies.lists(strategies.tuples(
    strategies.integers(-10**12, 10**18),
    strategies.lists(strategies.floats(), min_size=0, max_size=3),
    strategies.floats(0.0, 1e6),
    strategies.sampled_from(['state', 'overdue', 'stop', 'start', 'adopt', 'preview'])),
    max_size=40))
def test_any_sequence_of_events_gives_commands_within_limits(
        events: list[tuple[int, list[float], float, str]]) -> None:
    """Every command is finite and within the limits, whatever the order of events."""
    loop = ControlLoop(control(limits=((-2.0,), (2.0,)), rest=(1.0,), drift=(1.0, 0.0),
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
        if u is not None:
            assert len(u) == 1
            assert -2.0 <= u[0] <= 2.0
