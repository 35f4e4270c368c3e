# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Norms and bounds for the effect of rounding."""

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array

EPS = float(np.finfo(float).eps)
TINY = 1e-300
COMFORTABLE = 1e3  # times the rounding error; above it no sharper bound is computed


def norm(M: Array) -> float:
    """Return the Frobenius norm of an array of any shape."""
    return math.sqrt(float(np.vdot(M, M)))


def compute_mode_tolerance(M: Array, gap: Callable[[NDArray[np.complex128]], Array],
                           rounding: Array
                           ) -> float:
    """
    Estimate from below the factor c for which M + c E is stable for all |E| <= rounding.

    On the stability boundary |(s I - M)^-1| <= |V| diag(1 / gap) |V^-1|, with the eigenvectors V.
    M + c E has no eigenvalue there if the spectral radius of this bound times c |E| is below 1.
    The result does not depend on the units of the states. Rounding of V is neglected.

    :param gap: returns the distances of eigenvalues (n,) from the stability boundary, positive if
        stable.
    :param rounding: (n, n), bound of the absolute error of each entry of M.
    :return: the factor c; 0 if M has an eigenvalue that is not stable, or V is singular.
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
