# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Bounds of inputs that touch the set of a path constraint, and follow from it.

An example is -g <= a beside a^2 + b^2 <= g^2. Where both are active their gradients are parallel.
Their multipliers are then not unique, and an interior-point method stays at such a point.
"""

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.ocp.problem import Problem


def build_curvatures(problem: Problem) -> list[ca.Function]:
    """Return for each constraint the function (x, u, p) -> c, dc/du (m,), d2c/du2 (m, m)."""
    x, u, p = problem.x, problem.u, problem.p
    slopes = [ca.gradient(row, u) for row in ca.vertsplit(problem.path)]
    return [ca.Function('curvatures', [x, u, p], [row, slope, ca.jacobian(slope, u)])
            for row, slope in zip(ca.vertsplit(problem.path), slopes, strict=True)]


def find_implied_bounds(problem: Problem, curvatures: ca.Function, at: tuple[Array, Array],
                        sign: int, level: float, free: Mask) -> Mask:
    """
    Find the bounds of inputs that follow from one path constraint.

    :param problem: whose bounds of inputs are meant.
    :param curvatures: of the constraint, from `build_curvatures`.
    :param at: (K, n), (K, m), states and inputs at some times.
    :param sign, level: 1 for c <= level, -1 for c >= level.
    :param free: (m,), inputs of the constraint.
    :return: (2, m), lower and upper bounds that touch the set of the constraint at all the given
        states. A bound outside of that set is never active, and not returned: elsewhere it may cut
        the set. The judgement is exact for a constraint that is quadratic in the free inputs;
        another one is approximated at the given inputs.
    """
    implied: Mask = np.zeros((2, problem.m), dtype=bool)
    for side, bound in enumerate((problem.u_lower, problem.u_upper)):
        for i in np.flatnonzero(free & np.isfinite(bound)):
            others = free.copy()
            others[i] = False
            pairs = [(x, np.where(np.arange(problem.m) == i, bound, u))
                     for x, u in zip(*at, strict=True)]
            implied[side, i] = all(
                _is_tangent([sign * each.full() for each in curvatures(x, u, problem.p_value)],
                            sign * level, others) for x, u in pairs)
    return implied


def _is_tangent(derivatives: list[Array], level: float, others: Mask) -> bool:
    """Return whether the minimum of a row over the `others` is its upper bound `level`."""
    (value,), slope, curvature = derivatives[0].ravel(), derivatives[1].ravel(), derivatives[2]
    if others.any():
        bend, tilt = curvature[np.ix_(others, others)], slope[others]
        if np.linalg.eigvalsh(bend)[0] <= 0:
            return False
        value = value - 0.5 * float(tilt @ np.linalg.solve(bend, tilt))
    return bool(abs(value - level) <= 1e-9 * max(abs(level), abs(value)))   # rounding
