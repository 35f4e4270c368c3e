# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Enclosures of exp(A t) and of its integral, and bounds of linear motions, by Taylor series.

Norms are maximum norms of states in units of their sizes, rounded to powers of 2. With
X = A t / 2^k of norm at most 1/2, F(X) = sum of X^j / (j + 1)! has the remainder

    |sum over j > K of X^j / (j + 1)!| <= 1.2 |X|^(K + 1) / (K + 2)!.

Over t / 2^k, the integral is G = F t / 2^k, and E = I + X F. Both are doubled k times: G becomes
G + E G, and E becomes E^2.
"""

import math

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.enclosures.matrix_balls import MatrixBall, multiply_up, round_up
from obc_ros.core.numerics.rounding import EPS, TINY

_LARGEST = 500.0      # norm of A t; exp of it is a double
_NEGLIGIBLE = 1e-290   # rest of a series


def enclose_transition(A: MatrixBall, time: float, sizes: Array
                       ) -> tuple[MatrixBall, MatrixBall] | None:
    """
    Enclose exp(A t) and the integral of exp(A s) over s from 0 to t.

    Parameters
    ----------
    A : MatrixBall, shape (n, n)
        The matrices.
    time : float
        The time t >= 0.
    sizes : ndarray, shape (n,)
        Typical positive sizes of the states, for which the enclosures are tight.

    Returns
    -------
    tuple of two MatrixBall, or None
        None if the norm of A t in units of the sizes is above 500, or not finite.

    """
    if not A.is_finite:
        return None
    n, units = len(A.middle), _round_to_powers(sizes)
    X = A * (units / units[:, None]) * time
    norm = float(multiply_up(X.size, np.ones(n)).max(initial=0.0))
    if not norm <= _LARGEST:
        return None
    doublings = max(0, math.frexp(norm)[1] + 1)
    part = 0.5**doublings
    X, small = X * part, norm * part
    order, rest = 0, small / 2.0
    while rest > EPS / 16.0:
        order += 1
        rest *= small / (order + 2)
    one = MatrixBall.exact(np.eye(n))
    F = one
    for j in range(order + 1, 1, -1):
        F = one + (X @ F) / j
    # 2 in place of 1.2 exceeds the rounding errors of `rest`.
    F = MatrixBall(F.middle, round_up(F.radius + 2.0 * rest, 1))
    E, G = one + X @ F, F * (time * part)
    for _ in range(doublings):
        E, G = E @ E, G + E @ G
    back = units[:, None] / units
    return E * back, G * back


def bound_motion(M: Array, start: Array, forcing: Array, time: float, sizes: Array
                 ) -> Array | None:
    """
    Return upper bounds of y(s) for all s from 0 to t, for dy/ds = M y + g with y(0) = y0.

    Parameters
    ----------
    M : ndarray, shape (n, n)
        Nonnegative, as the others.
    start, forcing : ndarray, shape (n, k)
        y0 and g of k motions.
    time, sizes
        As for `enclose_transition`.

    Returns
    -------
    ndarray, shape (n, k), or None
        None if the norm of M t is above 500, or not finite.

    """
    n, units = len(M), _round_to_powers(sizes)
    X = M * time
    norm = float((multiply_up(X, units) / units).max())
    if not norm <= _LARGEST:
        return None
    # y = y0 + sum of X^j (X y0 + t g) / (j + 1)!, whose terms are nonnegative.
    order, term, total = 0, X @ start + forcing * time + TINY, start
    while True:
        total = total + term
        order += 1
        term = X @ term / (order + 1) + TINY
        rest = 2.0 * (term / units[:, None]).max(axis=0)
        enough = EPS * (total / units[:, None]).max(axis=0) + _NEGLIGIBLE
        # From here on the norm of a term is at most half of the one before.
        if 2.0 * norm <= order and (rest <= enough).all():
            return round_up(total + rest * units[:, None], (order + 2) * (n + 4))


def _round_to_powers(sizes: Array) -> Array:
    powers: Array = np.ldexp(1.0, np.frexp(sizes)[1])
    return powers
