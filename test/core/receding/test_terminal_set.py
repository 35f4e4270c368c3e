# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Terminal sets: closed forms, random starts, a moving set point, refusals."""

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
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


def state_scalar(rate: str) -> RecedingProblem:
    """Return a problem with one state x, its rate and one input u without bounds."""
    return make_receding({
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': rate},
        'running_cost': 'x**2 + u**2', 'initial_state': {'x': 0},
        'final_time': {'free': False, 'value': 1}}, horizon=5, period=0.1)


def state_plane(rates: Mapping[str, str]) -> RecedingProblem:
    """Return a problem with the states x and y, their rates and one bounded input u."""
    return make_receding({
        'states': ['x', 'y'], 'inputs': ['u'], 'dynamics': rates,
        'running_cost': 'x**2 + y**2 + u**2', 'initial_state': {'x': 0, 'y': 0},
        'final_time': {'free': False, 'value': 1}, 'input_bounds': {'u': [-1, 1]}},
        horizon=5, period=0.02)


FLYING = state('aircraft', weights={'Qx': [10, 10, 1, 1, 1, 1], 'Qu': [0.1, 0.1]},
               limits={'state_bounds': {'theta': [-0.3, 0.3]},
                       'input_bounds': {'f1': [-3, 3], 'f2': [30, 50]}})
DRIVING = state('vehicle', setpoint=[0.0, 0.0, 0.0], setpoint_input=[10.0, 0.0],
                limits={'state_bounds': {'py': [-1, 1]}, 'input_bounds': {'v': [0, 15]}})


def draw(found: TerminalSet, number: int) -> Array:
    """Return errors (number, n) with directions at random, half of them at the boundary."""
    random = np.random.default_rng(1)
    z = random.normal(size=(number, len(found.P)))
    length = random.uniform(size=(number, 1))
    length[::2] = 1.0 - 1e-9
    z *= length / np.linalg.norm(z, axis=1, keepdims=True)
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
    assert found.limit == 'u' and found.offset == 0.0
    assert found.decrease == pytest.approx(abs(1 - 0.1 * problem.K[0, 0]), rel=1e-6)


@pytest.mark.parametrize('problem', [
    FLYING, DRIVING, state_scalar('x**3 + u'),
    state_plane({'x': 'y + sin(x)', 'y': '(u - y)/0.01'})],
    ids=['aircraft', 'vehicle', 'cube', 'fast actuator'])
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
        assert (following <= V * found.decrease**2 + 1e-14 * found.level).all()
        V = following


@pytest.mark.parametrize('rates', [
    {'x': 'y', 'y': 'u'}, {'x': 'y', 'y': '(u - y)/0.001'}, {'x': '0.3*x + y', 'y': '3*u - 0.1*x'},
    {'x': 'y', 'y': '10*x - 0.1*y + u'}, {'x': '1e6*y', 'y': '1e-6*u'}],
    ids=['double integrator', 'fast actuator', 'spiral', 'pendulum', 'units'])
def test_the_decrease_of_a_linear_plant_is_proved_in_real_numbers(rates: dict[str, str]) -> None:
    """It is not below the largest ratio of sqrt(V) with 50 digits, and at most 1e-6 above it."""
    problem = state_plane(rates)
    found, plant = find_terminal_set(problem), problem.system
    J = ca.Function('J', [plant.x, plant.u, plant.p], [ca.jacobian(
        plant.xdot, ca.vertcat(plant.x, plant.u))])(0, 0, plant.p_value).full()
    with mpmath.workdps(50):
        exponent = mpmath.zeros(3)
        exponent[:2, :] = mpmath.matrix(J.tolist()) * mpmath.mpf(problem.period)
        K, P = (mpmath.matrix(each.tolist()) for each in (problem.K, found.P))
        flow = mpmath.expm(exponent)
        L, loop = mpmath.cholesky(P), flow[:2, :2] - flow[:2, 2] * K
        image = L.T * loop * mpmath.inverse(L).T
        exact = mpmath.sqrt(max(mpmath.eigsy(image.T * image, eigvals_only=True)))
        assert exact <= mpmath.mpf(found.decrease) <= exact * (1 + mpmath.mpf(1e-6))


def test_no_level_is_proved_from_which_a_start_leaves() -> None:
    """From x = 2, the cube overcomes the regulator of dx/dt = x^3 + u."""
    problem = state_scalar('x**3 + u')
    leaves = np.array([2.0])
    assert abs(float(problem.model(leaves, -problem.K @ leaves))) > 2.0
    assert find_terminal_set(problem).measure(leaves) > 1.0


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
    assert 0.0 < np.sqrt(moved @ found.P @ moved) <= found.offset
    for e in draw(found, 50):
        before = np.sqrt(e @ found.P @ e)
        e = problem.model(e, -problem.K @ e).full()[:, 0]
        reached = np.sqrt(e @ found.P @ e)
        assert reached <= found.decrease * before + found.offset + 1e-10
        assert reached <= np.sqrt(found.level)
    assert 'since the set point is rounded' in found.words


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


def test_an_exact_set_point_adds_no_offset() -> None:
    """The rate 0.3 x^2 + u is exactly 0 at 0: V falls to 0."""
    found = find_terminal_set(state_scalar('0.3*x**2 + u'))
    assert found.offset == 0.0 and found.limit == 'decrease of V'
    assert 'rounded' not in found.words


@pytest.mark.parametrize('rate', [
    'atan2(x, 1) + u', 'atan2(x - 0.1, -1)*x**2 + x + u', 'abs(x) + u'])
def test_dynamics_with_jumps_or_kinks_are_refused(rate: str) -> None:
    """The derivatives of atan2 do not show its jump, so that they prove nothing."""
    with pytest.raises(RefusedDesignError, match='without jumps or kinks'):
        find_terminal_set(state_scalar(rate))


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
    assert found.level < free.level and found.limit == 'path constraints'
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
