# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of references: inputs, dynamics, initial distance, outages; without ROS."""

from dataclasses import replace
import math
from types import SimpleNamespace
from typing import Any

from loop_bench import answers, control, K, leg, S
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.closed_loop.control import Leg, Prediction, Reference, Rules
from obc_ros.core.closed_loop.feedback import InputLimits, StateFeedback
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.closed_loop.references import explain_distance
from obc_ros.core.lqr.design.design import ALWAYS, Design, design, linearize_plant, Sampling
from obc_ros.core.lqr.design.reference_checks import check, compute_allowed_error
from obc_ros.core.lqr.design.reference_tracking import Course, read_course
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import RefusedReferenceError
import pytest
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

VEHICLE = registry.get_system('vehicle', {})
FREE = InputLimits((-math.inf,) * 2, (math.inf,) * 2)
WIDE = ((-math.inf, math.inf),) * 3
BEGUN = 'the control law begins'


def given(t: Any, x: Any, u: Any, holds: bool = False) -> Course:
    """Return a reference of the vehicle from arrays."""
    return read_course(VEHICLE, ((), ()), t, np.ravel(x).tolist(), np.ravel(u).tolist(),
                       'zoh' if holds else 'linear', None)


def regulator(sampling: Sampling = ALWAYS) -> Design:
    """Return an LQR design for the vehicle."""
    held = linearize_plant(VEHICLE, (0.0, 0.0, 0.0), (10.0, 0.0))
    return design(held, {'weights': 'matrices', 'Qx': (1.0,) * 3, 'Qu': (1.0,) * 2, 'cross': (),
                         'x_max': (), 'u_max': (), 'H': (), 'rho': 1.0, 'stability': 0.0},
                  (), (), sampling)


def bend(length: float = 2.0, samples: int = 41, holds: bool = False) -> Course:
    """Return the path of a vehicle of wheelbase `length` over 4 s, by scipy's integrator."""
    t = np.linspace(0.0, 4.0, samples)
    u = np.column_stack([8.0 + t, 0.1 * np.sin(t)])
    x = [np.zeros(3)]
    for k in range(samples - 1):

        def slope(time: float, x: Array, k: int = k) -> list[float]:
            part = 0.0 if holds else (time - t[k]) / (t[k + 1] - t[k])
            v, phi = u[k] + part * (u[k + 1] - u[k])
            return [v * math.cos(x[2]), v * math.sin(x[2]), v / length * math.tan(phi)]

        x.append(solve_ivp(slope, (t[k], t[k + 1]), x[-1], rtol=1e-10, atol=1e-10).y[:, -1])
    return given(t, x, u, holds)


# Allowed deviations


def test_allowed_deviations_follow_the_range_of_the_reference() -> None:
    """A tenth of the range, or of one unit where the range is smaller, is allowed."""
    along = given([0.0, 10.0], [[5.0, 0.0, 0.1], [45.0, 2.0, 0.1]], [[4.0, 0.0]] * 2)
    assert np.allclose(compute_allowed_error(along), [(-4.0, 4.0), (-0.2, 0.2), (-0.1, 0.1)])


def test_allowed_deviations_prefer_what_the_user_gives() -> None:
    """start_tolerance takes precedence over finite bounds of x_limits."""
    along = given([0.0, 10.0], [[5.0, 0.0, 0.1], [45.0, 2.0, 0.1]], [[4.0, 0.0]] * 2)
    limits = ((-1.0, 2.0), (-math.inf, 3.0), (-math.inf, math.inf))
    assert np.allclose(compute_allowed_error(along, limits),
                       [(-1.0, 2.0), (-0.2, 3.0), (-0.1, 0.1)])
    assert compute_allowed_error(along, limits, (2.0, 1.0, math.inf)) == (
        (-2.0, 2.0), (-1.0, 1.0), (-math.inf, math.inf))


# Inputs and dynamics


@pytest.mark.parametrize('holds', [False, True])
@pytest.mark.parametrize('sampling', [ALWAYS, Sampling(0.05, 0.0, True)])
def test_paths_of_the_plant_are_accepted(holds: bool, sampling: Sampling) -> None:
    """Few samples and 1e-7 beyond a limit are accepted, as solvers produce both."""
    for samples in (9, 41):
        along = bend(samples=samples, holds=holds)
        top = float(along.u[:, 0].max())
        check(along, regulator(sampling), InputLimits((0.0, -0.2), (top * (1.0 - 1e-7), 0.2)),
              compute_allowed_error(along))


def test_inputs_beyond_the_limits_are_rejected() -> None:
    """The message gives the time, the value and the limit."""
    with pytest.raises(RefusedReferenceError, match=(
            r'^v is 12 m/s at t = 4 s, the limit is 10 m/s; '
            r'phi is -0\.07568 rad at t = 4 s, the limit is -0\.05 rad; '
            r'phi is 0\.09.* rad at t = 1\.6 s, the limit is 0\.05 rad$')):
        check(bend(), regulator(), InputLimits((0.0, -0.05), (10.0, 0.05)), WIDE)


