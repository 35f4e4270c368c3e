# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The linear quadratic regulator (section 2.4); see docs/regulator.md.

A design is returned only if closed-loop stability has been verified with bounds of the rounding
errors. Otherwise the error names the reason.
"""

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from obc_ros.core.lqr import stabilizability
from obc_ros.core.numerics.arrays import Array, lapack
from obc_ros.core.numerics.rounding import EPS
from obc_ros.core.riccati import care, checks, dare
from obc_ros.core.text.errors import RefusedDesignError, StatementError
from obc_ros.core.text.tables import Tabulated

_LARGEST_RESIDUAL = 1e-8
_LEAST_ROBUSTNESS = 10.0


@dataclass(frozen=True, eq=False, repr=False)
class LqrDesign(Tabulated):
    """
    A state feedback u = -K x with verified stability, the plant and the cost.

    :ivar A, B: (n, n), (n, m), the plant; the sampled plant if `period` is positive.
    :ivar Qx, Qu, cross: weights; `cross` is N (n, m) in 2 x'N u.
    :ivar stability: prescribed degree of stability [1/s].
    :ivar K, P: (m, n), gain; (n, n), Riccati solution, J* = x0'P x0.
    :ivar E: (n,), closed-loop poles, the slowest last; in the z plane if `period` is positive.
    :ivar residual: residual of the Riccati equation, relative to the size of its terms.
    :ivar error: estimated bound of the relative rounding error of P.
    :ivar robustness: lower bound: the closed loop stays stable if each entry of A, B and K changes
        by at most this many rounding units.
    :ivar period: sampling period [s]; 0: continuous time.
    """

    A: Array
    B: Array
    Qx: Array
    Qu: Array
    cross: Array | None
    stability: float
    K: Array
    P: Array
    E: NDArray[np.complex128]
    residual: float
    error: float
    robustness: float
    period: float = 0.0


@np.errstate(all='ignore')  # an overflow is rejected: a comparison with nan is false
def lqr(A: ArrayLike, B: ArrayLike, Qx: ArrayLike, Qu: ArrayLike, *,
        cross: ArrayLike | None = None, stability: float = 0.0, to_rest: bool = False
        ) -> LqrDesign:
    """
    Return the gain that minimises the integral of x'Qx x + 2 x'N u + u'Qu u for dx/dt = A x + B u.

    P solves A'P + P A - (P B + N) Qu^-1 (B'P + N') + Qx = 0, for A + stability I: equation (2.9)
    and Theorem 2.2 (its "Qu = H'H" must read Qx = H'H; stabilisability and detectability suffice).

    :param Qx, Qu, cross: weights; symmetric, Qu > 0, [[Qx, N], [N', Qu]] >= 0.
    :param stability: poles left of -stability [1/s] (Anderson and Moore).
    :param to_rest: require x(infinity) = 0 also for modes that are not detectable (Exercise 2.9).
    :raises StatementError: if a matrix has a wrong size, an entry that is not finite, or is not
        symmetric.
    :raises RefusedDesignError: if Qx or Qu is not definite, (A, B) is not stabilisable, (A, Qx) is
        not detectable, or stability and accuracy cannot be verified. The message names entry or
        mode.
    """
    A, B, Qx, Qu, cross = checks.check_matrices(A, B, Qx, Qu, cross)
    _check_stability(stability)
    L, Ac, Qc, sees_all = checks.remove_cross_term(A, B, Qx, Qu, cross)
    if stability:
        Ac = Ac + stability * np.eye(len(A))
    F = lapack.dtrtrs(L, B.T, lower=1)[0].T
    solution = care.solve_continuous(Ac, F, Qc)
    about: dict[str, Any] = {'stability': stability, 'has_cross': cross is not None}
    if solution is None:
        raise RefusedDesignError(stabilizability.explain_no_gain(Ac, F, Qc, **about))
    if not (sees_all or to_rest):
        stabilizability.check_detectable(Ac, F, Qc, **about)
    right = B.T @ solution.P
    if cross is not None:
        right += cross.T
    K = lapack.dpotrs(L, right, lower=1)[0]
    ratio = solution.scale / solution.scale[:, None]
    M = (A - B @ K) * ratio
    if not np.isfinite(M).all():
        raise RefusedDesignError(stabilizability.TOO_FAR_APART)
    E = np.sort_complex(_poles(M))
    if stability:
        M.flat[::len(A) + 1] += stability
    robust = care.measure_robustness(M, solution.X, _rounding(A, B, K) * ratio)
    if not (robust >= _LEAST_ROBUSTNESS and solution.error <= stabilizability.LARGEST_ERROR
            and solution.residual <= _LARGEST_RESIDUAL and E[-1].real < -stability):
        raise RefusedDesignError(stabilizability.explain_no_gain(
            Ac, F, Qc, error=solution.error, **about))
    return LqrDesign(A=A, B=B, Qx=Qx, Qu=Qu, cross=cross, stability=stability, K=K, P=solution.P,
                     E=E, residual=solution.residual, error=solution.error, robustness=robust)


@np.errstate(all='ignore')
def dlqr(A: ArrayLike, B: ArrayLike, Qx: ArrayLike, Qu: ArrayLike, *,
         cross: ArrayLike | None = None, stability: float = 0.0, period: float = 1.0
         ) -> LqrDesign:
    """
    Return the gain that minimises the sum of x'Qx x + 2 x'N u + u'Qu u for x+ = A x + B u.

    P solves A'P A - P + Qx = (A'P B + N) (Qu + B'P B)^-1 (..)', with exp(stability period) times A
    and B.

    :param stability: [1/s], |z| < exp(-stability period) for all poles z.
    :param period: sampling period [s].
    :raises StatementError, RefusedDesignError: as `lqr`.
    """
    A, B, Qx, Qu, cross = checks.check_matrices(A, B, Qx, Qu, cross)
    _check_stability(stability)
    check_period(period)
    growth = math.exp(min(stability * period, 200.0))
    L, Ac, Qc, sees_all = checks.remove_cross_term(A, B, Qx, Qu, cross)
    Ac = growth * Ac
    F = growth * lapack.dtrtrs(L, B.T, lower=1)[0].T
    scale = care.compute_balancing(Ac, F, Qc)
    ratio = scale / scale[:, None]
    solution = dare.solve_discrete(Ac * ratio, F / scale[:, None], Qc * (scale * scale[:, None]))
    about: dict[str, Any] = {'stability': stability, 'period': period,
                             'has_cross': cross is not None}
    if not sees_all:
        stabilizability.check_detectable(Ac, F, Qc, **about)
    if solution is None:
        raise RefusedDesignError(stabilizability.explain_no_gain(Ac, F, Qc, **about))
    P = solution.P / (scale * scale[:, None])
    BP = growth * growth * B.T @ P
    right = BP @ A
    if cross is not None:
        right += cross.T
    K = lapack.dposv(Qu + BP @ B, right, lower=1)[1]
    M = (A - B @ K) * ratio
    if not np.isfinite(M).all():
        raise RefusedDesignError(stabilizability.TOO_FAR_APART)
    E = _poles(M)
    E = E[np.lexsort((E.imag, E.real, np.abs(E).round(12)))]
    robust = dare.measure_discrete_robustness(growth * M, solution.X,
                                              growth * _rounding(A, B, K) * ratio)
    if not (robust >= _LEAST_ROBUSTNESS and solution.error <= stabilizability.LARGEST_ERROR
            and solution.residual <= _LARGEST_RESIDUAL and np.abs(E).max() < 1.0 / growth):
        raise RefusedDesignError(stabilizability.explain_no_gain(
            Ac, F, Qc, error=solution.error, **about))
    return LqrDesign(A=A, B=B, Qx=Qx, Qu=Qu, cross=cross, stability=stability, K=K, P=P, E=E,
                     residual=solution.residual, error=solution.error, robustness=robust,
                     period=period)


def check_period(period: float) -> None:
    """Raise StatementError if a sampling period [s] is not positive and finite."""
    if not (math.isfinite(period) and period > 0.0):
        raise StatementError(f'period = {period:g}: wanted a positive number of seconds')


def _check_stability(stability: float) -> None:
    if not (math.isfinite(stability) and stability >= 0.0):
        raise StatementError(f'stability = {stability:g}: wanted 0 or a positive number')


def _rounding(A: Array, B: Array, K: Array) -> Array:
    """Return a bound of the rounding error of A - B K, entry by entry."""
    bound: Array = EPS * (np.abs(A) + (B.shape[1] + 2) * (np.abs(B) @ np.abs(K)))
    return bound


def _poles(M: Array) -> NDArray[np.complex128]:
    wr, wi, _, _, info = lapack.dgeev(M, compute_vl=0, compute_vr=0)
    poles: NDArray[np.complex128] = wr + 1j * wi
    return poles if info == 0 else np.full(len(M), complex(math.nan))
