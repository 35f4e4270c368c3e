# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which references may be followed: inputs, motion, start; without ROS."""

from dataclasses import replace
import math
from typing import Any

from loop_bench import answers, control, K, leg, MS, S
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.closed_loop import references
from obc_ros.core.closed_loop.control import Leg, Prediction, Reference, Rules
from obc_ros.core.closed_loop.feedback import InputLimits, StateFeedback
from obc_ros.core.closed_loop.loop import ControlLoop
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


def given(t: Any, x: Any, u: Any, holds: bool = False) -> Course:
    """Return a reference of the vehicle."""
    return read_course(VEHICLE, ((), ()), t, np.ravel(x).tolist(), np.ravel(u).tolist(),
                       'zoh' if holds else 'linear', None)


def regulator(sampling: Sampling = ALWAYS) -> Design:
    """Return a design for the vehicle."""
    held = linearize_plant(VEHICLE, (0.0, 0.0, 0.0), (10.0, 0.0))
    return design(held, {'weights': 'matrices', 'Qx': (1.0,) * 3, 'Qu': (1.0,) * 2, 'cross': (),
                         'x_max': (), 'u_max': (), 'H': (), 'rho': 1.0, 'stability': 0.0},
                  (), (), sampling)


def bend(length: float = 2.0, samples: int = 41, holds: bool = False) -> Course:
    """Return the path of a vehicle with a wheelbase, by another integrator, over 4 s."""
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


# What is allowed


def test_what_is_allowed_follows_the_range_of_the_reference() -> None:
    """A tenth of the range, and of one unit where the range is smaller."""
    along = given([0.0, 10.0], [[5.0, 0.0, 0.1], [45.0, 2.0, 0.1]], [[4.0, 0.0]] * 2)
    assert np.allclose(compute_allowed_error(along), [(-4.0, 4.0), (-0.2, 0.2), (-0.1, 0.1)])


def test_what_is_allowed_is_what_is_given() -> None:
    """First start_tolerance, then x_limits where they have a bound."""
    along = given([0.0, 10.0], [[5.0, 0.0, 0.1], [45.0, 2.0, 0.1]], [[4.0, 0.0]] * 2)
    limits = ((-1.0, 2.0), (-math.inf, 3.0), (-math.inf, math.inf))
    assert np.allclose(compute_allowed_error(along, limits),
                       [(-1.0, 2.0), (-0.2, 3.0), (-0.1, 0.1)])
    assert compute_allowed_error(along, limits, (2.0, 1.0, math.inf)) == (
        (-2.0, 2.0), (-1.0, 1.0), (-math.inf, math.inf))


# Inputs and motion


@pytest.mark.parametrize('holds', [False, True])
@pytest.mark.parametrize('sampling', [ALWAYS, Sampling(0.05, 0.0, True)])
def test_the_path_of_the_plant_is_accepted(holds: bool, sampling: Sampling) -> None:
    """With few samples, too, and 1e-7 beyond a limit, as answers of solvers are."""
    for samples in (9, 41):
        along = bend(samples=samples, holds=holds)
        top = float(along.u[:, 0].max())
        check(along, regulator(sampling), InputLimits((0.0, -0.2), (top * (1.0 - 1e-7), 0.2)),
              compute_allowed_error(along))


def test_inputs_beyond_the_limits_are_refused() -> None:
    """With the time, the value and the limit."""
    with pytest.raises(RefusedReferenceError, match=(
            r'^v is 12 m/s at t = 4 s, the limit is 10 m/s; '
            r'phi is -0\.07568 rad at t = 4 s, the limit is -0\.05 rad; '
            r'phi is 0\.09.* rad at t = 1\.6 s, the limit is 0\.05 rad$')):
        check(bend(), regulator(), InputLimits((0.0, -0.05), (10.0, 0.05)), WIDE)


def test_the_path_of_another_plant_is_refused() -> None:
    """A wheelbase of 1 m instead of 2 m turns twice as fast as these inputs turn this vehicle."""
    along = bend(length=1.0)
    with pytest.raises(RefusedReferenceError, match=(
            r'the reference does not satisfy the dynamics: with its inputs theta deviates '
            r'by .* rad at t = .* s, allowed')):
        check(along, regulator(), FREE, compute_allowed_error(along))
    check(along, regulator(), FREE, WIDE)