def test_a_value_and_its_limit_are_never_printed_alike() -> None:
    """With four digits both would be 10 m/s, and 1 m."""
    t = np.linspace(0.0, 1.0, 11)
    along = given(t, np.column_stack([10.0001 * t, 0.0 * t, 0.0 * t]), [[10.0001, 0.0]] * 11)
    limits = InputLimits((0.0, -0.5), (10.0, 0.5))
    with pytest.raises(RefusedReferenceError, match=(
            r'v is 10\.0001 m/s at t = 0 s, the limit is 10 m/s$')):
        check(along, regulator(), limits, WIDE)
    known: Any = SimpleNamespace(limits=InputLimits((), ()), names=('px', 'py'))
    near: Any = SimpleNamespace(allowed=((-1.0, 1.0), (-0.31437, 0.31437)), units=('m', 'm'),
                                reference=Reference(None, 1.0))
    assert explain_distance(known, near, 0.0, (0.0, 2.0 - 0.31441), (0.0, 2.0)) == (
        "py is 0.31441 m from the plan's start 2 m, allowed 0.31437 m")


def test_paths_of_another_plant_are_rejected() -> None:
    """A wheelbase of 1 m instead of 2 m turns twice as fast for the same inputs."""
    along = bend(length=1.0)
    with pytest.raises(RefusedReferenceError, match=(
            r'the reference does not satisfy the dynamics: with its inputs theta deviates '
            r'by .* rad at t = .* s, allowed')):
        check(along, regulator(), FREE, compute_allowed_error(along))
    check(along, regulator(), FREE, WIDE)


def test_paths_faster_than_their_inputs_are_rejected() -> None:
    """The path moves at 55 m/s with an input of 10 m/s; the slowest pole sets the deviation."""
    t = np.linspace(0.0, 100.0, 1_001)
    along = given(t, np.column_stack([55.0 * t, 0.0 * t, 0.0 * t]), [[10.0, 0.0]] * 1_001)
    found = regulator()
    expected = 45.0 / -found.lqr.E.real.max()  # steady state of e' = 45 - e / time constant
    with pytest.raises(RefusedReferenceError, match=(
            rf'px deviates by {expected:.4g} m at t = .* s, allowed 1 m')):
        check(along, found, FREE, ((-1.0, 1.0), *WIDE[:2]))


def test_jumps_of_states_are_rejected() -> None:
    """A repeated time is a jump of the inputs only."""
    x = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 3.0, 0.0], [20.0, 3.0, 0.0]]
    along = given([0.0, 1.0, 1.0, 2.0], x, [[10.0, 0.0]] * 4)
    with pytest.raises(RefusedReferenceError, match='py deviates by 3 m at t = 1 s, allowed 0.3'):
        check(along, regulator(), FREE, compute_allowed_error(along))


def test_paths_along_which_f_overflows_are_rejected() -> None:
    """Where f is not finite, the deviation is not within the allowed one."""
    along = given([0.0, 1.0], [[0.0, 0.0, 0.0]] * 2, [[1e308, 1.5707963267948966]] * 2)
    with pytest.raises(RefusedReferenceError, match='does not satisfy the dynamics'):
        check(along, regulator(), FREE, compute_allowed_error(along))


# Distance at the beginning


def held(begin: int | None, px: float, allowed: float = 0.5, end: float = 2.0) -> Leg:
    """Return a reference that holds px with its own gain."""
    law = StateFeedback((px, 0.0), (0.0,), ((3.0, 3.0),), (0.0, 0.0))
    return Leg(Reference(begin, end), law, law, ((-allowed, allowed),) * 2, ('m', ''))


def test_a_distant_reference_is_not_followed() -> None:
    """The loop holds the set point unchanged; the reason names state, distance and bound."""
    loop, plain = ControlLoop(control(legs=(held(2 * S, 5.0),))), ControlLoop(control())
    states = [(t, [0.1 * t, 0.3]) for t in np.arange(0.0, 5.0, 0.25).tolist()]
    assert answers(loop, *states) == answers(plain, *states)
    assert list(loop.refused) == ["px is 4.8 m from the plan's start 5 m, allowed 0.5 m"]
    assert list(loop.events) == [BEGUN]


def test_a_reference_is_checked_against_the_state_at_its_start() -> None:
    """The distance when the reference is received does not count."""
    for now, then, is_refused in ((5.0, 0.0, True), (0.0, 5.1, False)):
        loop = ControlLoop(control(legs=(held(S, 5.0),)))
        u = answers(loop, (0.0, [now, 0.0]), (1.0, [then, 0.0]))[-1]
        assert bool(loop.refused) is is_refused
        assert u == pytest.approx([-then if is_refused else -3.0 * (then - 5.0)])


