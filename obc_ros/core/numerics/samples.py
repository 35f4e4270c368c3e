# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Samples in order: interpolation of columns, and runs of true entries."""

import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask


def interpolate_columns(at: Array | float, t: Array, values: Array) -> Array:
    """
    Interpolate each column linearly.

    :param at: places; outside of the samples the nearest one is used.
    :param t: (N,), places of the samples, not decreasing.
    :param values: (N, n), the samples.
    :return: (..., n).
    """
    return np.stack([np.interp(at, t, column) for column in values.T], axis=-1)


def find_runs(of: Mask, gap: int = 1) -> list[tuple[int, int]]:
    """
    Find the runs of true entries.

    :param of: (N,), the entries.
    :param gap: distance of two true entries up to which they belong to one run.
    :return: first and last place of each run.
    """
    places = np.flatnonzero(of)
    return [(int(run[0]), int(run[-1])) for run in np.split(
        places, np.flatnonzero(np.diff(places) > gap) + 1) if run.size]
