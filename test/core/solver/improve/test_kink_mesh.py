# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Meshes with points where inputs come to bounds, and neighbours that are found from these."""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
from obc_ros.core.solver.improve.indirect import build_points
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
import problems
import pytest


def lane_change(phi=0.1):
    """Return the lane change of a kinematic bicycle, which accelerates, then weaves."""
    return problems.pose(
        {'px': 'v*cos(theta)', 'py': 'v*sin(theta)', 'theta': 'v/l*tan(phi)'},
        '0.1*(px - 100)**2 + 10*(py - 2)**2 + 0.1*theta**2 + 0.1*(v - 10)**2 + phi**2',
        (0, -2, 0), 10, inputs=['v', 'phi'], parameters={'l': 3},
        terminal_constraints=['px - 100', 'py - 2', 'theta'],
        input_bounds={'v': [8, 12], 'phi': [-phi, phi]})


def minimize_held(problem, intervals):
    """Return the minimum cost with constant inputs on each interval: Runge-Kutta 4 and IPOPT."""
    n, m, h = problem.n, problem.m, problem.final_time.value / intervals
    rate = ca.Function('rate', [problem.x, problem.u], [
        ca.substitute(ca.vertcat(problem.f, problem.L), problem.p, problem.p_value)])
    k, x, u = [], ca.SX.sym('x', n), ca.SX.sym('u', m)
    for weight in (0, 0.5, 0.5, 1):
        k.append(rate(x + weight * h * k[-1][:n] if k else x, u))
    rise = h / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
    step = ca.Function('step', [x, u], [x + rise[:n], rise[n]]).map(intervals)
    X, U = ca.MX.sym('X', n, intervals + 1), ca.MX.sym('U', m, intervals)
    following, costs = step(X[:, :-1], U)
    solver = ca.nlpsol('solver', 'ipopt', {
        'x': ca.veccat(X, U), 'f': ca.sum2(costs), 'g': ca.vec(X[:, 1:] - following)}, {
        'print_time': False, 'ipopt': {'print_level': 0, 'sb': 'yes', 'tol': 1e-9}})
    end = np.array([100, 2, 0])
    free = np.full((intervals - 1) * n, np.inf)
    lower, upper = (np.r_[problem.x0, side * free, end, np.tile(bound, intervals)]
                    for side, bound in ((-1, problem.u_lower), (1, problem.u_upper)))
    line = np.linspace(problem.x0, end, intervals + 1).ravel()
    found = solver(x0=np.r_[line, np.tile([12, 0.05], intervals)], lbx=lower, ubx=upper,
                   lbg=0, ubg=0)
    assert solver.stats()['success']
    return float(found['f'])


@pytest.mark.parametrize('slope', [1.0, 1e20, np.inf, np.nan])
def test_a_diverged_extremal_gives_a_bounded_mesh(slope):
    """A mesh built for slopes of 1e20, without a bound, would take 500 TiB."""
    diverged = SimpleNamespace(
        u=np.ones((6, 2, 1)), du=np.array([[[0.0], [slope]]] * 6), h=np.full(6, 0.5),
        arc_of=np.array([0, 0, 0, 1, 1, 1]))
    t, arc = build_points(diverged, 1e-4, 0.1, 1000)
    assert t[0] == 0
    assert t[-1] == pytest.approx(3)
    assert np.all(np.diff(t) > 0)
    assert 30 <= len(arc) <= 1002
    assert set(arc) == {0, 1}


def near_conjugate_point(T):
    """Return the problem of u^2 - x^2 with bounded u; without bounds T = pi is conjugate."""
    return problems.pose(
        {'x': 'u'}, 'u**2 - x**2', (0.3,), T, terminal_constraints=['x'],
        input_bounds={'u': [-0.25, 0.25]})


@pytest.mark.slow
def test_the_cost_is_just_below_that_of_held_inputs():
    """Constant inputs cost more: 1.9e-6 relative with 250 intervals, 3.2e-7 with 500."""
    problem = lane_change()
    held = minimize_held(problem, 500)
    assert held * (1 - 4e-7) < solve(problem).objective < held


def test_inputs_reach_their_bounds_where_dh_du_vanishes():
    problem = lane_change()
    found = solve(problem, method='indirect')
    assert found.certificate.holds
    lam = ca.SX.sym('lam', problem.n)
    slope = ca.Function('slope', [problem.x, problem.u, lam, problem.p], [
        ca.gradient(problem.L + ca.dot(lam, problem.f), problem.u)])
    rows = np.searchsorted(found.t, found.switching_times - 1e-9)
    np.testing.assert_allclose(found.t[rows], found.switching_times, atol=1e-9)
    Hu = np.array([slope(x, u, at, problem.p_value).full().ravel() for x, u, at in zip(
        found.x, found.u, found.lam, strict=True)])
    vanishes = np.abs(Hu[rows]) <= 1e-6 * np.abs(Hu).max(axis=0)
    at_bound = (found.u[rows] == problem.u_lower) | (found.u[rows] == problem.u_upper)
    assert len(rows) > 15
    assert np.all((vanishes & at_bound).any(axis=1))


@pytest.mark.slow
@pytest.mark.parametrize('change', [
    {'x0': np.array([0.03, -1.96, 0.04])}, {'x0': np.array([-0.5, -2.4, -0.03])},
    {'u_lower': np.array([8, -0.09]), 'u_upper': np.array([12, 0.09])},
    {'x0': np.array([0, -1, 0.1])}])
def test_a_neighbour_is_quick_and_costs_the_same_as_alone(change):
    problem, cache = lane_change(), Cache()
    first = solve(problem, cache=cache)
    other = replace(problem, **change)
    again, alone = solve(other, cache=cache), solve(other)
    assert again.certificate.holds
    assert again.objective == pytest.approx(alone.objective, rel=2e-8)
    assert again.iterations < first.iterations / 10
    assert len(again.switching_times) == len(alone.switching_times)


@pytest.mark.slow
def test_a_neighbour_with_other_arcs_costs_the_same_as_alone():
    problem, cache = lane_change(), Cache()
    solve(problem, cache=cache)
    other = replace(problem, u_lower=np.array([7.5, -0.1]))
    again, alone = solve(other, cache=cache), solve(other)
    assert again.certificate.holds
    assert again.objective == pytest.approx(alone.objective, rel=2e-8)


@pytest.mark.slow
def test_a_neighbour_beyond_a_conjugate_point_is_a_minimum():
    """Between T = 3 and 3.4 the extremal that goes straight to the end becomes a saddle."""
    cache = Cache()
    for T in (3.0, 3.1, 3.2, 3.3, 3.4):
        again, alone = solve(near_conjugate_point(T), cache=cache), solve(near_conjugate_point(T))
        assert again.certificate.holds
        assert again.objective <= alone.objective + 1e-7
