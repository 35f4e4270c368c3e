# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The residual of the optimality conditions of a nonlinear program, computed from an iterate.

Minimise f(w) subject to g_lower <= g(w) <= g_upper and lower <= w <= upper. A method may stop
because rounding errors leave no better step, although it has arrived. Hence an outcome is judged
by this residual, whatever method found it and whatever it said last.
"""

from typing import Any

import numpy as np
from obc_ros.core.numerics.arrays import Array

ACCEPTED = 1e-7   # largest residual of a solution


def measure_optimality(w: Array, bounds: tuple[Array, Array], rows: tuple[Array, Array],
                       values: tuple[Array, Array, Any], multipliers: tuple[Array, Array]
                       ) -> float:
    """
    Return the largest scaled residual of feasibility, stationarity and complementarity.

    The unit of rows and unknowns is 1, the scale of the program, and the rounding errors of a row
    count: at a far iterate any row is met. That of stationarity is the largest sum of the absolute
    values of its terms, |df/dw_j| + sum |dg_i/dw_j| |lam_i|, at least 1.

    Parameters
    ----------
    w : ndarray, shape (n,)
        The iterate.
    bounds, rows : pair of ndarray, shape (n,), (l,)
        Lower and upper bounds of w and of g; may be infinite.
    values : tuple
        g (l,), the gradient of f (n,) and the Jacobian of g, a sparse matrix (l, n).
    multipliers : pair of ndarray, shape (n,), (l,)
        Of w and g: df/dw + J'lam_g + lam_w = 0, positive at upper bounds.

    Returns
    -------
    float
        Infinite if a number is not finite.

    """
    (g, slope, J), (lam_w, lam_g) = values, multipliers
    size = abs(J)
    with np.errstate(all='ignore'):
        unit = max(1.0, float((np.abs(slope) + size.T @ np.abs(lam_g)).max(initial=0.0)))
        # A fixed unknown has a multiplier of any size and sign.
        free = bounds[0] < bounds[1]
        still = np.where(free, slope + J.T @ lam_g + lam_w, 0.0)
        parts = [
            _excess(w, *bounds),
            _excess(g, *rows) + np.finfo(float).eps * (size @ np.abs(w)),
            np.abs(still) / unit,
            _slack(w, *bounds, lam_w) / unit,
            _slack(g, *rows, lam_g) / unit]
        found = np.concatenate(parts)
    return float(found.max(initial=0.0)) if np.isfinite(found).all() else np.inf


def _excess(value: Array, lower: Array, upper: Array) -> Array:
    """Return by how much values are outside of their bounds."""
    return np.maximum(np.maximum(lower - value, value - upper), 0.0)


def _slack(value: Array, lower: Array, upper: Array, lam: Array) -> Array:
    """Return the multipliers times the distances from their bounds, at most 1."""
    gap = np.where(lam > 0, upper - value, value - lower)
    return np.asarray(np.where(lower < upper, np.abs(lam) * np.clip(gap, 0.0, 1.0), 0.0))
