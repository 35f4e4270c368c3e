# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The residual of the optimality conditions of a nonlinear program, computed from an iterate.

Minimise f(w) subject to g_lower <= g(w) <= g_upper and lower <= w <= upper, with unknowns w that
are scaled to 1. A method may stop because rounding errors leave no better step, although it has
arrived. Such an outcome counts if this residual is small.
"""

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index

ACCEPTED = 1e-7   # largest residual of a solution
_LEAST = 1e-2     # smallest unit; times ACCEPTED it is the tolerance of the methods, 1e-9


def measure_optimality(w: Array, bounds: tuple[Array, Array], rows: tuple[Array, Array],
                       values: tuple[float, Array, Array],
                       jacobian: tuple[Index, Index, Array],
                       multipliers: tuple[Array, Array]) -> float:
    """
    Return the largest scaled residual of feasibility, stationarity and complementarity.

    The unit of a row is sum |dg/dw_j|: to first order the residual is the change of w that meets
    the row. It does not grow with w, and the rounding error of a row counts, so that a far iterate
    hides no missed row. The unit of stationarity is the largest sum of the absolute values of its
    terms, l = |df/dw_j| + sum |dg_i/dw_j| |lam_i|; that of complementarity is the cost |f|, or
    1e-3 l as in the certificate. No unit is below 1e-2.

    :param w: (n,), the iterate.
    :param bounds, rows: (n,), (l,), lower and upper bounds of w and of g; may be infinite.
    :param values: f, g (l,) and the gradient of f (n,).
    :param jacobian: rows, columns and values of the entries of dg/dw.
    :param multipliers: (n,), (l,), of w and g: df/dw + J'lam_g + lam_w = 0, positive at upper
        bounds.
    :return: infinite if a number is not finite.
    """
    (f, g, slope), (rows_of, columns, J), (lam_w, lam_g) = values, jacobian, multipliers

    def by_rows(each: Array) -> Array:
        return np.asarray(np.bincount(rows_of, each, len(g)))

    def by_columns(each: Array) -> Array:
        return np.asarray(np.bincount(columns, each, len(w)))

    with np.errstate(all='ignore'):
        pull = J * lam_g[rows_of]
        terms = np.max(np.abs(slope) + by_columns(np.abs(pull)), initial=_LEAST)
        rounding = np.finfo(float).eps * by_rows(np.abs(J * w[columns]))
        # A fixed unknown has a multiplier of any size and sign.
        still = np.where(bounds[0] < bounds[1], slope + by_columns(pull) + lam_w, 0.0)
        slack = np.append(_slack(w, *bounds, lam_w), _slack(g, *rows, lam_g))
        found = np.concatenate([
            _excess(w, *bounds),
            (_excess(g, *rows) + rounding) / np.maximum(_LEAST, by_rows(np.abs(J))),
            np.abs(still) / terms,
            slack / max(_LEAST, abs(f), 1e-3 * terms)])
    return float(found.max(initial=0.0)) if np.isfinite(found).all() else np.inf


def _excess(value: Array, lower: Array, upper: Array) -> Array:
    """Return by how much values are outside of their bounds."""
    return np.maximum(np.maximum(lower - value, value - upper), 0.0)


def _slack(value: Array, lower: Array, upper: Array, lam: Array) -> Array:
    """Return the multipliers times the distances from their bounds, at most 1."""
    gap = np.where(lam > 0, upper - value, value - lower)
    return np.asarray(np.where(lower < upper, np.abs(lam) * np.clip(gap, 0.0, 1.0), 0.0))
