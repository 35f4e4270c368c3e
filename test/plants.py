# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Linear plants of the chapter, derived by hand from its equations."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CHAIN, FORCE = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])


def vehicle(v: float, length: float = 2.0) -> tuple[Array, Array]:
    """Return (A, B) of the lateral vehicle at a speed [m/s]; the state is (py, theta)."""
    return v * CHAIN, v / length * FORCE


def aircraft() -> tuple[Array, Array]:
    """Return (A, B) of the vectored thrust aircraft at hover."""
    m, J, r, g, c = 4.0, 0.0475, 0.25, 9.8, 0.05
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 2], A[3, 3], A[4, 4] = -g, -c / m, -c / m
    B = np.zeros((6, 2))
    B[3, 0] = B[4, 1] = 1.0 / m
    B[5, 0] = r / J
    return A, B
