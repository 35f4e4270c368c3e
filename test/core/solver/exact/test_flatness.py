# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Flat trajectories: dynamics, end conditions, and convergence of the cost to the minimum."""

from itertools import pairwise
from math import pi

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.numerics.polynomial_bases import BASIS_KINDS, build_basis
from obc_ros.core.solver.exact import closed_forms, flatness
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import StatementError
import pytest
from scipy.integrate import solve_bvp
from scipy.interpolate import BSpline

EXERCISE_2_4 = {'a': -1.0}   # x' = -a x + b u is the registered x' = a x + b u with a = -1
AIRCRAFT = registry.get_system('aircraft', {'c': 0.0})
HOVER = [0, 39.2]


def assert_dynamics_hold(system, found, n=41):
    """Compare f(x, u) with x', extrapolated from central differences after Richardson."""
    # None of these times is a knot of a spline.
    t = found.t0 + found.T * np.linspace(0.0513, 0.9481, n)
    h = 1e-4 * found.T
    x, u = found.at(t)
    around = [np.array([found.at(np.array([time + k * h]))[0][0] for time in t])
              for k in (-2, -1, 1, 2)]
    for each in around:
        for i, wraps in enumerate(system.angles):
            if wraps:
                each[:, i] = x[:, i] + np.angle(np.exp(1j * (each[:, i] - x[:, i])))
    slope = (around[0] - 8 * around[1] + 8 * around[2] - around[3]) / (12 * h)
    wanted = np.array([system.f(*pair) for pair in zip(x, u, strict=True)])
    np.testing.assert_allclose(slope, wanted, atol=1e-5 * (1 + np.abs(wanted).max()))


def assert_ends_met(system, found, start, goal):
    _, x, _ = found.sample(301)
    for state, wanted in ((x[0], start), (x[-1], goal)):
        difference = state - np.array(wanted, dtype=float)
        for i, wraps in enumerate(system.angles):
            if wraps:
                difference[i] = np.angle(np.exp(1j * difference[i]))
        np.testing.assert_allclose(difference, 0, atol=1e-9)


@pytest.mark.parametrize('kind', BASIS_KINDS)
@pytest.mark.parametrize('M', [5, 9])
def test_bases_agree_with_their_definitions(kind, M):
    s = np.linspace(0, 1, 11)
    mine = build_basis(kind, M, 3)
    for order in range(4):
        if kind == 'polynomial':
            wanted = np.column_stack([
                np.polynomial.Polynomial.basis(k).deriv(order)(s) for k in range(M)])
        else:
            wanted = np.column_stack([
                BSpline(mine.knots, row, mine.degree).derivative(order)(s) if order else
                BSpline(mine.knots, row, mine.degree)(s) for row in np.eye(M)])
        np.testing.assert_allclose(mine.values(s, order), wanted, atol=1e-9 * np.abs(wanted).max())


def test_exercise_2_4_c_is_linear_in_time():
    # M = 2: xd is linear in t and ud = (xd' + a xd) / b.
    system = registry.get_system('scalar', {'a': -0.7, 'b': 2.0})
    found = flatness.generate(system, [1.0], [3.0], 4.0, t0=0.5)
    t, x, u = found.sample(9)
    line = 1 + 2 * (t - 0.5) / 4
    np.testing.assert_allclose(x[:, 0], line)
    np.testing.assert_allclose(u[:, 0], (0.5 + 0.7 * line) / 2)
    assert found.minimal == 2


def test_exercise_2_4_d_has_the_known_costs_of_both_methods():
    # Errata 7: x(1) = 1 is imposed, b = 1.
    optimum = closed_forms.solve_scalar_between(-1, 1, 0, 1, [0, 1], tf=1)
    found = flatness.generate(registry.get_system('scalar', EXERCISE_2_4), [0], [1], 1.0, Qu=[0.5])
    assert pytest.approx(1 / (1 - np.exp(-2))) == optimum.J
    assert pytest.approx(7 / 6) == found.J   # x = t, u = 1 + t


