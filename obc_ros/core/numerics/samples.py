# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Samples in order: interpolation of columns, and runs of true entries."""

import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask


def interpolate_columns(at: Array | float, t: Array, values: Array) -> Array:
    """Interpolate each column of values (N, n) at t (N,) linearly, by the nearest outside."""
    return np.stack([np.interp(at, t, column) for column in values.T], axis=-1)


def find_runs(of: Mask, gap: int = 1) -> list[tuple[int, int]]:
    """Return first and last place of each run of true entries, at most `gap` apart."""
    places = np.flatnonzero(of)
    return [(int(run[0]), int(run[-1])) for run in np.split(
        places, np.flatnonzero(np.diff(places) > gap) + 1) if run.size]
