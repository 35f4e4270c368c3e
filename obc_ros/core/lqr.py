# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The linear quadratic regulator (section 2.4).

Minimise J = integral of x'Qx x + 2 x'N u + u'Qu u over [0, infinity) subject to dx/dt = A x + B u.

A design is returned only with its proof; otherwise the error says in words what stands against it.
"""

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from obc_ros.core import care
from obc_ros.core.errors import RefusedDesignError, StatementError
from scipy.linalg import lapack

Array = NDArray[np.float64]

LARGEST = 400  # states; far beyond it one request would block its server for minutes

_LARGEST_NUMBER = 1e100  # products of four stay finite

_TOO_FAR_APART = 'A, B, Qx and Qu are too far apart in size for double precision'

# What a design has to clear. An error of P of 1e-4 is one in the fourth digit of the gain.
_LARGEST_ERROR = 1e-4
_LARGEST_RESIDUAL = 1e-8
_LEAST_ROBUSTNESS = 10.0
_UNSEEN = 1e-14  # relative distance to an unobservable pair at which a mode counts as unseen


@dataclass(frozen=True, eq=False)
class LqrDesign:
    """
    A state feedback u = -K x that is proved to stabilise, and what it was designed for.

    Attributes
    ----------
    A, B : ndarray, shape (n, n) and (n, m)
        The plant; of the sampled plant when `period` is positive.
    Qx, Qu : ndarray, shape (n, n) and (m, m)
        Weights.
    cross : ndarray, shape (n, m), or None
        N of 2 x'N u.
    stability : float
        Prescribed degree of stability [1/s].
    K : ndarray, shape (m, n)
        Gain.
    P : ndarray, shape (n, n)
        Riccati solution; J* = x0'P x0.
    E : ndarray, shape (n,), complex
        Closed-loop poles, the rightmost last; of A - B K in the z plane when `period` is positive.
    residual : float
        Of the Riccati equation, relative to the size of its terms.
    error : float
        Estimated bound of the relative error of P made by rounding.
    robustness : float
        The closed loop stays stable when each entry of A, B and K is wrong by this many units of
        rounding (a lower bound).
    period : float
        Sampling period [s]; 0: continuous time.

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


