# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A transcription of one phase as a banded program, with its unknowns in order of time."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, Mask
from obc_ros.core.numerics.ipopt import Found
from obc_ros.core.solver.nlp.interior_point import (
    Interior,
    leave_saddle,
    Pattern,
    ProgramValues,
    solve_program,
    StoppingRule,
)
from obc_ros.core.solver.transcription.block_program import Piece


class Stages:
    """
    A banded program of intervals and an end, with their rows between the unknowns of mesh points.

    :param interval, end: rows and cost of an interval and of the end.
    :param index, own: (N, nv) and (N, .), places of the local variables of each interval in [w;
        c], and of its constants in c.
    :param last: (n,), places of x(T) in w.
    :param points: (N + 1, n + m), places of the unknowns of each mesh point in w.
    :param unknowns: length of w: the unknowns of the points, and at most one more.
    :param shared: number of constants that all intervals share, which come first.
    """

    def __init__(self, interval: Piece, end: Piece, index: Index, own: Index, last: Index,
                 points: Index, unknowns: int, shared: int) -> None:
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
        # Constants follow y.
        v = np.where(index < unknowns, self.at_w[np.minimum(index, unknowns - 1)],
                     index - unknowns + self.size)
        of_intervals = self.at_rows[:N * r].reshape(N, r)
        self._copies = (
            _Copies(interval, v, self.size + own, of_intervals, self.size + np.arange(shared)),
            _Copies(end, self.at_w[last][None, :], np.zeros((1, 0), dtype=np.int64),
                    self.at_rows[None, N * r:], self.size + np.arange(shared)))
        rows, columns = (np.concatenate([copies.entries[k] for copies in self._copies])
                         for k in (0, 1))
        # Entries of constants are dropped.
        self._kept = np.flatnonzero((rows < self.size) & (columns < self.size))
        self.pattern = Pattern(rows[self._kept], columns[self._kept], self.size, border)
        self._without: tuple[Any, Index] = None, np.zeros(0, dtype=np.int64)
        self._squared: tuple[ProgramValues | None, Array] = None, np.zeros(0)
        self._number()

    def _number(self) -> None:
        """Compute the places of the results of the copies, and where they are added."""
        first, second = self._copies
        self._places = slice(0, first.total), slice(first.total, first.total + second.total)
        nowhere = 3 * self.size   # slopes by constants are dropped
        slots, summands, entries = [], [], []
        for copies, offset in ((first, 0), (second, first.total)):
            g, cost, cost_slope, slope, J, H = (at + offset for at in copies.results)
            summands += [g, slope, cost_slope, cost]
            v = np.where(copies.v < self.size, copies.v, nowhere)
            slots += [copies.rows, self.size + v, 2 * self.size + v[:, copies.places[0][0]],
                      np.full(cost.shape, 3 * self.size)]
            entries += [H, J, J]
        slot, summand = (np.concatenate([part.ravel() for part in parts])
                         for parts in (slots, summands))
        self._slots, self._summands = np.minimum(slot, nowhere + 1), summand
        self._entries = np.concatenate([part.ravel() for part in entries])[self._kept]

    @cached_property
    def _squares(self) -> tuple[Pattern, Index]:
        """Return the pattern of the Hessian plus J'J, and which of their entries it contains."""
        rows, columns = [], []
        for copies in self._copies:
            _, (_, j), (a, b) = copies.places
            pairs = copies.v[:, j[copies.pairs]]
            rows += [copies.v[:, a], pairs.max(axis=1)]
            columns += [copies.v[:, b], pairs.min(axis=1)]
        i, j = (np.concatenate([part.ravel() for part in parts]) for parts in (rows, columns))
        inner = self.pattern.inner
        kept = np.flatnonzero((i < self.size) & (j < self.size) & (i >= j))
        i, j = i[kept], j[kept]
        # Entries of the border belong to its columns.
        edge = (i >= inner) & (j < inner)
        i, j = np.where(edge, j, i), np.where(edge, i, j)
        return Pattern(i, j, self.size, self.pattern.border, triangle=True), kept

    def convex(self, values: ProgramValues, fixed: Mask, diagonal: Array) -> bool:
        """
        Return whether the Hessian with a diagonal added is positive definite where J d = 0.

        This is tested as positive definiteness after a large multiple of J'J is added.
        """
        pattern, kept = self._squares
        if fixed is not self._without[0]:
            self._without = fixed, pattern.without(fixed)
        if values is not self._squared[0]:   # only the diagonal changes from test to test
            parts = []
            with np.errstate(over='ignore'):
                for copies, (jacobian, curvature) in zip(self._copies, values.parts, strict=True):
                    a, b = copies.pairs
                    heavy = np.sqrt(1e7) * jacobian   # a factor of J'J
                    parts += [curvature.ravel(), (heavy[:, a] * heavy[:, b]).ravel()]
            self._squared = values, np.concatenate(parts)[kept]
        return pattern.definite(self._squared[1], self._without[1], diagonal)

    @np.errstate(over='ignore', invalid='ignore')   # trial points that overflow are rejected
    def run(self, w: Array, constants: Array, bounds: tuple[Array, Array], goal: StoppingRule,
            watch: Callable[[float, float], bool], *, near: bool = False,
            lam_g: Array | None = None, mu: float = 0.0) -> Found:
        """
        Solve the program by the interior-point method.

        :param watch: called with cost and infeasibility; True stops.
        :param lam_g: initial multipliers of the rows; the method estimates `lam_w`.
        :param mu: barrier parameter at which these were found.
        """
        y, lower = np.zeros(self.size), np.full(self.size, -np.inf)
        upper = -lower
        y[self.at_w], lower[self.at_w], upper[self.at_w] = w, *bounds
        self._constants, self.factor = constants, 1.0

        def seen(f: float, worst: float) -> bool:
            return watch(f / self.factor, worst)

        if lam_g is not None:
            y[self.at_rows] = lam_g
        work = Interior(self, lower, upper)
        if near and lam_g is not None:
            # The barrier parameter begins above the last one of the neighbour.
            now = work.resume(y, float(np.clip(100 * mu, 1e-8, 1e-4)))
        else:
            # Barrier parameter and least distance from bounds, near a solution and far from one.
            now = work.begin(y, *((1e-6, 1e-6) if near else (0.1, 1e-2)))
        if not near:
            steepest, most = float(np.abs(now.values.cost_slope).max()), 100.0   # as in IPOPT
            if most < steepest < np.inf:   # the cost is scaled down
                self.factor = most / steepest
                now = replace(now, values=self.values(now.y))
            now = work.measured(replace(now, z=np.ones_like(now.z)))
        if lam_g is None:
            now = work.multipliers(now)
        end = leave_saddle(work, solve_program(work, now, goal, seen), goal, seen)
        return Found(
            w=end.y[self.at_w], f=end.values.f / self.factor, g=end.values.c[self.at_rows],
            lam_w=-work.spread(end.z)[self.at_w] / self.factor,
            lam_g=end.y[self.at_rows] / self.factor, converged=end.converged, status=end.status,
            iterations=end.iterations, mu=end.mu)

    def values(self, y: Array) -> ProgramValues:
        """Return values and derivatives at y."""
        known = np.concatenate([y, self._constants, [self.factor]])
        flat, parts = np.empty(self._places[-1].stop), []
        for copies, place in zip(self._copies, self._places, strict=True):
            result = flat[place].reshape(len(copies.take), -1)
            copies.piece.batch.of_joined(known[copies.take], result)
            parts.append((result[:, copies.at_J], result[:, copies.at_H]))
        sums: Array = np.asarray(np.bincount(
            self._slots, flat[self._summands], 3 * self.size + 2), dtype=float)
        c, slope, cost_slope = sums[:-2].reshape(3, -1)
        cost_slope *= self.factor
        return ProgramValues(self.factor * float(sums[-2]), c, slope, cost_slope,
                             flat[self._entries], tuple(parts))

    def merit(self, y: Array) -> tuple[float, Array]:
        """Return f and c at y."""
        known = np.concatenate([y, self._constants])
        c, cost, seen = np.zeros(self.size), 0.0, []
        for copies in self._copies:
            result = copies.piece.values.of_joined(known[copies.few])
            seen.append(result[:, :-1].ravel())
            cost += float(result[:, -1].sum())
        c[self.at_rows] = np.concatenate(seen)
        return self.factor * cost, c


