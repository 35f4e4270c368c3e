# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Relaxed minima that finitely many arcs attain, against the closed form of sailing upwind."""

import math

import numpy as np
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.solver.diagnosis.finite_arcs import attain_by_arcs
from obc_ros.core.solver.solve import solve
import problems
import pytest
from scipy.optimize import minimize_scalar

SPEED = 'sin(h)**2*(1.5 - 0.5*cos(h))'
WIDTH = 1.2


def climb(a):
    """Return the speed against the wind at a heading."""
    return math.sin(a)**2 * (1.5 - 0.5*math.cos(a)) * math.cos(a)


HEADING = minimize_scalar(lambda a: -climb(a), bounds=(0.5, 1.5), method='bounded',
                          options={'xatol': 1e-12}).x
T = 4 / climb(HEADING)


def sail(width=WIDTH, **more):
    return problems.pose(
        {'x': f'{SPEED}*sin(h)', 'y': f'{SPEED}*cos(h)'}, 1, (0, 0),
        {'free': True, 'lower': 1, 'upper': 40, 'guess': 10}, inputs=['h'],
        terminal_constraints=['x - 1', 'y - 4'], input_bounds={'h': [-2.5, 2.5]},
        state_bounds={'x': [-width, width]}, **more)


def mix():
    """Return the relaxed solution, on a straight line to the mark, and its inputs."""
    share = (1 - 1 / (T * climb(HEADING) * math.tan(HEADING))) / 2
    t = np.linspace(0, T, 9)
    rows = np.ones((9, 1))
    mixed = Solution(
        Status.NOT_CONVERGED, '', T, t, np.column_stack([t/T, 4*t/T]),
        np.hstack([HEADING*rows, -HEADING*rows, share*rows]),
        np.tile([0, -1 / climb(HEADING)], (9, 1)), 0*t, nu=np.array([0, -1 / climb(HEADING)]))
    return mixed, (HEADING*rows, -HEADING*rows, share*rows[:, 0])


@pytest.mark.parametrize(('width', 'tacks'), [(3.0, 1), (WIDTH, 16), (1.01, 256)])
def test_arcs_within_the_channel_attain_the_relaxed_minimum(width, tacks):
    found = attain_by_arcs(sail(width), *mix())
    assert found.certified
    assert found.objective == pytest.approx(T, rel=1e-9)
    assert np.abs(found.x[:, 0]).max() <= width * (1 + 1e-6)
    assert np.abs(found.u) == pytest.approx(HEADING, abs=1e-9)
    assert len(found.switching_times) <= tacks
    jumps = found.t[1:][np.diff(found.t) == 0]
    assert jumps == pytest.approx(found.switching_times)


def test_a_minimum_that_no_arcs_attain_is_not_invented():
    """Off the axis the boat is slower: only the mean, which no input has, stays on it."""
    problem = problems.pose({'x': 'u'}, 'x**2 + (u**2 - 1)**2', (0,), 1)
    t = np.linspace(0, 1, 9)
    zero, one = np.zeros((9, 1)), np.ones((9, 1))
    mixed = Solution(Status.NOT_CONVERGED, '', 0.0, t, zero, np.hstack([one, -one, one/2]),
                     zero, 0*t)
    assert attain_by_arcs(problem, mixed, (one, -one, one[:, 0]/2)) is None


@pytest.mark.slow
def test_a_saw_within_a_channel_is_found():
    """Speeds of 1 and -1 cost nothing; without the bound x reaches 1/2 before it turns back."""
    found = solve(problems.pose(
        {'x': 'u'}, '(u**2 - 1)**2', (0,), 1, terminal_constraints=['x'],
        input_bounds={'u': [-2, 2]}, state_bounds={'x': [-0.3, 0.3]}), time_limit=600)
    assert found.status is Status.SOLVED
    assert found.objective == pytest.approx(0, abs=1e-9)
    assert np.abs(found.x).max() <= 0.3 * (1 + 1e-6)
    assert len(found.switching_times) >= 2
