# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A path on phases with known active constraints, as the phase program returns it."""

from dataclasses import dataclass

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.solver.arcs.input_arcs import Arc

Grazing = frozenset[tuple[int, int]]

DEGREE = 4   # degree of the polynomials of x in an interval; that of u is DEGREE - 1
# Relative rate at which a path may cross its bound at a junction. The violation of the bound is
# of the order of its square.
OUTWARDS = 1e-4


def drop_negligible(density: Array, rate: float, slopes: Array, u: Array) -> Array:
    """
    Return densities of path constraints without those that are negligible relative to the cost.

    An interior-point method leaves them on inactive constraints.

    :param density: (..., l), multiplier densities.
    :param rate: mean cost per second.
    :param slopes: (K, l, m), derivatives of the constraints by the inputs, at K points.
    :param u: (K, m), the inputs there.
    """
    size = (np.abs(slopes) @ np.abs(u).max(axis=0)).max(axis=0)
    with np.errstate(over='ignore'):   # of constraints that inputs do not change
        # By the range of the inputs, relative to the mean cost per second.
        least = 1e-6 * abs(rate) / np.maximum(size, 1e-300)
    return np.asarray(np.where(np.abs(density) > least, density, 0.0))


@dataclass(frozen=True, eq=False)
class Phased:
    """
    A path on phases, K intervals of DEGREE points each.

    :ivar arcs: levels of the inputs and active constraints of each phase.
    :ivar meshes: lengths of the intervals of each phase, as parts of it.
    :ivar durations: length of each phase [s].
    :ivar x, lam: (K, DEGREE + 1, n), at the start and at the points of each interval; lam is lam~
        of `phase_program`.
    :ivar u: (K, DEGREE, m), inputs at the points.
    :ivar eta: (K, DEGREE, n + l), multiplier densities of the constraints held in a phase, and of
        those path constraints that depend on inputs.
    :ivar nu: (q,), multipliers of the terminal constraints.
    :ivar cost: J.
    :ivar converged: whether IPOPT did.
    :ivar outwards: for a junction and a row, the derivative of the constraint in which inputs
        occur, on the side off the bound, relative; < 0 if the path leaves the bound inwards. The
        junction is the start (phase) or the end (-1 - phase) of a phase on the bound. For a
        constraint that depends on inputs, its residual with the inputs at their bounds on that
        side.
    :ivar pushed: (K, DEGREE, n + l), multipliers of bounds of (x, c) that are not held, relative
        to the costates.
    :ivar astray: phases and rows whose touch of the bound at the start has a multiplier of the
        wrong sign.
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
        Return the junctions at which a path leaves or meets a bound tangentially.

        :param within: relative derivative up to which it counts as zero.
        :param touched: include the points at which a bound is only touched.
        :return: junctions and rows, as the keys of `outwards`.
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
