# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bounds of inputs that touch the set of a path constraint."""

import numpy as np
from obc_ros.core.solver.arcs.constraint_orders import build_curvatures, find_implied_bounds
import problems
import pytest


def _find(lower: float, upper: float, row: str, level: float) -> list[list[bool]]:
    """Return the bounds of a that follow from row <= level, at speeds of 1 and 20 m/s."""
    problem = problems.pose(
        {'v': 'a', 'h': 'w'}, 1, (1, 0), 3, inputs=['a', 'w'],
        input_bounds={'a': [lower, upper]}, path_constraints=[{'expr': row, 'upper': level}])
    x, u = np.array([[1.0, 0.0], [20.0, 0.5]]), np.array([[1.0, 2.0], [-3.0, 0.1]])
    return find_implied_bounds(problem, build_curvatures(problem)[0], (x, u), 1, level,
                               np.array([True, True])).tolist()


@pytest.mark.parametrize(('lower', 'upper', 'wanted'), [
    (-8, 4, [[True, False], [False, False]]),     # the circle has the radius 8
    (-8, 8, [[True, False], [True, False]]),
    (-9, 7.99, [[False, False], [False, False]])])
def test_a_bound_that_touches_the_friction_circle_follows_from_it(lower, upper, wanted):
    """The bounds at -8 and 8 are tangents of the circle, whatever the speed is."""
    assert _find(lower, upper, 'a**2 + (v*w)**2', 64) == wanted


@pytest.mark.parametrize('row', ['a*v', 'a**2 + v + w', 'a**2 - w**2'])
def test_a_bound_that_cuts_the_set_of_a_constraint_is_kept(row):
    """A limit of the power has another input at each speed; the others are no convex sets."""
    assert _find(-8, 8, row, 64) == [[False, False], [False, False]]