def test_a_path_faster_than_its_inputs_is_refused() -> None:
    """55 m/s along the road with an input of 10 m/s; the error is that of the slowest pole."""
    t = np.linspace(0.0, 100.0, 1_001)
    along = given(t, np.column_stack([55.0 * t, 0.0 * t, 0.0 * t]), [[10.0, 0.0]] * 1_001)
    found = regulator()
    expected = 45.0 / -found.lqr.E.real.max()  # e' = 45 - e / time
    with pytest.raises(RefusedReferenceError, match=(
            rf'px deviates by {expected:.4g} m at t = .* s, allowed 1 m')):
        check(along, found, FREE, ((-1.0, 1.0), *WIDE[:2]))


def test_a_jump_of_a_state_is_refused() -> None:
    """A time that stands twice is for inputs."""
    x = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 3.0, 0.0], [20.0, 3.0, 0.0]]
    along = given([0.0, 1.0, 1.0, 2.0], x, [[10.0, 0.0]] * 4)
    with pytest.raises(RefusedReferenceError, match='py deviates by 3 m at t = 1 s, allowed 0.3'):
        check(along, regulator(), FREE, compute_allowed_error(along))


def test_a_path_without_a_rate_is_refused() -> None:
    """Where f overflows nothing is within what is allowed."""
    along = given([0.0, 1.0], [[0.0, 0.0, 0.0]] * 2, [[1e308, 1.5707963267948966]] * 2)
    with pytest.raises(RefusedReferenceError, match='does not satisfy the dynamics'):
        check(along, regulator(), FREE, compute_allowed_error(along))


# The start


def held(begin: int | None, px: float, allowed: float = 0.5, end: float = 2.0) -> Leg:
    """Return a reference that holds px, with a gain of its own."""
    law = StateFeedback((px, 0.0), (0.0,), ((3.0, 3.0),), (0.0, 0.0))
    return Leg(Reference(begin, end), law, law, ((-allowed, allowed),) * 2, ('m', ''))


def test_a_reference_that_is_far_away_is_not_taken_up() -> None:
    """The set point goes on, to the last bit; the reason names state, distance and bound."""
    loop, plain = ControlLoop(control(legs=(held(2 * S, 5.0),))), ControlLoop(control())
    states = [(t, [0.1 * t, 0.3]) for t in np.arange(0.0, 5.0, 0.25).tolist()]
    assert answers(loop, *states) == answers(plain, *states)
    assert list(loop.refused) == ["px is 4.8 m from the plan's start 5 m, allowed 0.5 m"]
    assert not loop.events


def test_a_reference_is_judged_by_the_state_at_its_beginning() -> None:
    """Near now and far then it is refused; far now and near then it is followed."""
    for now, then, is_refused in ((5.0, 0.0, True), (0.0, 5.1, False)):
        loop = ControlLoop(control(legs=(held(S, 5.0),)))
        u = answers(loop, (0.0, [now, 0.0]), (1.0, [then, 0.0]))[-1]
        assert bool(loop.refused) is is_refused
        assert u == pytest.approx([-then if is_refused else -3.0 * (then - 5.0)])


def test_a_reference_that_came_before_the_first_state_is_judged_by_it() -> None:
    """It moves nothing before."""
    loop = ControlLoop(control(legs=(held(None, 5.0),)))
    assert answers(loop, (7.0, [0.0, 0.0])) == [[0.0]]
    assert len(loop.refused) == 1
    loop = ControlLoop(control(legs=(held(None, 5.0),)))
    assert answers(loop, (7.0, [5.2, 0.0])) == [pytest.approx([-0.6])]
    assert list(loop.events) == ['the reference of 2 s begins']


