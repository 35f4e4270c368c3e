# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Gains that follow a variable of the plant, such as the speed of a vehicle (Exercise 2.10).

Between two values v of the table the gain K is a straight line in v. With A and B straight lines
too, as they are for the vehicle, and X(v) > 0 between solutions of Lyapunov equations at the two,
S = (A - B K)'X + X (A - B K) is a cubic in v. Its Bernstein coefficients bound it: where all are
negative definite, x'X x decreases at every v in between, and still does while v changes at a rate
r as long as S + r dX/dv and S - r dX/dv are negative definite. A plant that is no straight line in
v is taken at four points of each interval.
"""

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import RefusedDesignError, StatementError
from scipy.linalg import solve_continuous_lyapunov

PlantAt = Callable[[float], tuple[Array, Array]]

_MOST = 1025  # gains
_ANY = 1e6  # [1/s] of the range: a rate above it is rounding
_THIRDS = (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
# From the values of a cubic there to its Bernstein coefficients.
_BERNSTEIN = np.array([[1.0, 0.0, 0.0, 0.0], [-5.0 / 6.0, 3.0, -1.5, 1.0 / 3.0],
                       [1.0 / 3.0, -1.5, 3.0, -5.0 / 6.0], [0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Table:
    """
    Gains for a range of a variable, proved to stabilise all over it.

    Attributes
    ----------
    values : ndarray, shape (N,)
        Increasing values of the variable.
    K : ndarray, shape (N, m, n)
        The gain for each; straight lines in between.
    rate : float
        However the variable changes by up to so much a second, the loop is stable.

    """

    values: Array
    K: Array
    rate: float


@dataclass(frozen=True, eq=False)
class _Knot:
    """The gain at a value of the variable, and X of the Lyapunov equation there."""

    value: float
    K: Array
    X: Array


def compute_schedule(plant: PlantAt, weights: Weights, lower: float, upper: float, *,
                     tolerance: float = 0.01) -> Table:
    """
    Return gains for every value of a variable in a range.

    A value is added where the interpolated gain is further than `tolerance` from the designed one,
    or stability in between is not proved.

    Parameters
    ----------
    plant : callable
        (A, B) for a value of the variable.
    weights : Weights
        One cost for all values.
    lower, upper : float
        The range.
    tolerance : float
        Of the gain, relative to its largest entry.

    Raises
    ------
    StatementError
        If the range is empty.
    RefusedDesignError
        If no gain can be proved to stabilise at some value, or between values.

    """
    if not (math.isfinite(lower) and math.isfinite(upper) and lower < upper):
        raise StatementError(f'a schedule from {lower:g} to {upper:g}: wanted a range')
    knots = [_knot(plant, weights, lower), _knot(plant, weights, upper)]
    rate, done = math.inf, 1
    while done < len(knots):  # what is before the last that is done is proved
        low, high = knots[done - 1:done + 1]
        middle = _knot(plant, weights, 0.5 * (low.value + high.value))
        gap = np.abs(middle.K - 0.5 * (low.K + high.K)).max()
        bears = _rate(plant, low, high) if gap <= tolerance * np.abs(middle.K).max() else 0.0
        if bears:
            rate, done = min(rate, bears), done + 1
        elif len(knots) < _MOST:
            knots.insert(done, middle)
        else:
            raise RefusedDesignError(
                f'the gain cannot be proved to stabilise between {low.value:g} and {high.value:g}')
    return Table(np.array([knot.value for knot in knots]), np.array([knot.K for knot in knots]),
                 rate if rate < _ANY * (upper - lower) else math.inf)


def _knot(plant: PlantAt, weights: Weights, value: float) -> _Knot:
    A, B = plant(value)
    design = lqr(A, B, weights.Qx, weights.Qu, cross=weights.cross, stability=weights.stability)
    # any weight would do; that of P does not depend on the units of the states
    X = solve_continuous_lyapunov((A - B @ design.K).T, -np.diag(np.diag(design.P)))
    # and any size; this one changes least with the variable
    X *= math.exp(-np.linalg.slogdet(X)[1] / len(X))
    return _Knot(value, design.K, 0.5 * (X + X.T))


def _rate(plant: PlantAt, low: _Knot, high: _Knot) -> float:
    """Return the rate of the variable that is borne between two values; 0: nothing is proved."""
    slopes = []
    for part in _THIRDS:
        A, B = plant(low.value + part * (high.value - low.value))
        M = A - B @ (low.K + part * (high.K - low.K))
        XM = (low.X + part * (high.X - low.X)) @ M
        slopes.append(XM + XM.T)
    dX = (high.X - low.X) / (high.value - low.value)
    rate = math.inf
    for S in np.tensordot(_BERNSTEIN, np.array(slopes), axes=1):
        try:
            L = np.linalg.cholesky(-S)
            np.linalg.cholesky(low.X)
            np.linalg.cholesky(high.X)
        except np.linalg.LinAlgError:  # not definite
            return 0.0
        relative = np.linalg.solve(L, np.linalg.solve(L, dX).T)
        rate = min(rate, 1.0 / max(float(np.abs(np.linalg.eigvalsh(relative)).max()), 1e-300))
    return rate
