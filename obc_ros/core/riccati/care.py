# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The continuous algebraic Riccati equation (2.9), with a bound of the error.

A'P + P A - P G P + Q = 0, G = B Qu^-1 B', by the invariant subspace (Laub 1979) and Newton's
method (Kleinman 1968): see docs/regulator.md.
"""

from collections.abc import Callable
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, lapack
from obc_ros.core.numerics.rounding import COMFORTABLE, compute_mode_tolerance, EPS, norm, TINY
from obc_ros.core.riccati import dare, propagation


def solve_continuous(A: Array, F: Array, Q: Array) -> dare.AssessedSolution | None:
    """
    Return the stabilising solution of A'P + P A - P F F'P + Q = 0.

    A. J. Laub, A Schur method for solving algebraic Riccati equations, IEEE TAC 24, 1979.
    D. L. Kleinman, On an iterative technique for Riccati equation computations, IEEE TAC 13,
    1968.

    :param F: (n, m), any factor of G = F F', such as B L'^-1 with Qu = L L'.
    :return: None if there is no stabilising solution within rounding: (A, F) is not stabilisable,
        or a mode on the imaginary axis is unobservable in Q. Otherwise `error` states the
        accuracy; whether the gain stabilises is checked by `measure_robustness`.
    """
    scale = compute_balancing(A, F, Q)
    A = A * (scale / scale[:, None])
    F = F / scale[:, None]
    Q = Q * (scale * scale[:, None])
    G = F @ F.T
    found = _by_doubling(A, G, Q) if len(A) >= _LARGE else None
    if found is None or not found.error <= _WANTED_ERROR:
        found = _by_schur(A, G, Q)
    if found is not None and _WANTED_ERROR < found.error < math.inf:
        found = _refine(A, F, Q, found)
    if found is None or not math.isfinite(found.error):
        return None
    return found._replace(P=found.P / (scale * scale[:, None]), scale=scale)


def compute_balancing(A: Array, F: Array, Q: Array) -> Array:
    """
    Return the scaling d for which x = diag(d) z balances the Hamiltonian matrix.

    Its entries are powers of 2, so that scaling is exact; 1 if the matrix is not finite.
    """
    n = len(A)
    H = np.empty((2 * n, 2 * n), order='F')
    H[:n, :n], H[:n, n:], H[n:, :n], H[n:, n:] = A, F @ F.T, Q, A.T
    if not np.isfinite(H).all():
        return np.ones(n)
    scale = lapack.dgebal(H, scale=1, permute=0)[3]
    return np.asarray(np.exp2(np.rint(0.5 * np.log2(scale[:n] / scale[n:]))))


_LARGE = 40  # states from which doubling, which consists of matrix products, beats Schur
_REFINEMENTS = 12
_WANTED_ERROR = 1e-10  # of the estimated bound, which is about a hundred times the error


def _is_stable(re: float, im: float) -> bool:
    return re < 0.0


def _by_schur(A: Array, G: Array, Q: Array) -> dare.AssessedSolution | None:
    """Return the solution spanned by the stable subspace."""
    n = len(A)
    H = np.empty((2 * n, 2 * n), order='F')
    H[:n, :n], H[:n, n:], H[n:, :n], H[n:, n:] = A, -G, -Q, -A.T
    if not np.isfinite(H).all():
        return None
    T, stable, _, _, U, _, info = lapack.dgees(
        _is_stable, H, sort_t=1, lwork=6 * n if n < 30 else 64 * n, overwrite_a=1)
    if stable != n or 0 < info <= 2 * n:
        return None
    T, V = T[:n, :n], U[:n, :n]
    lu, pivots, info = lapack.dgetrf(V)
    if info:
        return None
    W = lapack.dgetri(lu, pivots)[0]
    P = U[n:, :n].dot(W)
    return _newton(A, G, Q, 0.5 * (P + P.T), lambda C: _lyapunov(C, T, V, W))


def _by_doubling(A: Array, G: Array, Q: Array) -> dare.AssessedSolution | None:
    """
    Apply the Cayley transform and solve the discrete equation by doubling.

    E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, A structure-preserving doubling algorithm for
    continuous-time algebraic Riccati equations, Linear Algebra and its Applications 396, 2005.
    """
    n = len(A)
    identity = np.eye(n)
    speed = math.sqrt((norm(A)**2 + norm(G) * norm(Q)) / n)
    if not 0.0 < speed < math.inf:
        return None
    try:
        left = np.linalg.inv(A - speed * identity)
        right = np.linalg.inv((A - speed * identity).T + Q @ left @ G)
        P = propagation.double_horizon(identity + 2.0 * speed * right.T,
                                       2.0 * speed * left @ G @ right,
                                       2.0 * speed * right @ Q @ left)
        if P is None:
            return None
        M = A - G @ P
        back = np.linalg.inv(M - speed * identity)
    except np.linalg.LinAlgError:
        return None
    step = identity + 2.0 * speed * back

    def lyapunov(C: Array) -> Array:
        X = dare.solve_stein(step, 2.0 * speed * back.T @ C @ back)
        return np.full_like(C, math.nan) if X is None else X

    return _newton(A, G, Q, P, lyapunov)


def _newton(A: Array, G: Array, Q: Array, P: Array, lyapunov: Callable[[Array], Array]
            ) -> dare.AssessedSolution:
    """Correct P once; lyapunov(C) solves M'X + X M = -C for M = A - G P."""
    R, terms = _residual(A, G, Q, P)
    before = norm(R) / terms
    corrected = P + lyapunov(R)
    R, terms = _residual(A, G, Q, corrected)
    after = norm(R) / terms
    if not after <= before:
        corrected, after = P, before
    X = lyapunov(np.eye(len(A)))
    error = (after + len(A) * EPS) * terms * norm(X) / (norm(corrected) + TINY)
    return dare.AssessedSolution(corrected, after, error, X)