def test_a_reference_joined_in_the_middle_is_judged_there() -> None:
    """The ramp px = t from 0 is at 1 m after 1 s."""
    ramp = replace(leg(0, 2.0), allowed=((-0.5, 0.5),) * 2, units=('m', 'm/s'))
    loop = ControlLoop(control(legs=(ramp,)))
    answers(loop, (1.0, [0.0, 1.0]))
    assert list(loop.refused) == ['px is 1 m from 1 m of the plan at t = 1 s, allowed 0.5 m']
    ramp = replace(leg(0, 2.0), allowed=((-0.5, 0.5),) * 2, units=('m', 'm/s'))
    loop = ControlLoop(control(legs=(ramp,)))
    answers(loop, (1.0, [1.0, 1.0]), (2.5, [2.0, 0.0]))
    assert not loop.refused
    assert list(loop.events) == [
        'the reference of 2 s begins', 'the reference of 2 s has ended']


def test_what_was_followed_goes_on_when_the_next_is_refused() -> None:
    """With a reference in force, that one."""
    first, second = held(0, 5.0, end=4.0), held(S, 9.0)
    loop = ControlLoop(control(legs=(first, second)))
    u = answers(loop, (0.5, [5.0, 0.0]), (1.5, [5.1, 0.0]), (9.0, [5.2, 0.0]))
    assert u == [pytest.approx([0.0]), pytest.approx([-0.3]), pytest.approx([-0.6])]
    assert len(loop.refused) == 1


def test_a_stopped_loop_judges_when_it_is_started() -> None:
    """Not by where the plant was when the reference came."""
    loop = ControlLoop(control(legs=(held(0, 5.0, end=9.0),)))
    loop.stop('by hand')
    answers(loop, (0.0, [0.0, 0.0]))
    assert not loop.refused
    assert not loop.events
    loop.start()
    assert answers(loop, (1.0, [5.1, 0.0])) == [pytest.approx([-0.3])]
    assert not loop.refused


def test_a_reference_is_judged_by_the_state_when_its_first_command_acts() -> None:
    """With a delay of 1 s and a plant that rolls on at 4 m/s: 4 m from where it is."""
    rolls = Prediction(((1.0, 1.0), (0.0, 1.0)), (((0.5,), (1.0,)),), S, S)
    for px, is_refused in ((0.0, True), (4.0, False)):
        law = StateFeedback((px, 4.0), (0.0,), K, (0.0, 0.0))
        near = Leg(Reference(S, 2.0), law, law, ((-0.5, 0.5),) * 2, ('m', 'm/s'))
        loop = ControlLoop(control(legs=(near,), prediction=rolls))
        answers(loop, (0.0, [0.0, 4.0]))
        assert bool(loop.refused) is is_refused


# After an outage


def resumed(loop: ControlLoop, *states: tuple[float, list[float]]) -> list[list[float] | None]:
    """Return the answers after an outage, in which on_stale has acted."""
    assert loop.overdue(states[0][0]) is not None
    assert loop.is_stale
    return answers(loop, *states)


def moving(begin: int = 0, end: float = 4.0, allowed: float = 0.5) -> Leg:
    """Return the ramp px = t, which may be taken up so far away."""
    return replace(leg(begin, end), allowed=((-allowed, allowed), (-2.0, 2.0)), units=('m', 'm/s'))


def test_a_reference_that_has_left_the_plant_behind_is_given_up() -> None:
    """The plant stood while no state came. It stands on, and holds the set point after a start."""
    loop = ControlLoop(control(legs=(moving(),), u=7.0, rest=(7.0,)))
    answers(loop, (0.0, [0.0, 1.0]), (0.4, [0.4, 1.0]))
    assert resumed(loop, (1.4, [0.5, 0.0]), (1.5, [1.5, 1.0])) == [[7.0], [7.0]]
    assert list(loop.refused) == [
        'after 1 s without a state, px is 0.9 m from 1.4 m of the plan at t = 1.4 s, allowed '
        '0.5 m; stopped until ~/start']
    assert loop.stopped.startswith('after 1 s without a state, px is 0.9 m')
    loop.start()
    assert answers(loop, (1.6, [0.25, 0.0])) == [[6.75]]
    assert len(loop.refused) == 1


