# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where the intervals of phases go: which share of them is before each time."""

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.collocation import build_collocation
from obc_ros.core.solver.arcs.phases import DEGREE, Phased
from obc_ros.core.solver.transcription.mesh import Path

_RESOLVED, _MOST_CUTS = 1e-5, 4   # highest coefficients that are small enough; at once


def spread_like(path: Path) -> tuple[Array, Array]:
    """Return times and which share of all intervals is to be before each: more where it bends."""
    h = np.maximum(np.diff(path.t), 1e-300)
    slope = np.diff(path.x, axis=0) / h[:, None]
    bends = np.abs(np.diff(slope, axis=0)) / np.maximum(np.ptp(slope, axis=0), 1e-300)
    bends = np.pad(bends.max(axis=1), 1)
    return path.t, _shares(h, np.ones(len(h)), bends[:-1] + bends[1:])


def spread_by_error(found: Phased) -> tuple[Array, Array]:
    """Return likewise what makes the highest coefficients of x about the same everywhere."""
    return np.append(0.0, np.cumsum(found.h)), _shares(
        found.h, np.ones(len(found.h)), _highest(found.x).max(axis=1) ** (1 / DEGREE))


def spread_as_wanted(found: Phased) -> tuple[tuple[Array, Array], int]:
    """Return likewise, and how many intervals there are: cut where x or lam are not resolved."""
    error = np.maximum(_highest(found.x).max(axis=1), _highest(found.lam).max(axis=1))
    count = np.clip(np.ceil((error / _RESOLVED) ** (1 / DEGREE)), 1, _MOST_CUTS)
    return (np.append(0.0, np.cumsum(found.h)), _shares(count)), int(count.sum())


def _highest(values: Array) -> Array:
    """Return the highest coefficients in all intervals, (K, n), of their sizes."""
    points = 2 * np.append(0.0, build_collocation(DEGREE, 'radau')[0]) - 1
    highest = np.polynomial.legendre.legfit(points, np.eye(DEGREE + 1), DEGREE)[DEGREE]
    size = np.maximum(np.abs(values).max(axis=(0, 1)), 1e-300)
    return np.asarray(np.abs(np.einsum('j,kjn->kn', highest, values)) / size)


def _shares(*weights: Array) -> Array:
    """Return which share of some weights, each (N,), is before each point, (N + 1,)."""
    share = np.append(0.0, np.cumsum(sum(each / max(each.sum(), 1e-300) for each in weights)))
    return np.asarray(share / share[-1])
