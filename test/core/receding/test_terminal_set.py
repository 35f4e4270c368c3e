# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Terminal sets: closed forms, random starts, a moving set point, refusals."""

from dataclasses import replace

import mpmath
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.formulation import RecedingProblem, state_receding_problem
from obc_ros.core.receding.terminal_set import find_terminal_set, TerminalSet
from obc_ros.core.systems.registry import get_system
from obc_ros.core.text.errors import RefusedDesignError
import pytest
from receding_problems import make_receding

STARTS = 200


def state(name: str, **given: object) -> RecedingProblem:
    """Return a registered system with limits, at 50 Hz."""
    return state_receding_problem(get_system(name), horizon=20, period=0.02,
                                  **given)  # type: ignore[arg-type]


FLYING = state('aircraft', weights={'Qx': [10, 10, 1, 1, 1, 1], 'Qu': [0.1, 0.1]},
               limits={'state_bounds': {'theta': [-0.3, 0.3]},
                       'input_bounds': {'f1': [-3, 3], 'f2': [30, 50]}})
DRIVING = state('vehicle', setpoint=[0.0, 0.0, 0.0], setpoint_input=[10.0, 0.0],
                limits={'state_bounds': {'py': [-1, 1]}, 'input_bounds': {'v': [0, 15]}})


def draw(found: TerminalSet, number: int) -> Array:
    """Return errors (number, n) with directions at random, most of them near the boundary."""
    random = np.random.default_rng(1)
    z = random.normal(size=(number, len(found.P)))
    z *= (random.uniform(size=(number, 1))**(1 / len(found.P))
          / np.linalg.norm(z, axis=1, keepdims=True))
    root: Array = np.linalg.cholesky(np.linalg.inv(found.P))
    return np.asarray(np.sqrt(found.level) * z @ root.T)


def test_the_level_of_a_scalar_with_a_bounded_input_is_its_closed_form() -> None:
    """For dx/dt = u the input reaches its bound 1 where |K e| = 1, that is at V = P / K^2."""
    problem = make_receding({
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'x**2 + u**2',
        'initial_state': {'x': 0}, 'final_time': {'free': False, 'value': 1},
        'input_bounds': {'u': [-1, 2]}}, horizon=5, period=0.1)
    found = find_terminal_set(problem)
    assert found.level == pytest.approx(problem.P[0, 0] / problem.K[0, 0]**2, rel=1e-6)
    assert found.proof.limit == 'u' and found.proof.remainder == found.proof.offset == 0.0
    assert found.proof.decrease == pytest.approx(abs(1 - 0.1 * problem.K[0, 0]), rel=1e-6)


@pytest.mark.parametrize('problem', [FLYING, DRIVING], ids=['aircraft', 'vehicle'])
def test_no_start_leaves_the_set_and_all_limits_hold(problem: RecedingProblem) -> None:
    """V falls at each sample by the proved factor at least, on the exact model."""
    found = find_terminal_set(problem)
    e = draw(found, STARTS)
    steps = problem.model.map(STARTS)
    low, high = problem.input_box
    V = np.einsum('ki,ij,kj->k', e, found.P, e)
    assert V.max() > 0.99 * found.level
    for _ in range(100):
        v = -e @ problem.K.T
        assert (v >= low).all() and (v <= high).all()
        x = problem.xe + e
        free = problem.drift == 0.0
        assert (x >= problem.limits.x_lower)[:, free].all()
        assert (x <= problem.limits.x_upper)[:, free].all()
        e = steps(e.T, v.T).full().T
        following = np.einsum('ki,ij,kj->k', e, found.P, e)
        assert (following <= V * found.proof.decrease**2 + 1e-14 * found.level).all()
        V = following


def test_the_bound_of_the_remainder_holds_at_random_errors() -> None:
    """|e+ - Acl e|_P <= remainder * V, by differences of the model."""
    found = find_terminal_set(FLYING)
    step = 1e-6
    Acl = np.stack([(FLYING.model(d, -FLYING.K @ d) - FLYING.model(-d, FLYING.K @ d)).full()[:, 0]
                    / (2 * step) for d in step * np.eye(6)], axis=1)
    for e in draw(found, 50):
        r = FLYING.model(e, -FLYING.K @ e).full()[:, 0] - Acl @ e
        assert np.sqrt(r @ found.P @ r) <= found.proof.remainder * (e @ found.P @ e) + 1e-10


def test_the_contraction_of_the_vehicle_is_that_of_its_closed_form() -> None:
    """With 50 digits: A and B by hand, A^2 = 0, so that Ad = I + A h and Bd = B h + A B h^2/2."""
    found = find_terminal_set(DRIVING)
    with mpmath.workdps(50):
        h, v = mpmath.mpf(DRIVING.period), mpmath.mpf(float(DRIVING.ue[0]))
        [base] = (mpmath.mpf(each.value) for each in DRIVING.system.parameters)
        A, B = mpmath.zeros(3), mpmath.zeros(3, 2)
        A[1, 2], B[0, 0], B[2, 1] = v, 1, v / base
        K, P = (mpmath.matrix(each.tolist()) for each in (DRIVING.K, found.P))
        loop = mpmath.eye(3) + A * h - (B * h + A * B * (h * h / 2)) * K
        L = mpmath.cholesky(P)
        image = L.T * loop * mpmath.inverse(L).T
        exact = mpmath.sqrt(max(mpmath.eigsy(image.T * image, eigvals_only=True)))
        bound = mpmath.mpf(found.proof.contraction)
        assert exact <= bound <= exact * (1 + mpmath.mpf(1e-12))


