# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Certified solutions of problems with known solutions; messages of failures."""

import math
import time

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import METHODS, solve
from obc_ros.core.text.errors import StatementError
import problems
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq, root

# The files state the accuracy of the published values; the slowest problems are benchmarks.
NAMES = (
    'aircraft_5', 'batch_reactor', 'brachistochrone', 'brachistochrone_wall',
    'bryson_denham_touch', 'catalyst_mixing', 'catenary', 'clamped_beam', 'container_crane',
    'cstr_luus', 'di_energy_speed_limit', 'di_fuel_abs', 'di_min_fuel', 'dido', 'goddard',
    'hypersensitive', 'jacobson_state_bound', 'lane_change', 'linear_tangent', 'moon_lander',
    'orbit_raising', 'rayleigh_mixed', 'rayleigh_mintime', 'robot_arm', 'singular_aly',
    'singular_scalar', 'soap_film', 'vanderpol_bounded', 'vanderpol_mintime', 'zermelo_constant',
    'zermelo_shear', 'di_time_fuel', 'dielectrophoretic', 'double_oscillator', 'electric_vehicle',
    'hager_hou_rao', 'logarithmic', 'mountain_car', 'nishida', 'dubins_right_left_right',
    'lunar_ascent', 'quad_2d_mintime', 'reinvestment', 'robbins', 'two_link_arm',
    'vanderpol_state_bound', 'around_a_disc', 'clark_fishery', 'floating_oscillator', 'fuller',
    'goddard_feet', 'hanging_chain', 'nearest_of_a_parabola', 'oil_shale', 'tuberculosis',
    'drug_displacement', 'equality_of_inputs', 'reorientation', 'cstr_kirk', 'abs_off_centre',
    'stiff_cubic', 'lee_ramirez', 'double_tank', 'parallel_reactions', 'jerk_limited',
    'goddard_speed_limit', 'missile', 'terminal_wells', 'downhill_from_a_hump',
    'epidemic_weak_lockdown', 'production_to_stock', 'snap_limited', 'mars_descent',
    'goddard_pressure_limit', 'thrust_in_a_disc', 'epidemic_beds', 'detumble_mintime',
    'disc_with_drag', 'friction_circle', 'invest_or_produce', 'power_limit',
    'power_and_speed_limit', 'hover_hold', 'jerk_and_braking_limits', 'sphere_geodesic',
    'terminal_wells_plane', 'dubins_point_inside', 'two_stage_cstr', 'pendulum_long',
    'stock_with_capacity', 'car_linear_limits', 'heated_rod', 'heated_rod_limit',
    'battery_with_losses')
# For these an integration by SciPy must reproduce the cost from the input.
REPLAYED = ('goddard', 'jacobson_state_bound', 'robot_arm', 'catalyst_mixing')
SLOW = (
    'batch_reactor', 'container_crane', 'orbit_raising', 'rayleigh_mixed', 'zermelo_shear',
    'mountain_car', 'nishida', 'dubins_right_left_right', 'lunar_ascent', 'robbins',
    'two_link_arm', 'vanderpol_state_bound', 'around_a_disc', 'fuller', 'hanging_chain',
    'oil_shale', 'tuberculosis', 'drug_displacement', 'equality_of_inputs', 'reorientation',
    'stiff_cubic', 'lee_ramirez', 'double_tank', 'parallel_reactions', 'goddard_speed_limit',
    'missile', 'downhill_from_a_hump', 'production_to_stock', 'snap_limited', 'mars_descent',
    'goddard_pressure_limit', 'epidemic_beds', 'friction_circle', 'power_limit',
    'power_and_speed_limit', 'hover_hold', 'jerk_and_braking_limits', 'sphere_geodesic',
    'dubins_point_inside', 'two_stage_cstr', 'pendulum_long', 'stock_with_capacity',
    'car_linear_limits', 'heated_rod_limit', 'battery_with_losses', *REPLAYED)


