# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sizes, against which rounding is judged."""

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array

EPS = float(np.finfo(float).eps)
TINY = 1e-300
COMFORTABLE = 1e3  # times the rounding: what bears so much is looked at no closer


def norm(M: Array) -> float:
    """Return the Frobenius norm."""
    return math.sqrt(float(np.vdot(M, M)))


def compute_mode_tolerance(M: Array, gap: Callable[[NDArray[np.complex128]], Array],
                           rounding: Array
                           ) -> float:
    """
    Return how many times the perturbations |E| <= rounding a matrix can bear and stay stable.

    By |(s I - M)^-1| <= |V| diag(1 / gap) |V^-1| for s on the border of stability: M + E has no
    mode there while the spectral radius of that bound times |E| is below 1. The bound does not
    depend on the units of the states; 0: nothing is proved.

    Parameters
    ----------
    M : ndarray, shape (n, n)
        With the modes V.
    gap : callable
        Returns the distance of modes (n,) from the border, positive where they are stable.
    rounding : ndarray, shape (n, n)
        Bound of the absolute error of each entry of M.

    """
    modes, V = np.linalg.eig(M)
    distance = gap(modes)
    if not distance.min() > 0.0:
        return 0.0
    try:
        inverse = np.linalg.inv(V)
    except np.linalg.LinAlgError:
        return 0.0
    resolvent = (np.abs(V) / distance) @ np.abs(inverse)
    radius = float(np.abs(np.linalg.eigvals(resolvent @ rounding)).max())
    return 1.0 / max(radius, TINY)
