# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Closed-form solutions of problems of chapter 2.

Examples 2.2 and 2.4, Exercises 2.2, 2.3, 2.4(a) and 2.8. Misprints of the book are corrected,
and formulas that lose digits are evaluated in an equivalent form that does not.
"""

from dataclasses import dataclass
from math import exp, inf, isfinite, isinf, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike
from obc_ros.core.numerics.arrays import Array, special
from obc_ros.core.text.errors import StatementError

_SKEW = 1e-12  # largest Y + Y' that counts as rounding, relative to Y


@dataclass(frozen=True, eq=False)
class ScalarPath:
    """Optimal x, u and costate lam (N,) at t (N,) [s]; J = P x(0)^2 / 2, u(0) = -b P x(0)."""

    t: Array
    x: Array
    u: Array
    lam: Array
    J: float
    P: float


def solve_scalar_finite_horizon(a: float, b: float, c: float, x0: float, t: ArrayLike, *,
                                tf: float) -> ScalarPath:
    """
    Minimise the integral of u^2 / 2 over [0, tf] + c x(tf)^2 / 2 subject to x' = a x + b u.

    With r = tf - t, for either sign of a,

        x(t) = x0 e^(-|a| t) Q(r) / Q(tf),         Q(r) = e^(-2 a r) + b^2 c W(r)  (a > 0),
                                                   Q(r) = 1 + b^2 c W(r)           (a <= 0),

    W(r) = (1 - e^(-2 |a| r)) / (2 |a|). All terms of this sum have one sign. Equation (2.5) is a
    difference, which has no correct digit left at a = 2, tf = 10.

    Example 2.2, equations (2.4) and (2.5), for a > 0; Exercise 2.4(a) with -a in place of a.

    :param a, b: system; b is not 0.
    :param c: weight of x(tf), >= 0; inf for x(tf) = 0, the limit of the example.
    :param x0: x(0).
    :param t: (N,), times within [0, tf] [s].
    :param tf: [s], > 0.
    :raises StatementError: if a number is not finite or out of its range.
    """
    _finite(a=a, b=b, x0=x0, tf=tf)
    if not c >= 0:
        raise StatementError(f'c = {c}: the weight of x(tf) must be >= 0')
    if b == 0:
        raise StatementError('b = 0: wanted a nonzero number')
    times = _times(t, tf)
    r, growth = tf - times, abs(a)
    # If c is infinite, numerators and denominators are divided by c.
    own, weight = (0.0, b * b) if isinf(c) else (1.0, b * b * c)
    size = 1.0 if isinf(c) else c

    def q(r: Array) -> Array:
        return np.asarray(own * (np.exp(-2 * a * r) if a > 0 else 1.0)
                          + weight * _decayed(growth, r))

    whole = float(q(np.array(tf)))
    x = x0 * np.exp(-growth * times) * q(r) / whole
    fading = np.exp(-a * times) if a > 0 else np.exp(a * (tf + r))
    lam = size * x0 / whole * fading
    P = size / whole * (1.0 if a > 0 else exp(2 * a * tf))
    return ScalarPath(times, x, -b * lam, lam, P * x0 * x0 / 2, P)


@dataclass(frozen=True, eq=False)
class SecondOrderDesign:
    """K (1, 2) of u = -K x, P (2, 2) of J = x0'P x0; omega0 [rad/s] and zeta of the loop."""

    K: Array
    P: Array
    omega0: float
    zeta: float


def solve_double_integrator_regulator(q: float) -> SecondOrderDesign:
    """
    Minimise the integral of q^2 x1^2 + u^2 over [0, inf) subject to x1'' = u, q > 0.

    K = [q, sqrt(2 q)], the second row of P = [[sqrt(2 q^3), q], [q, sqrt(2 q)]], and
    omega0 = sqrt(q). The K and omega0 printed in Example 2.4 hold for q = 1 only.
    """
    _positive(q=q)
    root = sqrt(2 * q)
    return SecondOrderDesign(np.array([[q, root]]), np.array([[q * root, q], [q, root]]),
                             sqrt(q), 1 / sqrt(2))


def solve_lag_regulator(a: float) -> SecondOrderDesign:
    """
    Minimise the integral of x1^2 + u^2 over [0, inf) subject to x1' = x2, x2' = -a x2 + u, a > 0.

    K = [1, sqrt(a^2 + 2) - a], omega0 = 1, zeta = sqrt(a^2 + 2) / 2. The zero b of the transfer
    function has no influence. Exercise 2.8.
    """
    _positive(a=a)
    root = sqrt(a * a + 2)
    k = 2 / (root + a)
    return SecondOrderDesign(np.array([[1.0, k]]), np.array([[root, 1.0], [1.0, k]]), 1.0,
                             root / 2)


