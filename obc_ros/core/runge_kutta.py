# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
One explicit Runge-Kutta step of order 6, under an input linear over the step, and its derivatives.

With y = (x, ua, ub) and, where it is unknown, h, stage i is at z_i = (X_i, U_i, h), and there are
K_i = h (f, L) and J_i = dK_i/dz_i. By the chain rule dK_i/dy = J_i Z_i with Z_i = dz_i/dy forward
from stage to stage; backward the weights w_i of K_i in w' (end, cost) follow from those of the
stages after it, and the second derivative of w' (end, cost) is

    sum over i of Z_i' (second derivative of w_i' K_i by z_i) Z_i.

Differentiating the whole step by CasADi gives the same, built in half the time, but for twice as
many operations: it goes through all stages once for each direction.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np
from obc_ros.core.problem import Problem

# Returns f and L at x and u.
Rate = Callable[[ca.SX, ca.SX], tuple[ca.SX, ca.SX]]

# J. C. Butcher, On Runge-Kutta processes of high order, J. Austral. Math. Soc. 4 (1964).
_C = (0.0, 1 / 3, 2 / 3, 1 / 3, 1 / 2, 1 / 2, 1.0)
_A: tuple[tuple[float, ...], ...] = (
    (), (1 / 3,), (0.0, 2 / 3), (1 / 12, 1 / 3, -1 / 12),
    (-1 / 16, 9 / 8, -3 / 16, -3 / 8), (0.0, 9 / 8, -3 / 8, -3 / 4, 1 / 2),
    (9 / 44, -9 / 11, 63 / 44, 18 / 11, 0.0, -16 / 11))
_B = (11 / 120, 0.0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120)