@np.errstate(all='ignore')  # what overflows is refused: no comparison with nan holds
def lqr(A: ArrayLike, B: ArrayLike, Qx: ArrayLike, Qu: ArrayLike, *,
        cross: ArrayLike | None = None, stability: float = 0.0, to_rest: bool = False
        ) -> LqrDesign:
    """
    Return the gain that minimises the integral of x'Qx x + 2 x'N u + u'Qu u for dx/dt = A x + B u.

    Parameters
    ----------
    A, B : array_like, shape (n, n) and (n, m)
        Linearization of f at the equilibrium.
    Qx, Qu : array_like, shape (n, n) and (m, m)
        Weights; symmetric, Qx >= 0, Qu > 0.
    cross : array_like, shape (n, m), optional
        N of 2 x'N u; [[Qx, N], [N', Qu]] >= 0.
    stability : float
        Prescribed degree of stability [1/s]: poles left of -stability (Anderson and Moore).
    to_rest : bool
        Demand x(infinity) = 0 even of modes that the cost does not see (Exercise 2.9).

    Returns
    -------
    LqrDesign
        ``K`` (m, n), ``P`` (n, n) solving A'P + P A - (P B + N) Qu^-1 (B'P + N') + Qx = 0 (for
        A + stability I), ``E`` (n,).

    Raises
    ------
    StatementError
        If a matrix has a wrong size, an entry that is no finite number, or is not symmetric.
    RefusedDesignError
        If no gain can be proved to stabilise and to be optimal: Qx or Qu not definite, an unstable
        mode of A out of reach of B or not seen by Qx, or a problem too ill-conditioned. The
        message names the entry or the mode.

    References
    ----------
    Equation (2.9) and Theorem 2.2 (its "Qu = H'H" must read Qx = H'H; stabilisable and detectable
    is enough).

    """
    A, B, Qx, Qu, cross = _checked(A, B, Qx, Qu, cross)
    if not (math.isfinite(stability) and stability >= 0.0):
        raise StatementError(f'stability = {stability:g}: wanted 0 or a positive number')
    L, Ac, Qc, sees_all = _reduced(A, B, Qx, Qu, cross)
    if stability:
        Ac = Ac + stability * np.eye(len(A))
    F = lapack.dtrtrs(L, B.T, lower=1)[0].T
    solution = care.solve_continuous(Ac, F, Qc)
    if solution is None:
        raise RefusedDesignError(_why_not(Ac, F, Qc, stability))
    if not (sees_all or to_rest):
        _check_detectable(Ac, F, Qc, stability)
    right = B.T @ solution.P
    if cross is not None:
        right += cross.T
    K = lapack.dpotrs(L, right, lower=1)[0]
    d = solution.scale
    ratio = d / d[:, None]
    M = (A - B @ K) * ratio
    rounding = care.EPS * (np.abs(A) + (B.shape[1] + 2) * (np.abs(B) @ np.abs(K))) * ratio
    if not np.isfinite(M).all():
        raise RefusedDesignError(_TOO_FAR_APART)
    wr, wi, _, _, info = lapack.dgeev(M, compute_vl=0, compute_vr=0)
    if stability:
        M.flat[::len(A) + 1] += stability
    robust = care.robustness(M, solution.X, rounding)
    if (not robust >= _LEAST_ROBUSTNESS or not solution.error <= _LARGEST_ERROR
            or not solution.residual <= _LARGEST_RESIDUAL or info or wr.max() >= -stability):
        raise RefusedDesignError(_why_not(Ac, F, Qc, stability, solution.error))
    E = np.sort_complex(wr + 1j * wi)
    return LqrDesign(A, B, Qx, Qu, cross, stability, K, solution.P, E, solution.residual,
                     solution.error, robust)


def _checked(A: Any, B: Any, Qx: Any, Qu: Any, cross: Any
             ) -> tuple[Array, Array, Array, Array, Array | None]:
    """Return float copies of matrices that fit, or say which does not."""
    A, B = _matrix('A', A), _matrix('B', B)
    n, m = len(A), B.shape[1]
    _check_size('A', A, (n, n))
    _check_size('B', B, (n, m))
    if not n or not m:
        raise StatementError('A and B: wanted at least one state and one input')
    if n > LARGEST or m > LARGEST:
        raise StatementError(f'{max(n, m)} states or inputs: at most {LARGEST} are taken')
    Qx, Qu = _symmetric('Qx', Qx, n), _symmetric('Qu', Qu, m)
    if cross is not None:
        cross = _matrix('cross', cross)
        _check_size('cross', cross, (n, m))
    return A, B, Qx, Qu, cross


def _matrix(name: str, M: Any) -> Array:
    try:
        given = np.array(M)
    except ValueError as error:
        raise StatementError(f'{name}: wanted rows of equal length') from error
    if given.dtype.kind not in 'fiu':
        raise StatementError(f'{name}: wanted a matrix of real numbers')
    if given.ndim != 2:
        raise StatementError(f'{name}: expected a matrix (rows, columns) but found {given.shape}')
    matrix: Array = given.astype(float, copy=False)
    usable = np.abs(matrix) <= _LARGEST_NUMBER
    if not usable.all():
        i, j = np.argwhere(~usable)[0]
        raise StatementError(f'{name}[{i}, {j}] = {matrix[i, j]:g}: wanted a finite number of at '
                             f'most {_LARGEST_NUMBER:g}')
    return matrix


def _check_size(name: str, M: Array, shape: tuple[int, int]) -> None:
    if M.shape != shape:
        raise StatementError(f'{name}: expected {shape} but found {M.shape}')