def replay(problem, solution):
    """Return the cost and psi(x(T)) of the input, integrated from x(0) by SciPy."""
    import casadi as ca
    from scipy.integrate import solve_ivp
    rate = ca.Function('rate', [problem.x, problem.u, problem.p], [problem.f, problem.L])
    z = np.append(problem.x0, 0.0)
    for k in np.flatnonzero(np.diff(solution.t) > 0):
        a, b, ua, ub = *solution.t[k:k + 2], *solution.u[k:k + 2]
        slope = 0.0 if solution.interpolation == 'zoh' else (ub - ua) / (b - a)
        z = solve_ivp(lambda t, z, a=a, ua=ua, slope=slope: np.concatenate(
            [value.full().ravel() for value in rate(
                z[:-1], ua + slope * (t - a), problem.p_value)]),
            (a, b), z, 'DOP853', rtol=1e-10, atol=1e-11).y[:, -1]
    V = ca.Function('V', [problem.x, problem.p], [problem.V, problem.psi])
    end, psi = (value.full().ravel() for value in V(z[:-1], problem.p_value))
    return z[-1] + end[0], psi


def compute_jacobson_cost():
    """
    Return the minimum cost of jacobson_state_bound by shooting with matrix exponentials.

    Off the bound x2 <= b(t) the problem is linear quadratic, with u = -100 lam2. On it x2 = b and
    u = b' + b. At both ends of the boundary arc u is continuous; lam1 is continuous everywhere.
    """
    Z = np.array([[0, 1, 0, 0], [0, -1, 0, -100], [-2, 0, 0, 0], [0, -2, -1, 1.0]])
    b = np.polynomial.Polynomial([1.5, -8, 8])
    u, integral = b.deriv() + b, b.integ()

    def follow(lam1, lam2, enter, leave):
        z = expm(Z * enter) @ [0, -1, lam1, lam2]
        x1 = z[0] + integral - integral(enter)
        lam1 = z[2] - 2 * (x1.integ()(leave) - x1.integ()(enter))
        return z, x1, np.array([x1(leave), b(leave), lam1, -u(leave) / 100])

    def miss(unknown):
        z, _, after = follow(*unknown)
        enter, leave = unknown[2:]
        return [z[1] - b(enter), -100 * z[3] - u(enter), *(expm(Z * (1 - leave)) @ after)[2:]]

    found = root(miss, [0.0, 0.0, 0.3, 0.7], tol=1e-13).x
    np.testing.assert_allclose(miss(found), 0, atol=1e-10)   # u is about 6
    _, x1, after = follow(*found)
    enter, leave = found[2:]
    nodes, weights = np.polynomial.legendre.leggauss(30)

    def integrate(rate, begin, end):
        return (end - begin) / 2 * sum(
            weight * rate(begin + (end - begin) * (node + 1) / 2)
            for node, weight in zip(nodes, weights, strict=True))

    def rate(x1, x2, _, lam2):
        return x1**2 + x2**2 + 0.005 * (100 * lam2)**2

    return (integrate(lambda t: rate(*(expm(Z * t) @ [0, -1, *found[:2]])), 0, enter)
            + integrate(lambda t: rate(x1(t), b(t), 0, -u(t) / 100), enter, leave)
            + integrate(lambda t: rate(*(expm(Z * (t - leave)) @ after)), leave, 1))


def check_jacobson(solution):
    """Bounds tightened between mesh points cost little."""
    assert solution.objective == pytest.approx(compute_jacobson_cost(), rel=3e-6)


def check_friction_circle(solution):
    """On a coarse mesh the force appears to jump; on the optimal path it turns continuously."""
    assert solution.switching_times.size == 0
    turned = np.linalg.norm(np.diff(solution.u, axis=0), axis=1)
    assert turned.max() < 0.3


def check_moon_landing(solution):
    structure = problems.read('moon_lander')['expected']['structure']
    np.testing.assert_allclose(
        solution.switching_times, structure['switching_times'], atol=1e-7)
    assert solution.t[-1] == pytest.approx(structure['final_time'], abs=1e-8)
    assert set(np.round(solution.u.ravel(), 12)) == {0.0, 3.0}


def check_catalyst_mixing(solution):
    """Bang-singular-bang; the singular input in the literature is 0.227142."""
    np.testing.assert_allclose(solution.switching_times, [0.13630, 0.72524], atol=1e-4)
    middle = (solution.t > 0.3) & (solution.t < 0.6)
    np.testing.assert_allclose(solution.u[middle, 0], 0.227142, atol=1e-4)


# What is known of a solution besides its cost.
CHECKS = {
    'jacobson_state_bound': check_jacobson, 'friction_circle': check_friction_circle,
    'moon_lander': check_moon_landing, 'catalyst_mixing': check_catalyst_mixing}


