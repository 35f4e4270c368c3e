# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A transcription of one phase as a program whose unknowns follow each other in time."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.active import follow
from obc_ros.core.blocks import Index, Whole
from obc_ros.core.interior import Goal, Interior, Iterate, Pattern, solve, Values

Array = NDArray[np.float64]

_PENALTY = 1e7       # of J'J, when H is tested
_STEEPEST = 100.0   # of a cost
_FAR, _NEAR = (0.1, 1e-2), (1e-4, 1e-6)   # mu, distance from bounds


@dataclass(frozen=True, eq=False)
class Found:
    """
    What came of a program: w and f, multipliers of w's bounds and of the rows, the rows.

    Multipliers have the sign of f + lam_g' g + lam_w' w.
    """

    w: Array
    f: float
    g: Array
    lam_w: Array
    lam_g: Array
    converged: bool
    status: str
    iterations: int


class Stages:
    """
    Intervals and an end, their rows between the unknowns of the mesh points.

    Parameters
    ----------
    interval, end : Whole
        Functions of an interval and of the end.
    index, own : ndarray, shape (N, nv) and (N, .)
        Where the local variables of each interval stand in [w; c], and its constants in c.
    last : ndarray, shape (n,)
        Where x(T) stands in w.
    points : ndarray, shape (N + 1, n + m)
        Where the unknowns of each mesh point stand in w.
    unknowns : int
        Length of w: the unknowns of the points, and one more at most.

    """

    def __init__(self, interval: Whole, end: Whole, index: Index, own: Index, last: Index,
                 points: Index, unknowns: int) -> None:
        self._interval, self._end, self._own_index = interval, end, own
        N, per, r, q = len(index), points.shape[1], interval.r, end.r
        stride = per + r
        inner = (N + 1) * per + N * r + q
        border = unknowns - points.size
        self.at_w = np.full(unknowns, inner)
        self.at_w[points] = stride * np.arange(N + 1)[:, None] + np.arange(per)
        self.at_rows = np.append(
            (stride * np.arange(N)[:, None] + per + np.arange(r)).ravel(),
            stride * N + per + np.arange(q))
        self.size = inner + border
        self.is_row = np.zeros(self.size, dtype=bool)
        self.is_row[self.at_rows] = True
        # Constants stand behind y.
        self._v = np.where(index < unknowns, self.at_w[np.minimum(index, unknowns - 1)],
                           index - unknowns + self.size)
        self._x_end = self.at_w[last][None, :]
        self._rows, self._end_rows = self.at_rows[:N * r].reshape(N, r), self.at_rows[None, N * r:]
        pairs = [*self._entries(interval, self._v, self._rows),
                 *self._entries(end, self._x_end, self._end_rows)]
        rows, columns = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))
        # Entries of constants are dropped with the last place of the pattern.
        self._kept = np.flatnonzero((rows < self.size) & (columns < self.size))
        self.pattern = Pattern(rows[self._kept], columns[self._kept], self.size, border)

    @staticmethod
    def _entries(whole: Whole, v: Index, rows: Index) -> list[tuple[Index, Index]]:
        i, j = whole.jacobian
        a, b = whole.curvature
        return [(v[:, a], v[:, b]), (rows[:, i], v[:, j]), (v[:, j], rows[:, i])]

    def bind(self, shared: Array, constants: Array) -> None:
        """Set the constants `shared` by all intervals, and all of them."""
        self._own, self._shared, self._constants = constants[self._own_index], shared, constants

    @cached_property
    def _squares(self) -> tuple[Pattern, Index]:
        """Return the pattern of the Hessian and of J'J, and which of its entries are kept."""
        rows, columns = [], []
        for whole, v in ((self._interval, self._v), (self._end, self._x_end)):
            a, b = whole.curvature
            rows += [v[:, a], np.repeat(v, v.shape[1], axis=1)]
            columns += [v[:, b], np.tile(v, v.shape[1])]
        i, j = (np.concatenate([part.ravel() for part in parts]) for parts in (rows, columns))
        kept = np.flatnonzero((i < self.size) & (j < self.size))
        return Pattern(i[kept], j[kept], self.size, self.pattern.border), kept

    def convex(self, values: Values, fixed: NDArray[np.bool_], diagonal: Array) -> bool:
        """
        Return whether the Hessian with a diagonal added is positive definite where J d = 0.

        It is if it is positive definite everywhere once a multiple of J'J is added.
        """
        pattern, kept = self._squares
        parts = []
        for whole, (jacobian, curvature) in zip((self._interval, self._end), values.parts,
                                                strict=True):
            nv = self._v.shape[1] if whole is self._interval else self._x_end.shape[1]
            J = np.zeros((len(jacobian), whole.r, nv))
            J[:, whole.jacobian[0], whole.jacobian[1]] = jacobian
            with np.errstate(over='ignore'):
                squares = _PENALTY * np.matmul(J.transpose(0, 2, 1), J)
            parts += [curvature.ravel(), squares.ravel()]
        return pattern.definite(np.concatenate(parts)[kept], fixed, diagonal)

    def run(self, w: Array, bounds: tuple[Array, Array], goal: Goal,
            watch: Callable[[float, float], bool], *, near: bool = False,
            multipliers: tuple[Array, Array] | None = None) -> Found:
        """
        Return what the interior-point method makes of a start.

        Parameters
        ----------
        w : ndarray
            Where to start.
        bounds : pair of ndarray
            Of w.
        goal : Goal
            When to stop.
        watch : callable
            Called with cost and infeasibility; True stops.
        near : bool
            Whether the start is near the optimum.
        multipliers : pair of ndarray, optional
            `lam_w` and `lam_g` at the start; of `lam_w` the signs are enough.

        """
        y, lower = np.zeros(self.size), np.full(self.size, -np.inf)
        upper = -lower
        y[self.at_w], lower[self.at_w], upper[self.at_w] = w, *bounds
        self.factor, self.weights = 1.0, np.ones(self._end.r)
        if not near:
            self._scale(y)

        def seen(f: float, worst: float) -> bool:
            return watch(f / self.factor, worst)

        if multipliers is not None:
            z = np.zeros(self.size)
            z[self.at_w] = multipliers[0] * self.factor
            y[self.at_rows] = multipliers[1] * self.factor / self._row_weights()
            side = ((z > upper - y).astype(np.int8) - (-z > y - lower)).astype(np.int8)
            side[lower == upper] = 0
            followed = follow(self, (lower, upper), y, side, goal, seen)
            if followed is not None:
                return self._followed(*followed)
        work = Interior(self, lower, upper, strict=not near)
        now = work.begin(y, *(_NEAR if near else _FAR))
        if not near:
            now.z[:] = 1.0
        if multipliers is None:
            work.multipliers(now)
        return self._found(work, solve(work, now, goal, seen))

    def _followed(self, y: Array, there: Values, steps: int) -> Found:
        weights = self._row_weights()
        return Found(y[self.at_w], there.f / self.factor, there.c[self.at_rows] / weights,
                     -there.slope[self.at_w] / self.factor,
                     y[self.at_rows] * weights / self.factor, True, 'followed', steps)

    def _row_weights(self) -> Array:
        return np.append(np.ones(self._rows.size), self.weights)

    def _scale(self, y: Array) -> None:
        """Make the cost less steep where it is very steep."""
        steepest = float(np.abs(self.values(y).cost_slope).max())
        if np.isfinite(steepest):
            self.factor = min(1.0, _STEEPEST / max(steepest, 1e-300))

    def _found(self, work: Interior, end: Iterate) -> Found:
        weights = self._row_weights()
        return Found(end.y[self.at_w], end.values.f / self.factor,
                     end.values.c[self.at_rows] / weights,
                     -work.spread(end.z)[self.at_w] / self.factor,
                     end.y[self.at_rows] * weights / self.factor, end.converged, end.status,
                     end.iterations)

    def values(self, y: Array) -> Values:
        """Return everything at y."""
        both = np.concatenate([y, self._constants])
        f, parts, pieces = 0.0, [], []
        c, slope, cost_slope = np.zeros(self.size), np.zeros(self.size), np.zeros(self.size)
        both_slope = np.zeros(len(both))
        both_cost = np.zeros(len(both))
        for whole, v, own, rows, weight in (
                (self._interval, self._v, self._own, self._rows, None),
                (self._end, self._x_end, np.zeros((1, 0)), self._end_rows, self.weights)):
            lam = y[rows] if weight is None else y[rows] * weight
            g, cost, cost_v, slope_v, jacobian, curvature = whole.batch(
                both[v], own, self._shared, np.array([self.factor]), lam)
            if weight is not None:
                g = g * weight
                jacobian = jacobian * weight[whole.jacobian[0]]
            f += self.factor * float(cost.sum())
            c[rows] = g
            where = v.ravel()
            both_slope += np.bincount(where, slope_v.ravel(), len(both))
            both_cost += np.bincount(v[:, whole.slope].ravel(), self.factor * cost_v.ravel(),
                                     len(both))
            parts += [curvature.ravel(), jacobian.ravel(), jacobian.ravel()]
            pieces.append((jacobian, curvature))
        slope, cost_slope = both_slope[:self.size], both_cost[:self.size]
        slope[self.is_row] = 0.0
        return Values(f, c, slope, cost_slope, np.concatenate(parts)[self._kept], tuple(pieces))

    def merit(self, y: Array) -> tuple[float, Array]:
        """Return f and c at y."""
        both = np.concatenate([y, self._constants])
        c = np.zeros(self.size)
        g, cost = self._interval.values(both[self._v], self._own, self._shared)
        c[self._rows] = g
        g_end, V = self._end.values(both[self._x_end], np.zeros((1, 0)), self._shared)
        c[self._end_rows] = g_end * self.weights
        return self.factor * float(cost.sum() + V.sum()), c
