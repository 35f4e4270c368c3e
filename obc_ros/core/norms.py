# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sizes, against which rounding is judged."""

import math

import numpy as np
from numpy.typing import NDArray

EPS = float(np.finfo(float).eps)
TINY = 1e-300


def norm(M: NDArray[np.float64]) -> float:
    """Return the Frobenius norm."""
    return math.sqrt(float(np.vdot(M, M)))
