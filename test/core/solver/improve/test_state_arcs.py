# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arcs of state constraints: multipliers of phases, and bounds that are exceeded in between."""

from pathlib import Path

import numpy as np
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.arcs.constraint_orders import BoundRates
from obc_ros.core.solver.arcs.input_arcs import Arc
from obc_ros.core.solver.arcs.mixed_constraints import hold_constraints
from obc_ros.core.solver.arcs.phase_program import PhasedProgram
from obc_ros.core.solver.improve.state_arcs import add_exceeded_bounds
from obc_ros.core.solver.initial_guess import estimate_scales
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.transcription.mesh import build_path
import problems
import pytest
from scipy.integrate import quad

LIMIT = 0.1
ROBOTS = Path(__file__).parents[3] / 'collections' / 'practical'
FREE = (np.nan,)


def bryson_denham(least: float):
    """
    Return the problem from 0 back to 0 in 1 s with the least u^2/2 below x = l = 0.1.

    J = 4/(9 l), u(0) = -2/(3 l). There is a bound of u + v, too.
    """
    return problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2/2', (0, 1), 1, terminal_constraints=['x', 'v + 1'],
        state_bounds={'x': [None, LIMIT]},
        path_constraints=[{'expr': 'u + v', 'lower': least, 'upper': None}])


def solve_on_phases(problem):
    ends = np.array([0, 3 * LIMIT, 1 - 3 * LIMIT, 1])
    t = np.linspace(0, 1, 21)
    x = LIMIT * np.column_stack([np.sin(np.pi * t), np.cos(np.pi * t) / LIMIT])
    u = -2 / (3 * LIMIT) * np.maximum(1 - np.minimum(t, 1 - t) / (3 * LIMIT), 0)[:, None]
    guess = build_path(t, x, u[:-1], u[1:], np.array([1.0]))
    arcs = [Arc(float(a), float(b), FREE, (on, 0, 0))
            for a, b, on in zip(ends[:-1], ends[1:], (0, 1, 0), strict=True)]
    program = PhasedProgram(problem, (False,))
    return program, program.solve(
        problem, arcs, [np.full(6, 1 / 6)] * 3, guess, estimate_scales(problem, guess),
        np.ones(2, dtype=bool), Meter())


def test_a_constraint_that_is_never_active_has_no_multiplier():
    """IPOPT leaves multipliers on it; the arcs would be changed by the largest of these."""
    program, found = solve_on_phases(bryson_denham(-90.0))
    assert found.converged
    assert found.cost == pytest.approx(4 / (9 * LIMIT), rel=1e-7)
    assert not found.eta[:, :, 2].any()
    assert hold_constraints(found.arcs, found, program.bounds) == found.arcs


def test_a_constraint_that_is_active_keeps_its_multiplier():
    """Without it u + v ends at -1 - 2/(3 l) = -7.67."""
    program, found = solve_on_phases(bryson_denham(-7.0))
    assert found.converged
    assert found.cost > 4 / (9 * LIMIT)
    assert found.eta[-1, :, 2].min() < 0


@pytest.mark.parametrize('sign', [1, -1])
def test_a_bound_that_is_exceeded_between_points_becomes_active(sign):
    problem = problems.pose({'x': 'u', 'y': 'u'}, 'u**2', (0, 0), 3, state_bounds={
        'x': [-1, 1], 'y': [-1, 1]})
    bounds, t = BoundRates(problem), np.linspace(0, 3, 301)
    arcs = [Arc(0.0, 1.0, FREE, (0, 0)), Arc(1.0, 2.0, FREE, (0, sign)),
            Arc(2.0, 3.0, FREE, (0, 0))]
    # x exceeds its bound around 0.5, y around 1.5, where it is held anyway.
    value = sign * np.column_stack([1 + 1e-4 - (t - 0.5)**2, 1 + 1e-4 - (t - 1.5)**2])
    new = add_exceeded_bounds(problem, arcs, bounds, t, value, 1e-6)
    assert [arc.on for arc in new] == [(0, 0), (sign, 0), (0, 0), (0, sign), (0, 0)]
    assert (new[1].start, new[1].end) == pytest.approx((0.49, 0.51), abs=0.011)
    assert add_exceeded_bounds(problem, arcs, bounds, t, value * (1 - 1e-3), 1e-6) is arcs


@pytest.mark.slow
def test_a_bound_that_is_touched_twice_is_followed_in_between() -> None:
    """
    Swing up a cart-pole in least time on a short rail.

    At one end of the rail the cart stands still; at first it touches the end twice. The value is
    that of Radau collocation by hand, with IPOPT.
    """
    [mapping] = load_file(ROBOTS / 'cartpole_b.yaml')
    found = solve(build_problem(mapping), time_limit=600)
    assert found.certified, found.message
    expected = mapping['expected']
    assert found.objective == pytest.approx(expected['objective'], abs=expected['tolerance'])
    on_end = np.abs(found.x[:, 0] + 0.4) < 1e-6
    assert np.ptp(found.t[on_end]) > 0.02


@pytest.mark.slow
def test_a_limit_that_moves_is_followed_throughout() -> None:
    """
    Heat a room at least cost along r(t), with a multiplier that is positive at all times.

    With x = r the cost is an integral of known functions. At t = 0 r is 1.05e-9 above x(0) = 17.
    """
    bump = '3*exp(-((t - 7)/1.5)**2)'
    found = solve(problems.pose(
        {'x': '0.2*(4 - x) + 2*u'}, '(1 + 0.4*sin(2*pi*t/24))*u + 0.1*u**2', (17,), 12,
        input_bounds={'u': [0, 3]},
        path_constraints=[{'expr': f'x - 17 - {bump}', 'lower': 0, 'upper': None}]),
        time_limit=600)
    assert found.certified, found.message

    def spend(t: float) -> float:
        rise = 3 * np.exp(-((t - 7) / 1.5)**2)
        u = (-2 * (t - 7) / 1.5**2 * rise - 0.2 * (4 - 17 - rise)) / 2
        return (1 + 0.4 * np.sin(2 * np.pi * t / 24)) * u + 0.1 * u**2

    assert found.objective == pytest.approx(
        quad(spend, 0, 12, points=[7], limit=200)[0], rel=1e-6)