assert set(CHECKS) <= set(NAMES)


@pytest.mark.parametrize('name', [
    pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in NAMES])
def test_published_problem(name):
    problem, expected = problems.build(name), problems.read(name)['expected']
    solution = solve(problem, time_limit=60)
    assert solution.status is Status.SOLVED, solution.message
    assert certify(problem, solution).holds
    assert solution.objective == pytest.approx(
        float(expected['objective']), abs=expected['tolerance'])
    if name in REPLAYED:
        cost, psi = replay(problem, solution)
        assert cost == pytest.approx(solution.objective, rel=1e-6)
        np.testing.assert_allclose(psi, 0.0, atol=1e-6)
    if name in CHECKS:
        CHECKS[name](solution)


@pytest.mark.parametrize('start, minimum', [
    ((1, 0), 2.0), ((1, 0.5), 0.5 + 2 * math.sqrt(1.125))])
@pytest.mark.parametrize('method', ['auto', 'arcs'])
def test_double_integrator_in_minimum_time(start, minimum, method):
    """Above the switching curve T = v + 2 sqrt(x + v^2/2)."""
    problem = problems.build('di_mintime_rest', initial_state={'x': start[0], 'v': start[1]})
    solution = solve(problem, method=method)
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(minimum, abs=1e-9)


def test_minimum_time_with_a_speed_limit_is_exact():
    """
    From rest at 0 to rest at 4, |v|, |u| <= 1: accelerate for 1, cruise for 3, brake for 1.

    While it cruises the multiplier of v <= 1 is a density, -lam_x = 1.
    """
    problem = problems.build('di_mintime_speed_limit')
    solution = solve(problem)
    assert solution.status is Status.SOLVED, solution.message
    assert certify(problem, solution).holds
    assert problems.read('di_mintime_speed_limit')['expected']['objective'] == 5.0
    assert solution.objective == pytest.approx(5.0, abs=1e-9)
    np.testing.assert_allclose(solution.switching_times, [1, 4], atol=1e-8)
    inside = (solution.t > 1.2) & (solution.t < 3.8)
    np.testing.assert_allclose(solution.state_multipliers[inside, 1], 1.0, atol=1e-6)


@pytest.mark.parametrize('name, l', [
    ('bryson_denham', 1 / 9), pytest.param('breakwell', 0.1, marks=pytest.mark.slow),
    pytest.param('bryson_denham_tight', 0.05, marks=pytest.mark.slow)])
def test_a_state_constraint_has_its_known_junction_times(name, l):  # noqa: E741
    """
    The bound x <= l is active from 3 l to 1 - 3 l.

    Before, u = -2/(3 l) (1 - t/(3 l)); the minimum cost is J = 4/(9 l). On the three arcs lam_x
    is 2/(9 l^2), 0 and -2/(9 l^2).

    A. E. Bryson, Y.-C. Ho, Applied Optimal Control, section 3.11.
    """
    problem = problems.build(name)
    solution = solve(problem)
    assert solution.status is Status.SOLVED, solution.message
    assert certify(problem, solution).holds
    assert solution.objective == pytest.approx(4 / (9 * l), rel=1e-9)
    assert problems.read(name)['expected']['objective'] == pytest.approx(4 / (9 * l), rel=1e-12)
    np.testing.assert_allclose(solution.switching_times, [3 * l, 1 - 3 * l], atol=1e-7)
    np.testing.assert_allclose(solution.lam[0], [2 / (9 * l**2), 2 / (3 * l)], rtol=1e-5)
    if name == 'bryson_denham':
        lam, t = solution.lam[:, 0], solution.t
        np.testing.assert_allclose(lam[t < 0.31], 18.0, atol=1e-2)
        np.testing.assert_allclose(lam[(t > 0.36) & (t < 0.64)], 0.0, atol=1e-2)
        np.testing.assert_allclose(lam[t > 0.69], -18.0, atol=1e-2)


def test_a_constant_load_is_solved_by_the_riccati_method():
    # From rest to rest in the same place the mean of u equals the load; so does the optimal u.
    solution = solve(problems.pose(
        {'x': 'v', 'v': 'u - 1'}, '0.5*u**2', (0, 0), 2, terminal_constraints=['x', 'v']))
    assert (solution.status, solution.method) == (Status.SOLVED, 'riccati')
    assert solution.objective == pytest.approx(1.0, rel=1e-12)


