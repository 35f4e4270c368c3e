# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Meshes with points where inputs come to bounds, and neighbours that are found from these."""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
from obc_ros.core.solver.improve.kink_mesh import build_points
from obc_ros.core.solver.solve import Cache, solve
import problems
import pytest

# Least cost by a zero-order hold on 1000 intervals: a bound from above, 1e-7 away.
HELD = 3007.73213


def lane_change(phi=0.1):
    """Return the lane change of a kinematic bicycle that rushes ahead, then weaves."""
    return problems.pose(
        {'px': 'v*cos(theta)', 'py': 'v*sin(theta)', 'theta': 'v/l*tan(phi)'},
        '0.1*(px - 100)**2 + 10*(py - 2)**2 + 0.1*theta**2 + 0.1*(v - 10)**2 + phi**2',
        (0, -2, 0), 10, inputs=['v', 'phi'], parameters={'l': 3},
        terminal_constraints=['px - 100', 'py - 2', 'theta'],
        input_bounds={'v': [8, 12], 'phi': [-phi, phi]})


@pytest.mark.parametrize('slope', [1.0, 1e20, np.inf, np.nan])
def test_of_an_extremal_that_is_no_path_no_mesh_without_end_is_made(slope):
    """Where an indirect method has strayed slopes of 1e20 asked for 500 TiB of points."""
    strayed = SimpleNamespace(
        u=np.ones((6, 2, 1)), du=np.array([[[0.0], [slope]]] * 6), h=np.full(6, 0.5),
        arc_of=np.array([0, 0, 0, 1, 1, 1]))
    t, arc = build_points(strayed, 1e-4, 0.1, 1000)
    assert t[0] == 0
    assert t[-1] == pytest.approx(3)
    assert np.all(np.diff(t) > 0)
    assert 30 <= len(arc) <= 1002
    assert set(arc) == {0, 1}


def pulled(T):
    """Return u^2 - x^2 over a time about that of its conjugate point, pi, with bounds on u."""
    return problems.pose(
        {'x': 'u'}, 'u**2 - x**2', (0.3,), T, terminal_constraints=['x'],
        input_bounds={'u': [-0.25, 0.25]})


def test_inputs_come_to_their_bounds_where_dh_du_vanishes():
    problem = lane_change()
    found = solve(problem)
    assert found.certificate.holds
    assert HELD * (1 - 2e-7) < found.objective < HELD
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
def test_neighbours_are_found_at_once_and_cost_what_they_cost_alone(change):
    problem, cache = lane_change(), Cache()
    first = solve(problem, cache=cache)
    other = replace(problem, **change)
    again, alone = solve(other, cache=cache), solve(other)
    assert again.certificate.holds
    assert again.objective == pytest.approx(alone.objective, rel=2e-8)
    assert again.iterations < first.iterations / 10
    assert len(again.switching_times) == len(alone.switching_times)


@pytest.mark.slow
def test_a_neighbour_with_other_arcs_costs_what_it_costs_alone():
    problem, cache = lane_change(), Cache()
    solve(problem, cache=cache)
    other = replace(problem, u_lower=np.array([7.5, -0.1]))
    again, alone = solve(other, cache=cache), solve(other)
    assert again.certificate.holds
    assert again.objective == pytest.approx(alone.objective, rel=2e-8)


@pytest.mark.slow
def test_neighbours_past_a_conjugate_point_are_no_saddles():
    """With T from 3 to 3.4 the extremal that goes straight to the end ceases to be a minimum."""
    cache = Cache()
    for T in (3.0, 3.1, 3.2, 3.3, 3.4):
        again, alone = solve(pulled(T), cache=cache), solve(pulled(T))
        assert again.certificate.holds
        assert again.objective <= alone.objective + 1e-7
