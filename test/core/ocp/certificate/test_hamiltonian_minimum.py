# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Minima of H over the input set compared with closed forms and a fine grid."""

import casadi as ca
import numpy as np
from obc_ros.core.ocp.certificate.hamiltonian_minimum import HamiltonianScales, InputMinimum
import problems
import pytest


def stated(inputs, running_cost, rate, bounds, path=None):
    """Return a problem with one state and x(0) = 0."""
    return problems.pose(
        {'x': rate}, running_cost, (0,), 1, inputs=inputs, input_bounds=bounds,
        path_constraints=path or [])


def gaps(problem, u, lam, mu=None, scale=1.0):
    """Return the gap of each row of u at x = 0."""
    u, lam = np.atleast_2d(np.asarray(u, float)), np.reshape(lam, (-1, 1)).astype(float)
    K = len(u)
    mu = np.zeros((K, problem.path.numel())) if mu is None else np.reshape(mu, (K, -1))
    minimum = InputMinimum(problem)
    at = minimum.points(problem, np.zeros((K, 1)), u, np.broadcast_to(lam, (K, 1)), mu)
    return minimum.gap(problem, at, np.arange(K),
                       HamiltonianScales(np.full(problem.m, scale), 1.0))


def brute_force(problem, u, lam, low=-1.0, high=1.0):
    """Return the gap of each row of u from a fine grid over the box."""
    symbol = ca.SX.sym('lam')
    H = ca.Function('H', [problem.u, symbol],
                    [ca.substitute(problem.L + symbol*problem.f, problem.x, 0)])
    axes = np.meshgrid(*[np.linspace(low, high, 201)]*problem.m)
    grid = np.array([axis.ravel() for axis in axes])
    return [float(H(row, value) - ca.mmin(H.map(grid.shape[1])(
        grid, np.full((1, grid.shape[1]), value)))) for row, value in zip(u, lam, strict=True)]


BOX = {'u': [-1, 1]}
TWO = {'u': [-1, 1], 'w': [-1, 1]}


@pytest.mark.parametrize(('inputs', 'L', 'f', 'bounds'), [
    (['u'], 'u', 'u', BOX),                                  # affine
    (['u'], 'u**2', 'u', BOX),                               # quadratic
    (['u'], '-u**2', 'u', BOX),                              # concave
    (['u'], 'u**4 - u**2', 'u', BOX),                        # two local minima
    (['u'], 'abs(u)', 'u', BOX),                             # a kink
    (['u'], 'sin(4*u)', 'u', BOX),                           # local minima in the interior
    (['u', 'w'], 'u**2 + abs(w)', 'u + w', TWO),             # separable
    (['u', 'w'], 'u**2 + u*w + w**2', 'u - w', TWO),         # coupled and convex
    (['u', 'w'], 'u**2 + 3*u*w + w**2', 'u - w', TWO),       # coupled and nonconvex
    (['u', 'w'], '(u - 0.3)**2', 'u*sin(2*w)', TWO),         # coupled and not quadratic
    (['u', 'w'], 'u*w', 'u', TWO),
], ids=lambda value: value if isinstance(value, str) else '')
def test_the_gap_equals_that_of_a_fine_grid(inputs, L, f, bounds):
    problem = stated(inputs, L, f, bounds)
    generator = np.random.default_rng(0)
    u, lam = generator.uniform(-1, 1, (20, len(inputs))), generator.uniform(-2, 2, 20)
    expected = brute_force(problem, u, lam)
    found = gaps(problem, u, lam)
    # The grid's minimum is at least the exact one and exceeds it by at most the spacing squared.
    assert found == pytest.approx(expected, abs=2e-3)
    if 'sin' not in L + f and '**4' not in L:
        assert np.all(found >= np.array(expected) - 1e-12)


def test_gaps_of_unbounded_inputs_have_closed_forms():
    quadratic = stated(['u'], 'u**2', 'u', {})
    assert gaps(quadratic, [[0.0], [-0.5], [3.0]], 1.0) == pytest.approx([0.25, 0.0, 12.25])
    # H = u is unbounded below; the gap is the decrease for a step of the scale of u.
    assert gaps(stated(['u'], '0', 'u', {}), [[0.0]], 2.0, scale=0.5) == pytest.approx([1.0])
    assert gaps(stated(['u'], '0', 'u', {}), [[0.0]], 0.0) == pytest.approx([0.0])
    assert gaps(stated(['u'], '-u**2', 'u', {}), [[0.0]], 1.0)[0] > 1e100
    assert gaps(stated(['u'], 'u', 'x', {'u': [0, None]}), [[2.0]], 1.0) == pytest.approx([2.0])
    coupled = stated(['u', 'w'], 'u**2 + u*w + w**2', 'u', {})
    # Stationary at u = -2/3, w = 1/3 for lam = 1, where H = -1/3
    assert gaps(coupled, [[0, 0], [-2/3, 1/3]], 1.0) == pytest.approx([1/3, 0.0], abs=1e-9)


