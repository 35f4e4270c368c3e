# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The discrete algebraic Riccati equation, solved by doubling, with an estimate of the error.

P = A'P (I + G P)^-1 A + Q, G = B Qu^-1 B', for x+ = A x + B u and the sum of x'Qx x + u'Qu u
"""

import math
from typing import NamedTuple

import numpy as np
from obc_ros.core.numerics.arrays import Array, lapack
from obc_ros.core.numerics.rounding import COMFORTABLE, compute_mode_tolerance, EPS, norm, TINY
from obc_ros.core.riccati.propagation import double_horizon

_LONGEST = 60  # doublings, which are 1e18 steps


class AssessedSolution(NamedTuple):
    """
    The solution P (n, n) of a Riccati equation and its accuracy.

    :ivar residual: norm of the residual of the equation, relative to the size of its terms.
    :ivar error: estimated bound of the rounding error of P, relative to P.
    :ivar X: (n, n), Lyapunov matrix of the closed loop M: M'X M - X = -I; of a continuous one M'X
        + X M = -I.
    :ivar scale: (n,), powers of 2; error and X are those in the coordinates z of x = scale * z.
    """

    P: Array
    residual: float
    error: float
    X: Array
    scale: Array = np.ones(1)


def solve_discrete(A: Array, F: Array, Q: Array) -> AssessedSolution | None:
    """
    Return the solution of P = A'P (I + F F'P)^-1 A + Q that is the minimum cost matrix.

    Its gain stabilises if (A, F) is stabilisable and (A, Q) is detectable.

    E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, Structure-preserving algorithms for periodic
    discrete-time algebraic Riccati equations, International Journal of Control 77, 2004.

    :param Q: (n, n), positive semidefinite.
    :param F: (n, m), any factor of G = B Qu^-1 B' = F F'.
    :return: None if the cost grows without bound or the closed loop is not stable.
    """
    P = double_horizon(A, F @ F.T, Q)
    if P is None:
        return None
    M, K, X = A, F.T, P
    step = math.inf
    for _ in range(5):
        right = F.T @ P
        inner = right @ F
        inner.flat[::len(inner) + 1] += 1.0
        K = lapack.dposv(inner, right @ A, lower=1)[1]
        M = A - F @ K
        sums = solve_stein(M, np.eye(len(A)))
        if sums is None:
            return None
        X = sums
        correction = solve_stein(M, _residual(M, K, Q, P)[0])
        if correction is None or not norm(correction) < 0.5 * step:
            break
        P, step = P + correction, norm(correction)
        if step <= len(A) * EPS * norm(P):
            break
    R, terms = _residual(M, K, Q, P)
    error = (norm(R) + len(A) * EPS * terms) * norm(X) / (norm(P) + TINY)
    return AssessedSolution(P, norm(R) / terms, error, X) if math.isfinite(error) else None


def _residual(M: Array, K: Array, Q: Array, P: Array) -> tuple[Array, float]:
    """Return M'P M + K'K + Q - P, the residual of P as the cost of K, and its scale."""
    moved = M.T @ P @ M
    spent = K.T @ K
    R = moved + spent + Q - P
    return 0.5 * (R + R.T), norm(moved) + norm(spent) + norm(Q) + norm(P) + TINY


def solve_stein(M: Array, C: Array) -> Array | None:
    """Solve X - M'X M = C by doubling the sum of M'^k C M^k; None if it does not converge."""
    X = C
    for _ in range(_LONGEST):
        more = M.T @ X @ M
        X = X + more
        size = norm(more)
        if size <= 0.1 * EPS * norm(X):
            return X
        if not size < 1e200:
            return None
        M = M @ M
    return None


def measure_discrete_robustness(M: Array, X: Array, rounding: Array) -> float:
    """
    Bound from below the factor c for which M + c E is stable for all |E| <= rounding.

    :param M, X: (n, n), X should solve M'X M - X = -I; the residual is checked.
    :param rounding: (n, n), bound of the absolute error of each entry of M.
    :return: the lower bound of c, from (M + c E)'X (M + c E) < X or `compute_mode_tolerance`; 0
        if stability is not verified.
    """
    bound = 0.0
    if not lapack.dpotrf(X)[1]:
        XM = X @ M
        S = M.T @ XM - X
        S.flat[::len(M) + 1] += 1.0
        left = 1.0 - norm(S) - 4.0 * len(M) * EPS * norm(X) * (1.0 + norm(M)**2)
        if left > 0.0:
            size = norm(XM)
            reach = left / (size + math.sqrt(size * size + norm(X) * left))
            bound = reach / max(norm(rounding), TINY)
    return bound if bound > COMFORTABLE else max(
        bound, compute_mode_tolerance(M, lambda modes: 1.0 - np.abs(modes), rounding))