def _symmetric(name: str, M: Any, n: int) -> Array:
    matrix = _matrix(name, M)
    _check_size(name, matrix, (n, n))
    gap = np.abs(matrix - matrix.T)
    if gap.any():
        size = np.sqrt(np.abs(matrix.diagonal()))
        wrong = gap > 1e-10 * (size * size[:, None] + np.abs(matrix))
        if wrong.any():
            i, j = np.argwhere(wrong)[0]
            raise StatementError(f'{name}[{i}, {j}] = {matrix[i, j]:g} but {name}[{j}, {i}] = '
                                 f'{matrix[j, i]:g}: {name} must be symmetric')
        matrix = 0.5 * (matrix + matrix.T)
    return matrix


def _reduced(A: Array, B: Array, Qx: Array, Qu: Array, cross: Array | None
             ) -> tuple[Array, Array, Array, bool]:
    """
    Check the weights and remove the cross term.

    Returns
    -------
    L : ndarray, shape (m, m)
        Qu = L L'.
    A, Q : ndarray, shape (n, n)
        A - B Qu^-1 N' and Qx - N Qu^-1 N'.
    sees_all : bool
        Whether Q is positive definite, so that every mode is seen.

    """
    L = _definite('Qu', Qu)
    Q = Qx
    if cross is not None:
        right = lapack.dpotrs(L, cross.T, lower=1)[0]
        A = A - B @ right
        Q = Qx - cross @ right
        Q = 0.5 * (Q + Q.T)
    root, info = lapack.dpotrf(Q, lower=1)
    diagonal = Q.diagonal()
    sees_all = info == 0 and bool((root.diagonal()**2 > 1e-10 * diagonal).all())
    if not sees_all:
        _check_semidefinite(Qx, Q, cross is not None)
    return L, A, Q, sees_all


def _definite(name: str, M: Array) -> Array:
    """Return the lower Cholesky factor, or say why there is none."""
    L: Array
    L, info = lapack.dpotrf(M, lower=1)
    diagonal = M.diagonal()
    if info or (L.diagonal()**2 <= 4 * len(M) * care.EPS * diagonal).any():
        for i, value in enumerate(diagonal):
            if value <= 0.0:
                raise RefusedDesignError(
                    f'{name}[{i}] = {value:g}: {name} must be positive definite')
        least = _least_eigenvalue(M)
        raise RefusedDesignError(f'{name} is no positive definite matrix: scaled to a unit '
                                 f'diagonal it has the eigenvalue {least:.3g}')
    return L


def _check_semidefinite(Qx: Array, Q: Array, is_reduced: bool) -> None:
    """Refuse Qx that is not positive semidefinite; Q is Qx - N Qu^-1 N'."""
    for i, value in enumerate(Qx.diagonal()):
        if value < 0.0:
            raise RefusedDesignError(f'Qx[{i}] = {value:g}: Qx must be positive semidefinite')
    for i, j in np.argwhere(np.abs(Qx) > 0.0):
        if Qx[i, i] == 0.0 and i != j:
            raise RefusedDesignError(f'Qx[{i}, {j}] = {Qx[i, j]:g} but Qx[{i}, {i}] = 0: '
                                     f'Qx must be positive semidefinite')
    # The reduced Q has the rounding of Qx: both are seen in the units of Qx.
    size = np.sqrt(np.where(Qx.diagonal() > 0.0, Qx.diagonal(), 1.0))
    least = float(np.linalg.eigvalsh(Q / size / size[:, None])[0])
    if least < -1e-12 * len(Q):
        what = 'the matrix of Qx, cross and Qu' if is_reduced else 'Qx'
        raise RefusedDesignError(f'{what} must be positive semidefinite: scaled to a unit '
                                 f'diagonal it has the eigenvalue {least:.3g}')


