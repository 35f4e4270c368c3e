# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Steady Kalman gains by duality: the estimator of (A, C) is the regulator of (A', C').

Continuous time: intensities Qw, Rv of w and v. Discrete time: covariances. docs/estimation.md has
the *predictor* form and the *filter* form.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from obc_ros.core.lqr.lqr import check_period, dlqr, lqr, LqrDesign
from obc_ros.core.lqr.margins import compute_margins
from obc_ros.core.lqr.sampled import discretize_cost
from obc_ros.core.lqr.stabilizability import explain_no_estimator
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array, linalg
from obc_ros.core.riccati.checks import check_definite, check_matrix, check_semidefinite
from obc_ros.core.text.errors import RefusedDesignError, StatementError
from obc_ros.core.text.tables import Tabulated


@dataclass(frozen=True, eq=False, repr=False)
class KalmanDesign(Tabulated):
    """
    A steady Kalman filter with verified stability, the plant and the noise.

    :ivar A, C: (n, n), (q, n), the plant; the sampled plant if `period` is positive.
    :ivar Qw, Rv: intensities of the noise of process and measurement; covariances if `period` is
        positive.
    :ivar L, M: (n, q), gains of the predictor and the filter form; equal in continuous time.
    :ivar P, P_filtered: covariance of the estimation error before and after a measurement; equal
        in continuous time.
    :ivar E: (n,), poles of the estimator, the slowest last; in the z plane if `period` is
        positive.
    :ivar bandwidth: (q,), [rad/s], highest frequency at which the gain of the estimator's loop,
        opened at each output, crosses 1; 0: none.
    :ivar residual, error, robustness: of the dual regulator, see `LqrDesign`.
    :ivar period: sampling period [s]; 0: continuous time.
    """

    A: Array
    C: Array
    Qw: Array
    Rv: Array
    L: Array
    M: Array
    P: Array
    P_filtered: Array
    E: NDArray[np.complex128]
    bandwidth: Array
    residual: float
    error: float
    robustness: float
    period: float = 0.0


def lqe(A: ArrayLike, C: ArrayLike, Qw: ArrayLike, Rv: ArrayLike, *,
        outputs: tuple[str, ...] = ()) -> KalmanDesign:
    """
    Return the steady Kalman filter of dx/dt = A x + w, y = C x + v (Kalman and Bucy 1961).

    L = P C'Rv^-1, where P solves A P + P A' - P C'Rv^-1 C P + Qw = 0.

    :param Qw, Rv: intensities of the white noise; symmetric, Qw >= 0, Rv > 0.
    :param outputs: names of the outputs, for messages.
    :raises StatementError: if a matrix has a wrong size, an entry that is not finite, or is not
        symmetric.
    :raises RefusedDesignError: if Qw or Rv is not definite, (A, C) is not detectable, a mode that
        does not decay is not driven by Qw, or stability cannot be verified. The message names the
        mode.
    """
    A, C, Qw, Rv = _check(A, C, Qw, Rv, outputs, 0.0)
    dual = _solve_dual(lambda: lqr(A.T, C.T, Qw, Rv))
    L = dual.K.T
    return _describe(dual, L, L, dual.P, dual.P)


def dlqe(A: ArrayLike, C: ArrayLike, Qw: ArrayLike, Rv: ArrayLike, *, period: float = 1.0,
         outputs: tuple[str, ...] = ()) -> KalmanDesign:
    """
    Return the steady Kalman filter of x+ = A x + w, y = C x + v.

    M = P C'(C P C' + Rv)^-1, L = A M, P = A P_filtered A' + Qw.

    :param Qw, Rv: covariances of the noise.
    :param period: sampling period [s], for the bandwidth and for messages.
    :raises StatementError, RefusedDesignError: as `lqe`.
    """
    check_period(period)
    A, C, Qw, Rv = _check(A, C, Qw, Rv, outputs, period)
    dual = _solve_dual(lambda: dlqr(A.T, C.T, Qw, Rv, period=period))
    P = dual.P
    M = linalg.solve(C @ P @ C.T + Rv, C @ P, assume_a='pos').T
    kept = np.eye(len(A)) - M @ C
    return _describe(dual, dual.K.T, M, P, kept @ P @ kept.T + M @ Rv @ M.T)


def sampled_lqe(A: ArrayLike, C: ArrayLike, Qw: ArrayLike, Rv: ArrayLike, period: float, *,
                outputs: tuple[str, ...] = ()) -> KalmanDesign:
    """
    Return the steady Kalman filter of dx/dt = A x + w that is measured once in each period.

    It is that of the plant and noise of `discretize_noise`.

    :param A, C, Qw: (n, n), (q, n), (n, n), plant and process noise in continuous time.
    :param Rv: (q, q), covariance of each measurement.
    :param period: [s].
    :param outputs: as for `lqe`.
    :raises StatementError, RefusedDesignError: as `lqe`; also if the period cannot be used.
    """
    check_period(period)
    A, C, Qw, Rv = _check(A, C, Qw, Rv, outputs, 0.0)
    Ad, Qd = discretize_noise(A, Qw, period)
    return dlqe(Ad, C, Qd, Rv, period=period, outputs=outputs)


def discretize_noise(A: Array, Qw: Array, period: float) -> tuple[Array, Array]:
    """
    Return Ad = exp(A period) and the covariance of the noise that arrives in a period.

    The covariance (n, n) is the integral of exp(A s) Qw exp(A's) over the period [s]. It is
    computed over a short time by one exponential (Van Loan 1978) and doubled, without growing
    exponentials.

    :raises StatementError: if a state within the period exceeds the range of double precision.
    """
    none = np.zeros((len(A), 0))
    Ad, _, sampled = discretize_cost(A.T, none, Weights(Qw, np.zeros((0, 0))), period)
    return Ad.T, sampled.Qx


def _check(A: ArrayLike, C: ArrayLike, Qw: ArrayLike, Rv: ArrayLike, outputs: tuple[str, ...],
           period: float) -> tuple[Array, Array, Array, Array]:
    A = check_matrix('A', A, (None, None))
    n = len(A)
    A = check_matrix('A', A, (n, n))
    C = check_matrix('C', C, (None, n))
    q = len(C)
    if len(outputs) not in (0, q):
        raise StatementError(f'outputs: {len(outputs)} names for {q} rows of C')
    Qw, Rv = check_semidefinite('Qw', Qw, n), check_definite('Rv', Rv, q)
    names = outputs or tuple(f'y{i}' for i in range(q))
    if reason := explain_no_estimator(A, C, Qw, names, period=period):
        raise RefusedDesignError(reason)
    return A, C, Qw, Rv


def _solve_dual(solve_regulator: Callable[[], LqrDesign]) -> LqrDesign:
    try:
        return solve_regulator()
    except RefusedDesignError as error:
        raise RefusedDesignError(
            "no estimator with verified stability was found; of its dual regulator (A', C', Qw "
            f'and Rv as A, B, Qx and Qu): {error}') from error


def _describe(dual: LqrDesign, L: Array, M: Array, P: Array, filtered: Array) -> KalmanDesign:
    figures = compute_margins(dual.A, dual.B, dual.K, dual.period)
    return KalmanDesign(
        A=dual.A.T, C=dual.B.T, Qw=dual.Qx, Rv=dual.Qu, L=L, M=M, P=P,
        P_filtered=0.5 * (filtered + filtered.T), E=dual.E, bandwidth=figures.bandwidth,
        residual=dual.residual, error=dual.error, robustness=dual.robustness,
        period=dual.period)
