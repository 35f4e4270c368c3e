# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Replay: integration of states, costates and cost between the samples of a solution.

docs/certificate.md has the method and its reasons. In the equation of the costates, -dH/dx - s -
c_x' m, the densities of the multipliers of state bounds and path constraints are s and m. Equal
steps are halved until the embedded error estimate is small, backwards until two results agree. If
f is affine, L quadratic and many steps would be needed, `affine_replay` replaces them. The
solver's mesh and method are not used.
"""

from dataclasses import dataclass
from functools import cached_property
import math

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.numerics.runge_kutta import DORMAND_PRINCE
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.certificate.affine_replay import AffineReplay, Rates, replay_affine
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.ocp.structure import make_differentiable

_A, _C = DORMAND_PRINCE.A, DORMAND_PRINCE.c
PARTS = 4           # values are returned at the quarters of an interval
FEWEST_STEPS = 2    # in an interval, at first
_MANY_STEPS = 32    # in an interval; for more, matrix exponentials are used if f is affine
_STEPS_BACK = 32    # in an interval, at first, for costates integrated backwards
_AT_ONCE = 256      # intervals integrated together backwards
_FAR = 1e3          # times its scale: beyond it a value counts as unbounded growth
LEAST_COST = 1e-6   # scaling factor of a cost that vanishes, relative to its summands
MOST_STEPS = 2048   # in an interval


@dataclass(frozen=True, eq=False)
class Intervals:
    """
    The intervals of a solution: values at the start, inputs and multiplier densities.

    `h` (K,); `x`, `lam` (K, n) at the start; `ua`, `ub` (K, m), `sa`, `sb` (K, n) and `ma`, `mb`
    (K, l) at the start and at the end, linear in between.
    """

    h: Array
    x: Array
    lam: Array
    ua: Array
    ub: Array
    sa: Array
    sb: Array
    ma: Array
    mb: Array

    def some(self, rows: Index) -> 'Intervals':
        """Return the intervals with these indices."""
        return Intervals(**{name: values[rows] for name, values in vars(self).items()})


def build_intervals(problem: Problem, solution: Solution, k: Index) -> Intervals:
    """Return the intervals of a solution that begin at the samples k (K,)."""
    ends = k if solution.interpolation == 'zoh' else k + 1
    none = np.zeros((len(solution.t), problem.path.numel()))
    s, m = solution.state_multipliers, solution.path_multipliers
    s, m = np.zeros_like(solution.x) if s is None else s, none if m is None else m
    return Intervals(
        h=solution.t[k + 1] - solution.t[k], x=solution.x[k], lam=solution.lam[k],
        ua=solution.u[k], ub=solution.u[ends], sa=s[k], sb=s[k + 1], ma=m[k], mb=m[k + 1])


@dataclass(frozen=True, eq=False)
class Replay:
    """
    Values of each interval at its quarters 0, 1/4, 1/2, 3/4, 1.

    `x`, `lam` (K, 5, n), `u` (K, 5, m); `cost` (K,) is the integral of L over each interval,
    `failed` the indices of intervals whose error estimate stayed above the limit.
    """

    x: Array
    lam: Array
    u: Array
    cost: Array
    failed: Index

    @property
    def converged(self) -> bool:
        """Return whether all error estimates came below the limit."""
        return not self.failed.size


class ReplayIntegrator:
    """The equations of states, costates and cost of a problem, for any values of its numbers."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        lam, s = ca.SX.sym('lam', problem.n), ca.SX.sym('s', problem.n)
        mu = ca.SX.sym('mu', problem.path.numel())
        smooth = make_differentiable(problem)
        H = smooth.L + ca.dot(lam, smooth.f) + ca.dot(mu, smooth.path)
        self._rate = VectorizedFunction(
            [ca.vertcat(problem.x, lam), ca.vertcat(problem.u, s, mu), problem.p],
                                        [problem.f, -ca.gradient(H, problem.x) - s, problem.L])

    def replay(self, intervals: Intervals, p: Array, scale: Array, tolerance: float | Array,
               least: float = LEAST_COST) -> Replay:
        """
        Return the values of every interval, integrated from its start.

        :param scale: (2 n,), scaling factors of x and lam. That of the cost is the cost found, or
            `least`.
        :param tolerance: (2 n + 1,), largest scaled error of x, lam and cost in an interval.
        :return: intervals that miss the tolerance with `MOST_STEPS` steps are in `failed`.
        """
        K, n = intervals.x.shape
        z = np.empty((K, PARTS + 1, 2*n + 1))
        rows, steps, before = np.arange(K), FEWEST_STEPS, 0
        while rows.size and steps > before:
            with np.errstate(all='ignore'):
                z[rows], error = self._course(intervals.some(rows), p, steps)
            cost = max(float(np.abs(z[:, -1, -1]).sum()), least)
            error = np.max(error / (tolerance * np.append(scale, cost)), axis=1)
            # An interval whose values are not finite is integrated again in smaller steps.
            bad = ~(error <= 1.0)
            rows, error = rows[bad], error[bad]
            worst = float(error.max(initial=0.0)) if np.all(np.isfinite(error)) else np.inf
            # The estimate falls with the fourth power of the number of steps.
            wanted = 1.3 * steps * min(worst**0.25, 50.0)
            more = PARTS * max(-(-2*steps // PARTS), math.ceil(wanted / PARTS))
            before, steps = steps, min(more, MOST_STEPS)
            if rows.size and steps > _MANY_STEPS and (rates := self._rates(intervals, p, scale)):
                z[rows] = self._exactly(rates, intervals.some(rows), intervals.lam[rows])
                # Costates that grow so far are integrated from the ends (`there_and_back`).
                rows = rows[~(np.abs(z[rows, :, :2*n]) <= _FAR * scale).all(axis=(1, 2))]
                break
        parts = np.linspace(0.0, 1.0, PARTS + 1)[None, :, None]
        u = (1 - parts)*intervals.ua[:, None] + parts*intervals.ub[:, None]
        return Replay(x=z[:, :, :n], lam=z[:, :, n:2*n], u=u, cost=z[:, -1, -1],
                      failed=rows)

    def there_and_back(self, course: Replay, intervals: Intervals, lam_end: Array, p: Array,
                       scale: Array, tolerance: float | Array, least: float = LEAST_COST, *,
                       back: bool = False) -> tuple[Replay, Array]:
        """
        Return values whose costates are integrated from the ends if that is the stable way.

        :param lam_end: (K, n), the solution's costates at the ends of the intervals.
        :param back: integrate from the ends even if the costates of `course` stay bounded.
        :return: (K, n), the values, and the defect of lam: at the end of each interval, or at its
            start if the costates were integrated from the end.
        """
        n, failed, far = intervals.x.shape[1], course.failed, _FAR * scale
        x, lam = (np.abs(part[failed]).max(axis=(0, 1)) if failed.size else np.zeros(n)
                  for part in (course.x, course.lam))
        if not np.all(x <= far[:n]) or np.all(lam <= far[n:]) and not back:
            return course, course.lam[:, -1] - lam_end
        z = np.full((len(intervals.x), PARTS + 1, 2*n + 1), np.inf)
        if rates := self._rates(intervals, p, scale):
            z = self._exactly(rates, intervals, lam_end, back=True)
            return self._from_ends(course, intervals, z, np.flatnonzero(
                ~np.isfinite(z).all(axis=(1, 2))))
        left, steps = np.arange(len(z)), _STEPS_BACK
        while left.size and steps <= MOST_STEPS:
            before = z[left]
            with np.errstate(all='ignore'):
                for part in np.array_split(left, -(-len(left) // _AT_ONCE)):
                    z[part] = self._both_ways(intervals.some(part), lam_end[part], p, steps)
                cost = max(float(np.abs(z[:, -1, -1]).sum()), least)
                error = np.abs(z[left] - before).max(axis=1) / np.append(scale, cost)
            left, steps = left[~(error <= tolerance).all(axis=1)], 2 * steps
        return self._from_ends(course, intervals, z, left)

    @staticmethod
    def _from_ends(course: Replay, intervals: Intervals, z: Array, failed: Index
                   ) -> tuple[Replay, Array]:
        """Return values whose costates come from the ends, and the defects at the starts."""
        n = intervals.x.shape[1]
        defect = intervals.lam - z[:, 0, n:2*n]
        parts = np.linspace(0.0, 1.0, PARTS + 1)[:, None]
        z[:, :, n:2*n] += (1 - parts) * defect[:, None]
        return Replay(z[:, :, :n], z[:, :, n:2*n], course.u, z[:, -1, -1], failed), defect

    @cached_property
    def _affine(self) -> AffineReplay:
        return AffineReplay(self._problem)

    def _rates(self, intervals: Intervals, p: Array, scale: Array) -> Rates | None:
        """Return the matrices of an affine problem; None for another problem."""
        return self._affine.rates(p, scale[:intervals.x.shape[1]], np.vstack(
            _inputs(intervals)), intervals.h)

    @staticmethod
    def _exactly(rates: Rates, intervals: Intervals, lam: Array, *, back: bool = False) -> Array:
        """Return (x, lam, J) at the quarters, (K, 5, 2 n + 1); lam at the ends if `back`."""
        with np.errstate(all='ignore'):
            return replay_affine(rates, intervals.h, intervals.x, _inputs(intervals), lam, PARTS,
                                 back)

    def growth(self, course: Replay, intervals: Intervals, p: Array, scale: Array) -> float:
        """
        Return a bound of the factor by which a defect of lam grows within an interval.

        In units of `scale` (2 n,) it is exp(h |df/dx|), with the Frobenius norm, the larger one
        of both ends. Other parameters are those of `replay`.
        """
        if rates := self._rates(intervals, p, scale):
            n = intervals.x.shape[1]
            with np.errstate(over='ignore'):
                return float(np.exp(intervals.h.max() * np.linalg.norm(rates.Y[:n, :n])))
        K, n = intervals.x.shape
        x, u, s, m = (np.concatenate(both) for both in (
            (course.x[:, 0], course.x[:, -1]), (course.u[:, 0], course.u[:, -1]),
            (intervals.sa, intervals.sb), (intervals.ma, intervals.mb)))
        given = np.hstack([u, s, m])

        def rate(lam: Array) -> Array:
            state = np.hstack([x, np.broadcast_to(lam, x.shape)])
            return self._rate.joined(state, given, p)[:, n:2*n]

        with np.errstate(all='ignore'):
            none = rate(np.zeros(n))   # the equation is affine in lam
            slopes = np.stack([rate(row) - none for row in np.diag(scale[n:])], axis=1) / scale[n:]
            size = np.linalg.norm(slopes, axis=(1, 2)).reshape(2, K).max(axis=0)
            return float(np.exp(np.max(intervals.h * size)))

    def _both_ways(self, intervals: Intervals, lam_end: Array, p: Array, steps: int) -> Array:
        """Return (x, lam, J) at the quarters, (K, 5, 2 n + 1), in equal steps there and back."""
        K, n = intervals.x.shape
        h = intervals.h[:, None] / steps
        x, J, lam = np.empty((steps + 1, K, n)), np.zeros(K), np.empty((steps + 1, K, n))
        f, slopes = np.empty((steps + 1, K, n)), np.empty((len(_C) - 1, K, n + 1))

        first, last = _inputs(intervals)
        change = last - first

        def rate(step: float, x: Array, lam: Array) -> Array:
            return self._rate.joined(np.hstack([x, lam]), first + step / steps * change, p)

        x[0], none = intervals.x, np.zeros((K, n))
        for k in range(steps):
            for i in range(len(_C) - 1):
                now = x[k] + h*_sum(_A[i], slopes)[:, :n] if i else x[k]
                slopes[i] = np.delete(rate(k + _C[i], now, none), slice(n, 2*n), axis=1)
            f[k] = slopes[0, :, :n]
            end = h*_sum(_A[-1], slopes)
            x[k + 1], J = x[k] + end[:, :n], J + end[:, n]
        f[steps], lam[steps] = rate(steps, x[steps], none)[:, :n], lam_end
        back = np.empty((len(_C) - 1, K, n))
        for k in range(steps - 1, -1, -1):
            for i in range(len(_C) - 1):
                now = lam[k + 1] + h*_sum(_A[i], back) if i else lam[k + 1]
                between = _cubic(1 - _C[i], h, x[k:k + 2], f[k:k + 2])
                back[i] = -rate(k + 1 - _C[i], between, now)[:, n:2*n]
            lam[k] = lam[k + 1] + h*_sum(_A[-1], back)
        quarters = np.arange(PARTS + 1) * (steps // PARTS)
        cost = np.broadcast_to(J, (PARTS + 1, K))[:, :, None]
        return np.concatenate([x[quarters], lam[quarters], cost], axis=2).swapaxes(0, 1)

    def _course(self, intervals: Intervals, p: Array, steps: int) -> tuple[Array, Array]:
        """Return z = (x, lam, J) at the quarters, and the sum of the steps' error estimates."""
        K, n = intervals.x.shape
        z = np.column_stack([intervals.x, intervals.lam, np.zeros(K)])
        h = intervals.h[:, None] / steps

        first, last = _inputs(intervals)
        change = last - first

        def rate(tau: float, z: Array) -> Array:
            return self._rate.joined(z[:, :2*n], first + tau*change, p)

        seen, total = [z], np.zeros_like(z)
        slopes = np.empty((len(_C), *z.shape))
        slopes[0] = rate(0.0, z)
        for step in range(steps):
            for i in range(1, len(_C)):
                end = z + h*_sum(_A[i], slopes)
                slopes[i] = rate((step + _C[i])/steps, end)
            total += np.abs(h*_sum(DORMAND_PRINCE.error, slopes))
            if steps < PARTS:
                half = end - z
                bend = h*slopes[0] - half
                seen.append(z + (half + (bend + (half - h*slopes[-1] - bend + h*_sum(
                    DORMAND_PRINCE.middle, slopes)/2)/2)/2)/2)
            # The last row of the pair is its step; its slope is the first of the next step.
            z, slopes[0] = end, slopes[-1]
            if (step + 1) % max(steps // PARTS, 1) == 0:
                seen.append(z)
        return np.stack(seen, axis=1), total


def _inputs(intervals: Intervals) -> tuple[Array, Array]:
    """Return (u, s, m) at the start and at the end of each interval."""
    return (np.hstack([intervals.ua, intervals.sa, intervals.ma]),
            np.hstack([intervals.ub, intervals.sb, intervals.mb]))


def _cubic(tau: float, h: Array, x: Array, f: Array) -> Array:
    """Return the cubic Hermite interpolant at the fraction tau of a step."""
    return np.asarray(x[0] + tau * (h*f[0] + tau * (
        3*(x[1] - x[0]) - h*(2*f[0] + f[1]) + tau*(2*(x[0] - x[1]) + h*(f[0] + f[1])))))


def _sum(weights: tuple[float, ...], slopes: Array) -> Array:
    """Return the weighted sum of the first slopes, shape (., K, length)."""
    count = len(weights)
    return np.asarray(np.dot(weights, slopes[:count].reshape(count, -1))).reshape(slopes.shape[1:])
