# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Marks along a path: contacts of state constraints, jumps of costates, switching times."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.api.figures.style import LINE_COLOURS, THIN
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution

ACTIVE = 1e-6   # of the range of a constraint along the path: it is active
JUMPS = 0.02   # of the magnitude of a costate: what a figure can show
MOST_TIMES = 3   # times of jumps that a legend names
CONTACT: dict[str, Any] = {'color': LINE_COLOURS[4], 'linewidth': 1.6, 'zorder': 1.4}
JUMP: dict[str, Any] = {'color': 'black', 'linewidth': 1.3, 'linestyle': (0, (1, 1.5)),
                        'zorder': 1.6}


@dataclass(frozen=True)
class PathMarks:
    """
    Times that the panels of a path mark [s].

    `contacts` are first and last times at which a constraint on states alone is active, equal for
    a touch; `jumps` are times at which costates jump; `switches` those at which an input does.
    """

    contacts: tuple[tuple[float, float], ...]
    jumps: tuple[float, ...]
    switches: tuple[float, ...]


def find_marks(problem: Problem, path: Solution) -> PathMarks:
    """Return the marks of a path with all states of the problem; with phases, no contacts."""
    contacts = _find_contacts(problem, path) if problem.phases is None else []
    return PathMarks(tuple(contacts), tuple(_find_jumps(path, contacts)),
                     tuple(path.switching_times.tolist()))


def find_state_rows(problem: Problem) -> dict[int, tuple[int, ...]]:
    """Return the states in each path constraint on states alone, by the constraint's number."""
    columns: dict[int, set[int]] = {}
    sparsity = ca.jacobian(problem.path, ca.vertcat(problem.x, problem.u)).sparsity()
    for row, column in zip(*sparsity.get_triplet(), strict=True):
        columns.setdefault(row, set()).add(column)
    banned = set(range(problem.n, problem.n + problem.m))
    if problem.has_clock:
        banned.add(problem.stated)
    return {row: tuple(sorted(each for each in found if each < problem.stated))
            for row, found in sorted(columns.items())
            if not found & banned and min(found) < problem.stated}


def evaluate_rows(problem: Problem, rows: Sequence[int], x: Array) -> Array:
    """Return path constraints on states alone, (N, k), at states (N, n)."""
    c = ca.Function('c', [problem.x, problem.p], [ca.densify(problem.path[list(rows)])])
    found: Array = c.map(len(x))(x.T, ca.repmat(problem.p_value, 1, len(x))).full().T
    return found


def draw_marks(axes: Sequence[Any], marks: PathMarks) -> list[Any]:
    """Draw marks into all panels over time; return one artist of each kind for a legend."""
    for panel in axes:
        for begin, end in marks.contacts:
            if begin < end:
                panel.axvspan(begin, end, color=CONTACT['color'], alpha=0.22, zorder=1.3)
            for time in {begin, end}:
                panel.axvline(time, **CONTACT)
        for time in marks.switches:
            panel.axvline(time, **THIN)
        for time in marks.jumps:
            panel.axvline(time, **JUMP)
    return _list_handles(marks)


def _list_handles(marks: PathMarks) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    handles: list[Any] = []
    if marks.switches:
        handles.append(Line2D([], [], label='an input switches', **THIN))
    arcs = [begin < end for begin, end in marks.contacts]
    if any(arcs):
        handles.append(Patch(facecolor=CONTACT['color'], alpha=0.35, edgecolor=CONTACT['color'],
                             label='on a state constraint'))
    if not all(arcs):
        handles.append(Line2D([], [], label='touches a state constraint', **CONTACT))
    if marks.jumps:
        times = ', '.join(f'{time:.4g}' for time in marks.jumps[:MOST_TIMES])
        more = ' ...' if len(marks.jumps) > MOST_TIMES else ''
        handles.append(Line2D([], [], label=f'costates jump, t = {times}{more} s', **JUMP))
    return handles


def _find_jumps(path: Solution, contacts: Sequence[tuple[float, float]]) -> list[float]:
    """Return when costates jump. They can do so only where a state constraint is active."""
    t, lam = path.t, path.lam
    if not lam.size:
        return []
    sizes = np.abs(lam).max(axis=0)
    jumps = (np.diff(t) == 0) & (np.abs(np.diff(lam, axis=0)) > JUMPS * sizes).any(axis=1)
    return [time for time in np.unique(t[1:][jumps]).tolist()
            if any(begin <= time <= end for begin, end in contacts)]


def _find_contacts(problem: Problem, path: Solution) -> list[tuple[float, float]]:
    """Return when constraints on states alone are active; where a path begins, many are."""
    n = problem.stated
    columns = [(path.x[:, :n], problem.x_lower[:n], problem.x_upper[:n])]
    if rows := list(find_state_rows(problem)):
        columns.append((evaluate_rows(problem, rows, path.x), problem.path_lower[rows],
                        problem.path_upper[rows]))
    found = set()
    for values, lower, upper in columns:
        near = ACTIVE * np.ptp(values, axis=0)
        active = (np.minimum(values - lower, upper - values) <= near) & (near > 0) & (
            lower < upper)
        for column in active.T:
            found |= set(_find_runs(path.t, column))
    return sorted(found)


def _find_runs(t: Array, active: Array) -> list[tuple[float, float]]:
    """Return first and last times of runs, without those of no duration at an end of the path."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], active, [False]])))
    runs = [(float(t[a]), float(t[b - 1])) for a, b in edges.reshape(-1, 2)]
    return [run for run in runs if run[0] < run[1] or t[0] < run[0] < t[-1]]