@pytest.mark.parametrize('kind', BASIS_KINDS)
def test_exercise_2_4_e_more_coefficients_lower_the_cost(kind):
    system = registry.get_system('scalar', EXERCISE_2_4)
    optimum = closed_forms.solve_scalar_between(-1, 1, 0, 1, np.linspace(0, 1, 33), tf=1)
    found = [flatness.generate(system, [0], [1], 1.0, kind=kind, coefficients=M, Qu=[0.5])
             for M in (2, 3, 5, 9)]
    for more, less in pairwise(found[::-1]):
        assert optimum.J - 1e-12 <= more.J < less.J
    limit = 1e-5 if kind == 'bspline' else 1e-12
    assert limit > found[-1].J - optimum.J
    np.testing.assert_allclose(found[-1].sample(33)[2][:, 0], optimum.u, atol=30 * limit**0.5)


def test_exercise_2_5_converges_to_the_optimum():
    # Pontryagin: x' = -a x^3 - b^2 lam, lam' = 3 a x^2 lam, solved as a boundary value problem.
    bvp = solve_bvp(
        lambda t, y: np.vstack((-y[0]**3 - y[1], 3 * y[0]**2 * y[1], y[1]**2 / 2)),
        lambda a, b: np.array([a[0], b[0] - 1, a[2]]), np.linspace(0, 1, 51),
        np.vstack((np.linspace(0, 1, 51), -np.ones(51), np.zeros(51))), tol=1e-9)
    costs = [
        flatness.generate(registry.get_system('cubic'), [0], [1], 1.0, coefficients=M, Qu=[0.5]).J
             for M in (2, 4, 6, 10)]
    assert all(more < less for less, more in pairwise(costs))
    assert costs[-1] == pytest.approx(bvp.y[2, -1], rel=1e-6)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.floats(-3, 3)] * 4), st.floats(0.3, 5), st.sampled_from(BASIS_KINDS))
def test_double_integrator_has_the_minimum_effort(ends, T, kind):
    x0, v0, x1, v1 = ends
    # The optimum is a cubic polynomial: four coefficients reach it.
    found = flatness.generate(registry.get_system('double_integrator'), [x0, v0], [x1, v1], T,
                              kind=kind)
    way, turn = x1 - x0 - v0 * T, v1 - v0
    wanted = 12 * way**2 / T**3 - 12 * way * turn / T**2 + 4 * turn**2 / T
    assert pytest.approx(wanted, abs=1e-8 * (1 + wanted)) == found.J
    assert_ends_met(registry.get_system('double_integrator'), found, [x0, v0], [x1, v1])


@pytest.mark.parametrize('kind', BASIS_KINDS)
@pytest.mark.parametrize(('name', 'start', 'goal', 'T', 'options'), [
    ('vehicle', [0, -2, 0], [100, 2, 0], 10.0, {'ur': [10, 0]}),
    ('vehicle', [0, 0, 0.3], [20, 8, -0.4], 4.0,
     {'start_input': [6, 0], 'goal_input': [4, 0], 'ur': [5, 0]}),
    ('two_wheeled', [0, 0, 1], [-3, 2, 2.5], 5.0,
     {'start_input': [-0.7, 0], 'goal_input': [-0.5, 0]}),
    ('two_wheeled', [1, 1, 3.0], [-2, 1.5, -3.1], 6.0, {}),
])
def test_vehicles_follow_their_dynamics(kind, name, start, goal, T, options):
    system = registry.get_system(name)
    found = flatness.generate(system, start, goal, T, kind=kind, coefficients=7, **options)
    assert_ends_met(system, found, start, goal)
    assert_dynamics_hold(system, found)


@pytest.mark.slow
@pytest.mark.parametrize('kind', BASIS_KINDS)
def test_aircraft_without_drag_follows_its_dynamics(kind):
    start, goal = np.zeros(6), [1, 1, 0, 0, 0, 0]
    costs = []
    for M in (8, 11):
        found = flatness.generate(AIRCRAFT, start, goal, 5.0, kind=kind, coefficients=M, ur=HOVER)
        assert_ends_met(AIRCRAFT, found, start, goal)
        assert_dynamics_hold(AIRCRAFT, found)
        costs.append(found.J)
    assert costs[1] < costs[0]


def test_aircraft_between_tilted_states_follows_its_dynamics():
    start = [0, 0, 0.2, 0.3, -0.1, 0.1]
    goal = [2, 1, -0.1, 0, 0.2, 0]
    found = flatness.generate(AIRCRAFT, start, goal, 3.0, start_input=[0.1, 40],
                              goal_input=[0, 38],
                              coefficients=9, ur=HOVER)
    assert_ends_met(AIRCRAFT, found, start, goal)
    assert_dynamics_hold(AIRCRAFT, found)


