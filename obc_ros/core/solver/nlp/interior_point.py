# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A primal-dual interior-point method for banded programs, whose unknowns are in order of time.

Minimise f(w) subject to c(w) = 0, lower <= w <= upper. Newton's method is applied to

    grad f + J'lam - zl + zu = 0,   c = 0,   (w - lower) zl = mu,   (upper - w) zu = mu

for a sequence of mu that goes to zero. The unknowns and the rows of each mesh point are adjacent,
so that the matrix has a narrow band. The cost of a step is proportional to the number of
intervals, and small compared with one evaluation of the second derivatives. Steps are accepted by
a filter. A multiple of the identity is added to the Hessian until it is positive definite on the
null space of J, so that the method descends. There is no restoration phase: if one is needed the
method stops with the status 'no step'.

A. Waechter, L. T. Biegler, On the implementation of an interior-point filter line-search
algorithm for large-scale nonlinear programming, Math. Program. 106 (2006).
N.-Y. Chiang, V. M. Zavala, An inertia-free filter line-search algorithm for large-scale nonlinear
programming, Comput. Optim. Appl. 64 (2016).

The symmetric path of a symmetric problem satisfies the first-order conditions, and Newton steps
from it stay symmetric: none leads from a path through an obstacle to one around it. At such a
saddle the Hessian has negative curvature on the null space of J. A small step in that direction
gives an initial point from which the method finds a minimum (`leave_saddle`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, lapack, Mask


@dataclass(frozen=True, eq=False)
class ProgramValues:
    """
    The values and derivatives of a program at y = (w, lam).

    :ivar c: of y, constraints in the places of their multipliers, else 0.
    :ivar slope, cost_slope: of y, gradients of the Lagrangian and of f in the places of the
        unknowns.
    :ivar entries: of the matrix, in the order of the pattern.
    :ivar parts: blocks for `NewtonProgram.convex`.
    """

    f: float
    c: Array
    slope: Array
    cost_slope: Array
    entries: Array
    parts: tuple[tuple[Array, Array], ...]


class NewtonProgram(Protocol):
    """A program: unknowns w and multipliers lam of its rows in one vector y, in order of time."""

    pattern: 'Pattern'
    is_row: Mask

    def values(self, y: Array) -> ProgramValues:
        """Return values and derivatives at y."""

    def merit(self, y: Array) -> tuple[float, Array]:
        """Return f and c at y."""

    def convex(self, values: ProgramValues, fixed: Mask, diagonal: Array) -> bool:
        """Return whether the Hessian with a diagonal added is positive where J d = 0."""


class Pattern:
    """
    The structure of a symmetric matrix: a band, and a border of a few last columns.

    :param rows, columns: places of all entries of both triangles; entries at the same place are
        added.
    :param triangle: keep only the lower triangle of the band, which is sufficient for `definite`.
    """

    def __init__(self, rows: Index, columns: Index, size: int, border: int, *,
                 triangle: bool = False) -> None:
        self.inner = inner = size - border
        self.size, self.border = size, border
        banded = (rows < inner) & (columns < inner)
        self.width = int(np.abs(rows - columns)[banded].max(initial=0))
        self._above = 0 if triangle else 2 * self.width
        self.height = self._above + self.width + 1
        banded &= (rows >= columns) | (not triangle)
        place = self._above + rows - columns + self.height * columns
        edge = self.height * inner + rows + size * (columns - inner)
        outside = self.height * inner + size * border
        self.place = np.where(banded, place, np.where(columns >= inner, edge, outside))
        self.rows, self.columns, self._outside = rows, columns, outside
        self.diagonal = np.append(
            self._above + self.height * np.arange(inner),
            self.height * inner + inner + np.arange(border) * (size + 1))

    def without(self, fixed: Mask) -> Index:
        """Return the places of the entries with those of the fixed unknowns discarded."""
        return np.where(fixed[self.rows] | fixed[self.columns], self._outside, self.place)

    def _summed(self, place: Index, entries: Array, diagonal: Array) -> tuple[Array, Array]:
        """Return the sum of all entries as a band and a border."""
        flat: Array = np.asarray(np.bincount(place, entries, self._outside + 1), dtype=float)
        flat[self.diagonal] += diagonal
        first = self.height * self.inner
        return (flat[:first].reshape(self.inner, self.height).T,
                flat[first:-1].reshape(self.border, self.size).T)

    def factor(self, entries: Array, place: Index, diagonal: Array) -> 'Factor | None':
        """
        Factorise the matrix with a diagonal (size,) added; return None if it is singular.

        `entries` are in the order of `rows` and `columns`, `place` is `place` or from `without`.
        """
        band, edge = self._summed(place, entries, diagonal)
        lu, pivots, info = lapack.dgbtrf(band, self.width, self.width, overwrite_ab=1)
        factor = None if info else Factor(self, lu, pivots, edge)
        return None if factor is None or factor.singular else factor

    def definite(self, entries: Array, place: Index, diagonal: Array) -> bool:
        """Return whether the matrix with a diagonal added (see `factor`) is positive definite."""
        band, edge = self._summed(place, entries, diagonal)
        lower, info = lapack.dpbtrf(band[self._above:], lower=1, overwrite_ab=1)
        if info or not self.border:
            return not info
        upper = edge[:self.inner]
        corner = edge[self.inner:] - upper.T @ lapack.dpbtrs(lower, upper, lower=1)[0]
        return bool(np.all(np.linalg.eigvalsh(corner) > 0))


class Factor:
    """The LU factors of a banded matrix with a border."""

    def __init__(self, pattern: Pattern, lu: Array, pivots: Any, edge: Array) -> None:
        self._pattern, self._lu, self._pivots = pattern, lu, pivots
        self._upper = edge[:pattern.inner]
        self.singular = False
        if pattern.border:
            self._response = self._banded(self._upper)
            *self._corner, info = lapack.dgetrf(
                edge[pattern.inner:] - self._upper.T @ self._response)
            self.singular = info != 0

    def odd(self) -> bool:
        """Return whether the number of negative eigenvalues is odd, by the determinant's sign."""
        negative = _odd(self._lu[2 * self._pattern.width], self._pivots)
        if self._pattern.border:
            lu, pivots = self._corner
            negative += _odd(np.diagonal(lu), pivots)
        return negative % 2 == 1

    def _banded(self, right: Array) -> Array:
        width = self._pattern.width
        return np.asarray(lapack.dgbtrs(self._lu, width, width, right, self._pivots)[0])

    def solve(self, right: Array) -> Array:
        """Return the solution for a right-hand side."""
        inner = self._pattern.inner
        if not self._pattern.border:
            return self._banded(right)
        first = self._banded(right[:inner])
        last = lapack.dgetrs(*self._corner, right[inner:] - self._upper.T @ first)[0]
        return np.concatenate([first - self._response @ last, last])


def _odd(diagonal: Array, pivots: Any) -> int:
    """Return the number of factors -1 of det: row exchanges and negative pivots of an LU."""
    return int(np.count_nonzero(pivots != np.arange(len(pivots))) + np.count_nonzero(diagonal < 0))


@dataclass(frozen=True)
class StoppingRule:
    """
    Tolerances and limits of a run.

    :ivar feasible, optimal: tolerances of the rows and of the other optimality conditions, scaled.
    :ivar rough: relative error of the cost that is small enough; 0: none.
    :ivar once: with `rough`, a run that stays infeasible ends after 10 steps; with `once` after 5
        or 10.
    """

    feasible: float = 1e-9
    optimal: float = 1e-9
    most: int = 100
    rough: float = 0.0
    once: bool = False


@dataclass(frozen=True, eq=False)
class Iterate:
    """
    An iterate.

    :ivar gap, z: (count,), distances from the bounds, the lower ones first, and their multipliers
        (>= 0).
    :ivar status: of the run that ends here: 'converged', 'good enough', 'stopped', 'no step', 'too
        slow'.
    :ivar error: largest scaled residual of the gradient of the Lagrangian.
    :ivar size: scale of the products of `gap` and `z`.
    :ivar worst, total: largest absolute value and sum of the absolute values of c.
    """

    y: Array
    gap: Array
    z: Array
    mu: float
    values: ProgramValues
    converged: bool = False
    status: str = ''
    iterations: int = 0
    error: float = 0.0
    size: float = 1.0
    worst: float = 0.0
    total: float = 0.0

    def misses(self, mu: float) -> float:
        """Return the largest scaled residual of stationarity and complementarity for a mu."""
        return max(self.error, float(np.abs(self.z * self.gap - mu).max(initial=0.0)) / self.size)


class Interior:
    """
    One run of the method.

    :param lower, upper: of y, bounds of y; infinite for multipliers, equal for fixed unknowns.
    """

    def __init__(self, program: NewtonProgram, lower: Array, upper: Array) -> None:
        self.program = program
        self.fixed = (lower == upper) & ~program.is_row
        self.place = program.pattern.without(self.fixed)
        self.low = np.flatnonzero(np.isfinite(lower) & ~self.fixed)
        self.high = np.flatnonzero(np.isfinite(upper) & ~self.fixed)
        self.lower, self.upper = lower, upper
        self.count = len(self.low) + len(self.high)
        self.row = program.is_row.astype(float)
        self.free = (~program.is_row & ~self.fixed).astype(float)
        # The proximal term keeps redundant rows from being singular.
        self.base = self.fixed - 1e-10 * self.row
        self.odd = int(program.is_row.sum()) % 2 == 1
        self.shift = 0.0
        self.sure = False   # whether the Hessian needed no shift in the last step

    def gaps(self, y: Array) -> Array:
        """Return the distances from all bounds, the lower ones first."""
        return np.concatenate([y[self.low] - self.lower[self.low],
                               self.upper[self.high] - y[self.high]])

    def moves(self, step: Array) -> Array:
        """Return the changes of the distances by a step of y."""
        return np.concatenate([step[self.low], -step[self.high]])

    def spread(self, z: Array, sign: int = -1) -> Array:
        """Return multipliers of lower bounds minus those of upper ones, or plus, shape of y."""
        found = np.zeros(len(self.row))
        found[self.low] = z[:len(self.low)]
        found[self.high] += sign * z[len(self.low):]
        return found

    def begin(self, y: Array, mu: float, push: float) -> Iterate:
        """
        Return the first iterate for a barrier parameter.

        `push`: least distance from a bound, relative to its size and to the span.
        """
        y = np.where(self.fixed, self.lower, y)
        span = self.upper - self.lower
        for places, bound, sign in ((self.low, self.lower, 1.0), (self.high, self.upper, -1.0)):
            edge = bound[places]
            least = np.minimum(push * np.maximum(1.0, np.abs(edge)), push * span[places])
            y[places] = edge + sign * np.maximum(sign * (y[places] - edge), least)
        return self._first(y, mu)

    def resume(self, y: Array, mu: float) -> Iterate:
        """
        Return the first iterate from y near a solution, with the multipliers of the rows.

        The gradient of the Lagrangian gives the multipliers of the bounds, and mu over a
        multiplier the distance from its bound.
        """
        y = np.clip(np.where(self.fixed, self.lower, y), self.lower, self.upper)
        pull = np.maximum(self.moves(self.program.values(y).slope), 1e-300)
        spans = np.minimum((self.upper - self.lower)[np.append(self.low, self.high)], 1.0)
        near = np.minimum(mu / pull, 1e-2 * spans)   # from an active bound
        count = len(self.low)
        y[self.low] = np.maximum(y[self.low], self.lower[self.low] + near[:count])
        y[self.high] = np.minimum(y[self.high], self.upper[self.high] - near[count:])
        return self._first(y, mu)

    def _first(self, y: Array, mu: float) -> Iterate:
        gap = self.gaps(y)
        return self.measured(Iterate(
            y=y, gap=gap, z=mu / gap, mu=mu, values=self.program.values(y)))

    def measured(self, now: Iterate) -> Iterate:
        """Return an iterate with its residuals."""
        slope = now.values.slope * self.free - self.spread(now.z)
        sum_z = float(now.z.sum())
        sum_all = sum_z + float(np.abs(now.y) @ self.row)
        error = float(np.abs(slope).max()) / max(
            1.0, sum_all / (self.count + self.row.sum()) / 100.0)
        c = np.abs(now.values.c)
        return replace(now, error=error, size=max(1.0, sum_z / max(self.count, 1) / 100.0),
                       worst=float(c.max()), total=float(c.sum()))

    def multipliers(self, now: Iterate) -> Iterate:
        """Return an iterate with multipliers of the rows by least squares of stationarity."""
        pattern = self.program.pattern
        jacobian = self.row[pattern.rows] != self.row[pattern.columns]
        factor = pattern.factor(now.values.entries * jacobian, self.place, self.base + self.free)
        if factor is None:
            return now
        found = self.row * factor.solve(self.spread(now.z) - now.values.slope * self.free)
        if not (np.all(np.isfinite(found)) and np.abs(found).max() < 1e3):   # else none
            return now
        y = now.y + found
        return self.measured(replace(now, y=y, values=self.program.values(y)))

    def right(self, now: Iterate, c: Array) -> Array:
        """Return the right-hand side of Newton's equations."""
        return np.asarray(self.spread(now.mu / now.gap) - now.values.slope * self.free - c)

    def direction(self, now: Iterate) -> tuple[Array, Factor] | None:
        """Return a Newton step of positive curvature and its factors; None if there is none."""
        weight = self.spread(now.z / now.gap, 1)
        right, c = self.right(now, now.values.c), now.values.c
        shift = 0.0
        while shift <= 1e10:   # a multiple of the identity is added
            added = weight + shift * self.free
            factor = None
            sure, self.sure = self.sure and not shift, False
            if sure or self.program.convex(now.values, self.fixed, added + 1.0 - self.free):
                factor = self.program.pattern.factor(
                    now.values.entries, self.place, self.base + added)
            if factor is not None and factor.odd() == self.odd:
                step = factor.solve(right)
                primal = step * self.free
                # d'(W + Sigma)d from Newton's equations: (W + Sigma) d = right - J'dlam.
                bent = float(primal @ right) + float(c @ (step * self.row))
                pull = max(-float(c @ ((now.y + step) * self.row)), 0.0)
                if bent + pull >= 1e-9 * float(primal @ primal):   # curvature along it
                    self.shift, self.sure = shift or self.shift, not (sure or shift)
                    return step, factor
            if sure:
                continue
            shift = (max(1e-8, self.shift / 3) if not shift
                     else shift * (8.0 if self.shift else 100.0))
        return None

    def barrier(self, f: float, gap: Array, mu: float) -> float:
        """Return the barrier function f - mu sum log(gap); infinite outside of the bounds."""
        return f - mu * float(np.log(gap).sum()) if gap.min(initial=1.0) > 0 else np.inf


def _part(value: Array, change: Array, keep: float) -> float:
    """Return the largest step length up to 1 by which no value falls by more than `keep` of it."""
    least = float((change / value).min(initial=0.0))
    return min(1.0, -keep / least) if least < 0 else 1.0


class Filter:
    """Pairs of infeasibility and barrier function that later iterates must improve upon."""

    def __init__(self, infeasibility: float) -> None:
        self.most = 1e4 * max(1.0, infeasibility)
        self.least = 1e-4 * max(1.0, infeasibility)
        self._pairs: list[tuple[float, float]] = []

    def add(self, theta: float, phi: float) -> None:
        """Add a pair, with its margins."""
        self._pairs.append(((1 - 1e-5) * theta, phi - 1e-5 * theta))

    def accept(self, before: tuple[float, float], after: tuple[float, float], slope: float,
              part: float) -> tuple[bool, bool]:
        """
        Return whether a trial point is accepted, and whether the filter stays as it is then.

        That is by the Armijo condition of the barrier function. `before`, `after`: infeasibility
        and barrier function of the iterate and of the trial point; `slope`: derivative of the
        barrier function along the step; `part`: step length.
        """
        (theta, phi), (new_theta, new_phi) = before, after
        slack = 1e-14 * abs(phi)
        if not (new_theta <= self.most and np.isfinite(new_phi) and all(
                new_theta <= t or new_phi - slack <= p for t, p in self._pairs)):
            return False, False
        falls, most = min(-slope, 1e100), min(theta, 1e100)   # powers of larger ones overflow
        if theta <= self.least and falls > 0 and part * falls**2.3 > most**1.1:
            return new_phi <= phi + 1e-8 * part * slope + slack, True
        return (new_theta <= (1 - 1e-5) * theta or new_phi <= phi - 1e-5 * theta + slack), False


def solve_program(work: Interior, now: Iterate, goal: StoppingRule,
                  watch: Callable[[float, float], bool]) -> Iterate:
    """
    Run the interior-point method from a first iterate; return the last one.

    `watch` is called with cost and infeasibility of every iterate; True stops.
    """
    pairs, start, least = Filter(now.total), now.total, goal.optimal / 10
    first = now.worst
    # A run ends after so many steps if more than this part of the first infeasibility is left,
    # and more than 0.1.
    ends = ((10, 0.5), (5, 0.8))[:1 + goal.once]
    while True:
        if now.worst <= goal.feasible and now.misses(0.0) <= goal.optimal:
            return replace(now, converged=True, status='converged')
        if now.iterations >= goal.most or watch(now.values.f, now.worst):
            return replace(now, status='stopped')
        mu = now.mu
        while mu > least and max(now.misses(mu), now.worst) <= 10 * mu:
            mu = max(least, min(0.2 * mu, mu**1.5))
        if mu < now.mu:
            now, pairs = replace(now, mu=mu), Filter(start)
        step = _advance(work, now, pairs)
        if step is None:
            return replace(now, status='no step')
        now, promise = step
        if goal.rough and any(now.iterations == steps and now.worst > max(part * first, 0.1)
                              for steps, part in ends):
            return replace(now, status='too slow')
        near = goal.rough * abs(now.values.f)
        if near and now.worst <= 1e-5 and promise <= near and now.mu * work.count <= near:
            return replace(now, converged=True, status='good enough')


def _advance(work: Interior, now: Iterate, pairs: Filter) -> tuple[Iterate, float] | None:
    """Return the next iterate and the predicted decrease of the barrier function, or None."""
    found = work.direction(now)
    if found is None:
        return None
    step, factor = found
    moves = work.moves(step)
    dz = (now.mu - now.z * moves) / now.gap - now.z
    keep = max(0.99, 1.0 - now.mu)
    longest, dual = _part(now.gap, moves, keep), _part(now.z, dz, keep)
    before = now.total, work.barrier(now.values.f, now.gap, now.mu)
    slope = (float(now.values.cost_slope @ (step * work.free))
             - now.mu * float((moves / now.gap).sum()))
    there = work.program.values(now.y + longest * step)
    trial, f, c, part = now.y + longest * step, there.f, there.c, longest
    while True:
        after = float(np.abs(c).sum()), work.barrier(f, work.gaps(trial), now.mu)
        good, descends = pairs.accept(before, after, slope, part)
        if not good and part == longest and after[0] >= before[0]:
            # A second-order correction.
            second = factor.solve(work.right(now, part * now.values.c + c))
            other = now.y + _part(now.gap, work.moves(second), keep) * second
            f, c = work.program.merit(other)
            after = float(np.abs(c).sum()), work.barrier(f, work.gaps(other), now.mu)
            good, descends = pairs.accept(before, after, slope, part)
            trial = other if good else trial
        if good:
            break
        part *= 0.5
        if part < 1e-7:   # the line search has failed
            return None
        trial = now.y + part * step
        f, c = work.program.merit(trial)
    if not descends:
        pairs.add(*before)
    gap = work.gaps(trial)
    limit = now.mu / gap
    # The multipliers of bounds stay within a factor of mu / distance.
    return work.measured(replace(
        now, y=trial, gap=gap, z=np.clip(now.z + dual * dz, limit / 1e10, limit * 1e10),
        values=(there if f == there.f and part == longest else work.program.values(trial)),
        iterations=now.iterations + 1)), -slope


def leave_saddle(work: Interior, end: Iterate, goal: StoppingRule,
                 watch: Callable[[float, float], bool]) -> Iterate:
    """
    Return the last iterate of a run; from a saddle, continue along negative curvature.

    :return: `end`, or a converged iterate of lower cost; `iterations` counts those of all runs.
    """
    for _ in range(3):   # saddles in a row
        way = _down(work, end) if end.converged else None
        if way is None:
            break
        gone = -float((work.moves(way) / end.gap).min(initial=0.0))
        y = end.y + min(0.1, 0.9 / max(gone, 1e-300)) * way
        begun = work.begin(y, max(end.mu, 1e-4), 1e-6)   # least distance from bounds
        below = solve_program(work, begun, goal, watch)
        if below.status == 'too slow':   # repeat without the early end: a saddle is no solution
            below = solve_program(work, replace(begun, iterations=below.iterations),
                                  replace(goal, most=goal.most + below.iterations, rough=0.0),
                                  watch)
        below = replace(below, iterations=below.iterations + end.iterations)
        if not (below.converged and below.values.f < end.values.f - 1e-9 * abs(end.values.f)):
            return replace(end, iterations=below.iterations)
        end = below
    return end


def _down(work: Interior, now: Iterate) -> Array | None:
    """Return d with J d = 0, negative curvature and largest entry 1; None if there is none."""
    slight = 1e-6   # scaled curvature that counts as none; 1e6 is the largest one looked for
    program, weight, shift = work.program, work.spread(now.z / now.gap, 1), slight
    while not program.convex(now.values, work.fixed, weight + shift * work.free + 1 - work.free):
        shift *= 10
        if shift > 1e6:
            return None
    if shift == slight:
        return None
    factor = program.pattern.factor(
        now.values.entries, work.place, work.base + weight + shift * work.free)
    if factor is None:
        return None
    way = np.random.default_rng(1).normal(size=len(now.y))
    for _ in range(3):
        way = factor.solve(way * work.free) * work.free
        way /= np.abs(way).max(initial=1e-300)
    return way if np.all(np.isfinite(way)) else None
