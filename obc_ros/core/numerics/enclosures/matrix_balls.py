# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Balls of matrices: sums and products with bounds of their rounding errors.

A ball is a matrix with a radius for each entry. With the unit roundoff u, a sum of n products
differs from the exact one by at most n u / (1 - n u) <= 2 n u times the sum of their absolute
values, in any order of summation, with fused operations or without (N. J. Higham, Accuracy and
Stability of Numerical Algorithms, 2002, section 3.1). Radii are sums of nonnegative numbers and
are enlarged by their own rounding errors, as in S. M. Rump, Verification methods, Acta Numerica
(2010). TINY exceeds what is lost where a result underflows. It is assumed that double precision
rounds to nearest (IEEE 754), and that NumPy adds n products for each entry of a product.

`interval_arithmetic` encloses any expression, number by number. For matrices, balls are faster.
"""

from dataclasses import dataclass

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.rounding import EPS, TINY

_OTHERS = 8   # rounded operations besides a sum, at most 4, and those of `round_up`


def round_up(values: Array, terms: int) -> Array:
    """
    Return upper bounds of nonnegative numbers that were computed in double precision.

    Parameters
    ----------
    values : ndarray
        Sums of nonnegative products, computed without subtractions.
    terms : int
        Number of terms of the sums. There may be 4 further rounded operations.

    """
    bound: Array = values * (1.0 + (terms + _OTHERS) * EPS) + TINY
    return bound


def multiply_up(a: Array, b: Array) -> Array:
    """
    Return an upper bound of a @ b.

    Parameters
    ----------
    a, b : ndarray
        Nonnegative arrays.

    """
    return round_up(a @ b, a.shape[-1])


def add_up(a: Array, b: Array) -> Array:
    """
    Return an upper bound of a + b.

    Parameters
    ----------
    a, b : ndarray
        Nonnegative arrays.

    """
    return round_up(a + b, 1)


@dataclass(frozen=True, eq=False)
class MatrixBall:
    """
    All matrices M with |M - middle| <= radius, entry by entry.

    The operators return balls that contain the results for all matrices of their operands.

    Attributes
    ----------
    middle, radius : ndarray, shape (n, k)
        The radius is nonnegative. If entries are not finite, nothing is known of M.

    """

    middle: Array
    radius: Array

    @classmethod
    def enclose(cls, lower: Array, upper: Array) -> 'MatrixBall':
        """Return a ball that contains all matrices between two bounds, shape (n, k)."""
        middle = 0.5 * lower + 0.5 * upper
        return cls(middle, round_up(np.maximum(upper - middle, middle - lower), 1))

    @classmethod
    def exact(cls, matrix: Array) -> 'MatrixBall':
        """Return the ball of one matrix."""
        return cls(matrix, np.zeros_like(matrix))

    @property
    def size(self) -> Array:
        """Return an upper bound of the absolute value of each entry."""
        return add_up(np.abs(self.middle), self.radius)

    @property
    def high(self) -> Array:
        """Return an upper bound of each entry."""
        return np.nextafter(self.middle + self.radius, np.inf)

    @property
    def T(self) -> 'MatrixBall':
        """Return the ball of the transposed matrices."""
        return MatrixBall(self.middle.T, self.radius.T)

    @property
    def is_finite(self) -> bool:
        """Return whether there is a bound of each entry."""
        return bool(np.isfinite(self.middle).all() and np.isfinite(self.radius).all())

    def __matmul__(self, other: 'MatrixBall') -> 'MatrixBall':
        """Return a ball of the products."""
        n = len(other.middle)
        size, spread = np.abs(other.middle), other.radius + TINY
        radius = (np.abs(self.middle) @ (n * EPS * size + spread)
                  + self.radius @ (size + spread))
        return MatrixBall(self.middle @ other.middle, round_up(radius, n))

    def __add__(self, other: 'MatrixBall') -> 'MatrixBall':
        """Return a ball of the sums."""
        middle = self.middle + other.middle
        return MatrixBall(middle, round_up(
            self.radius + other.radius + EPS * np.abs(middle), 1))

    def __sub__(self, other: 'MatrixBall') -> 'MatrixBall':
        """Return a ball of the differences."""
        return self + MatrixBall(-other.middle, other.radius)

    def __mul__(self, factor: Array | float) -> 'MatrixBall':
        """Return a ball of the products with a number, or with numbers (n, k) entry by entry."""
        middle = self.middle * factor
        return MatrixBall(middle, round_up(
            self.radius * np.abs(factor) + EPS * np.abs(middle), 1))

    def __truediv__(self, divisor: float) -> 'MatrixBall':
        """Return a ball of the quotients by a positive number."""
        middle = self.middle / divisor
        return MatrixBall(middle, round_up(self.radius / divisor + EPS * np.abs(middle), 1))
