# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Obstacle homotopy classes: initial guesses that pass each obstacle on either side.

Paths on different sides of an obstacle belong to different homotopy classes, and a descent does
not lead from one class to another. With several obstacles each choice of sides may have a local
minimum. A straight line is bent around the obstacles for each choice, and a path near the bent
line that nearly satisfies the dynamics is found by least squares.
"""

from dataclasses import replace
from itertools import product

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array, Mask, optimize
from obc_ros.core.numerics.instructions import find_dependence
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.options import DEFAULTS, ObstacleOptions
from obc_ros.core.solver.starts.initial_guess import estimate_scales
from obc_ros.core.solver.starts.start import Known, Proposal
from obc_ros.core.solver.starts.start_pool import StartPool
from obc_ros.core.solver.transcription.mesh import Path

_SEEN = 81            # points of the line at which constraints are evaluated
_ASIDE = 201          # points across the line, up to its length, at which an obstacle is sought
_STRAIGHT = 1e-6      # part of the gradient across the line below which it has no direction
# Weights in the least squares of defects, of fixed final states, and of inputs and their changes;
# the distance from the line has weight 1.
_OBEY, _ARRIVE, _EASY = 30.0, 10.0, 0.01
_ROOM = 1e-9          # least scaled distance of two bounds in the least squares


def has_obstacles(bench: Bench, known: Known) -> bool:
    """Return whether path constraints are obstacles."""
    outcome = known.outcome
    return not bench.programs.twin and outcome is not None and bool(
        np.isfinite(outcome.path.t[-1]) and _curved(bench.problem).size)


def start_around(bench: Bench, _: StartPool, known: Known) -> Proposal:
    """Propose one path for each choice of sides of the obstacles, the shortest first."""
    problem, guesser, outcome = bench.problem, bench.programs.guesser, known.outcome
    assert outcome is not None
    line = guesser.line(problem, float(outcome.path.t[-1]))
    options = bench.options.obstacles
    around = bend_around(problem, line, options)
    if not around:
        return Proposal(why='the line passes all of them')
    follow = Follower(problem, line, guesser.final_state(problem)[1], options.trials)
    return Proposal(first=map(follow, around), wanted=len(around))


def bend_around(problem: Problem, line: Path,
                options: ObstacleOptions = DEFAULTS.obstacles) -> list[Path]:
    """
    Bend a line around the path constraints that it violates.

    Parameters
    ----------
    problem : Problem
        Its path constraints that are nonlinear in x and free of u are obstacles.
    line : Path
        Straight, from x(0) to the end.
    options : ObstacleOptions
        Of the search.

    Returns
    -------
    list of Path
        At most one for each choice of sides, the shortest first.

    """
    rows = _curved(problem)
    if not rows.size:
        return []
    s = np.linspace(0.0, 1.0, _SEEN)
    x = interpolate_columns(s * line.t[-1], line.t, line.x)
    # Rows that depend on u are not used.
    path = ca.substitute(problem.path, problem.u, ca.DM.zeros(problem.m))
    seen = VectorizedFunction([problem.x, problem.p], [path, ca.jacobian(path, problem.x).T])
    value, slopes = seen(x, problem.p_value)
    slopes = slopes.reshape(_SEEN, -1, problem.n)
    room = np.minimum(value - problem.path_lower, problem.path_upper - value)
    depends, sides = find_dependence(problem.path, problem.x), []
    for row in rows[np.argsort(room[:, rows].min(axis=0))][:options.ways].tolist():
        k = int(np.argmin(room[:, row]))
        found = _sides(problem, seen, (x[0], x[k], x[-1]), row,
                       np.where(depends[row], slopes[k, row], np.nan), options)
        if any(aside.any() for aside in found):
            sides.append([(s[k], aside) for aside in found])
    if not sides:
        return []
    ways = [_bent(line, choice) for choice in product(*sides)]
    size = np.maximum(np.ptp([way.x for way in ways], axis=(0, 1)), 1e-300)
    return sorted(ways, key=lambda way: float(np.linalg.norm(
        np.diff(way.x / size, axis=0), axis=1).sum()))[:options.ways]


def _curved(problem: Problem) -> NDArray[np.int64]:
    """Return which path constraints are nonlinear in x and free of u."""
    rows = [row for row, c in enumerate(ca.vertsplit(problem.path))
            if not ca.depends_on(c, problem.u)
            and ca.depends_on(ca.jacobian(c, problem.x), problem.x)]
    return np.array(rows, dtype=np.int64)


def _sides(problem: Problem, seen: VectorizedFunction, line: tuple[Array, Array, Array], row: int,
           slope: Array, options: ObstacleOptions) -> list[Array]:
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
    if not np.linalg.norm(away) > _STRAIGHT * np.linalg.norm(slope[of]):   # through the centre
        away = np.eye(len(of))[int(np.argmin(np.abs(along)))]
        away -= (away @ along) * along
    step, far = np.zeros(problem.n), np.linspace(0.0, length, _ASIDE)
    step[of] = away / np.linalg.norm(away)
    found = []
    for sign in (1.0, -1.0):
        value = seen(near + sign * far[:, None] * step, problem.p_value)[0][:, row]
        inside = ~((value >= problem.path_lower[row]) & (value <= problem.path_upper[row]))
        first = int(np.argmax(inside))
        beyond = first + int(np.argmin(inside[first:]))
        if not inside.any():
            found.append(np.zeros(problem.n))
        elif not inside[beyond] and (
                inside[0] or far[beyond] <= options.detour * length):
            found.append(sign * options.clear * far[beyond] * step)
    return found


def _bent(line: Path, choice: tuple[tuple[float, Array], ...]) -> Path:
    """Return a line with the given displacements at parts of its length, straight in between."""
    none, choice = np.zeros(line.x.shape[1]), tuple(sorted(choice, key=lambda each: each[0]))
    at = [0.0, *(part for part, _ in choice), 1.0]
    aside = np.array([none, *(each for _, each in choice), none])
    s = line.t / line.t[-1]
    return replace(line, x=line.x + interpolate_columns(s, np.array(at), aside))


class Follower:
    """
    A least-squares problem: the path near a bent line with small trapezoidal defects.

    Parameters
    ----------
    problem : Problem
    line : Path
        Straight, from x(0) to the end; its times are those of the path.
    fixed : ndarray of bool, shape (n,)
        Components of x(T) that psi fixes.
    trials : int
        Maximum number of evaluations.

    """

    def __init__(self, problem: Problem, line: Path, fixed: Mask,
                 trials: int = DEFAULTS.obstacles.trials) -> None:
        self._trials = trials
        x, u = problem.x, problem.u
        self._problem, self._N = problem, len(line.t) - 1
        self._rate = VectorizedFunction([x, u, problem.p], [
            problem.f, ca.jacobian(problem.f, x).T, ca.jacobian(problem.f, u).T])
        placed = find_dependence(problem.path, x)[_curved(problem)].any(axis=0)
        self._placed, self._fixed = np.flatnonzero(placed), np.flatnonzero(fixed)
        self._rest = line.u
        found = estimate_scales(problem, line)
        length = float(np.linalg.norm(np.ptp(line.x[:, placed], axis=0)))
        self._x_size, self._u_size = np.where(placed, length, found.x), found.u

    def __call__(self, way: Path) -> Path:
        """Return a path near a bent line."""
        problem, N = self._problem, self._N
        lower, upper = (np.concatenate([
            np.tile(x / self._x_size, N), np.tile(u / self._u_size, N + 1)]) for x, u in (
                (problem.x_lower, problem.u_lower), (problem.x_upper, problem.u_upper)))
        first = np.concatenate([(way.x[1:] / self._x_size).ravel(),
                                (self._rest / self._u_size).ravel()])
        with np.errstate(all='ignore'):
            try:
                z = optimize.least_squares(
                    self._misses, np.clip(first, lower, upper), self._slopes,
                    (lower, np.maximum(upper, lower + _ROOM)),
                    max_nfev=self._trials, args=(way,)).x
            except ValueError:   # f is undefined somewhere
                return way
        x, u = self._parts(z)
        return replace(way, x=x, ua=u[:-1], ub=u[1:])

    def _parts(self, z: Array) -> tuple[Array, Array]:
        N, n, m = self._N, self._problem.n, self._problem.m
        x = z[:N * n].reshape(N, n) * self._x_size
        return np.vstack([self._problem.x0, x]), z[N * n:].reshape(N + 1, m) * self._u_size

    def _misses(self, z: Array, way: Path) -> Array:
        x, u = self._parts(z)
        f, h = self._rate(x, u, self._problem.p_value)[0], way.t[-1] / self._N
        defect = np.diff(x, axis=0) - h * (f[1:] + f[:-1]) / 2
        off = (x - way.x) / self._x_size
        return np.concatenate([
            _OBEY * (defect / self._x_size).ravel(), off[1:, self._placed].ravel(),
            _ARRIVE * off[-1, self._fixed], _EASY * ((u - self._rest) / self._u_size).ravel(),
            _EASY * (np.diff(u, axis=0) / self._u_size).ravel()])

    def _slopes(self, z: Array, way: Path) -> Array:
        N, n, m = self._N, self._problem.n, self._problem.m
        h, k = way.t[-1] / N, np.arange(N)
        _, fx, fu = self._rate(*self._parts(z), self._problem.p_value)
        fx, fu = fx.reshape(-1, n, n), fu.reshape(-1, n, m)
        by_x, by_u = np.zeros((N, n, N + 1, n)), np.zeros((N, n, N + 1, m))
        for step, sign in ((0, -1.0), (1, 1.0)):
            by_x[k, :, k + step] = sign * np.eye(n) - h / 2 * fx[k + step]
            by_u[k, :, k + step] = -h / 2 * fu[k + step]
        size = self._x_size[:, None, None]
        defect = np.hstack([(by_x * self._x_size / size)[:, :, 1:].reshape(N * n, -1),
                            (by_u * self._u_size / size).reshape(N * n, -1)])
        each = np.eye(defect.shape[1])
        at, inputs = np.arange(N * n).reshape(N, n), each[N * n:]
        return np.vstack([_OBEY * defect, each[at[:, self._placed].ravel()],
                          _ARRIVE * each[at[-1, self._fixed]], _EASY * inputs,
                          _EASY * (inputs[m:] - inputs[:-m])])
