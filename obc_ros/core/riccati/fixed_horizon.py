# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Linear quadratic problems with a fixed horizon: the Riccati differential equation (2.7).

-dP/dt = P A + A'P - P B Qu^-1 B'P + Qx, P(T) = P1, u = -Qu^-1 B'P(t) x

P is not integrated: parts of the horizon are joined (`propagation`), which is exact to rounding
for long horizons and unstable plants too, and needs no stationary solution. What is affine or
constrained at T joins the state: with (x, 1, nu) the value function
V(x) = x'P x / 2 + p'x + ..., its linear part and the multipliers nu of C x(T) = d are one P.
"""

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import ArrayLike
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.riccati import checks, propagation
from obc_ros.core.riccati.care import compute_balancing
from obc_ros.core.text.errors import StatementError
from scipy.linalg import lapack


def solve_finite_horizon(A: ArrayLike, B: ArrayLike, Qx: ArrayLike, Qu: ArrayLike, P1: ArrayLike,
                         t: Sequence[float] | Array, T: float, *, cross: ArrayLike | None = None
                         ) -> tuple[Array, Array]:
    """
    Return the solution of the Riccati differential equation (2.7) and the gain, u = -K(t) x.

    They minimise the integral of x'Qx x + 2 x'N u + u'Qu u over [t, T] plus x(T)'P1 x(T).

    Parameters
    ----------
    A, B, Qx, Qu, cross : array_like
        As for `lqr.lqr`; Qx >= 0, Qu > 0. Neither stabilisable nor detectable is needed.
    P1 : array_like, shape (n, n)
        Terminal weight; symmetric, P1 >= 0.
    t : sequence of float, shape (N,)
        Times [s], increasing, at most T. Equally spaced ones are much faster.
    T : float
        Final time [s].

    Returns
    -------
    P : ndarray, shape (N, n, n)
    K : ndarray, shape (N, m, n)

    Raises
    ------
    StatementError, RefusedDesignError
        If a matrix does not fit, or is not definite as needed; if times are not increasing.

    """
    A, B, Qx, Qu, cross = checks.check_matrices(A, B, Qx, Qu, cross)
    P1 = checks.check_semidefinite('P1', P1, len(A))
    L, Ac, Qc, _ = checks.remove_cross_term(A, B, Qx, Qu, cross)
    to_go = _to_go(t, T)
    F = lapack.dtrtrs(L, B.T, lower=1)[0].T
    d = compute_balancing(Ac, F, Qc)
    F = F / d[:, None]
    weight = d * d[:, None]
    P = propagation.evaluate_before_end(Ac * (d / d[:, None]), F @ F.T, Qc * weight, P1 * weight,
                                        to_go) / weight
    right = P.reshape(-1, len(A)) @ B
    if cross is not None:
        right = (right.reshape(len(P), *B.shape) + cross).reshape(right.shape)
    K = lapack.dpotrs(L, right.T, lower=1)[0].T.reshape(len(P), *B.shape)
    return P, np.swapaxes(K, 1, 2)


def _to_go(t: Sequence[float] | Array, T: float) -> Array:
    """Return T - t, checked."""
    times = np.asarray(t, dtype=float)
    if times.ndim != 1 or not times.size or not np.isfinite(times).all() or not math.isfinite(T):
        raise StatementError('t and T: wanted a list of finite times and a finite final time')
    if (np.diff(times) <= 0.0).any() or times[-1] > T:
        raise StatementError(f't: wanted increasing times of at most T = {T:g}')
    to_go: Array = T - times
    return to_go