def test_a_reference_that_the_plant_kept_up_with_goes_on() -> None:
    """As it would have without the outage."""
    loop, plain = ControlLoop(control(legs=(moving(),))), ControlLoop(control(legs=(moving(),)))
    before, after = [(0.0, [0.0, 1.0]), (0.4, [0.4, 1.0])], [(1.4, [1.3, 1.1]), (1.5, [1.4, 1.0])]
    answers(loop, *before)
    assert resumed(loop, *after) == answers(plain, *before, *after)[2:]
    assert not loop.refused
    assert not loop.stopped


def test_a_gap_that_nobody_noticed_is_an_outage_too() -> None:
    """Where the machine stood still on_stale could not act."""
    loop = ControlLoop(control(legs=(moving(),)))
    answers(loop, (0.4, [0.4, 1.0]), (0.8, [0.0, 1.0]))   # 0.4 s are none
    assert not loop.stopped
    answers(loop, (1.4, [0.5, 0.0]))
    assert loop.stopped.startswith('after 0.6 s without a state, px is 0.9 m from 1.4 m')


def test_an_outage_over_the_end_of_a_reference() -> None:
    """Its end is where the plant should be; one that had ended before is a set point."""
    loop = ControlLoop(control(legs=(moving(end=2.0),), u=7.0, rest=(7.0,)))
    answers(loop, (1.0, [1.0, 1.0]))
    assert resumed(loop, (9.0, [1.0, 0.0])) == [[7.0]]
    assert 'px is 1 m from 2 m of the plan at t = 2 s' in loop.refused[0]
    loop = ControlLoop(control(legs=(moving(end=2.0),)))
    answers(loop, (1.7, [1.7, 1.0]), (2.1, [2.0, 0.0]))
    assert resumed(loop, (9.0, [1.0, 0.0])) == [[1.5]]    # 0.5 - (1 - 2)
    assert not loop.refused
    assert not loop.stopped


def test_the_next_reference_takes_over_after_an_outage() -> None:
    """If the plant is near it; else neither it nor the one before is followed."""
    for px, is_refused in ((5.2, False), (1.0, True)):
        loop = ControlLoop(control(legs=(moving(), held(S, 5.0)), u=7.0, rest=(7.0,)))
        answers(loop, (0.4, [0.4, 1.0]))
        u = resumed(loop, (3.0, [px, 0.0]))
        assert bool(loop.stopped) is is_refused
        assert len(loop.refused) == 2 * is_refused
        assert u == [pytest.approx([7.0 if is_refused else -0.6])]


def test_a_rate_does_not_skip_the_judgement() -> None:
    """The first state that is answered after the outage is judged."""
    loop = ControlLoop(control(legs=(moving(),), rules=Rules(period=S, state_timeout=0.5)))
    answers(loop, (0.0, [0.0, 1.0]))
    assert resumed(loop, (0.9, [0.0, 0.0]), (1.0, [0.0, 0.0])) == [None, [0.0]]
    assert loop.stopped.startswith('after 0.9 s without a state, px is 1 m from 1 m')


def test_a_reference_is_judged_again_where_time_begins_again() -> None:
    """A simulation that was reset starts elsewhere."""
    loop = ControlLoop(control(legs=(held(S, 5.0),), rules=Rules(state_timeout=0.5)))
    answers(loop, (1.0, [5.0, 0.0]))
    assert not loop.refused
    loop.answer(0, [0.0, 0.0], 2.0)
    loop.answer(10 * MS, [0.0, 0.0], 2.01)
    loop.answer(S, [0.0, 0.0], 3.0)
    assert len(loop.refused) == 1


def test_an_error_of_an_angle_wraps() -> None:
    """A turn more or less is no distance."""
    turned = control(legs=(held(0, 2.0 * math.pi),))
    turned = replace(turned, limits=InputLimits((-9.0,), (9.0,), (0,)))
    assert not list(references.judge_references(turned, 0, [0.1, 0.0]))


def test_states_that_are_back_are_told_with_how_long_they_were_missing() -> None:
    """By the steady clock."""
    loop = ControlLoop(control(rules=Rules(state_timeout=0.5)))
    loop.answer(0, [0.0, 0.0], 10.0)
    assert loop.overdue(10.6) == [0.0]
    loop.answer(S, [0.0, 0.0], 13.25)
    assert list(loop.events) == ['states have returned after 3.25 s']