def test_state_weights_use_wrapped_angles():
    system = registry.get_system('two_wheeled')
    options = {'coefficients': 6, 'Qx': [0, 0, 1], 'Qu': [1, 1]}
    once = flatness.generate(system, [0, 0, 0], [4, 1, 0], 5.0, xr=[0, 0, 0], **options)
    turned = flatness.generate(system, [0, 0, 0], [4, 1, 0], 5.0, xr=[0, 0, 2 * pi], **options)
    assert pytest.approx(turned.J) == once.J


def test_no_random_neighbour_is_cheaper():
    system = registry.get_system('cubic')
    found = flatness.generate(system, [0.2], [1.5], 2.0, coefficients=6, Qx=[1])
    nodes, weights = np.polynomial.legendre.leggauss(40)
    s = (nodes + 1) / 2
    rng = np.random.default_rng(1)
    for _ in range(100):
        bump = s * (1 - s) * np.polynomial.Polynomial(rng.normal(size=4) * 0.05)(s)
        slope = np.polynomial.Polynomial.fit(s, bump, 5).deriv()(s) / 2.0
        flag = found.flag(2.0 * s)[:, 0]
        x, rate = flag[:, 0] + bump, flag[:, 1] + slope
        assert weights @ (x**2 + (rate + x**3)**2) >= found.J - 1e-9


@pytest.mark.parametrize(('name', 'arguments', 'options', 'text'), [
    ('aircraft', (np.zeros(6), np.zeros(6), 1.0), {}, 'flat for c = 0 only'),
    ('nonholonomic_integrator', ([0, 0, 0], [1, 0, 0], 1.0), {}, 'not known to be'),
    ('scalar', ([0], [1], 0.0), {}, 'finite duration > 0'),
    ('scalar', ([0], [1], float('nan')), {}, 'finite duration > 0'),
    ('scalar', ([0, 1], [1], 1.0), {}, 'start: wanted 1 finite numbers'),
    ('scalar', ([0], [float('inf')], 1.0), {}, 'goal: not all numbers are finite'),
    ('scalar', ([0], ['a'], 1.0), {}, 'goal: wanted 1 numbers'),
    ('scalar', ([0], [1], 1.0), {'coefficients': 1}, 'coefficients = 1: wanted 2'),
    ('scalar', ([0], [1], 1.0), {'coefficients': 2.5}, 'coefficients = 2.5'),
    ('scalar', ([0], [1], 1.0), {'kind': 'fourier'}, "unknown basis 'fourier'"),
    ('scalar', ([0], [1], 1.0), {'Qu': [-1]}, 'negative eigenvalue'),
    ('scalar', ([0], [1], 1.0), {'Qx': [[1, 2]]}, 'Qx: wanted 1 numbers'),
    ('two_wheeled', ([0, 0, 0], [0, 0, 1], 1.0), {}, 'at rest'),
    ('two_wheeled', ([0, 0, 0], [1, 0, 0], 1.0),
     {'start_input': [1, 0], 'goal_input': [-1, 0]}, 'two of one sign'),
    ('two_wheeled', ([0, 0, 0], [-1, 0, 0], 1.0),
     {'start_input': [1, 0], 'goal_input': [1, 0]}, 'the path stops at'),
])
def test_bad_input_is_rejected(name, arguments, options, text):
    with pytest.raises(StatementError, match=text):
        flatness.generate(registry.get_system(name), *arguments, **options)


def test_parameters_that_remove_flatness_are_rejected():
    with pytest.raises(StatementError, match='flat for r = 0'):
        flatness.generate(registry.get_system('aircraft', {'c': 0.0, 'r': 0.0}), np.zeros(6),
                          np.zeros(6),
                          1.0)
    with pytest.raises(StatementError, match='flat for b = 0'):
        flatness.generate(registry.get_system('cubic', {'b': 0.0}), [0], [1], 1.0)


@pytest.mark.parametrize('n', [1, 0, 2.5, True, None])
def test_a_bad_number_of_samples_is_rejected(n):
    found = flatness.generate(registry.get_system('cubic'), [0], [1], 1.0)
    with pytest.raises(StatementError, match='2 or more times'):
        found.sample(n)
