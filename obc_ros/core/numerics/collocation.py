# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Collocation: Gauss and Radau points and their Lagrange polynomials."""

from functools import cache

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array


@cache
def compute_gauss_points(stages: int) -> Array:
    """Return the Gauss points on the unit interval, (stages,), increasing, in (0, 1)."""
    if not stages:
        return np.zeros(0)
    return np.asarray((np.polynomial.legendre.leggauss(stages)[0] + 1) / 2)


def evaluate_lagrange(points: Array, at: Array | float, order: int = 0) -> Array:
    """Return values, or derivatives, of the Lagrange polynomials of distinct points, (..., s)."""
    return np.stack([np.polyder(each, order)(at) for each in _polynomials(points)], axis=-1)


def _polynomials(points: Array) -> list[np.poly1d]:
    others = [np.delete(points, i) for i in range(len(points))]
    return [np.poly1d(np.poly(rest) / np.prod(point - rest))
            for point, rest in zip(points, others, strict=True)]


@cache
def build_collocation(stages: int, kind: str = 'legendre') -> tuple[Array, Array, Array, Array]:
    """
    Return points, weights and differentiation matrix of a collocation method on [0, 1].

    :param kind: 'legendre': Gauss-Legendre points. 'radau': Radau points, the last of which is 1.
    :return: c, b: (s,), points and quadrature weights; D: (s, s + 1), derivatives at the points of
        the polynomial through the values at 0 and the points; e: (s + 1,), its value at 1 is e
        times these values.
    """
    points = np.append(0.0, ca.collocation_points(stages, kind))
    weights = np.array([np.polyint(each)(1.0) for each in _polynomials(points[1:])])
    return (points[1:], weights, evaluate_lagrange(points, points[1:], 1),
            evaluate_lagrange(points, 1.0))


def build_stage_matrices(differentiation: Array, h: Array, slopes: Array) -> Array:
    """
    Return the matrices (K, s n, s n) of the linear equations of stages, D x - h A x.

    :param differentiation: (s, s + 1), D of `build_collocation`; its first column is left out.
    :param h: (K,), lengths of the intervals.
    :param slopes: (K, s, n, n), A at the points.
    """
    K, stages, n, _ = slopes.shape
    found = np.tile(np.kron(differentiation[:, 1:], np.eye(n)), (K, 1, 1))
    for j in range(stages):
        part = slice(j * n, (j + 1) * n)
        found[:, part, part] -= h[:, None, None] * slopes[:, j]
    return found