def rate_of(problem: Problem) -> Rate:
    """Return f and L of a problem as a function of x and u."""
    function = ca.Function('rate', [problem.x, problem.u, problem.p], [problem.f, problem.L])

    def rate(x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        f, L = function.call([x, u, problem.p])
        return f, L

    return rate


def step(rate: Rate, x: ca.SX, inputs: tuple[ca.SX, ca.SX], h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """
    Return x after a step of length h and the integral of L over it.

    Parameters
    ----------
    rate : callable
        Returns f and L.
    x : casadi.SX
        State at the start.
    inputs : pair of casadi.SX
        Input at the start and at the end.
    h : casadi.SX
        Length of the step.

    """
    start, slopes = ca.vertcat(x, 0), list[ca.SX]()
    for row, u in zip(_A, _called(_along(inputs[0].numel()), *inputs), strict=True):
        inner = _called(_after(row, start.numel()), start, h, *slopes)[0] if row else start
        slopes.append(ca.vertcat(*rate(inner[:-1], u)))
    end, = _called(_after(_B, start.numel()), start, h, *slopes)
    return end[:-1], end[-1]


def _called(function: ca.Function, *arguments: ca.SX) -> Sequence[ca.SX]:
    return function.call(arguments)


# Calling a function that is there costs less than each operation that it is made of.
@lru_cache(maxsize=64)
def _along(m: int) -> ca.Function:
    """Return the inputs at the stages, of those at both ends."""
    a, b = ca.SX.sym('a', m), ca.SX.sym('b', m)
    change, between = b - a, {0.0: a, 1.0: b}
    between |= {c: a + c * change for c in _C if c not in between}
    return ca.Function('along', [a, b], [between[c] for c in _C])


@lru_cache(maxsize=256)
def _after(weights: tuple[float, ...], n: int) -> ca.Function:
    """Return start + h times the slopes by weight, of start, h and all slopes, each (n,)."""
    start, h = ca.SX.sym('start', n), ca.SX.sym('h')
    slopes = [ca.SX.sym('slope', n) for _ in weights]
    total = sum((a * slope for a, slope in zip(weights, slopes, strict=True) if a), ca.SX(0))
    return ca.Function('after', [start, h, *slopes], [start + h * total])


@lru_cache(maxsize=4)
def step_of(problem: Problem) -> ca.Function:
    """Return x after a step and the integral of L, of x, both inputs, h and p; made once."""
    ua, ub = ca.SX.sym('ua', problem.m), ca.SX.sym('ub', problem.m)
    h = ca.SX.sym('h')
    return ca.Function('step', [problem.x, ua, ub, h, problem.p],
                       [*step(rate_of(problem), problem.x, (ua, ub), h)])


class StepDerivatives:
    """First and second derivatives of a step of a problem; by h too if it is `free`."""

    def __init__(self, problem: Problem, free: bool) -> None:
        n, m = problem.n, problem.m
        self._n, self._size = n, n + 2 * m + free
        c, h = ca.SX.sym('c'), ca.SX.sym('h')
        z = ca.vertcat(problem.x, problem.u, h) if free else ca.vertcat(problem.x, problem.u)
        K = h * ca.vertcat(problem.f, problem.L)
        J = ca.jacobian(K, z, {'helper_options': {'ad_weight': 1.0}})
        curved = ca.jacobian(J.nz[:], z)
        # They share sines and cosines.
        K, *entries = ca.cse([K, J.nz[:], curved.nz[:]])
        at = ca.Function('at', [problem.x, problem.u, h, problem.p], [K, *entries])
        self._pattern = self._reached(J, m, free)
        M = ca.SX(self._pattern, ca.SX.sym('M', self._pattern.nnz()))
        Z = self._moved(M, c, m)
        ua, ub = ca.SX.sym('ua', m), ca.SX.sym('ub', m)
        K, j, t = at.call([M[:n, 0], ua + c * (ub - ua), h, problem.p])
        both = ca.horzcat(K, ca.mtimes(ca.SX(J.sparsity(), j), Z))
        self._forward = ca.Function('forward', [M.nz[:], ua, ub, c, h, problem.p], [
            ca.project(both, self._pattern).nz[:], j, t])
        w, j, t = (ca.SX.sym(name, size) for name, size in (
            ('w', n + 1), ('j', j.numel()), ('t', t.numel())))
        rows, columns = J.sparsity().get_triplet()
        weights = ca.SX(ca.Sparsity.triplet(
            z.numel(), len(rows), columns, list(range(len(rows)))), w[rows])
        inner = ca.mtimes(weights, ca.SX(curved.sparsity(), t))
        part = ca.triu(ca.mtimes(Z.T, ca.mtimes(inner, Z)))
        self._upper = part.sparsity()
        back = ca.mtimes(ca.SX(J.sparsity(), j).T, w)[:n]
        self._backward = ca.Function('backward', [w, M.nz[:], c, j, t], [
            ca.vertcat(back, 0), part.nz[:]])

    def _reached(self, J: ca.SX, m: int, free: bool) -> ca.Sparsity:
        """Return which entries (x, dx/dy) and (K, dK/dy) of a stage may have."""
        n, size = self._n, self._size
        slope, Z = np.zeros(J.shape, dtype=int), np.zeros((n + m + free, size), dtype=int)
        slope[J.sparsity().get_triplet()] = 1
        Z[:n, :n], Z[n + m:, n + 2 * m:] = np.eye(n), 1
        Z[n:n + m, n:n + m] = Z[n:n + m, n + m:n + 2 * m] = np.eye(m)
        rows = slope @ Z > 0
        while np.any(rows[:n] > Z[:n]):
            Z[:n] |= rows[:n]
            rows = slope @ Z > 0
        whole = np.ones((n + 1, 1 + size))
        whole[:n, 1:], whole[n, 1:] = Z[:n], rows[n]
        return ca.sparsify(ca.DM(whole)).sparsity()

    def _moved(self, M: ca.SX, c: ca.SX, m: int) -> ca.SX:
        """Return dz/dy of a stage at the part c of the step."""
        n, eye, rest = self._n, ca.SX.eye(m), self._size - self._n - 2 * m
        u = ca.horzcat(ca.SX(m, n), (1 - c) * eye, c * eye, ca.SX(m, rest))
        h = ca.horzcat(ca.SX(rest, n + 2 * m), ca.SX.eye(rest))
        return ca.vertcat(M[:n, 1:], u, h)

    def __call__(self, x: ca.SX, inputs: tuple[ca.SX, ca.SX], h: ca.SX, p: ca.SX, weights: ca.SX
                 ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """
        Return x after the step and its cost, (n + 1,), and their derivatives by y.

        The first is of shape (n + 1, size of y); the second, of the sum by weights (n + 1,), the
        upper triangle.
        """
        n, size, one = self._n, self._size, ca.SX(1)
        first = ca.vertcat(ca.horzcat(x, ca.SX.eye(size)[:n, :]), ca.SX(1, 1 + size))
        start = ca.project(first, self._pattern).nz[:]
        slopes, seen = list[ca.SX](), list[tuple[ca.SX, ...]]()
        for row, c in zip(_A, _C, strict=True):
            M = _called(_after(row, start.numel()), start, one, *slopes)[0] if row else start
            slope, *entries = self._forward.call([M, *inputs, ca.SX(c), h, p])
            slopes.append(slope)
            seen.append((M, ca.SX(c), *entries))
        end, = _called(_after(_B, start.numel()), start, one, *slopes)
        terms, none, parts = [weights], ca.SX.zeros(n + 1), list[ca.SX]()
        for i in reversed(range(len(_B))):
            later = (_B[i], *(row[i] for row in reversed(_A[i + 1:])))
            w, = _called(_after(later, n + 1), none, one, *terms)
            back, part = self._backward.call([w, *seen[i]])
            terms.append(back)
            parts.append(part)
        none = ca.SX.zeros(parts[0].numel())
        upper, = _called(_after((1.0,) * len(parts), none.numel()), none, one, *parts)
        found = ca.SX(self._pattern, end)
        return found[:, 0], ca.sparsify(found[:, 1:]), ca.sparsify(ca.SX(self._upper, upper))