def test_the_minimum_over_an_unbounded_angle_is_found():
    heading = stated(['u', 'w'], 'u**2', 'cos(w)*u', {'u': [-1, 1]})
    assert gaps(heading, [[0.5, 0.0], [-0.5, 0.0]], 1.0) == pytest.approx([1.0, 0.0], abs=1e-9)
    turn = stated(['w'], '0', 'cos(w)', {})
    assert gaps(turn, [[0.0], [np.pi]], 1.0) == pytest.approx([2.0, 0.0], abs=1e-9)


def test_the_minimum_over_coupled_inputs_is_found():
    inputs = ['a', 'b', 'c', 'd', 'e']
    box = {name: [-1, 1] for name in inputs}
    problem = stated(inputs, 'a*b*c + (d - 0.2)**2', 'a + e', box)
    # The coupled part has its minimum at a vertex, d at 0.2 and e at a bound.
    u = np.zeros((1, 5))
    assert gaps(problem, u, 0.5) == pytest.approx([1.5 + 0.04 + 0.5])


def test_the_gap_accounts_for_a_shared_constraint():
    # u + w <= 1 with multiplier 1: H = u^2/2 + w^2/2 - 1.5 (u + w) is minimal at u = w = 1/2.
    problem = stated(['u', 'w'], '(u**2 + w**2)/2', 'u + w', {},
                     [{'expr': 'u + w', 'lower': None, 'upper': 1}])
    right = gaps(problem, [[0.5, 0.5]], -1.5, mu=[[1.0]])
    assert right == pytest.approx([0.0], abs=1e-12)
    assert gaps(problem, [[0.5, 0.5]], -1.5, mu=[[0.0]])[0] > 0.5
    assert gaps(problem, [[0.9, 0.1]], -1.5, mu=[[1.0]])[0] > 0.1


def test_inputs_outside_a_constraint_do_not_count():
    # |u| <= 1 through u^2 <= 1: outside it H = -u would be lower.
    problem = stated(['u'], '0', 'u', {'u': [-5, 5]},
                     [{'expr': 'u**2', 'lower': None, 'upper': 1}])
    assert gaps(problem, [[1.0]], -1.0, mu=[[0.5]]) == pytest.approx([0.0], abs=1e-12)
    assert gaps(problem, [[-1.0]], -1.0, mu=[[-0.5]])[0] > 1.5


def test_inputs_inside_a_disc_have_the_gap_to_its_circle():
    # H = 2 u is minimal at (-1, 0); the gap of an input inside the disc ignores the multiplier.
    problem = stated(['u', 'w'], 'w', '2*u - w/2', {}, [
        {'expr': 'u**2 + w**2', 'lower': None, 'upper': 1}])
    # For lam = 1 the gradient of H is (2, 1/2), with norm h.
    h = np.hypot(2.0, 0.5)
    best = -np.array([2.0, 0.5]) / h
    for part in (1.0, 0.999, 0.9):
        assert gaps(problem, [part * best], 1.0, h / 2) == pytest.approx([h * (1 - part)])
    # Inside the disc H + 2 c is also stationary; the gap remains.
    inside = [-0.5, -0.125]
    assert gaps(problem, [inside], 1.0, 2.0)[0] >= h * (1 - np.hypot(*inside))


def test_multipliers_of_inactive_constraints_do_not_hide_gaps():
    problem = stated(['u', 'w'], '0', 'u', {'u': [-1, 1], 'w': [-1, 1]}, [
        {'expr': 'u + w', 'lower': None, 'upper': 1}])
    # H = u is minimal at u = -1, where u + w is far below 1.
    assert gaps(problem, [[-1.0, 0.0]], 1.0) == pytest.approx([0.0])
    assert gaps(problem, [[-1.0, 0.0]], 1.0, 0.1)[0] == pytest.approx(0.1 * 2.0 + 0.1)