ZERO_COST = {
    'inverted pendulum': {
        'states': ['q', 'w'], 'inputs': ['u'], 'dynamics': {'q': 'w', 'w': 'sin(q) + u'},
        'initial_state': {'q': 1, 'w': 0}, 'terminal_constraints': ['q', 'w'],
        'input_bounds': {'u': [-1.5, 1.5]}, 'final_time': {'free': False, 'value': 25}},
    'around a disc': {
        'states': ['x', 'y'], 'inputs': ['u', 'v'], 'dynamics': {'x': 'u', 'y': 'v'},
        'initial_state': {'x': -2, 'y': 0}, 'terminal_constraints': ['x - 2', 'y'],
        'input_bounds': {'u': [-2, 2], 'v': [-2, 2]}, 'final_time': {'free': False, 'value': 5},
        'path_constraints': [{'expr': 'x**2 + y**2', 'lower': 1}]},
    'aircraft': {
        'system': 'aircraft', 'initial_state': dict.fromkeys(
            ('px', 'py', 'theta', 'vx', 'vy', 'omega'), 0),
        'terminal_constraints': ['px - 1', 'py - 1', 'theta', 'vx', 'vy', 'omega'],
        'input_bounds': {'f1': [-5, 5], 'f2': [0, 60]},
        'final_time': {'free': True, 'lower': 1, 'upper': 10}},
}


@pytest.mark.slow
@pytest.mark.parametrize('name', ZERO_COST)
def test_a_zero_cost_gives_a_feasible_path(name):
    problem = problems.build({'running_cost': '0'} | ZERO_COST[name])
    solution = solve(problem)
    assert (solution.status, solution.objective) == (Status.SOLVED, 0.0), solution.message
    _, psi = replay(problem, solution)
    # The falling pendulum amplifies errors of the replay by up to e^25 over T = 25.
    np.testing.assert_allclose(psi, 0.0, atol=0.1 if name == 'inverted pendulum' else 1e-6)
    if name == 'around a disc':
        assert np.hypot(*solution.x[:, :2].T).min() > 1 - 1e-6


# References that can be followed, as (states of x' = v, v' = u, or x' = u; running cost; T).
FOLLOWED = {
    'a sine': (1, '(x - sin(t))**2 + (u - cos(t))**2', 1),
    'a sine for long': (1, '(x - sin(t))**2 + (u - cos(t))**2', 5),
    'three periods': (1, '(x - sin(t))**2 + (u - cos(t))**2', 20),
    'the input alone': (1, '(u - cos(t))**2', 1),
    'the square of the square': (1, '(x - sin(t))**4 + 0.1*(u - cos(t))**2', 1),
    'two states': (2, '(x - sin(t))**2 + (v - cos(t))**2 + (u + sin(t))**2', 3)}


@pytest.mark.slow
@pytest.mark.parametrize('name, cost, more', [
    *((name, 1, {}) for name in FOLLOWED), ('a sine', 1e6, {}), ('a sine', 1e-6, {}),
    ('two states', 1e6, {}), ('three periods', 1e-6, {}),
    ('a sine for long', 1, {'input_bounds': {'u': [-2, 2]}}),
    ('a sine', 1, {'terminal_cost': '10*(x - sin(1))**2'})])
