# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Boundaries of obstacles in the plane, of a problem whose states have px and py.

A path constraint that depends on px, py and constants only is g(px, py) in [lower, upper]. Its
boundaries are the curves where g equals one of the two, found on a grid around the plan. Bounds on
px and py are straight lines. Other constraints cannot be drawn in the plane.
"""

from collections.abc import Iterator, Mapping
from typing import Any, cast

import casadi as ca
from contourpy import contour_generator
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.statement import build_problem

GRID = 201      # points of the grid along px and along py
MARGIN = 0.5    # part of the larger side of a plan, by which the grid is larger than the plan
SMALLEST = 0.5  # [m] margin of a plan that stays where it is
MOST_POINTS = 5_000   # of all curves

Rectangle = tuple[float, float, float, float]


def find_box(places: Array) -> Rectangle:
    """Return (px, px, py, py) [m] of a rectangle around points, shape (N, 2), with a margin."""
    low, high = places.min(axis=0), places.max(axis=0)
    margin = max(MARGIN * float((high - low).max()), SMALLEST)
    return (float(low[0]) - margin, float(high[0]) + margin,
            float(low[1]) - margin, float(high[1]) + margin)


def find_boundaries(statement: Mapping[str, Any], box: Rectangle) -> list[Array]:
    """
    Return the curves that bound where px and py may be.

    :param statement: a valid problem, as in a file.
    :param box: (px, px, py, py) [m]: what is outside is not drawn.
    :return: (K, 2), points (px, py) [m], joined by lines. At most `MOST_POINTS`; further curves
        are left out.
    """
    problem = build_problem(statement)
    if not {'px', 'py'} <= set(problem.states):
        return []
    curves, left = [], MOST_POINTS
    for curve in (*_trace_bounds(problem, box), *_trace_constraints(problem, box)):
        left -= len(curve)
        if left < 0:
            break
        curves.append(curve)
    return curves


def _trace_bounds(problem: Problem, box: Rectangle) -> Iterator[Array]:
    """Yield lines where px or py is at a bound."""
    for name, axis in (('px', 0), ('py', 1)):
        index = problem.states.index(name)
        across = box[2:] if axis == 0 else box[:2]
        for bound in (problem.x_lower[index], problem.x_upper[index]):
            if box[2 * axis] <= bound <= box[2 * axis + 1]:
                line = np.empty((2, 2))
                line[:, axis], line[:, 1 - axis] = bound, across
                yield line


def _trace_constraints(problem: Problem, box: Rectangle) -> Iterator[Array]:
    """Yield curves where a path constraint of px and py alone is at a bound."""
    at = [problem.states.index(name) for name in ('px', 'py')]
    places = ca.vertcat(*(problem.x[index] for index in at))
    others = ca.vertcat(*(problem.x[index] for index in range(len(problem.states))
                          if index not in at), problem.u)
    px, py = np.linspace(*box[:2], GRID), np.linspace(*box[2:], GRID)
    points = np.stack(np.meshgrid(px, py)).reshape(2, -1)
    rows = zip(ca.vertsplit(problem.path), problem.path_lower, problem.path_upper, strict=True)
    for row, *bounds in rows:
        if ca.depends_on(row, others) or not ca.depends_on(row, places):
            continue
        g = ca.Function('g', [places, problem.p], [row])
        values = g(points, problem.p_value).full().reshape(GRID, GRID)
        traced = contour_generator(px, py, np.ma.masked_invalid(values))
        for bound in filter(np.isfinite, bounds):
            yield from cast(list[Array], traced.lines(float(bound)))   # of separate curves
