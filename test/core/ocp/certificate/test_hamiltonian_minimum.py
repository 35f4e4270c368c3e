# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The least H over the input set, beside closed forms and brute force."""

import casadi as ca
import numpy as np
from obc_ros.core.ocp.certificate.hamiltonian_minimum import HamiltonianScales, InputMinimum
import problems
import pytest


def stated(inputs, running_cost, rate, bounds, path=None):
    """Return a problem with one state, x = 0 at the start."""
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
    (['u'], 'u**4 - u**2', 'u', BOX),                        # two wells
    (['u'], 'abs(u)', 'u', BOX),                             # a kink
    (['u'], 'sin(4*u)', 'u', BOX),                           # a well inside
    (['u', 'w'], 'u**2 + abs(w)', 'u + w', TWO),             # separate
    (['u', 'w'], 'u**2 + u*w + w**2', 'u - w', TWO),         # coupled and convex
    (['u', 'w'], 'u**2 + 3*u*w + w**2', 'u - w', TWO),       # coupled and not convex
    (['u', 'w'], '(u - 0.3)**2', 'u*sin(2*w)', TWO),         # coupled and not quadratic
    (['u', 'w'], 'u*w', 'u', TWO),
], ids=lambda value: value if isinstance(value, str) else '')
def test_gap_is_that_of_a_fine_grid(inputs, L, f, bounds):
    problem = stated(inputs, L, f, bounds)
    generator = np.random.default_rng(0)
    u, lam = generator.uniform(-1, 1, (20, len(inputs))), generator.uniform(-2, 2, 20)
    expected = brute_force(problem, u, lam)
    found = gaps(problem, u, lam)
    # The brute force is never below the least value, and above it by its spacing squared.
    assert found == pytest.approx(expected, abs=2e-3)
    if 'sin' not in L + f and '**4' not in L:
        assert np.all(found >= np.array(expected) - 1e-12)


def test_unbounded_inputs():
    quadratic = stated(['u'], 'u**2', 'u', {})
    assert gaps(quadratic, [[0.0], [-0.5], [3.0]], 1.0) == pytest.approx([0.25, 0.0, 12.25])
    # H = u has no least value: what moving u by its scale would gain.
    assert gaps(stated(['u'], '0', 'u', {}), [[0.0]], 2.0, scale=0.5) == pytest.approx([1.0])
    assert gaps(stated(['u'], '0', 'u', {}), [[0.0]], 0.0) == pytest.approx([0.0])
    assert gaps(stated(['u'], '-u**2', 'u', {}), [[0.0]], 1.0)[0] > 1e100
    assert gaps(stated(['u'], 'u', 'x', {'u': [0, None]}), [[2.0]], 1.0) == pytest.approx([2.0])
    coupled = stated(['u', 'w'], 'u**2 + u*w + w**2', 'u', {})
    # Stationary at u = -2/3, w = 1/3 for lam = 1, where H = -1/3.
    assert gaps(coupled, [[0, 0], [-2/3, 1/3]], 1.0) == pytest.approx([1/3, 0.0], abs=1e-9)


def test_an_angle_without_bounds_finds_the_other_side():
    heading = stated(['u', 'w'], 'u**2', 'cos(w)*u', {'u': [-1, 1]})
    assert gaps(heading, [[0.5, 0.0], [-0.5, 0.0]], 1.0) == pytest.approx([1.0, 0.0], abs=1e-9)
    turn = stated(['w'], '0', 'cos(w)', {})
    assert gaps(turn, [[0.0], [np.pi]], 1.0) == pytest.approx([2.0, 0.0], abs=1e-9)


def test_three_and_more_coupled_inputs():
    inputs = ['a', 'b', 'c', 'd', 'e']
    box = {name: [-1, 1] for name in inputs}
    problem = stated(inputs, 'a*b*c + (d - 0.2)**2', 'a + e', box)
    # The coupled part is least at a vertex, d at 0.2 and e at an end.
    u = np.zeros((1, 5))
    assert gaps(problem, u, 0.5) == pytest.approx([1.5 + 0.04 + 0.5])


def test_inputs_that_share_a_constraint():
    # u + w <= 1 with multiplier 1: H = u^2/2 + w^2/2 - 1.5 (u + w) is least at u = w = 1/2.
    problem = stated(['u', 'w'], '(u**2 + w**2)/2', 'u + w', {},
                     [{'expr': 'u + w', 'lower': None, 'upper': 1}])
    right = gaps(problem, [[0.5, 0.5]], -1.5, mu=[[1.0]])
    assert right == pytest.approx([0.0], abs=1e-12)
    assert gaps(problem, [[0.5, 0.5]], -1.5, mu=[[0.0]])[0] > 0.5
    assert gaps(problem, [[0.9, 0.1]], -1.5, mu=[[1.0]])[0] > 0.1


def test_a_better_input_across_a_constraint_is_no_input():
    # |u| <= 1 through u^2 <= 1: beyond it H = -u would be less.
    problem = stated(['u'], '0', 'u', {'u': [-5, 5]},
                     [{'expr': 'u**2', 'lower': None, 'upper': 1}])
    assert gaps(problem, [[1.0]], -1.0, mu=[[0.5]]) == pytest.approx([0.0], abs=1e-12)
    assert gaps(problem, [[-1.0]], -1.0, mu=[[-0.5]])[0] > 1.5


def test_a_chord_of_a_disc_gives_away_what_it_is_off_the_circle():
    # H = 2 u is least at (-1, 0); halfway to it is off by half, whatever the multiplier says.
    problem = stated(['u', 'w'], 'w', '2*u - w/2', {}, [
        {'expr': 'u**2 + w**2', 'lower': None, 'upper': 1}])
    # With lam = 1 the slope of H is (2, 1/2), of size h.
    h = np.hypot(2.0, 0.5)
    best = -np.array([2.0, 0.5]) / h
    for part in (1.0, 0.999, 0.9):
        assert gaps(problem, [part * best], 1.0, h / 2) == pytest.approx([h * (1 - part)])
    # Inside the disc H + 2 c is stationary, too: that hides nothing.
    inside = [-0.5, -0.125]
    assert gaps(problem, [inside], 1.0, 2.0)[0] >= h * (1 - np.hypot(*inside))


def test_a_multiplier_of_a_constraint_that_is_not_met_is_given_away():
    problem = stated(['u', 'w'], '0', 'u', {'u': [-1, 1], 'w': [-1, 1]}, [
        {'expr': 'u + w', 'lower': None, 'upper': 1}])
    # H = u is least at u = -1, where u + w is far from 1.
    assert gaps(problem, [[-1.0, 0.0]], 1.0) == pytest.approx([0.0])
    assert gaps(problem, [[-1.0, 0.0]], 1.0, 0.1)[0] == pytest.approx(0.1 * 2.0 + 0.1)