def test_a_reference_that_can_be_followed_costs_nothing(name, cost, more):
    n, L, T = FOLLOWED[name]
    rates = {'x': 'u'} if n == 1 else {'x': 'v', 'v': 'u'}
    found = solve(problems.pose(rates, f'{cost}*({L})', (0, 1)[:n], T, **more))
    assert found.status is Status.SOLVED, found.message
    assert found.objective == pytest.approx(0.0, abs=1e-9 * cost)
    np.testing.assert_allclose(found.u[:, 0], np.cos(found.t) if n == 1 else -np.sin(found.t),
                               atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize('length', [1e3, 1e-3])
def test_a_reference_is_followed_in_any_unit_of_length(length):
    found = solve(problems.pose(
        {'x': f'{length}*u'}, f'(x/{length} - sin(t))**2 + (u - cos(t))**2', (0,), 1))
    assert found.status is Status.SOLVED, found.message
    assert found.objective == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_no_path_is_found_across_an_equilibrium():
    # Harvested logistic growth comes within 1e-9 of x = 1 but never falls below it.
    solution = solve(problems.pose(
        {'x': '(x - 1)*(2 - x - u)'}, '0', (1.5,), 40, terminal_constraints=['x - 0.8'],
        input_bounds={'u': [0, 3]}))
    assert solution.status is Status.NOT_CONVERGED
    assert 'no path was found' in solution.message
    assert 'one meets them' not in solution.message


@pytest.mark.parametrize('end', [(1, 2), (1, 2, 2), (0, -3), (1e-3, 2e-3)])
def test_exercise_2_3_is_solved_as_stated(end):
    # The integrand |u| has no gradient at u = 0, and the speed along the line is arbitrary.
    names = [f'x{i}' for i in range(len(end))]
    inputs = [f'u{i}' for i in range(len(end))]
    solution = solve(problems.build({
        'states': names, 'inputs': inputs, 'dynamics': dict(zip(names, inputs, strict=True)),
        'running_cost': f'sqrt({" + ".join(f"{name}**2" for name in inputs)})',
        'initial_state': dict.fromkeys(names, 0),
        'terminal_constraints': [f'{name} - ({value})' for name, value in zip(
            names, end, strict=True)],
        'final_time': {'free': False, 'value': 1}}))
    assert solution.status is Status.SOLVED, solution.message
    assert solution.objective == pytest.approx(math.hypot(*end), rel=1e-7)


@pytest.mark.slow
def test_quadratic_drag_from_rest_to_rest_is_that_along_a_line():
    """On the line to (3, 1) the drag |v| v is v^2, which is smooth."""
    drag = '0.5*sqrt(vx**2 + vy**2)'
    plane = solve(problems.pose(
        {'x': 'vx', 'y': 'vy', 'vx': f'ax - {drag}*vx', 'vy': f'ay - {drag}*vy'}, 'ax**2 + ay**2',
        (0, 0, 0, 0), 4, inputs=('ax', 'ay'), terminal_constraints=['x - 3', 'y - 1', 'vx', 'vy']))
    line = solve(problems.pose(
        {'s': 'v', 'v': 'a - 0.5*v**2'}, 'a**2', (0, 0), 4, inputs=('a',),
        terminal_constraints=['s - sqrt(10)', 'v']))
    assert plane.status == line.status == Status.SOLVED
    assert plane.objective == pytest.approx(line.objective, rel=1e-6)


def test_arcs_of_a_triple_integrator():
    """From (1, 0, 0) to rest: T = 32^(1/3), switches at T/4 and 3 T/4."""
    problem = problems.build('triple_integrator_mintime')
    solution = solve(problem, method='arcs')
    T = 32 ** (1 / 3)
    assert solution.objective == pytest.approx(T, abs=1e-8)
    np.testing.assert_allclose(solution.switching_times, [T / 4, 3 * T / 4], atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize('thrust, brake, limit, distance', [
    (1, 2, 1, 4), (3, 7, 1, 4), (2, 1, 3, 20), (1, 1, 2.5, 13), (9.81, 3, 30, 1000),
    (1e-3, 1e-3, 0.5, 4e3), (1e4, 1e4, 1e2, 4), (1, 1, 1.99, 4), (1, 1, 1.9999, 4)])
def test_minimum_time_with_a_speed_limit_in_any_units(thrust, brake, limit, distance):
    """Full thrust up to the limit, cruise, brake: a trapezoidal speed profile."""
    cruise = distance - limit**2 / 2 * (1 / thrust + 1 / brake)
    minimum = limit / thrust + limit / brake + cruise / limit
    solution = solve(problems.pose(
        {'s': 'v', 'v': 'u'}, 1, (0, 0),
        {'free': True, 'lower': minimum / 40, 'upper': minimum * 200},
        terminal_constraints=[f's - {distance}', 'v'], input_bounds={'u': [-brake, thrust]},
        state_bounds={'v': [None, limit]}))
    assert solution.status is Status.SOLVED, solution.message
    assert solution.objective == pytest.approx(minimum, rel=1e-7)
    np.testing.assert_allclose(
        solution.switching_times, [limit / thrust, minimum - limit / brake], rtol=1e-6)


def test_a_speed_limit_that_is_only_touched():
    """The limit 2 is the peak speed without a limit; T = 2 sqrt(4)."""
    solution = solve(problems.build('di_mintime_speed_limit', state_bounds={'v': [None, 2]}))
    assert solution.status is Status.SOLVED, solution.message
    assert solution.objective == pytest.approx(4, rel=1e-8)


def test_no_minimum_is_claimed_past_a_conjugate_point():
    """From 0 to 0 the integral of u^2 - x^2 is nonnegative for T < pi and unbounded beyond."""
    for T, status in ((3, Status.SOLVED), (4, Status.NOT_CONVERGED)):
        found = solve(problems.pose(
            {'x': 'u'}, 'u**2 - x**2', (0,), T, terminal_constraints=['x']))
        assert found.status is status
    assert 'no minimum' in found.message


def test_a_stationary_path_without_a_minimum_is_rejected():
    """At x = 0 all residuals vanish, but the integral of -x^2 is unbounded on either side."""
    found = solve(problems.pose({'x': 'u*(1 + x**2)'}, '-x**2', (0,), 1))
    assert found.status is Status.NOT_CONVERGED
    assert 'input_bounds may be missing' in found.message


def test_an_impulsive_infimum_is_reported():
    """The infimum of the integral of |u| is 2; ever shorter pulses at both ends approach it."""
    found = solve(problems.pose(
        {'x': 'v', 'v': 'u'}, 'abs(u)', (0, 0), 1, terminal_constraints=['x - 1', 'v']))
    assert found.status is Status.NOT_CONVERGED
    assert 'u approaches an impulse' in found.message


def test_a_saddle_is_left_for_a_minimum():
    """
    The path x = 0 is an extremal, and iterations that start on it stay on it.

    The minima on either side: |u| = 1 until a, then |x| = A cos 2(t - 1), with x and u
    continuous at a.
    """
    a = brentq(lambda a: np.tan(2 * (1 - a)) - 1 / (2 * a), 0.5, 0.9)
    minimum = 2 * (a - 4 * a**3 / 3 - (a / np.cos(2 * (1 - a)))**2 * np.sin(4 * (1 - a)))
    found = solve(problems.pose(
        {'x': 'u'}, 'u**2 - 4*x**2', (0,), 2, terminal_constraints=['x'],
        input_bounds={'u': [-1, 1]}))
    assert found.status is Status.SOLVED, found.message
    assert found.objective == pytest.approx(minimum, rel=1e-5)
    assert np.abs(found.x).max() == pytest.approx(a / np.cos(2 * (1 - a)), rel=1e-4)


def test_an_extremal_with_conjugate_points_is_left():
    """
    Driving straight on after the lane change is an extremal of cost 3007.994, but no minimum.

    The weight of px rewards swerving, which reduces the speed along the road. The expected cost
    3007.732 is that of a zero-order hold on 1000 intervals.
    """
    found = solve(problems.build({
        'states': ['px', 'py', 'theta'], 'inputs': ['v', 'phi'],
        'dynamics': {'px': 'v*cos(theta)', 'py': 'v*sin(theta)', 'theta': 'v/3*tan(phi)'},
        'running_cost': '0.1*(px-100)**2+10*(py-2)**2+0.1*theta**2+0.1*(v-10)**2+phi**2',
        'initial_state': {'px': 0, 'py': -2, 'theta': 0},
        'terminal_constraints': ['px - 100', 'py - 2', 'theta'],
        'input_bounds': {'v': [8, 12], 'phi': [-0.1, 0.1]},
        'final_time': {'free': False, 'value': 10}}))
    assert found.status is Status.SOLVED, found.message
    assert found.objective == pytest.approx(3007.732, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize('name', ['cart_pole', 'f8_aircraft'])
def test_a_published_local_minimum_is_not_exceeded(name):
    """Published: 58.81 for the cart-pole, 5.73 for the F-8; both have better minima."""
    solution = solve(problems.build(name))
    known = float(problems.read(name)['expected']['objective'])
    assert solution.status is Status.SOLVED, solution.message
    assert solution.objective <= known * (1 + 1e-5)


def test_the_tail_of_an_optimal_path_is_optimal():
    """Bellman: the Van der Pol problem solved again from its middle has the same path."""
    problem = problems.build('vanderpol_bounded')
    whole = solve(problem)
    k = int(np.searchsorted(whole.t, 2.5))
    tail = solve(problems.build('vanderpol_bounded', initial_state=dict(
        zip(problem.states, map(float, whole.x[k]), strict=True)),
        final_time={'free': False, 'value': float(5 - whole.t[k])}))
    assert tail.status is Status.SOLVED
    np.testing.assert_allclose(tail.x[-1], whole.x[-1], atol=1e-3)
    np.testing.assert_allclose(tail.lam[0], whole.lam[k], atol=1e-2)


@pytest.mark.slow
def test_no_feasible_neighbour_is_cheaper():
    """The Van der Pol solution against 20 perturbed inputs, clipped to the bounds."""
    from dataclasses import replace
    problem = problems.build('vanderpol_bounded')
    solution = solve(problem)
    chance = np.random.default_rng(0)
    for _ in range(20):
        wave = sum(chance.normal() * np.sin(k * solution.t) for k in range(1, 6))
        u = np.clip(solution.u + 0.05 * wave[:, None], -0.3, 1)
        cost, _ = replay(problem, replace(solution, u=u))
        assert cost > solution.objective


@pytest.mark.slow
@settings(max_examples=5)
@given(scale=st.floats(1e-3, 1e3), speed=st.floats(1e-2, 1e2))
def test_scaling_cost_and_time_scales_the_minimum(scale, speed):
    """With the running cost c L and the dynamics k f over T / k the minimum is c J / k."""
    def problem(c, k):
        return problems.pose(
            {'x1': f'{k!r}*((1 - x2**2)*x1 - x2 + u)', 'x2': f'{k!r}*x1'},
            f'{c!r}*(x1**2 + x2**2 + u**2)', (0, 1), 5 / k, input_bounds={'u': [-0.3, 1]})

    plain, scaled = solve(problem(1.0, 1.0)), solve(problem(scale, speed))
    assert scaled.status is Status.SOLVED
    assert scaled.objective == pytest.approx(plain.objective * scale / speed, rel=1e-5)


@settings(max_examples=8)
@given(a=st.floats(-2, 2), b=st.floats(0.3, 2), c=st.floats(0.1, 5), T=st.floats(0.3, 3))
def test_transcription_agrees_with_the_closed_form(a, b, c, T):
    """Example 2.2: J = P(0) x0^2 / 2 with dP/dt = -2 a P + b^2 P^2, P(T) = c."""
    problem = problems.build('lq_scalar_unit', parameters={'a': a, 'b': b, 'c': c},
                        final_time={'free': False, 'value': T})
    solution = solve(problem, method='transcription')
    # W = 1/P satisfies dW/dt = 2 a W - b^2, whose closed form is stable for small a.
    gain = T if abs(a) < 1e-9 else -math.expm1(-2 * a * T) / (2 * a)
    minimum = 0.5 / (math.exp(-2 * a * T) / c + b**2 * gain)
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(minimum, rel=1e-5)


def test_each_method_solves_only_its_class():
    lq = problems.build('lq_scalar_unit')
    minimum_time = problems.build('di_mintime_rest')
    # The minimum is 1/(1 + exp(-2)).
    assert solve(lq, method='riccati').objective == pytest.approx(0.8807970779778824, abs=1e-10)
    assert solve(lq).method == 'riccati'
    assert solve(minimum_time).method == 'time_optimal'
    rejected = solve(minimum_time, method='riccati')
    assert rejected.status is Status.NOT_CONVERGED
    assert 'linear quadratic' in rejected.message
    rejected = solve(lq, method='time_optimal')
    assert rejected.status is Status.NOT_CONVERGED
    assert 'minimum-time' in rejected.message


def test_an_unknown_method_is_reported_with_the_known_ones():
    with pytest.raises(StatementError, match="'shooting' is unknown.*transcription") as caught:
        solve(problems.build('lq_scalar_unit'), method='shooting')
    assert all(name in str(caught.value) for name in METHODS)


@pytest.mark.parametrize('problem, words', [
    (lambda: problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2', (1, 0), 1.5, terminal_constraints=['x', 'v'],
        input_bounds={'u': [-1, 1]}), 'minimum time is 2'),
    (lambda: problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2', (0, 0), 3, terminal_constraints=['v - 2'],
        state_bounds={'v': [None, 1]}), 'v <= 1'),
    (lambda: problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2', (0, 0), 3, terminal_constraints=['x - 1', 'v'],
        input_bounds={'u': [-1, 1]}, state_bounds={'v': [-0.2, 0.2]}),
     'minimum time is 5.2'),   # 1/0.2 + 0.2
])
def test_infeasible_problems_report_the_reason(problem, words):
    solution = solve(problem(), time_limit=30)
    assert solution.status is Status.INFEASIBLE
    assert words in solution.message


