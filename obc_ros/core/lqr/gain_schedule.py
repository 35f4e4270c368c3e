# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Gain schedules over a variable of the plant, such as the speed of a vehicle (Exercise 2.10).

The proof that x'X x decreases is in docs/regulator.md. If A or B is not linear in the variable, S
is interpolated through four points of each interval, and stability in between is not proved.
"""

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array, linalg
from obc_ros.core.text.errors import RefusedDesignError, StatementError

PlantAt = Callable[[float], tuple[Array, Array]]

_MOST = 1025  # gains
_TOLERANCE = 0.01  # of an interpolated gain, relative to the largest entry of the designed one
_ANY = 1e6  # [1/s] relative to the range; a larger rate is finite by rounding only
_THIRDS = (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
# From the values of a cubic there to its Bernstein coefficients.
_BERNSTEIN = np.array([[1.0, 0.0, 0.0, 0.0], [-5.0 / 6.0, 3.0, -1.5, 1.0 / 3.0],
                       [1.0 / 3.0, -1.5, 3.0, -5.0 / 6.0], [0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Table:
    """
    Gains for a range of a variable, with stability verified on the whole range.

    :ivar values: (N,), increasing.
    :ivar K: (N, m, n), the gain for each value; linear in between.
    :ivar rate: the loop is stable while the variable changes by at most this much a second.
    """

    values: Array
    K: Array
    rate: float


@dataclass(frozen=True, eq=False)
class _Knot:
    """The gain at a value of the variable, and the solution X of the Lyapunov equation."""

    value: float
    K: Array
    X: Array


def compute_schedule(plant: PlantAt, weights: Weights, lower: float, upper: float) -> Table:
    """
    Return a table of gains for the values of a variable in a range; see docs/regulator.md.

    :param weights: one cost for all values.
    :raises StatementError: if the range is empty.
    :raises RefusedDesignError: if stability cannot be verified at some value, or between values.
    """
    if not (math.isfinite(lower) and math.isfinite(upper) and lower < upper):
        raise StatementError(f'a schedule from {lower:g} to {upper:g}: wanted finite values, the '
                             'first below the second')
    knots = [_knot(plant, weights, lower), _knot(plant, weights, upper)]
    rate, done = math.inf, 1
    while done < len(knots):  # the first `done` values are verified
        low, high = knots[done - 1:done + 1]
        middle = _knot(plant, weights, 0.5 * (low.value + high.value))
        gap = np.abs(middle.K - 0.5 * (low.K + high.K)).max()
        bears = _rate(plant, low, high) if gap <= _TOLERANCE * np.abs(middle.K).max() else 0.0
        if bears:
            rate, done = min(rate, bears), done + 1
        elif len(knots) < _MOST:
            knots.insert(done, middle)
        else:
            raise RefusedDesignError(
                'the stability of the interpolated gain cannot be verified between '
                f'{low.value:g} and {high.value:g}')
    return Table(np.array([knot.value for knot in knots]), np.array([knot.K for knot in knots]),
                 rate if rate < _ANY * (upper - lower) else math.inf)


def _knot(plant: PlantAt, weights: Weights, value: float) -> _Knot:
    A, B = plant(value)
    design = lqr(A, B, weights.Qx, weights.Qu, cross=weights.cross, stability=weights.stability)
    # Any positive weight is valid; the diagonal of P does not depend on the units of the states.
    X = linalg.solve_continuous_lyapunov((A - B @ design.K).T, -np.diag(np.diag(design.P)))
    # Any size is valid; with a unit determinant X changes little with the variable.
    X *= math.exp(-np.linalg.slogdet(X)[1] / len(X))
    return _Knot(value, design.K, 0.5 * (X + X.T))


def _rate(plant: PlantAt, low: _Knot, high: _Knot) -> float:
    """Return the largest rate of the variable with verified stability; 0: none is verified."""
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
        except np.linalg.LinAlgError:  # not positive definite
            return 0.0
        relative = np.linalg.solve(L, np.linalg.solve(L, dX).T)
        rate = min(rate, 1.0 / max(float(np.abs(np.linalg.eigvalsh(relative)).max()), 1e-300))
    return rate