def test_a_reference_received_early_is_checked_at_the_first_state() -> None:
    """The first state decides whether it is followed."""
    loop = ControlLoop(control(legs=(held(None, 5.0),)))
    assert answers(loop, (7.0, [0.0, 0.0])) == [[0.0]]
    assert len(loop.refused) == 1
    loop = ControlLoop(control(legs=(held(None, 5.0),)))
    assert answers(loop, (7.0, [5.2, 0.0])) == [pytest.approx([-0.6])]
    assert list(loop.events) == [BEGUN, 'the reference of 2 s begins']


def test_a_reference_joined_midway_is_checked_there() -> None:
    """The ramp px = t, begun at 0, is at 1 m after 1 s."""
    ramp = replace(leg(0, 2.0), allowed=((-0.5, 0.5),) * 2, units=('m', 'm/s'))
    loop = ControlLoop(control(legs=(ramp,)))
    answers(loop, (1.0, [0.0, 1.0]))
    assert list(loop.refused) == ['px is 1 m from 1 m of the plan at t = 1 s, allowed 0.5 m']
    ramp = replace(leg(0, 2.0), allowed=((-0.5, 0.5),) * 2, units=('m', 'm/s'))
    loop = ControlLoop(control(legs=(ramp,)))
    answers(loop, (1.0, [1.0, 1.0]), (2.5, [2.0, 0.0]))
    assert not loop.refused
    assert list(loop.events) == [
        BEGUN, 'the reference of 2 s begins', 'the reference of 2 s has ended']


def test_rejecting_a_reference_leaves_the_previous_one_active() -> None:
    """The first reference is followed throughout."""
    first, second = held(0, 5.0, end=4.0), held(S, 9.0)
    loop = ControlLoop(control(legs=(first, second)))
    u = answers(loop, (0.5, [5.0, 0.0]), (1.5, [5.1, 0.0]), (9.0, [5.2, 0.0]))
    assert u == [pytest.approx([0.0]), pytest.approx([-0.3]), pytest.approx([-0.6])]
    assert len(loop.refused) == 1


def test_a_stopped_loop_checks_the_reference_at_its_start() -> None:
    """The state when the reference was received does not count."""
    loop = ControlLoop(control())
    loop.stop('by hand')
    loop.adopt(control(legs=(held(0, 5.0, end=9.0),)))
    answers(loop, (0.0, [0.0, 0.0]))
    assert not loop.refused
    assert not loop.events
    loop.start()
    assert answers(loop, (1.0, [5.1, 0.0])) == [pytest.approx([-0.3])]
    assert not loop.refused


def test_a_reference_is_checked_at_the_predicted_state() -> None:
    """With a delay of 1 s at 4 m/s the plant is 4 m further when the first command acts."""
    rolls = Prediction(((1.0, 1.0), (0.0, 1.0)), (((0.5,), (1.0,)),), S, S)
    for px, is_refused in ((0.0, True), (4.0, False)):
        law = StateFeedback((px, 4.0), (0.0,), K, (0.0, 0.0))
        near = Leg(Reference(S, 2.0), law, law, ((-0.5, 0.5),) * 2, ('m', 'm/s'))
        loop = ControlLoop(control(legs=(near,), prediction=rolls))
        answers(loop, (0.0, [0.0, 4.0]))
        assert bool(loop.refused) is is_refused


# Outages


def resumed(loop: ControlLoop, *states: tuple[float, list[float]]) -> list[list[float] | None]:
    """Return the commands after an outage during which on_stale has acted."""
    assert loop.overdue(states[0][0]) is not None
    assert loop.is_stale
    return answers(loop, *states)


def moving(begin: int = 0, end: float = 4.0, allowed: float = 0.5) -> Leg:
    """Return the ramp px = t with an allowed distance of `allowed`."""
    return replace(leg(begin, end), allowed=((-allowed, allowed), (-2.0, 2.0)), units=('m', 'm/s'))


def test_a_reference_far_ahead_after_an_outage_is_dropped() -> None:
    """The loop stops; after a start it holds the set point."""
    loop = ControlLoop(control(legs=(moving(),), u=7.0, rest=(7.0,)))
    answers(loop, (0.0, [0.0, 1.0]), (0.4, [0.4, 1.0]))
    assert resumed(loop, (1.4, [0.5, 0.0]), (1.5, [1.5, 1.0])) == [[7.0], [7.0]]
    assert list(loop.refused) == [
        'after 1 s without a state, px is 0.9 m from 1.4 m of the plan at t = 1.4 s, allowed '
        '0.5 m; stopped until ~/start']
    assert loop.is_stopped and loop.reason.startswith('after 1 s without a state, px is 0.9 m')
    loop.start()
    assert answers(loop, (1.6, [0.25, 0.0])) == [[6.75]]
    assert len(loop.refused) == 1


