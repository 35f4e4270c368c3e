# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The Riccati differential equation (2.7): linear quadratic problems with a fixed horizon.

P is not integrated step by step: intervals of the horizon are joined (`propagation`). This is
accurate to rounding, also for long horizons and unstable plants, and needs no stationary solution.
Affine terms and terminal constraints are treated in `terminal_constraints`.
"""

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import ArrayLike
from obc_ros.core.numerics.arrays import Array, lapack
from obc_ros.core.riccati import checks, propagation
from obc_ros.core.riccati.care import compute_balancing
from obc_ros.core.text.errors import StatementError


def solve_finite_horizon(A: ArrayLike, B: ArrayLike, Qx: ArrayLike, Qu: ArrayLike, P1: ArrayLike,
                         t: Sequence[float] | Array, T: float, *, cross: ArrayLike | None = None
                         ) -> tuple[Array, Array]:
    """
    Return the solution of the Riccati differential equation (2.7) and the gain, u = -K(t) x.

    The gain minimises the integral of x'Qx x + 2 x'N u + u'Qu u over [t, T] plus x(T)'P1 x(T).

    :param A, B, Qx, Qu, cross: as for `lqr.lqr`; Qx >= 0, Qu > 0. Stabilisability and
        detectability are not needed.
    :param P1: (n, n), terminal weight; symmetric, P1 >= 0.
    :param t: (N,), times [s], increasing, at most T. Equally spaced times are much faster.
    :param T: final time [s].
    :return: P: (N, n, n), P(t); the minimum cost from t on is x'P x; K: (N, m, n), K(t).
    :raises StatementError: if a matrix has the wrong shape or is not symmetric, or times do not
        increase.
    :raises RefusedDesignError: if a weight is not definite as required.
    """
    A, B, Qx, Qu, cross = checks.check_matrices(A, B, Qx, Qu, cross)
    P1 = checks.check_semidefinite('P1', P1, len(A))
    L, Ac, Qc, _ = checks.remove_cross_term(A, B, Qx, Qu, cross)
    times = np.asarray(t, dtype=float)
    if times.ndim != 1 or not times.size or not np.isfinite(times).all() or not math.isfinite(T):
        raise StatementError('t and T: wanted a list of finite times and a finite final time')
    if (np.diff(times) <= 0.0).any() or times[-1] > T:
        raise StatementError(f't: wanted increasing times of at most T = {T:g}')
    F = lapack.dtrtrs(L, B.T, lower=1)[0].T
    d = compute_balancing(Ac, F, Qc)
    F = F / d[:, None]
    weight = d * d[:, None]
    P = propagation.evaluate_before_end(Ac * (d / d[:, None]), F @ F.T, Qc * weight, P1 * weight,
                                        T - times) / weight
    right = P.reshape(-1, len(A)) @ B
    if cross is not None:
        right = (right.reshape(len(P), *B.shape) + cross).reshape(right.shape)
    K = lapack.dpotrs(L, right.T, lower=1)[0].T.reshape(len(P), *B.shape)
    return P, np.swapaxes(K, 1, 2)
