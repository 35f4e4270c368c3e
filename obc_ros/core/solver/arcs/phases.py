# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A path on phases, in each of which is known what holds."""

from dataclasses import dataclass

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.solver.arcs.input_arcs import Arc

Grazing = frozenset[tuple[int, int]]

DEGREE = 4   # of the polynomials of x in an interval; one less of those of u
OUTWARDS = 1e-4   # relative, where a path leaves a bound: it exceeds it by the square


@dataclass(frozen=True, eq=False)
class Phased:
    """
    A path on phases, K intervals of DEGREE points each.

    Attributes
    ----------
    arcs : list of Arc
        What holds in each phase.
    meshes : list of ndarray
        Lengths of the intervals of each phase, as parts of it.
    durations : ndarray
        Length of each phase [s].
    x, lam : ndarray, shape (K, DEGREE + 1, n)
        At the start and at the points of each interval; lam as without the bounds held.
    u : ndarray, shape (K, DEGREE, m)
    eta : ndarray, shape (K, DEGREE, n + l)
        Multipliers of what holds in a phase, or of the path constraints.
    nu : ndarray, shape (q,)
    outwards : dict of (int, int) to float
        By numbers of phases and rows, the derivative that inputs enter on the other side of the
        junction at which this phase begins (phase) or ends (-1 - phase), relative; inwards < 0.
        Of constraints on inputs, the rest of them with the inputs at their bounds there.
    pushed : ndarray, shape (K, DEGREE, n + l)
        What bounds of (x, c) that are not held weigh at points, beside the costates.
    astray : list of (int, int)
        Numbers of phases and rows whose bound, touched where the phase begins, pulls.

    """

    arcs: list[Arc]
    meshes: list[Array]
    durations: Array
    x: Array
    u: Array
    lam: Array
    eta: Array
    nu: Array
    cost: float
    converged: bool
    outwards: dict[tuple[int, int], float]
    pushed: Array
    astray: list[tuple[int, int]]

    def grazing(self, within: float = OUTWARDS, *, touched: bool = False) -> Grazing:
        """
        Return where derivatives vanish on the other side of junctions, too, or nearly do.

        `touched`: also where a bound is touched, which a path may do without.
        """
        met = [arc.met or (0,) * self.eta.shape[2] for arc in self.arcs]
        return frozenset(
            (place, row) for (place, row), rate in self.outwards.items()
            if rate > -within and (touched or place < 0 or not met[place][row]))

    @property
    def phase_of(self) -> Index:
        """Return the phase of each interval."""
        return np.repeat(np.arange(len(self.meshes)), [len(mesh) for mesh in self.meshes])

    @property
    def h(self) -> Array:
        """Return the length of each interval [s]."""
        return self.durations[self.phase_of] * np.concatenate(self.meshes)
