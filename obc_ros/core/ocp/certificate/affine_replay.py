# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Replay of an interval by matrix exponentials, for affine f and quadratic L.

With w = (u, s, m) linear in time and y = (x, w, dw/dt, 1)

    dy/dt = Y y,   dlam/dt = -A'lam - C y,   dJ/dt = y'D y / 2,

and over a time h

    y(h) = E y(0),   lam(0) = F'lam(h) + S y(0),   lam(h) = G lam(0) - R y(0),
    J(h) = y(0)'W y(0) / 2

where F is the block of E that belongs to x. The matrices of the time 2 h follow from those of h,
so that the work for an interval hardly depends on its stiffness. The solver's mesh and method are
not used.
"""

from collections import defaultdict
from dataclasses import dataclass
import math

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array, linalg
from obc_ros.core.numerics.instructions import has_jumps
from obc_ros.core.ocp.problem import Problem

_SAME = 1e-9    # relative difference of interval lengths that are treated as equal
_SHORT = 0.5    # norm of the rates times the time for which the exponential is computed


@dataclass(frozen=True, eq=False)
class IntervalFlow:
    """The matrices at the head of this file for one time h."""

    E: Array
    S: Array
    G: Array
    R: Array
    W: Array

    def doubled(self) -> 'IntervalFlow':
        """Return the matrices of twice the time."""
        E, G = self.E, self.G
        F = E[:len(G), :len(G)]
        return IntervalFlow(E @ E, self.S + F.T @ self.S @ E, G @ G, G @ self.R + self.R @ E,
                            self.W + E.T @ self.W @ E)


@dataclass(frozen=True, eq=False)
class Rates:
    """
    Y (d, d), C (n, d), D (d, d) above, for w of length k: d = n + 2 k + 1.

    They are in units: `x`, `lam` (n,), `w` (k,), `slope` [1/s] of w.
    """

    Y: Array
    C: Array
    D: Array
    x: Array
    lam: Array
    w: Array
    slope: float

    def flow(self, h: float) -> IntervalFlow:
        """Return the matrices of a time h [s], short relative to the fastest rate."""
        n, d = self.C.shape
        back = linalg.expm(
            h * np.block([[-self.Y[:n, :n].T, -self.C], [np.zeros((d, n)), self.Y]]))
        cost = linalg.expm(h * np.block([[-self.Y.T, self.D], [np.zeros((d, d)), self.Y]]))
        E, G, R = back[n:, n:], back[:n, :n], -back[:n, n:]
        return IntervalFlow(E, E[:n, :n].T @ R, G, R, E.T @ cost[:d, d:])


class AffineReplay:
    """The matrices of a problem's structure, for any values of its numbers."""

    def __init__(self, problem: Problem) -> None:
        n = problem.n
        lam, s = ca.SX.sym('lam', n), ca.SX.sym('s', n)
        m = ca.SX.sym('m', problem.path.numel())
        z = ca.vertcat(problem.x, problem.u, s, m)
        H = problem.L + ca.dot(lam, problem.f) + ca.dot(m, problem.path)
        rate = ca.vertcat(problem.f, -ca.gradient(H, problem.x) - s)
        both = ca.vertcat(z, lam)
        slopes = ca.jacobian(rate, both)
        curvature, slope = ca.hessian(problem.L, z)
        self._read: ca.Function | None = None
        if not (ca.depends_on(ca.veccat(slopes, curvature), both) or has_jumps(rate, both)):
            self._read = ca.Function('read', [both, problem.p], [
                ca.densify(part) for part in (slopes, rate, curvature, slope, problem.L)])

    def rates(self, p: Array, scale: Array, w: Array, h: Array) -> Rates | None:
        """Return the matrices for parameters p, scales of x and lengths h; None if not affine."""
        if self._read is None:
            return None
        slopes, rate, curvature, slope, cost = (
            part.full() for part in self._read(np.zeros(self._read.numel_in(0)), p))
        n, k = len(scale), w.shape[1]
        size = np.abs(w).max(axis=0, initial=0.0)
        size[size == 0.0] = 1.0
        pace = 1.0 / float(h.max())
        d, state, one = n + 2*k + 1, np.append(scale, size), n + 2*k
        Y, C, D = np.zeros((d, d)), np.zeros((n, d)), np.zeros((d, d))
        Y[:n, :n + k] = slopes[:n, :n + k] * (state / scale[:, None])
        Y[:n, one] = rate[:n, 0] / scale
        Y[n:n + k, n + k:one] = pace * np.eye(k)
        C[:, :n + k] = -slopes[n:, :n + k] * (state * scale[:, None])
        C[:, one] = -rate[n:, 0] * scale
        D[:n + k, :n + k] = curvature * (state * state[:, None])
        D[:n + k, one] = D[one, :n + k] = slope[:, 0] * state
        D[one, one] = 2.0 * cost[0, 0]
        found = Rates(Y, C, D, scale, 1.0 / scale, size, pace)
        return found if all(np.isfinite(part).all() for part in (Y, C, D)) else None


def replay_affine(rates: Rates, h: Array, x: Array, w: tuple[Array, Array], lam: Array, parts: int,
                  back: bool) -> Array:
    """
    Return (x, lam, J) at equal parts of K intervals, shape (K, parts + 1, 2 n + 1).

    :param x, w: (K, n), pair of (K, k), the states at the start; w at the start and at the end.
    :param lam: (K, n), the costates at the end if `back`, else at the start.
    :param parts: number of equal parts.
    """
    K, n = x.shape
    slope = (w[1] - w[0]) / h[:, None] / (rates.w * rates.slope)
    y = np.hstack([x / rates.x, w[0] / rates.w, slope, np.ones((K, 1))])
    found = np.zeros((K, parts + 1, 2*n + 1))
    for rows, flow in _grouped(rates, h / parts):
        at = [y[rows]]
        for _ in range(parts):
            at.append(at[-1] @ flow.E.T)
        cost = sum(0.5 * np.einsum('ki,ki->k', each @ flow.W, each) for each in at[:-1])
        now, F = lam[rows] / rates.lam, flow.E[:n, :n]
        course = [now]
        for j in range(parts):
            now = (now @ F + at[parts - 1 - j] @ flow.S.T if back else
                   now @ flow.G.T - at[j] @ flow.R.T)
            course.append(now)
        found[rows, :, :n] = np.stack(at, axis=1)[:, :, :n] * rates.x
        found[rows, :, n:2*n] = np.stack(course[::-1] if back else course, axis=1) * rates.lam
        found[rows, -1, -1] = cost
    return found


def _grouped(rates: Rates, h: Array) -> list[tuple[NDArray[np.intp], IntervalFlow]]:
    """Return the indices of the intervals of each length, and its matrices."""
    shortest: dict[float, dict[int, list[int]]] = defaultdict(lambda: defaultdict(list))
    known = np.zeros(0)
    for k in np.argsort(np.frexp(h)[0]).tolist():
        mantissa, exponent = math.frexp(h[k])
        if not known.size or mantissa > known[-1] * (1 + _SAME):
            known = np.append(known, mantissa)
        shortest[float(known[-1])][exponent].append(k)
    found, speed = [], float(np.linalg.norm(rates.Y))
    for mantissa, exponents in shortest.items():
        least = math.floor(math.log2(_SHORT / max(speed * mantissa, 1e-300)))
        at = min(least, *exponents)
        flow = rates.flow(math.ldexp(mantissa, at))
        while exponents:
            if at in exponents:
                found.append((np.array(exponents.pop(at)), flow))
            flow, at = flow.doubled() if exponents else flow, at + 1
    return found
