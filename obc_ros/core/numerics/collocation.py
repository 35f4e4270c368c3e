# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Collocation: Gauss and Radau points and their Lagrange polynomials."""

from functools import cache

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array


@cache
def compute_gauss_points(stages: int) -> Array:
    """
    Return the Gauss points on the unit interval.

    Parameters
    ----------
    stages : int
        Number of points s, >= 0.

    Returns
    -------
    ndarray, shape (s,)
        Increasing, in (0, 1).

    """
    if not stages:
        return np.zeros(0)
    return np.asarray((np.polynomial.legendre.leggauss(stages)[0] + 1) / 2)


def build_lagrange_polynomials(points: Array) -> list[np.poly1d]:
    """
    Return the Lagrange polynomials: each is 1 at its point and 0 at the others.

    Parameters
    ----------
    points : ndarray, shape (s,)
        Distinct.

    Returns
    -------
    list of numpy.poly1d
        One for each point, of degree s - 1.

    """
    found = []
    for i, point in enumerate(points):
        others = np.delete(points, i)
        found.append(np.poly1d(np.poly(others) / np.prod(point - others)))
    return found


@cache
def build_collocation(stages: int, kind: str = 'legendre') -> tuple[Array, Array, Array, Array]:
    """
    Return points, weights and differentiation matrix of a collocation method on [0, 1].

    Parameters
    ----------
    stages : int
        Number of collocation points s.
    kind : str
        'legendre': Gauss-Legendre points. 'radau': Radau points, the last of which is 1.

    Returns
    -------
    c, b : ndarray, shape (s,)
        Points and quadrature weights.
    D : ndarray, shape (s, s + 1)
        Derivatives at the points of the polynomial through the values at 0 and the points.
    e : ndarray, shape (s + 1,)
        Its value at 1 is e times these values.

    """
    points = np.append(0.0, ca.collocation_points(stages, kind))
    through_all = build_lagrange_polynomials(points)
    derivative = np.column_stack([np.polyder(each)(points[1:]) for each in through_all])
    weights = np.array([np.polyint(each)(1.0) for each in build_lagrange_polynomials(points[1:])])
    return points[1:], weights, derivative, np.array([each(1.0) for each in through_all])
