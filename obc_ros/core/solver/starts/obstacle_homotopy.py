# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Obstacle homotopy classes: initial guesses that pass each obstacle on either side.

Paths on different sides of an obstacle belong to different homotopy classes, and a descent does
not lead from one class to another. With several obstacles each choice of sides may have a local
minimum. A straight line is bent around the obstacles for each choice.
"""

from dataclasses import replace
from itertools import product

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import find_dependence
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.options import DEFAULTS
from obc_ros.core.solver.starts.start import Known, Proposal, StartPool
from obc_ros.core.solver.transcription.mesh import Path


def has_obstacles(bench: Bench, known: Known) -> bool:
    """Return whether path constraints are obstacles."""
    outcome = known.outcome
    return not bench.programs.twin and outcome is not None and bool(
        bench.problem.path.numel() and np.isfinite(outcome.path.t[-1])
        and _curved(bench.problem).size)


def start_around(bench: Bench, _: StartPool, known: Known) -> Proposal:
    """Propose one path for each choice of sides of the obstacles, the shortest first."""
    problem, guesser, outcome = bench.problem, bench.programs.guesser, known.outcome
    assert outcome is not None
    around = bend_around(problem, guesser.line(problem, float(outcome.path.t[-1])),
                         bench.options.obstacles.ways)
    if not around:
        return Proposal(why='the line passes all of them')
    return Proposal(first=iter(around), wanted=len(around))


def bend_around(problem: Problem, line: Path,
                most: int = DEFAULTS.obstacles.ways) -> list[Path]:
    """
    Bend a straight line from x(0) to the end around the path constraints that it violates.

    At most one path for each choice of sides is returned, the `most` shortest, around the `most`
    largest obstacles. Path constraints that are nonlinear in x and free of u are obstacles.
    """
    rows = _curved(problem)
    if not rows.size:
        return []
    s = np.linspace(0.0, 1.0, 81)
    x = interpolate_columns(s * line.t[-1], line.t, line.x)
    # Rows that depend on u are not used.
    path = ca.substitute(problem.path, problem.u, ca.DM.zeros(problem.m))
    seen = VectorizedFunction([problem.x, problem.p], [path, ca.jacobian(path, problem.x).T])
    value, slopes = seen(x, problem.p_value)
    slopes = slopes.reshape(len(s), -1, problem.n)
    room = np.minimum(value - problem.path_lower, problem.path_upper - value)
    depends, sides = find_dependence(problem.path, problem.x), []
    for row in rows[np.argsort(room[:, rows].min(axis=0))][:most].tolist():
        k = int(np.argmin(room[:, row]))
        found = _sides(problem, seen, (x[0], x[k], x[-1]), row,
                       np.where(depends[row], slopes[k, row], np.nan))
        if any(aside.any() for aside in found):
            sides.append([(s[k], aside) for aside in found])
    if not sides:
        return []
    ways = [_bent(line, choice) for choice in product(*sides)]
    size = np.maximum(np.ptp([way.x for way in ways], axis=(0, 1)), 1e-300)
    return sorted(ways, key=lambda way: float(np.linalg.norm(
        np.diff(way.x / size, axis=0), axis=1).sum()))[:most]


def _curved(problem: Problem) -> NDArray[np.int64]:
    """Return which path constraints are nonlinear in x and free of u."""
    rows = [row for row, c in enumerate(ca.vertsplit(problem.path))
            if not ca.depends_on(c, problem.u)
            and ca.depends_on(ca.jacobian(c, problem.x), problem.x)]
    return np.array(rows, dtype=np.int64)


def _sides(problem: Problem, seen: VectorizedFunction, line: tuple[Array, Array, Array], row: int,
           slope: Array) -> list[Array]:
    """
    Return the displacements (n,) of a line, to either side, that pass a constraint.

    `line`: its start, its point with the largest violation, and its end; `slope`: gradient of the
    constraint there, nan for states that do not occur in it.
    """
    start, near, end = line
    of = np.flatnonzero(~np.isnan(slope))
    length = float(np.linalg.norm(end[of] - start[of]))
    if len(of) < 2 or not length > 0:
        return []
    along = (end[of] - start[of]) / length
    away = slope[of] - (slope[of] @ along) * along
    if not np.linalg.norm(away) > 1e-6 * np.linalg.norm(slope[of]):   # through the centre
        away = np.eye(len(of))[int(np.argmin(np.abs(along)))]
        away -= (away @ along) * along
    step, far = np.zeros(problem.n), np.linspace(0.0, length, 201)
    step[of] = away / np.linalg.norm(away)
    found = []
    for sign in (1.0, -1.0):
        value = seen(near + sign * far[:, None] * step, problem.p_value)[0][:, row]
        inside = ~((value >= problem.path_lower[row]) & (value <= problem.path_upper[row]))
        first = int(np.argmax(inside))
        beyond = first + int(np.argmin(inside[first:]))
        if not inside.any():
            found.append(np.zeros(problem.n))
        elif not inside[beyond] and (inside[0] or far[beyond] <= 0.5 * length):   # no long detour
            found.append(sign * 1.1 * far[beyond] * step)   # clear of the edge
    return found


def _bent(line: Path, choice: tuple[tuple[float, Array], ...]) -> Path:
    """Return a line with the given displacements at parts of its length, straight in between."""
    none, choice = np.zeros(line.x.shape[1]), tuple(sorted(choice, key=lambda each: each[0]))
    at = [0.0, *(part for part, _ in choice), 1.0]
    aside = np.array([none, *(each for _, each in choice), none])
    s = line.t / line.t[-1]
    return replace(line, x=line.x + interpolate_columns(s, np.array(at), aside))
