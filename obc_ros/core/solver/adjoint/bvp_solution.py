# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The solution of Pontryagin's boundary value problem, and how its time is cut."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.solver.arcs.input_arcs import Arc


@dataclass(frozen=True, eq=False)
class BoundaryValues:
    """
    A solution of the boundary value problem.

    Attributes
    ----------
    arc_of, h : ndarray, shape (N,)
        The arc of each interval, and its length.
    lengths : ndarray
        Of the arcs.
    levels : ndarray, shape (arcs, m)
        The bounds that inputs are at, nan where they are free.
    z, dz, ddz : ndarray, shape (N, 2, 2n)
        (x, lam) at the start and at the end of each interval, and its derivatives.
    u, du : ndarray, shape (N, 2, m)
    by_u : ndarray, shape (N, 2, 2n, m)
        Derivative of dz/dt by u.
    nu : ndarray, shape (q,)
    cost, residual : float
        J, and the norm of what is left of the scaled equations.

    """

    arc_of: Index
    h: Array
    lengths: Array
    levels: Array
    z: Array
    dz: Array
    ddz: Array
    u: Array
    du: Array
    by_u: Array
    nu: Array
    cost: float
    residual: float

    @property
    def free(self) -> NDArray[np.bool_]:
        """Return whether an input is not at a bound, shape (N, m)."""
        return np.isnan(self.levels)[self.arc_of]

    @property
    def arcs(self) -> list[Arc]:
        """Return the arcs."""
        ends = np.cumsum(self.lengths)
        return [Arc(end - length, end, tuple(row)) for end, length, row in zip(
            ends, self.lengths, self.levels, strict=True)]

    @property
    def intervals(self) -> tuple[Array, Index]:
        """Return the length of each interval as a part of its arc, and its arc."""
        return self.h / self.lengths[self.arc_of], self.arc_of

    def where(self, t: Array, arc: Index) -> tuple[Index, Array]:
        """Return the intervals that times in given arcs lie in, and at which parts of them."""
        starts = np.append(0.0, np.cumsum(self.h))
        first, last = (np.searchsorted(self.arc_of, arc, side) for side in ('left', 'right'))
        k = np.clip(np.searchsorted(starts, t, 'right') - 1, first, last - 1)
        return k, (t - starts[k]) / self.h[k]

    def at(self, k: Index, part: Array) -> tuple[Array, Array]:
        """Return (x, lam) and u in the intervals `k` at parts of their lengths."""
        s, h = part[:, None], self.h[k][:, None]
        a, b, da, db = self.z[k, 0], self.z[k, 1], h * self.dz[k, 0], h * self.dz[k, 1]
        bend, other = 0.5 * h**2 * self.ddz[k, 0], 0.5 * h**2 * self.ddz[k, 1]
        # The polynomial of degree 5 with these values, slopes and curvatures at both ends.
        p, q, r = b - a - da - bend, db - da - 2 * bend, other - bend
        z = a + s * (da + s * (bend + s * (
            10 * p - 4 * q + r + s * (-15 * p + 7 * q - 2 * r + s * (6 * p - 3 * q + r)))))
        v, dv, dw = self.u[k, 0], h * self.du[k, 0], h * self.du[k, 1]
        change = self.u[k, 1] - v
        return z, v + s * (dv + s * (3 * change - 2 * dv - dw + s * (dv + dw - 2 * change)))

    def bend(self, k: Index, part: Array) -> Array:
        """Return the second derivative of u, likewise."""
        h, mean = self.h[k][:, None], np.diff(self.u, axis=1)[k, 0] / self.h[k][:, None]
        a, b = self.du[k, 0], self.du[k, 1]
        return np.asarray((6 * mean - 4 * a - 2 * b + 6 * part[:, None] * (a + b - 2 * mean)) / h)


def cut_evenly(ends: Array, counts: Array) -> tuple[Index, Array]:
    """Return which span each part of spans lies in, and where all parts end, 0 before them."""
    parts: Index = np.maximum(counts, 1).astype(np.int64)
    of = np.repeat(np.arange(len(parts)), parts)
    number = np.arange(1, len(of) + 1) - np.repeat(np.cumsum(parts) - parts, parts)
    return of, np.append(ends[0], ends[of] + np.diff(ends)[of] * (number / parts[of]))