def _residual(A: Array, G: Array, Q: Array, P: Array) -> tuple[Array, float]:
    """Return A'P + P A - P G P + Q and the size of its terms."""
    PA = P.dot(A)  # for small matrices `dot` takes half the time of `@`
    PGP = P.dot(G).dot(P)
    R: Array = PA + PA.T - PGP + Q
    return R, 2.0 * norm(PA) + norm(PGP) + norm(Q) + TINY


def _lyapunov(C: Array, T: Array, V: Array, W: Array) -> Array:
    """Return X with M'X + X M = -C for M = V T W, T quasi-triangular and W = V^-1."""
    Y, size, _ = lapack.dtrsyl(T, T, V.T.dot(C).dot(V), trana='T')
    half: Array = W.T.dot(Y).dot(W) * (-0.5 / size)
    return half + half.T


def _refine(A: Array, F: Array, Q: Array, start: dare.AssessedSolution) -> dare.AssessedSolution:
    """
    Continue with Newton's method; the residual is evaluated in extended precision.

    The error is then the norm of the last correction plus the effect of rounding the residual.
    """
    wide = np.longdouble
    P, F_wide, A_wide, Q_wide = (M.astype(wide) for M in (start.P, F, A, Q))
    G_wide = F_wide @ F_wide.T
    X, step = start.X, math.inf
    for _ in range(_REFINEMENTS):
        M = (A_wide - G_wide @ P).astype(float)
        T, _, wr, _, V, _, info = lapack.dgees(_is_stable, M, lwork=64 * len(A))
        if info or not wr.max() < 0.0:
            return start
        PA = P @ A_wide
        R = (PA + PA.T - P @ G_wide @ P + Q_wide).astype(float)
        correction = _lyapunov(0.5 * (R + R.T), T, V, V.T)
        size = norm(correction) / (norm(P.astype(float)) + TINY)
        if not size < step:
            break
        P, step, X = P + correction, size, _lyapunov(np.eye(len(A)), T, V, V.T)
        if step <= EPS:
            break
    narrow = P.astype(float)
    terms = np.abs(narrow) @ np.abs(A)
    terms = terms + terms.T + np.abs(narrow) @ np.abs(F @ F.T) @ np.abs(narrow) + np.abs(Q)
    lost = len(A) * float(np.finfo(wide).eps) * min(
        norm(_sensitivity(M, terms)), norm(terms) * norm(X))
    # Where G is large in directions that cancel in P G P, the residual of the rounded P has the
    # size of the terms within this product.
    R, size = _residual(A, F @ F.T, Q, narrow)
    error = step + EPS + lost / (norm(narrow) + TINY)
    return dare.AssessedSolution(narrow, norm(R) / max(size, norm(terms)), error, X)


def _sensitivity(M: Array, C: Array) -> Array:
    """Return a bound of |X| for M'X + X M = E and all |E| <= C, entry by entry."""
    modes, V = np.linalg.eig(M)
    if not modes.real.max() < 0.0:
        return np.full_like(M, math.inf)
    size, inverse = np.abs(V), np.abs(np.linalg.inv(V))
    inner = (size.T @ C @ size) / np.abs(modes.real + modes.real[:, None])
    bound: Array = inverse.T @ inner @ inverse
    return bound


def measure_robustness(M: Array, X: Array, rounding: Array) -> float:
    """
    Bound from below the factor c for which M + c E is stable for all |E| <= rounding.

    :param M, X: (n, n), X should solve M'X + X M = -I; the residual is checked.
    :param rounding: (n, n), bound of the absolute error of each entry of M.
    :return: the lower bound of c, from (M + E)'X + X (M + E) < 0 or `compute_mode_tolerance`; 0
        if stability is not verified.
    """
    bound = 0.0
    if not lapack.dpotrf(X)[1]:
        S = X @ M
        S += S.T
        S.flat[::len(M) + 1] += 1.0
        left = 1.0 - norm(S) - 4.0 * len(M) * EPS * norm(X) * norm(M)
        bound = max(0.0, left / (2.0 * norm(X) * max(norm(rounding), TINY)))
    return bound if bound > COMFORTABLE else max(
        bound, compute_mode_tolerance(M, lambda modes: -modes.real, rounding))
