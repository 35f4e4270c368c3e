# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The path in the plane of two states, with the region that constraints forbid."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.api.figures.marks import CONTACT, evaluate_rows, find_state_rows, PathMarks
from obc_ros.api.figures.style import get_line, label_unit, typeset_symbol
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution

PLANE_HEIGHT = 3.6   # [in]
GRID = 241   # points of an axis at which constraints are evaluated
ROOM = 0.12   # around the path, of the larger of its two ranges
WIDEST = 2.2   # ratio of the sides of the panel
FLATTEST = 8.0   # ratio of the ranges up to which both axes have one scale
POSITIONS = (('px', 'py'), ('x', 'y'), ('px', 'pz'), ('x', 'z'))


@dataclass(frozen=True)
class Plane:
    """Two states, the path constraints on them alone, and whether both have one unit."""

    states: tuple[int, int]
    rows: tuple[int, ...]
    equal: bool


def find_plane(problem: Problem) -> Plane | None:
    """
    Return the plane in which a path is drawn, if any.

    It is that of the two states that most of the path constraints on exactly two states have; else
    of two states that are named as positions.
    """
    if problem.phases is not None:
        return None
    rows = find_state_rows(problem)
    pairs = Counter(states for states in rows.values() if len(states) == 2)
    names = problem.shown_states
    named = [(names.index(a), names.index(b)) for a, b in POSITIONS
             if a in names and b in names]
    if not pairs and not named:
        return None
    i, j = pairs.most_common(1)[0][0] if pairs else named[0]
    units = {problem.units.get(names[k], '') for k in (i, j)}
    # A state and its rate have different units.
    rates = any(ca.is_equal(problem.f[a], problem.x[b], 1) for a, b in ((i, j), (j, i)))
    return Plane((i, j), tuple(row for row, states in rows.items() if {*states} <= {i, j}),
                 len(units) == 1 and not rates)


def draw_plane(axes: Any, problem: Problem, plane: Plane, path: Solution, marks: PathMarks
               ) -> None:
    """Draw a path in a plane, where it touches constraints, and the forbidden region."""
    points = path.x[:, plane.states]
    low, high = points.min(axis=0), points.max(axis=0)
    scaled = plane.equal and max(high - low) <= FLATTEST * max(min(high - low), 1e-300) or (
        plane.equal and bool(plane.rows))
    low, high = _choose_limits(*_include_obstacles(problem, plane, path, low, high), scaled)
    _draw_forbidden(axes, problem, plane, path, low, high)
    axes.plot(*points.T, **get_line(0), label='path')
    for begin, end in marks.contacts:
        during = (path.t >= begin) & (path.t <= end)
        axes.plot(*points[during].T, color=CONTACT['color'], linewidth=4.0, zorder=2.5,
                  solid_capstyle='round', marker='o' if begin == end else '', markersize=9)
    if marks.contacts:
        axes.plot([], [], color=CONTACT['color'], linewidth=4.0, label='on a state\nconstraint')
    axes.plot(*points[0], 'o', color='black', markerfacecolor='white', label='start', zorder=3)
    axes.plot(*points[-1], 's', color='black', label='end', zorder=3)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for set_label, state in zip((axes.set_xlabel, axes.set_ylabel), plane.states, strict=True):
        name = problem.shown_states[state]
        set_label(label_unit(f'${typeset_symbol(name)}$', problem.units.get(name, '')))
    if scaled:
        axes.set_aspect('equal')
    axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5))


def _choose_limits(low: Array, high: Array, scaled: bool) -> tuple[Array, Array]:
    """Return the corners of the panel; with one scale, neither side is much the longer."""
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.where(half > 0.0, half, half.max() or 1.0)
    if not scaled:
        return middle - (1 + 2 * ROOM) * half, middle + (1 + 2 * ROOM) * half
    half = half + 2 * ROOM * half.max()
    half = np.maximum(half, np.array([half[1], half[0] / WIDEST]))
    return middle - half, middle + half


def _include_obstacles(problem: Problem, plane: Plane, path: Solution, low: Array, high: Array
                       ) -> tuple[Array, Array]:
    """Return the corners of the box of the path and of the obstacles that are whole near it."""
    from scipy.ndimage import find_objects, label
    reach = max(high - low)
    x, y, excess = _evaluate_excess(problem, plane, path, low - reach, high + reach)
    for rows, columns in find_objects(label(excess > 0.0)[0]):
        if rows.start and columns.start and rows.stop < GRID and columns.stop < GRID:
            low = np.minimum(low, [x[columns.start], y[rows.start]])
            high = np.maximum(high, [x[columns.stop - 1], y[rows.stop - 1]])
    return low, high


def _draw_forbidden(axes: Any, problem: Problem, plane: Plane, path: Solution, low: Array,
                    high: Array) -> None:
    """Shade where a constraint on the two states does not hold."""
    x, y, excess = _evaluate_excess(problem, plane, path, low, high)
    if excess.max() <= 0.0:
        return
    axes.contourf(x, y, excess, levels=[0.0, 2.0 * excess.max()], colors=['#d9d9d9'], zorder=1.1)
    if excess.min() < 0.0:
        axes.contour(x, y, excess, levels=[0.0], colors='black', linewidths=1.2, zorder=1.2)
    axes.fill([], [], facecolor='#d9d9d9', edgecolor='black', label='forbidden')


def _evaluate_excess(problem: Problem, plane: Plane, path: Solution, low: Array, high: Array
                     ) -> tuple[Array, Array, Array]:
    """Return a grid x, y, and by how much a constraint on the two states is violated there."""
    x, y = (np.linspace(a, b, GRID) for a, b in zip(low, high, strict=True))
    states = np.tile(path.x[0], (GRID**2, 1))
    states[:, plane.states] = np.column_stack([each.ravel() for each in np.meshgrid(x, y)])
    values = states[:, plane.states]
    lower, upper = (each[list(plane.states)] for each in (problem.x_lower, problem.x_upper))
    if plane.rows:
        values = np.hstack([values, evaluate_rows(problem, plane.rows, states)])
        lower = np.append(lower, problem.path_lower[list(plane.rows)])
        upper = np.append(upper, problem.path_upper[list(plane.rows)])
    excess = np.maximum(lower - values, values - upper).max(axis=1)
    # Where a constraint is undefined, it does not hold.
    return x, y, np.nan_to_num(excess, nan=1.0, posinf=1.0, neginf=-1.0).reshape(GRID, GRID)