def _least_eigenvalue(M: Array) -> float:
    size = np.sqrt(M.diagonal())
    return float(np.linalg.eigvalsh(M / size / size[:, None])[0])


def _lost(A: Array, C: Array, tolerance: float) -> NDArray[np.complex128]:
    """
    Return the modes of A that do not decay and that C does not see.

    A mode s is seen when the smallest singular value of [A - s I; C], C scaled to the norm of A,
    is above `tolerance` times that norm (the test of Popov, Belevitch and Hautus). Only the
    invariant subspace of such modes is looked at.
    """
    n = len(A)
    size = max(float(np.linalg.norm(A)), 1e-300)
    border = -n * care.EPS * size
    T, k, wr, wi, U, _, _ = lapack.dgees(lambda re, im: re >= border, A, sort_t=1)
    T = T[:k, :k] / size
    seen = np.asarray(np.linalg.qr(C @ U[:, :k], mode='r'))
    seen = seen / max(float(np.linalg.norm(C)), 1e-300)
    modes = (wr + 1j * wi)[:k]
    distances = [np.linalg.svd(np.vstack([T - mode / size * np.eye(k), seen]), compute_uv=False)
                 for mode in modes]
    lost: NDArray[np.complex128] = modes[[values[-1] < tolerance for values in distances]]
    return lost


def _named(modes: NDArray[np.complex128], stability: float) -> str:
    """Name modes, of A + stability I, once each; of a conjugate pair one."""
    names = []
    for mode in modes:
        re, im = mode.real - stability + 0.0, abs(mode.imag)
        if abs(re) < 1e-12 * abs(mode):
            re = 0.0
        name = f'{re:+.4g}' if im == 0.0 else f'{re:+.4g} +- {im:.4g}j'
        if name not in names:
            names.append(name)
    return ('the modes at ' if len(names) > 1 else 'the mode at ') + ' and '.join(names)


def _clause(modes: NDArray[np.complex128], text: str, stability: float) -> str:
    named = _named(modes, stability)
    return f'{named} of A {"are" if named.startswith("the modes") else "is"} {text}'


def _why_not(A: Array, F: Array, Q: Array, stability: float, error: float = math.nan) -> str:
    """Say why dx/dt = A x + F u with weight Q has no stabilising gain that can be proved."""
    d = care.balancing(A, F, Q)
    A, F, Q = A * (d / d[:, None]), F / d[:, None], Q * (d * d[:, None])
    if not np.isfinite(np.array([np.linalg.norm(M) for M in (A, F @ F.T, Q)])).all():
        return _TOO_FAR_APART
    wanted = f' and a degree of stability of {stability:g} is wanted' if stability else ''
    lost = _lost(A.T, F.T, 1e-8)
    if lost.size:
        return _clause(lost, 'out of reach of the inputs', stability) + wanted
    unseen = _lost(A, Q, 1e-8)
    unseen = unseen[unseen.real <= 1e-8 * np.linalg.norm(A)]
    if unseen.size:
        return _clause(unseen, 'not seen by Qx; give it a weight', stability) + wanted
    if math.isfinite(error) and error > _LARGEST_ERROR:
        return (f'the Riccati equation is too ill-conditioned: rounding leaves P uncertain by '
                f'{min(error, 1.0):.1g} of its size; bring the weights closer together')
    return ('no gain can be proved to stabilise: rounding alone may put a mode of the closed loop '
            'on the border of stability; bring the weights closer together')


def _check_detectable(A: Array, F: Array, Q: Array, stability: float) -> None:
    """Refuse when the cost does not see a mode of A that does not decay."""
    d = care.balancing(A, F, Q)
    unseen = _lost(A * (d / d[:, None]), Q * (d * d[:, None]), _UNSEEN)
    if unseen.size:
        raise RefusedDesignError(
            _clause(unseen, 'not seen by Qx: the least cost leaves it as it is; give it a weight',
                    stability))
