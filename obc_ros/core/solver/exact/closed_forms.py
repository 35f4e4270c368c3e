# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Answers of chapter 2 that can be written down.

Examples 2.2 and 2.4, Exercises 2.2, 2.3, 2.4(a), 2.8 and 2.9. Where the book's formulas are
misprinted or lose digits, the corrected ones are evaluated, in a form that does not.
"""

from dataclasses import dataclass
from math import exp, inf, isfinite, isinf, nan, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import StatementError

_SKEW = 1e-12  # what rounding may leave of Y + Y', relative to Y


@dataclass(frozen=True, eq=False)
class ScalarPath:
    """
    An optimal trajectory of a scalar system.

    Attributes
    ----------
    t, x, u, lam : ndarray, shape (N,)
        Times [s], state, input, costate of H = u^2 / 2 + lam f.
    J : float
        Cost, P x(t0)^2 / 2.
    P : float
        Cost-to-go at t0; u(t0) = -b P x(t0).

    """

    t: Array
    x: Array
    u: Array
    lam: Array
    J: float
    P: float


def solve_scalar_finite_horizon(a: float, b: float, c: float, x0: float, t: ArrayLike, *,
                                t0: float = 0.0, tf: float) -> ScalarPath:
    """
    Return the minimum of the integral of u^2 / 2 over [t0, tf] + c x(tf)^2 / 2 for x' = a x + b u.

    Example 2.2, equations (2.4) and (2.5), for a > 0, and Exercise 2.4(a) with -a in place of a.
    With S = tf - t0 and r = tf - t, for either sign,

        x(t) = x0 e^(-|a| (S - r)) Q(r) / Q(S),    Q(r) = e^(-2 a r) + b^2 c W(r)  (a > 0),
                                                   Q(r) = 1 + b^2 c W(r)           (a <= 0),

    W(r) = (1 - e^(-2 |a| r)) / (2 |a|): a sum of terms of one sign, where (2.5) is a difference
    that has no digit left at a = 2, S = 10.

    Parameters
    ----------
    a, b : float
        System; b is not 0.
    c : float
        Weight of x(tf), >= 0; inf for x(tf) = 0, the limit of the example.
    x0 : float
        x(t0).
    t : array_like, shape (N,)
        Times within [t0, tf] [s].
    t0, tf : float
        [s], t0 < tf.

    Returns
    -------
    ScalarPath

    Raises
    ------
    StatementError
        If a number is not finite or out of its range.

    """
    _finite(a=a, b=b, x0=x0, t0=t0, tf=tf)
    if not c >= 0:
        raise StatementError(f'c = {c}: the weight of x(tf) is >= 0')
    _nonzero(b=b)
    times = _times(t, t0, tf)
    S, r, growth = tf - t0, tf - times, abs(a)
    # Everything divided by c where that is infinite.
    own, weight = (0.0, b * b) if isinf(c) else (1.0, b * b * c)
    size = 1.0 if isinf(c) else c

    def q(r: Array) -> Array:
        w = -np.expm1(-2 * growth * r) / (2 * growth) if growth else r
        return np.asarray(own * (np.exp(-2 * a * r) if a > 0 else 1.0) + weight * w)

    whole = float(q(np.array(S)))
    x = x0 * np.exp(-growth * (S - r)) * q(r) / whole
    fading = np.exp(-a * (S - r)) if a > 0 else np.exp(a * (S + r))
    lam = size * x0 / whole * fading
    P = size / whole * (1.0 if a > 0 else exp(2 * a * S))
    return ScalarPath(times, x, -b * lam, lam, P * x0 * x0 / 2, P)


def solve_scalar_infinite_horizon(a: float, b: float, x0: float, t: ArrayLike, *,
                                  t0: float = 0.0) -> ScalarPath:
    """
    Return the minimum of the integral of u^2 / 2 over [t0, inf) with x(inf) = 0, x' = a x + b u.

    Exercise 2.9: P = 2 a / b^2 and u = -b P x, so that x' = -a x. P = 0 solves the Riccati
    equation too; it is x(inf) = 0 that chooses P > 0. For a <= 0 nothing has to be done.

    Parameters
    ----------
    a, b, x0 : float
        System, b not 0, and x(t0).
    t : array_like, shape (N,)
        Times from t0 on [s].
    t0 : float
        [s]

    Returns
    -------
    ScalarPath

    Raises
    ------
    StatementError
        If a number is not finite or out of its range; if a = 0, where no minimum is attained.

    """
    _finite(a=a, b=b, x0=x0, t0=t0)
    _nonzero(a=a, b=b)
    times = np.asarray(t, dtype=float).ravel()
    if not ((times >= t0) & np.isfinite(times)).all():
        raise StatementError(f'times must be finite and not before t0 = {t0:g}')
    P = max(2 * a / b**2, 0.0)
    x = x0 * np.exp(-abs(a) * (times - t0))
    return ScalarPath(times, x, -b * P * x, P * x, P * x0 * x0 / 2, P)


def solve_scalar_between(a: float, b: float, x0: float, xf: float, t: ArrayLike, *,
                         t0: float = 0.0,
                         tf: float) -> ScalarPath:
    """
    Return the minimum of the integral of u^2 / 2 over [t0, tf] with x(tf) = xf, x' = a x + b u.

    What Exercise 2.4(d) compares flat trajectories with: part (a) leads from x(t0) = 0 nowhere.
    x'' = a^2 x, so that

        x(t) = (x0 sinh(a (tf - t)) + xf sinh(a (t - t0))) / sinh(a (tf - t0)),

    evaluated without overflow. P is nan, since J is no multiple of x0^2.

    Parameters
    ----------
    a, b, x0, xf : float
        System, b not 0, and x at both ends.
    t : array_like, shape (N,)
        Times within [t0, tf] [s].
    t0, tf : float
        [s], t0 < tf.

    Returns
    -------
    ScalarPath

    Raises
    ------
    StatementError
        If a number is not finite or out of its range.

    """
    _finite(a=a, b=b, x0=x0, xf=xf, t0=t0, tf=tf)
    _nonzero(b=b)
    times = _times(t, t0, tf)
    S, s, k = tf - t0, times - t0, abs(a)

    def w(r: Array) -> Array:
        return np.asarray(-np.expm1(-2 * k * r) / (2 * k) if k else r)

    whole = float(w(np.array(S)))
    x = (x0 * np.exp(-k * s) * w(S - s) + xf * np.exp(-k * (S - s)) * w(s)) / whole
    # What is missing at tf, seen from the end at which it is not small beside its growth.
    if a > 0:
        missing = xf * exp(-a * S) - x0
        u, J = missing * np.exp(-a * s) / (b * whole), missing**2 / (2 * b * b * whole)
    else:
        missing = xf - exp(a * S) * x0
        u, J = missing * np.exp(a * (S - s)) / (b * whole), missing**2 / (2 * b * b * whole)
    return ScalarPath(times, x, u, -u / b, J, nan)


@dataclass(frozen=True, eq=False)
class SecondOrderDesign:
    """
    A regulator of a second-order system.

    Attributes
    ----------
    K, P : ndarray, shape (1, 2) and (2, 2)
        u = -K x; J = x0'P x0.
    omega0 : float
        Natural frequency of the closed loop [rad/s].
    zeta : float
        Its damping ratio.

    """

    K: Array
    P: Array
    omega0: float
    zeta: float


def solve_double_integrator_regulator(q: float) -> SecondOrderDesign:
    """
    Return the minimum of the integral of q^2 x1^2 + u^2 for x1'' = u (Example 2.4).

    K = [q, sqrt(2 q)], the second row of P = [[sqrt(2 q^3), q], [q, sqrt(2 q)]], and
    omega0 = sqrt(q); the K and omega0 printed in the example hold for q = 1 only.
    """
    _positive(q=q)
    root = sqrt(2 * q)
    return SecondOrderDesign(np.array([[q, root]]), np.array([[q * root, q], [q, root]]),
                             sqrt(q), 1 / sqrt(2))


def solve_lag_regulator(a: float) -> SecondOrderDesign:
    """
    Return the minimum of the integral of x1^2 + u^2 for x1' = x2, x2' = -a x2 + u.

    Exercise 2.8: K = [1, sqrt(a^2 + 2) - a], omega0 = 1, zeta = sqrt(a^2 + 2) / 2. The zero b of
    the transfer function does not enter.
    """
    _positive(a=a)
    root = sqrt(a * a + 2)
    k = 2 / (root + a)
    return SecondOrderDesign(np.array([[1.0, k]]), np.array([[root, 1.0], [1.0, k]]), 1.0,
                             root / 2)


@dataclass(frozen=True, eq=False)
class BrockettPath:
    """
    Optimal inputs of Brockett's system.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times within [0, 1] [s].
    q, u : ndarray, shape (N, m)
        q(t) and its rate.
    J : float
        Integral of u'u / 2.

    """

    t: Array
    q: Array
    u: Array
    J: float


def solve_brockett(Y: ArrayLike, t: ArrayLike) -> BrockettPath:
    """
    Return the least integral of u'u / 2 over [0, 1] that leads (0, 0) to (0, Y).

    Exercise 2.2 for q' = u, Y' = q u' - u q', any m. The optimal inputs satisfy u' = Omega u with
    a constant skew Omega (a). With Y = sum of sigma_k (e_k f_k' - f_k e_k') over orthonormal
    planes, sigma_1 >= sigma_2 >= ..., the k-th plane is circled k times (c):

        u(t) = sum of sqrt(2 pi k sigma_k) (-e_k sin(2 pi k t) + f_k cos(2 pi k t)),
        J = pi (sigma_1 + 2 sigma_2 + 3 sigma_3 + ...).

    Different frequencies keep the planes from moving each other; the largest sigma gets the
    lowest. For m = 3 (b), Y z = y x z, there is one plane, normal to y, and J = pi |y|.

    Parameters
    ----------
    Y : array_like, shape (m, m)
        Y(1); skew, Y' = -Y.
    t : array_like, shape (N,)
        Times within [0, 1] [s].

    Returns
    -------
    BrockettPath

    Raises
    ------
    StatementError
        If Y is not a skew matrix of finite numbers, or a time is not within [0, 1].

    References
    ----------
    R. W. Brockett, Control theory and singular Riemannian geometry, in: New Directions in Applied
    Mathematics, Springer, 1981.

    """
    matrix = np.asarray(Y, dtype=float)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.size:
        raise StatementError(f'Y must be a square matrix; found shape {matrix.shape}')
    if not np.isfinite(matrix).all():
        raise StatementError('Y must consist of finite numbers')
    if np.abs(matrix + matrix.T).max() > _SKEW * np.abs(matrix).max():
        raise StatementError("Y must be skew, Y' = -Y")
    times = _times(t, 0.0, 1.0)
    # For an eigenvector v of i Y with eigenvalue s > 0: Y re(v) = s im(v), Y im(v) = -s re(v).
    values, vectors = np.linalg.eigh(1j * (matrix - matrix.T) / 2)
    q, u, J = np.zeros((len(times), len(matrix))), np.zeros((len(times), len(matrix))), 0.0
    for k, i in enumerate(np.argsort(-values)[:len(matrix) // 2], start=1):
        sigma = max(float(values[i]), 0.0)
        e, f = sqrt(2) * vectors[:, i].imag, sqrt(2) * vectors[:, i].real
        angle, rate = 2 * pi * k * times, sqrt(2 * pi * k * sigma)
        radius = rate / (2 * pi * k)
        u += rate * (np.outer(np.cos(angle), f) - np.outer(np.sin(angle), e))
        q += radius * (np.outer(np.sin(angle), f) + np.outer(np.cos(angle) - 1, e))
        J += pi * k * sigma
    return BrockettPath(times, q, u, J)


@dataclass(frozen=True, eq=False)
class StraightPath:
    """
    The shortest path between two points (Exercise 2.3), at constant speed over [0, 1].

    Attributes
    ----------
    t : ndarray, shape (N,)
    x, u : ndarray, shape (N, n)
        Positions and velocity.
    length : float
        Integral of |u|; the same for every other speed along the line.
    energy : float
        Integral of u'u, which constant speed alone minimises.
    lam : ndarray, shape (n,)
        Costate for the length, -u / |u|; zero for a path of no length.

    """

    t: Array
    x: Array
    u: Array
    length: float
    energy: float
    lam: Array


def solve_straight_line(x0: ArrayLike, xf: ArrayLike, t: ArrayLike) -> StraightPath:
    """
    Return the path of least length between two points, for x' = u over [0, 1].

    For L = |u| the conditions fix the direction of u and not its size: H = |u| + lam'u = 0 for
    every u along -lam. There is no maximum velocity in the problem.

    Parameters
    ----------
    x0, xf : array_like, shape (n,)
        [m]
    t : array_like, shape (N,)
        Times within [0, 1] [s].

    Raises
    ------
    StatementError
        If the points are not finite or not of one dimension, or a time is not within [0, 1].

    """
    start, end = np.asarray(x0, dtype=float), np.asarray(xf, dtype=float)
    if start.shape != end.shape or start.ndim != 1 or not start.size:
        raise StatementError(
            f'x0 and xf must be points of one dimension; found {start.shape} and {end.shape}')
    if not (np.isfinite(start).all() and np.isfinite(end).all()):
        raise StatementError('x0 and xf must consist of finite numbers')
    times = _times(t, 0.0, 1.0)
    u = end - start
    length = float(np.linalg.norm(u))
    return StraightPath(times, start + np.outer(times, u), np.tile(u, (len(times), 1)), length,
                        length**2, -u / length if length else np.zeros_like(u))


def _times(t: ArrayLike, t0: float, tf: float) -> Array:
    """Return t, shape (N,), checked to be within [t0, tf]."""
    if not t0 < tf:
        raise StatementError(f't0 = {t0:g} is not before tf = {tf:g}')
    times = np.asarray(t, dtype=float).ravel()
    if not ((times >= t0) & (times <= tf)).all():
        raise StatementError(f'times must lie within [{t0:g}, {tf:g}]')
    return times


def _finite(**values: float) -> None:
    for name, value in values.items():
        if not isfinite(value):
            raise StatementError(f'{name} = {value}: wanted a finite number')


def _nonzero(**values: float) -> None:
    for name, value in values.items():
        if value == 0:
            raise StatementError(f'{name} = 0: wanted another number')


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not 0 < value < inf:
            raise StatementError(f'{name} = {value}: wanted a finite number > 0')