def test_a_cancelled_solver_stops_soon():
    """The solver stops within two iterations of the report that requests it."""
    calls = []

    def report(phase, iteration, cost, infeasibility):
        calls.append((phase, iteration))
        return len(calls) >= 12

    solution = solve(problems.build('goddard'), report=report)
    assert solution.status is Status.CANCELLED
    assert solution.message
    assert 12 <= len(calls) <= 14


@pytest.mark.slow
@pytest.mark.alone
def test_the_time_limit_is_kept():
    begun = time.monotonic()
    solution = solve(problems.build('alp_rider'), time_limit=1.0)
    assert solution.status is Status.TIMED_OUT
    assert '1 s' in solution.message
    assert time.monotonic() - begun < 3.0


@pytest.mark.parametrize('method, limit', [('auto', 10), ('transcription', 40)])
def test_meshes_keep_max_intervals_and_the_message_says_so(method, limit):
    problem = problems.build('vanderpol_bounded')
    short = solve(problem, method=method, max_intervals=limit)
    assert short.status is Status.NOT_CONVERGED
    assert f'max_intervals = {limit}' in short.message
    assert len(np.unique(short.t)) <= 4 * limit + 1
    enough = solve(problem, max_intervals=200)
    assert enough.status is Status.SOLVED
    assert 'max_intervals' not in enough.message


