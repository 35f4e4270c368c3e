# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One step of explicit Runge-Kutta methods for dx/ds = f(x, s), as CasADi expressions."""

from collections.abc import Callable, Sequence
from fractions import Fraction

import casadi as ca

Slope = Callable[[ca.SX, ca.SX], ca.SX]


def rk4(f: Slope, x: ca.SX, s: ca.SX, h: ca.SX) -> ca.SX:
    """
    Return x at s + h by the classical method of order 4.

    Parameters
    ----------
    f : callable
        f(x, s), shape (n, 1).
    x, s, h : casadi.SX
        State (n, 1), time and step.

    Returns
    -------
    casadi.SX, shape (n, 1)

    """
    k1 = f(x, s)
    k2 = f(x + h / 2 * k1, s + h / 2)
    k3 = f(x + h / 2 * k2, s + h / 2)
    k4 = f(x + h * k3, s + h)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


# J. R. Dormand and P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comput. Appl.
# Math. 6 (1980), RK5(4)7M: the rows of A, the last of which are the weights of order 5, and the
# weights of order 4.
_ROWS = (
    '',
    '1/5',
    '3/40 9/40',
    '44/45 -56/15 32/9',
    '19372/6561 -25360/2187 64448/6561 -212/729',
    '9017/3168 -355/33 46732/5247 49/176 -5103/18656',
    '35/384 0 500/1113 125/192 -2187/6784 11/84',
)
_ORDER_4 = '5179/57600 0 7571/16695 393/640 -92097/339200 187/2100 1/40'


def dormand_prince(f: Slope, x: ca.SX, s: ca.SX, h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """
    Return x at s + h by the method of order 5, and its difference from that of order 4.

    Parameters
    ----------
    f : callable
        f(x, s), shape (n, 1).
    x, s, h : casadi.SX
        State (n, 1), time and step.

    Returns
    -------
    x, error : casadi.SX, shape (n, 1)

    """
    rows = [_fractions(row) for row in _ROWS]
    slopes: list[ca.SX] = []
    for row in rows:
        slopes.append(f(x + h * _weighted(row, slopes), s + float(sum(row)) * h))
    order_5 = [*rows[-1], Fraction(0)]
    difference = [b5 - b4 for b5, b4 in zip(order_5, _fractions(_ORDER_4), strict=True)]
    return x + h * _weighted(order_5, slopes), h * _weighted(difference, slopes)


def _fractions(row: str) -> list[Fraction]:
    return [Fraction(number) for number in row.split()]


def _weighted(weights: Sequence[Fraction], slopes: Sequence[ca.SX]) -> ca.SX:
    return sum((float(weight) * slope for weight, slope in zip(weights, slopes, strict=True)
                if weight), ca.SX(0))