def move_set_point(problem: RecedingProblem, by: float) -> RecedingProblem:
    """Return a problem whose set point is no equilibrium: its first input is moved."""
    plant = problem.design.plant
    u = plant.equilibrium.u + by * (np.arange(len(problem.ue)) == 0)
    return replace(problem, design=replace(problem.design, plant=replace(
        plant, equilibrium=replace(plant.equilibrium, u=u))))


def test_a_set_point_beside_the_equilibrium_is_part_of_the_bound() -> None:
    """The error that a period makes of 0 is below the offset; V falls outside of a small set."""
    problem = move_set_point(FLYING, 1e-6)
    found = find_terminal_set(problem)
    moved = problem.model(np.zeros(6), np.zeros(2)).full()[:, 0]
    assert 0.0 < np.sqrt(moved @ found.P @ moved) <= found.proof.offset
    for e in draw(found, 50):
        before = np.sqrt(e @ found.P @ e)
        e = problem.model(e, -problem.K @ e).full()[:, 0]
        reached = np.sqrt(e @ found.P @ e)
        assert reached <= found.proof.decrease * before + found.proof.offset + 1e-10
        assert reached <= np.sqrt(found.level)
    assert 'since the set point is rounded' in found.proof.words


def test_a_set_point_far_from_the_equilibrium_is_refused() -> None:
    """A force of 0.5 N drives the aircraft out of any small set."""
    with pytest.raises(RefusedDesignError, match='decrease of V cannot be proved'):
        find_terminal_set(move_set_point(FLYING, 0.5))


def test_a_cost_to_go_that_is_too_ill_conditioned_is_refused() -> None:
    """Five times the same row and a rest below the rounding error."""
    design = FLYING.design
    P = np.ones((6, 6)) + 1e-16 * np.diag(np.arange(6))
    with pytest.raises(RefusedDesignError, match='terminal set: P cannot be proved'):
        find_terminal_set(replace(FLYING, design=replace(design, lqr=replace(design.lqr, P=P))))


def state_scalar(rate: str) -> RecedingProblem:
    """Return a problem with one state x, its rate and one input u without bounds."""
    return make_receding({
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': rate},
        'running_cost': 'x**2 + u**2', 'initial_state': {'x': 0},
        'final_time': {'free': False, 'value': 1}}, horizon=5, period=0.1)


def test_an_exact_set_point_adds_no_offset() -> None:
    """The rate 0.3 x^2 + u is exactly 0 at 0: V falls to 0."""
    found = find_terminal_set(state_scalar('0.3*x**2 + u'))
    assert found.proof.offset == 0.0 < found.proof.remainder
    assert 'rounded' not in found.proof.words


def test_dynamics_with_jumps_are_refused() -> None:
    """The derivatives of atan2 do not show its jump, so that they prove nothing."""
    problem = state_scalar('atan2(x, 1) + u')
    with pytest.raises(RefusedDesignError, match='where its rate is only known to be below 3.1'):
        find_terminal_set(problem)


def test_a_limit_along_the_motion_of_the_set_point_is_refused() -> None:
    """The bound of px is reached for sure."""
    problem = state('vehicle', setpoint=[0.0, 0.0, 0.0], setpoint_input=[10.0, 0.0],
                    limits={'state_bounds': {'px': [-5, 500]}})
    with pytest.raises(RefusedDesignError, match='moves along px'):
        find_terminal_set(problem)


def test_a_set_point_at_a_limit_is_refused() -> None:
    """There is no ellipsoid about it in which the bound holds."""
    problem = state('vehicle_lateral', limits={'state_bounds': {'py': [0, 1]}})
    with pytest.raises(RefusedDesignError, match='at the limit of py'):
        find_terminal_set(problem)


def test_a_path_constraint_makes_the_set_smaller() -> None:
    """The set keeps out of an obstacle near the set point."""
    near = {'path_constraints': [{'expr': '(px - 0.05)**2 + py**2', 'lower': 0.04**2}]}
    problem = state('aircraft', weights={'Qx': [10, 10, 1, 1, 1, 1], 'Qu': [0.1, 0.1]},
                    limits=near)
    found, free = find_terminal_set(problem), find_terminal_set(FLYING)
    assert found.level < free.level and found.proof.limit == 'path constraints'
    e = draw(found, STARTS)
    assert ((e[:, 0] - 0.05)**2 + e[:, 1]**2 >= 0.04**2).all()


def test_a_heavier_aircraft_may_leave_the_set() -> None:
    """The proof is for the exact model: 5 % of mass move the equilibrium out of the set."""
    found = find_terminal_set(FLYING)
    plant = FLYING.design.plant
    heavy = replace(FLYING, design=replace(FLYING.design, plant=replace(
        plant, system=plant.system.with_parameters({'m': 4.2}))))
    e = np.zeros(6)
    worst = 0.0
    for _ in range(500):
        e = heavy.model(e, -FLYING.K @ e).full()[:, 0]
        worst = max(worst, float(e @ found.P @ e))
    assert worst > found.level
