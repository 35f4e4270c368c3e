# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A path on phases with known active constraints, as the phase program returns it.

For the next program its intervals are distributed: the share of all intervals before each time.
"""

from dataclasses import dataclass

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.numerics.collocation import build_collocation
from obc_ros.core.solver.arcs.input_arcs import Arc
from obc_ros.core.solver.transcription.mesh import choose_cuts, Path

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


def spread_like(path: Path) -> tuple[Array, Array]:
    """
    Distribute intervals like those of a path, with more where its states bend.

    :return: t, share: (N + 1,), times [s], and the share of all intervals before each, from 0 to
        1.
    """
    h = np.maximum(np.diff(path.t), 1e-300)
    slope = np.diff(path.x, axis=0) / h[:, None]
    bends = np.abs(np.diff(slope, axis=0)) / np.maximum(np.ptp(slope, axis=0), 1e-300)
    bends = np.pad(bends.max(axis=1), 1)
    return path.t, _shares(h, np.ones(len(h)), bends[:-1] + bends[1:])


def spread_by_error(found: Phased) -> tuple[Array, Array]:
    """
    Distribute intervals so that the highest coefficients of x and u become about equal everywhere.

    Inputs that turn fast have an influence on x that is small, and yet decides the residuals.

    :return: t, share: (K + 1,), as returned by `spread_like`.
    """
    points = build_collocation(DEGREE, 'radau')[0]
    errors = [_highest(values, at).max(axis=1) ** (1 / (len(at) - 1)) for values, at in (
        (found.x, np.append(0.0, points)), (found.u, points))]
    error = sum(each / max(each.sum(), 1e-300) for each in errors)
    return np.append(0.0, np.cumsum(found.h)), _shares(
        found.h, np.ones(len(found.h)), np.asarray(error))


def spread_as_wanted(found: Phased) -> tuple[tuple[Array, Array], int]:
    """
    Distribute intervals with cuts where x or lam is not resolved.

    :return: shares: as returned by `spread_like`; count: number of intervals needed.
    """
    points = np.append(0.0, build_collocation(DEGREE, 'radau')[0])
    error = np.maximum(*(_highest(values, points).max(axis=1)
                         for values in (found.x, found.lam)))
    # Of a resolved interval the highest Legendre coefficient is at most 1e-5, relative.
    count = choose_cuts(error, 1e-5, DEGREE).astype(float)
    return (np.append(0.0, np.cumsum(found.h)), _shares(count)), int(count.sum())


def _highest(values: Array, points: Array) -> Array:
    """Return the highest Legendre coefficients in all intervals, relative, (K, n)."""
    degree = len(points) - 1
    highest = np.polynomial.legendre.legfit(2 * points - 1, np.eye(degree + 1), degree)[degree]
    size = np.maximum(np.abs(values).max(axis=(0, 1)), 1e-300)
    return np.asarray(np.abs(np.einsum('j,kjn->kn', highest, values)) / size)


def _shares(*weights: Array) -> Array:
    """Return the share of the weights, each (N,) and normalised, before each point, (N + 1,)."""
    share = np.append(0.0, np.cumsum(sum(each / max(each.sum(), 1e-300) for each in weights)))
    return np.asarray(share / share[-1])
