# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The solution of Pontryagin's boundary value problem, with its interpolation in time."""

from dataclasses import dataclass

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, Mask
from obc_ros.core.solver.arcs.input_arcs import Arc


@dataclass(frozen=True, eq=False)
class BoundaryValues:
    """
    A solution of the boundary value problem.

    :ivar arc_of, h: (N,), arc of each interval, and its length [s].
    :ivar lengths: (arcs,), lengths of the arcs [s].
    :ivar levels: (arcs, m), bounds that inputs are at; nan where they are free.
    :ivar z, dz, ddz: (N, 2, 2n), (x, lam) at the start and at the end of each interval, and its
        time derivatives.
    :ivar u, du: (N, 2, m), inputs and their time derivatives there.
    :ivar by_u: (N, 2, 2n, m), derivative of dz/dt with respect to u.
    :ivar nu: (q,), multipliers of the terminal constraints.
    :ivar cost, residual: J, and the norm of the residuals of the scaled equations.
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
    def free(self) -> Mask:
        """Return which inputs are not at a bound in each interval, shape (N, m)."""
        return np.isnan(self.levels)[self.arc_of]

    @property
    def arcs(self) -> list[Arc]:
        """Return the arcs of the inputs."""
        ends = np.cumsum(self.lengths)
        return [Arc(end - length, end, tuple(row)) for end, length, row in zip(
            ends, self.lengths, self.levels, strict=True)]

    @property
    def intervals(self) -> tuple[Array, Index]:
        """Return the length of each interval as a part of its arc, and its arc."""
        return self.h / self.lengths[self.arc_of], self.arc_of

    def where(self, t: Array, arc: Index) -> tuple[Index, Array]:
        """Return the intervals k (K,) of times t (K,) [s] in their arcs, and places in them."""
        starts = np.append(0.0, np.cumsum(self.h))
        first, last = (np.searchsorted(self.arc_of, arc, side) for side in ('left', 'right'))
        k = np.clip(np.searchsorted(starts, t, 'right') - 1, first, last - 1)
        return k, (t - starts[k]) / self.h[k]

    def at(self, k: Index, part: Array) -> tuple[Array, Array]:
        """
        Interpolate the solution at what `where` returns.

        By polynomials of degree 5 for z = (x, lam), (K, 2n), and of degree 3 for u, (K, m).
        """
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
        """Return the second time derivative of u, (K, m), with arguments as for `at`."""
        h, mean = self.h[k][:, None], np.diff(self.u, axis=1)[k, 0] / self.h[k][:, None]
        a, b = self.du[k, 0], self.du[k, 1]
        return np.asarray((6 * mean - 4 * a - 2 * b + 6 * part[:, None] * (a + b - 2 * mean)) / h)


def cut_evenly(parts: Array, arc_of: Index, lengths: Array) -> tuple[Array, Index]:
    """
    Cut arcs into new intervals with equal shares of a density.

    :param parts: (N,), number of new intervals that each interval requires, not whole.
    :param arc_of: (N,), arc of each interval.
    :param lengths: (N,), lengths of the intervals, in which the density is constant.
    :return: points: (K + 1,), start of the first new interval, 0, and the end of each; arc_of:
        (K,), their arcs, each with at least one.
    """
    total = np.append(0.0, np.cumsum(parts))
    ends = total[np.append(0, np.flatnonzero(np.diff(arc_of, append=-1)) + 1)]
    spans = np.diff(ends)
    counts: Index = np.maximum(np.ceil(spans), 1).astype(np.int64)
    of = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(1, len(of) + 1) - np.repeat(np.cumsum(counts) - counts, counts)
    inner = np.append(ends[0], ends[of] + spans[of] * (number / counts[of]))
    return np.interp(inner, total, np.append(0.0, np.cumsum(lengths))), of