def test_a_reference_close_after_an_outage_continues() -> None:
    """The commands equal those without the outage."""
    loop, plain = ControlLoop(control(legs=(moving(),))), ControlLoop(control(legs=(moving(),)))
    before, after = [(0.0, [0.0, 1.0]), (0.4, [0.4, 1.0])], [(1.4, [1.3, 1.1]), (1.5, [1.4, 1.0])]
    answers(loop, *before)
    assert resumed(loop, *after) == answers(plain, *before, *after)[2:]
    assert not loop.refused
    assert not loop.is_stopped


def test_a_gap_between_stamps_is_an_outage_without_on_stale() -> None:
    """If the whole machine stalls, on_stale cannot act."""
    loop = ControlLoop(control(legs=(moving(),)))
    answers(loop, (0.4, [0.4, 1.0]), (0.8, [0.0, 1.0]))   # 0.4 s is no outage
    assert not loop.is_stopped
    answers(loop, (1.4, [0.5, 0.0]))
    assert loop.is_stopped
    assert loop.reason.startswith('after 0.6 s without a state, px is 0.9 m from 1.4 m')


def test_after_an_outage_the_end_of_the_reference_is_checked() -> None:
    """A reference that had ended before the outage is a set point and is not checked."""
    loop = ControlLoop(control(legs=(moving(end=2.0),), u=7.0, rest=(7.0,)))
    answers(loop, (1.0, [1.0, 1.0]))
    assert resumed(loop, (9.0, [1.0, 0.0])) == [[7.0]]
    assert 'px is 1 m from 2 m of the plan at t = 2 s' in loop.refused[0]
    loop = ControlLoop(control(legs=(moving(end=2.0),)))
    answers(loop, (1.7, [1.7, 1.0]), (2.1, [2.0, 0.0]))
    assert resumed(loop, (9.0, [1.0, 0.0])) == [[1.5]]    # 0.5 - (1 - 2)
    assert not loop.refused
    assert not loop.is_stopped


def test_the_next_reference_begins_after_an_outage_if_close() -> None:
    """If the plant is far from it, neither reference is followed."""
    for px, is_refused in ((5.2, False), (1.0, True)):
        loop = ControlLoop(control(legs=(moving(), held(S, 5.0)), u=7.0, rest=(7.0,)))
        answers(loop, (0.4, [0.4, 1.0]))
        u = resumed(loop, (3.0, [px, 0.0]))
        assert loop.is_stopped is is_refused
        assert len(loop.refused) == 2 * is_refused
        assert u == [pytest.approx([7.0 if is_refused else -0.6])]


def test_skipped_states_do_not_skip_the_check() -> None:
    """The first state that is answered after the outage is checked."""
    loop = ControlLoop(control(legs=(moving(),), rules=Rules(period=S, state_timeout=0.5)))
    answers(loop, (0.0, [0.0, 1.0]))
    assert resumed(loop, (0.6, [0.0, 0.0]), (1.0, [0.0, 0.0])) == [None, [0.0]]
    assert loop.is_stopped
    assert loop.reason.startswith('after 0.6 s without a state, px is 1 m from 1 m')


def test_a_reference_does_not_begin_again_after_a_reset() -> None:
    """After a reset the simulation starts elsewhere; its stamps come by again."""
    loop = ControlLoop(control(legs=(held(S, 5.0),), rules=Rules(state_timeout=0.5)))
    answers(loop, (1.0, [5.0, 0.0]))
    assert not loop.refused
    loop.answer(0, [0.0, 0.0], 2.0)
    assert list(loop.refused) == ['time went back by 1 s: the loop was restarted']
    assert answers(loop, (0.4, [0.0, 0.0]), (0.8, [0.0, 0.0]), (1.0, [5.0, 0.0])) == [
        [0.0], [0.0], [-5.0]]
    assert len(loop.refused) == 1


def test_errors_of_angles_wrap() -> None:
    """A difference of one turn counts as zero."""
    turned = control(legs=(held(0, 2.0 * math.pi),))
    loop = ControlLoop(replace(turned, limits=InputLimits((-9.0,), (9.0,), (0,))))
    answers(loop, (0.0, [0.1, 0.0]))
    assert not loop.refused


def test_the_return_of_states_is_reported_with_the_outage_time() -> None:
    """The duration is measured with the steady clock."""
    loop = ControlLoop(control(rules=Rules(state_timeout=0.5)))
    loop.answer(0, [0.0, 0.0], 10.0)
    assert loop.overdue(10.6) == [0.0]
    loop.answer(S, [0.0, 0.0], 13.25)
    assert list(loop.events) == [BEGUN, 'states have returned after 3.25 s']
