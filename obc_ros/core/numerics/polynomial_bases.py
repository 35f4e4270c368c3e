# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Bases of functions on [0, 1] for trajectories: powers, Bernstein polynomials and B-splines.

Bernstein polynomials are B-splines without interior knots.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import quote, StatementError

BasisKind = Literal['polynomial', 'bezier', 'bspline']
BASIS_KINDS: tuple[BasisKind, ...] = ('polynomial', 'bezier', 'bspline')


@dataclass(frozen=True)
class Basis:
    """
    A basis of M functions on [0, 1].

    Attributes
    ----------
    kind : str
        'polynomial': s^k, k = 0 .. M - 1. 'bezier': Bernstein polynomials of degree M - 1.
        'bspline': B-splines of the given degree with uniform knots, clamped at both ends.
    M : int
        Number of functions.
    degree : int
        Degree of the pieces; M - 1 unless the kind is 'bspline'.

    """

    kind: BasisKind
    M: int
    degree: int

    def values(self, s: Array, derivative: int = 0) -> Array:
        """
        Return a derivative of the functions.

        Parameters
        ----------
        s : ndarray, shape (N,)
            Within [0, 1].
        derivative : int
            Order of the derivative; 0: the values.

        Returns
        -------
        ndarray, shape (N, M)

        """
        if self.kind == 'polynomial':
            k = np.arange(self.M)
            factor = np.prod([np.maximum(k - i, 0) for i in range(derivative)], axis=0)
            return np.asarray(factor * s[:, None]**np.maximum(k - derivative, 0), dtype=float)
        return _splines(self.knots, self.degree, s, derivative)

    @property
    def knots(self) -> Array:
        """Return the knots of the B-splines, shape (M + degree + 1,)."""
        inner = np.linspace(0, 1, self.M - self.degree + 1)[1:-1]
        return np.concatenate((np.zeros(self.degree + 1), inner, np.ones(self.degree + 1)))

    @property
    def breaks(self) -> Array:
        """Return the ends of the polynomial pieces, increasing."""
        return np.array([0.0, 1.0]) if self.kind == 'polynomial' else np.unique(self.knots)


def build_basis(kind: str, M: int, degree: int) -> Basis:
    """
    Return a basis of M functions.

    Parameters
    ----------
    kind : str
        One of `BASIS_KINDS`.
    M : int
        Number of functions.
    degree : int
        Degree of B-splines, reduced to M - 1 if it is larger; ignored for other kinds.

    Returns
    -------
    Basis

    Raises
    ------
    StatementError
        If the kind is unknown.

    """
    for known in BASIS_KINDS:
        if known == kind:
            return Basis(known, M, min(degree, M - 1) if known == 'bspline' else M - 1)
    raise StatementError(
        f"unknown basis '{quote(str(kind))}'; known bases: {', '.join(BASIS_KINDS)}")


def _splines(knots: Array, degree: int, s: Array, derivative: int) -> Array:
    """Return derivatives of B-splines by the recursion of Cox and de Boor."""
    if derivative > degree:
        return np.zeros((len(s), len(knots) - degree - 1))
    if derivative:
        lower = _splines(knots[1:-1], degree - 1, s, derivative - 1)
        span = knots[degree + 1:-1] - knots[1:-degree - 1]
        slopes = degree * lower / np.where(span > 0, span, np.inf)
        zero = np.zeros((len(s), 1))
        return np.hstack((zero, slopes)) - np.hstack((slopes, zero))
    spans = len(knots) - 1
    last = int(np.flatnonzero(np.diff(knots) > 0)[-1])
    at = np.clip(np.searchsorted(knots, s, side='right') - 1, 0, last)
    B: Array = (at[:, None] == np.arange(spans)).astype(float)
    for p in range(1, degree + 1):
        left, right = knots[:-p - 1], knots[p + 1:]
        up, down = knots[p:-1] - left, right - knots[1:-p]
        rise = (s[:, None] - left) / np.where(up > 0, up, np.inf)
        fall = (right - s[:, None]) / np.where(down > 0, down, np.inf)
        B = rise * B[:, :-1] + fall * B[:, 1:]
    return B
