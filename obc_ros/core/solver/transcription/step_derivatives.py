# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
First and second derivatives of a Runge-Kutta step, for many intervals at once.

Let y = (x, ua, ub), with h added if it is unknown. Stage i is evaluated at z_i = (X_i, U_i, h) and
gives K_i = h (f, L) and J_i = dK_i/dz_i. The chain rule gives dK_i/dy = J_i Z_i with
Z_i = dz_i/dy, forward from stage to stage. Backward, the weights w_i of K_i in w' (end, cost)
follow from those of the later stages. The second derivative of w' (end, cost) is

    sum over i of Z_i' (second derivative of w_i' K_i by z_i) Z_i.

Differentiation of the whole step by CasADi gives the same and takes half the time to build, but
has twice as many operations, since it passes through all stages once for each direction. Here the
stages are evaluated column by column.
"""

from collections.abc import Sequence
from itertools import pairwise

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.column_functions import ByColumn, Columns
from obc_ros.core.numerics.runge_kutta import BUTCHER
from obc_ros.core.ocp.problem import Problem

_PAID = 3000, 20_000   # thresholds of ByColumn in rows; functions with calls take long to build
Symbols = tuple[ca.SX, ...]


class StepDerivatives:
    """
    Rows g and the cost of an interval by one step, scaled, and their derivatives.

    Parameters
    ----------
    problem : Problem
    given : sequence of casadi.SX
        Local variables v, constants of an interval and constants of all.
    scaled : sequence of casadi.SX
        x at the start, u at both ends and x at the end of the interval, divided by their sizes.
    sizes : sequence of casadi.SX
        Of x (n,), of u (m,) and of the cost.
    h, dh : casadi.SX
        Length of the step, and its derivative by the unknown before the last x, if it has one.

    Attributes
    ----------
    slope, J, H : casadi.SX
        Expressions with the sparsity of the gradient of the cost, of the Jacobian of g and of the
        Hessian of factor cost + lam' g, with respect to v.
    outputs : list of slice
        Places in a row of results of g, the cost, its gradient, the gradient of
        factor cost + lam' g, and the entries of J and H.

    """

    def __init__(self, problem: Problem, given: Symbols, scaled: Symbols, sizes: Symbols,
                 h: ca.SX, dh: ca.SX) -> None:
        n, m = problem.n, problem.m
        self._problem, self._size = problem, n + 2 * m + int(dh.numel())
        self._given = [int(part.numel()) for part in given]
        v, own, shared = given
        factor, lam = ca.SX.sym('factor'), ca.SX.sym('lam', n)
        local = ca.vertcat(v, own, factor, lam)
        self._stages(bool(dh.numel()))
        xa, ua, ub, xb = scaled
        sx, su, sj = sizes
        rows = 1 / ca.vertcat(-sx, sj)   # those of g are xb - end / sx
        # Derivatives are by scaled unknowns.
        start = ca.vertcat(ca.horzcat(sx * xa, ca.diag(sx), ca.SX(n, self._size - n)),
                           ca.SX(1, 1 + self._size))
        self._begin = Columns(ca.Function('begin', [local, shared], [
            ca.project(start, self._pattern).nz[:], su * ua, su * ub, ca.vertcat(h, dh),
            rows * ca.vertcat(lam, factor), su]), shared=(1,))
        E, U = (ca.SX.sym(name, pattern.nnz()) for name, pattern in (
            ('E', self._pattern), ('U', self._upper)))
        end = ca.SX(self._pattern, E)
        D = ca.mtimes(ca.diag(rows), ca.sparsify(end[:, 1:]))
        H = ca.sparsify(ca.SX(self._upper, U))
        self.slope = ca.sparsify(ca.vertcat(D[n, :].T, ca.SX(n, 1)))
        self.J = ca.sparsify(ca.horzcat(D[:n, :], ca.SX.eye(n)))
        self.H = ca.sparsify(ca.diagcat(ca.triu2symm(H), ca.SX(n, n)))
        both = ca.densify(factor * self.slope + ca.mtimes(self.J.T, lam))
        # The entries of a single row are one, too.
        found = [xb + rows[:n] * end[:n, 0], end[n, 0] / sj, self.slope.nz[:], both,
                 ca.vec(self.J.nz[:]), ca.vec(self.H.nz[:])]
        self._finish = Columns(ca.Function(
            'finish', [local, E, U, shared], [ca.densify(ca.vertcat(*found))]), shared=(3,))
        ends = np.append(0, np.cumsum([part.numel() for part in found])).tolist()
        self.outputs = [slice(a, b) for a, b in pairwise(ends)]
        self._by_column = ByColumn(self._whole, sum(self._given) + 1 + n, ends[-1], _PAID)

    def of_joined(self, w: Array, result: Array) -> None:
        """Compute the results, in place, for rows w of v, both constants, factor and lam."""
        self._by_column([w], result)

    def _stages(self, free: bool) -> None:
        """Build the functions of a stage, forward and backward."""
        problem, n, m = self._problem, self._problem.n, self._problem.m
        c, h = ca.SX.sym('c'), ca.SX.sym('h')
        z = ca.vertcat(problem.x, problem.u, h) if free else ca.vertcat(problem.x, problem.u)
        K = h * ca.vertcat(problem.f, problem.L)
        J = ca.jacobian(K, z, {'helper_options': {'ad_weight': 1.0}})
        curved = ca.jacobian(J.nz[:], z)
        # Common subexpressions, such as sines, are evaluated once.
        K, *entries = ca.cse([K, J.nz[:], curved.nz[:]])
        at = ca.Function('at', [problem.x, problem.u, h, problem.p], [K, *entries])
        self._pattern = self._reached(J, m, free)
        M = ca.SX(self._pattern, ca.SX.sym('M', self._pattern.nnz()))
        ua, ub, su = ca.SX.sym('ua', m), ca.SX.sym('ub', m), ca.SX.sym('su', m)
        lengths = ca.vertcat(h, ca.SX.sym('dh', int(free)))
        shared = ca.vertcat(c, su, problem.p)
        Z = self._moved(M, c, su, lengths[1:])
        K, j, t = at.call([M[:n, 0], ua + c * (ub - ua), h, problem.p])
        both = ca.horzcat(K, ca.mtimes(ca.SX(J.sparsity(), j), Z))
        self._forward = Columns(ca.Function(
            'forward', [M.nz[:], ua, ub, lengths, shared],
            [ca.project(both, self._pattern).nz[:], j, t]), shared=(4,))
        w, j, t = (ca.SX.sym(name, size) for name, size in (
            ('w', n + 1), ('j', j.numel()), ('t', t.numel())))
        rows, columns = J.sparsity().get_triplet()
        weights = ca.SX(ca.Sparsity.triplet(
            z.numel(), len(rows), columns, list(range(len(rows)))), w[rows])
        inner = ca.mtimes(weights, ca.SX(curved.sparsity(), t))
        part = ca.triu(ca.mtimes(Z.T, ca.mtimes(inner, Z)))
        self._upper = part.sparsity()
        back = ca.mtimes(ca.SX(J.sparsity(), j).T, w)[:n]
        self._backward = Columns(ca.Function('backward', [w, M.nz[:], j, t, lengths, shared], [
            ca.densify(ca.vertcat(back, 0)), part.nz[:]]), shared=(5,))
        self._entries = j.numel(), t.numel()

    def _reached(self, J: ca.SX, m: int, free: bool) -> ca.Sparsity:
        """Return the sparsity of (x, dx/dy) and (K, dK/dy) of a stage."""
        n, size = self._problem.n, self._size
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

    def _moved(self, M: ca.SX, c: ca.SX, su: ca.SX, dh: ca.SX) -> ca.SX:
        """Return dz/dy of a stage at the part c of the step, y scaled."""
        n, m, rest = self._problem.n, su.numel(), dh.numel()
        u = ca.horzcat(ca.SX(m, n), ca.diag(su - c * su), ca.diag(c * su), ca.SX(m, rest))
        h = ca.horzcat(ca.SX(rest, n + 2 * m), ca.diag(dh))
        return ca.vertcat(M[:n, 1:], u, h)

    def _whole(self, rows: int) -> ca.Function:
        """Return the function to all results for a number of rows."""
        n, m = self._problem.n, self._problem.m
        nv, own, shared = self._given
        given = ca.MX.sym('given', rows, nv + own + shared + 1 + n)
        constants = given[0, nv + own:nv + own + shared].T
        local = ca.horzcat(given[:, :nv + own], given[:, nv + own + shared:])
        start, ua, ub, lengths, weights, su = self._begin(rows, local, constants)
        p, su, reached = constants[:self._problem.p.numel()], su[0, :].T, self._pattern.nnz()
        common = lengths.size2(), 1 + m + p.numel()
        forward = self._forward.function(rows, [reached, m, m, *common])
        backward = self._backward.function(rows, [n + 1, reached, *self._entries, *common])
        slopes, seen = list[ca.MX](), list[tuple[ca.MX, ...]]()
        for row, c in zip(BUTCHER.A, BUTCHER.c, strict=True):
            M = _sum(row, slopes, start)
            alike = ca.vertcat(c, su, p)
            slope, j, t = forward(M, ua, ub, lengths, alike)
            slopes.append(slope)
            seen.append((M, j, t, lengths, alike))
        terms, upper = [weights], list[ca.MX]()
        for i in reversed(range(len(BUTCHER.b))):
            later = (BUTCHER.b[i], *(row[i] for row in reversed(BUTCHER.A[i + 1:])))
            back, part = backward(_sum(later, terms), *seen[i])
            terms.append(back)
            upper.append(part)
        found, = self._finish(rows, local, _sum(BUTCHER.b, slopes, start),
                              _sum((1.0,) * len(upper), upper), constants)
        return ca.Function('whole', [given], [found])


def _sum(weights: Sequence[float], terms: Sequence[ca.MX], start: ca.MX | None = None) -> ca.MX:
    """Return a sum by weight."""
    total = start
    for a, term in zip(weights, terms, strict=True):
        if a:
            # The operators of Python spend more time on conversion than this call takes.
            part = term if a == 1.0 else ca.MX.binary(ca.OP_MUL, ca.MX(a), term)
            total = part if total is None else ca.MX.binary(ca.OP_ADD, total, part)
    assert total is not None
    return total