@dataclass(frozen=True, eq=False)
class BrockettPath:
    """Optimal q (N, m) and its rate u at t (N,) [s]; J is the integral of u'u / 2."""

    t: Array
    q: Array
    u: Array
    J: float


def solve_brockett(Y: ArrayLike, t: ArrayLike) -> BrockettPath:
    """
    Minimise the integral of u'u / 2 over [0, 1] from (0, 0) to (0, Y) for Brockett's system.

    The system is dq/dt = u, dY/dt = q u' - u q' with q and u of any size m. The optimal inputs
    satisfy du/dt = Omega u with a constant skew-symmetric Omega (a). Let Y be the sum of
    sigma_k (e_k f_k' - f_k e_k') over orthonormal pairs (e_k, f_k), sigma_1 >= sigma_2 >= ... The
    path circles k times in the k-th plane (c):

        u(t) = sum of sqrt(2 pi k sigma_k) (-e_k sin(2 pi k t) + f_k cos(2 pi k t)),
        J = pi (sigma_1 + 2 sigma_2 + 3 sigma_3 + ...).

    Because the frequencies differ, the motions in different planes do not interact; the largest
    sigma has the lowest frequency. For m = 3 (b), with Y z = y x z, there is one plane, normal to
    y, and J = pi |y|.

    Exercise 2.2. R. W. Brockett, Control theory and singular Riemannian geometry, in: New
    Directions in Applied Mathematics, Springer, 1981.

    :param Y: (m, m), Y(1); skew, Y' = -Y.
    :param t: (N,), times within [0, 1] [s].
    :raises StatementError: if Y is not a skew-symmetric matrix of finite numbers, or a time is not
        within [0, 1].
    """
    matrix = np.asarray(Y, dtype=float)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.size:
        raise StatementError(f'Y must be a square matrix; found shape {matrix.shape}')
    if not np.isfinite(matrix).all():
        raise StatementError('Y must consist of finite numbers')
    if np.abs(matrix + matrix.T).max() > _SKEW * np.abs(matrix).max():
        raise StatementError("Y must be skew-symmetric, Y' = -Y")
    times = _times(t, 1.0)
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
    Shortest path between two points, at constant speed over t (N,) from 0 to 1 s.

    :ivar x, u: (N, n), position [m] and velocity [m/s].
    :ivar length: integral of |u| [m]; it does not depend on the speed along the line.
    :ivar energy: integral of u'u; only constant speed minimises it.
    :ivar lam: (n,), costate of the length, -u / |u|; zero for a path of length 0.
    """

    t: Array
    x: Array
    u: Array
    length: float
    energy: float
    lam: Array


def solve_straight_line(x0: ArrayLike, xf: ArrayLike, t: ArrayLike) -> StraightPath:
    """
    Minimise the length of the path between two points, for x' = u over [0, 1].

    For L = |u| the necessary conditions determine the direction of u, not its size:
    H = |u| + lam'u = 0 for every u along -lam. The problem has no maximum speed.

    Exercise 2.3.

    :param x0, xf: (n,), initial and final position [m].
    :param t: (N,), times within [0, 1] [s].
    :raises StatementError: if the points are not finite or not of equal dimension, or a time is
        not within [0, 1].
    """
    start, end = np.asarray(x0, dtype=float), np.asarray(xf, dtype=float)
    if start.shape != end.shape or start.ndim != 1 or not start.size:
        raise StatementError(
            f'x0 and xf must be points of equal dimension; found {start.shape} and {end.shape}')
    if not (np.isfinite(start).all() and np.isfinite(end).all()):
        raise StatementError('x0 and xf must consist of finite numbers')
    times = _times(t, 1.0)
    u = end - start
    length = float(np.linalg.norm(u))
    return StraightPath(times, start + np.outer(times, u), np.tile(u, (len(times), 1)), length,
                        length**2, -u / length if length else np.zeros_like(u))


def _decayed(k: float, r: Array) -> Array:
    """Return the integral of e^(-2 k s) over s in [0, r]."""
    return np.asarray(r * special.exprel(-2 * k * r))


def _times(t: ArrayLike, tf: float) -> Array:
    """Return t, shape (N,), checked to be within [0, tf]."""
    if not tf > 0:
        raise StatementError(f'tf = {tf:g}: wanted a number > 0')
    times = np.asarray(t, dtype=float).ravel()
    if not ((times >= 0) & (times <= tf)).all():
        raise StatementError(f'times must lie within [0, {tf:g}]')
    return times


def _finite(**values: float) -> None:
    for name, value in values.items():
        if not isfinite(value):
            raise StatementError(f'{name} = {value}: wanted a finite number')


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not 0 < value < inf:
            raise StatementError(f'{name} = {value}: wanted a finite number > 0')