@pytest.mark.slow
def test_diverging_states_do_not_converge():
    """On ten long intervals the states of the hypersensitive problem diverge from any guess."""
    solution = solve(problems.build('hypersensitive'), max_intervals=10)
    assert solution.status is Status.NOT_CONVERGED


def test_similar_problems_share_compiled_programs():
    """The same problem with other numbers builds no program and takes fewer iterations."""
    cache = Cache()
    first = solve(problems.build('lane_change'), cache=cache)
    nearby = problems.build('lane_change', initial_state={'x': 0.1, 'y': -1.9, 'theta': 0.01})
    again, alone = solve(nearby, cache=cache), solve(nearby)
    assert again.status is Status.SOLVED
    assert first.build_time > 0.0
    assert again.build_time == 0.0
    assert again.iterations < first.iterations
    assert again.objective == pytest.approx(alone.objective, rel=1e-5)


def test_a_search_adds_no_bounds_that_nobody_stated():
    """An input without bounds may take x below 0, although inputs of ordinary size do not."""
    found = solve(problems.pose(
        {'x': '20 - u'}, '(u - 20)**2 + 100*(x + 1)**4', [1], 2, terminal_constraints=['x - 1']))
    shifted = solve(problems.pose(
        {'x': '-u'}, 'u**2 + 100*(x + 1)**4', [1], 2, terminal_constraints=['x - 1']))
    assert found.certified and shifted.certified
    assert found.objective == pytest.approx(106.6496533, rel=1e-6)   # a boundary value problem
    assert found.objective == pytest.approx(shifted.objective, rel=1e-6)
    assert found.x.min() < 0


@pytest.mark.slow
def test_a_fed_batch_with_sharp_kinetics_is_solved():
    """On coarse meshes s steps over the pole of its growth rate at s = -0.02."""
    found = solve(problems.build({
        'states': ['b', 's', 'v'], 'inputs': ['u'],
        'dynamics': {'b': '0.4*s/(s + 0.02)*b - u*b/v',
                     's': '-4*s/(s + 0.02)*b + u*(150 - s)/v', 'v': 'u'},
        'running_cost': 0, 'terminal_cost': '-b*v', 'initial_state': {'b': 1, 's': 150, 'v': 10},
        'input_bounds': {'u': [0, 12]}, 'final_time': {'free': False, 'value': 10}}))
    assert found.certified
    assert found.x.min() >= -1e-6 * 150
