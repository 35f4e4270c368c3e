# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Distribution of the intervals of phases: the share of all intervals before each time."""

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.collocation import build_collocation
from obc_ros.core.solver.arcs.phases import DEGREE, Phased
from obc_ros.core.solver.transcription.mesh import choose_cuts, Path


def spread_like(path: Path) -> tuple[Array, Array]:
    """
    Distribute intervals like those of a path, with more where its states bend.

    :param path: with N intervals.
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

    :param found: a path with K intervals.
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

    :param found: a path with K intervals.
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