class _Copies:
    """
    Copies of a piece, with the places of their arguments and results.

    `take`, `few`: places in (y, constants, factor) of the arguments for all results, and for g and
    the cost alone. `results`: places of g, cost, its gradient, that of the Lagrangian, J and H
    among `total` results; `at_J`, `at_H`: places of the last two in the results of one copy.
    `entries`: rows and columns of H, J and J' in the matrix. `pairs` (2, .): pairs of entries of J
    whose products give J'J.
    """

    def __init__(self, piece: Piece, v: Index, own: Index, rows: Index, shared: Index) -> None:
        self.piece, self.places, self.v, self.rows = piece, piece.places, v, rows
        K, outputs = len(v), piece.batch.outputs
        self.few = np.hstack([v, own, np.tile(shared, (K, 1))])
        self.take = np.hstack([self.few, np.full((K, 1), -1), rows])
        width = outputs[-1].stop
        self.total = K * width
        self.results = [width * np.arange(K)[:, None] + np.arange(part.start, part.stop)
                        for part in outputs]
        _, (i, j), (a, b) = piece.places
        self.pairs = np.array(np.nonzero(np.triu(i[:, None] == i)))
        self.at_J, self.at_H = outputs[-2:]
        pairs = ((v[:, a], v[:, b]), (rows[:, i], v[:, j]), (v[:, j], rows[:, i]))
        self.entries = [np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1)]
