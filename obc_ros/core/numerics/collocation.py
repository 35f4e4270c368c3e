# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Collocation: Gauss and Radau points, and the polynomials through them."""

from functools import cache

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array


@cache
def compute_gauss_points(stages: int) -> Array:
    """Return the Gauss points in (0, 1)."""
    if not stages:
        return np.zeros(0)
    return np.asarray((np.polynomial.legendre.leggauss(stages)[0] + 1) / 2)


def build_lagrange_polynomials(points: Array) -> list[np.poly1d]:
    """Return the polynomials of Lagrange: each is 1 at its point and 0 at the others."""
    found = []
    for i, point in enumerate(points):
        others = np.delete(points, i)
        found.append(np.poly1d(np.poly(others) / np.prod(point - others)))
    return found


@cache
def build_collocation(stages: int, kind: str = 'legendre') -> tuple[Array, Array, Array, Array]:
    """
    Return points c, weights b, derivatives D (s, s + 1) and end values e (s + 1,).

    Of the points of Gauss and Legendre, or with ``radau`` of Radau's, the last of which is 1.
    """
    points = np.append(0.0, ca.collocation_points(stages, kind))
    through_all = build_lagrange_polynomials(points)
    derivative = np.column_stack([np.polyder(each)(points[1:]) for each in through_all])
    weights = np.array([np.polyint(each)(1.0) for each in build_lagrange_polynomials(points[1:])])
    return points[1:], weights, derivative, np.array([each(1.0) for each in through_all])
