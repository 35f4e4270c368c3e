# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Primal-dual active set method, started from the solution of a neighbouring program.

Newton's method is applied with the unknowns at active bounds fixed. After each step an unknown
beyond a bound is fixed at it, and one whose multiplier has the wrong sign is released. Near a
solution this takes a few steps; an interior-point method takes more, since it must leave the
bounds first. There is no line search: without progress the method gives up after a few steps.

M. Hintermueller, K. Ito, K. Kunisch, The primal-dual active set strategy as a semismooth Newton
method, SIAM J. Optim. 13 (2002).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.solver.nlp.interior_point import (
    NewtonProgram,
    ProgramValues,
    PROXIMAL,
    StoppingRule,
)

Side = NDArray[np.int8]

_MOST = 20       # maximum number of steps
_PATIENCE = 3    # steps without progress, after which the method gives up
_LOST = 1.0      # scaled residual, larger than the first one, at which it gives up at once
_QUADRATIC = 1e-2   # ratio of two residuals below which convergence counts as quadratic


def follow_active_set(program: NewtonProgram, bounds: tuple[Array, Array], y: Array, side: Side,
                      goal: StoppingRule,
                      watch: Callable[[float, float], bool]) -> tuple[Array, ProgramValues,
                                                                      int] | None:
    """
    Solve a program by the active set method from a point near its solution.

    Parameters
    ----------
    program : NewtonProgram
        Cost, constraints and their derivatives.
    bounds : pair of ndarray
        Lower and upper bounds of y; infinite for multipliers, equal for fixed unknowns.
    y : ndarray
        Initial unknowns and multipliers.
    side : ndarray of int8
        Initial active set: -1 or 1 where an unknown is at its lower or upper bound, else 0.
    goal : StoppingRule
        Tolerances.
    watch : callable
        Called with cost and infeasibility; True stops.

    Returns
    -------
    tuple or None
        y, the values of the program there, and the number of steps; None if the method did not
        converge, or not to a minimum.

    """
    lower, upper = bounds
    row = program.is_row
    fixed = (lower == upper) & ~row
    y = np.where(fixed, lower, y)
    least, before, waited, steps, first = np.inf, np.nan, 0, 0, 1e300
    while True:
        y = np.where(side < 0, lower, np.where(side > 0, upper, y))
        there = program.values(y)
        held = fixed | (side != 0)
        wrong = _misses(there, row | held)
        if not wrong <= max(first, _LOST):
            return None
        # Release the unknowns for which the cost falls inwards.
        free = (side != 0) & (side * there.slope > goal.optimal)
        size = max(1.0, float(np.abs(y[row]).max(initial=0.0)) / 100.0)
        if (not free.any() and wrong <= goal.optimal * size
                and float(np.abs(there.c).max()) <= 0.01 * goal.feasible):
            return (y, there, steps) if _least(program, there, held) else None
        waited = 0 if wrong < 0.7 * least else waited + 1
        least, first = (min(least, wrong), first) if steps else (least, wrong)
        if steps == _MOST or waited > _PATIENCE or watch(there.f, float(np.abs(there.c).max())):
            return None
        side = np.where(free, 0, side).astype(np.int8)
        held = fixed | (side != 0)
        factor = program.pattern.factor(
            there.entries, program.pattern.without(held), np.where(
                held, 1.0, np.where(row, -PROXIMAL, 0.0)))
        if factor is None:
            return None
        step = factor.solve(np.where(held, 0.0, np.where(row, -there.c, -there.slope)))
        y, steps = y + step, steps + 1
        met = np.where(held, 0, np.where(y < lower, -1, np.where(y > upper, 1, 0)))
        # With quadratic convergence the next residual is known without an evaluation.
        if (not (free.any() or met.any()) and wrong < _QUADRATIC * before
                and wrong * (wrong / before)**2 <= 1e-3 * min(goal.optimal, goal.feasible)):
            there = replace(there, f=there.f + float(there.cost_slope @ step))
            return (y, there, steps) if _least(program, there, held) else None
        before, side = wrong, (side + met).astype(np.int8)


def _least(program: NewtonProgram, there: ProgramValues, held: NDArray[np.bool_]) -> bool:
    """Return whether the Hessian is positive definite on the null space of the active rows."""
    return program.convex(there, held, np.where(program.is_row | held, 1.0, 0.0))


def _misses(there: ProgramValues, but: NDArray[np.bool_]) -> float:
    """Return the largest residual of the rows, and of the slope except for `but`."""
    return max(float(np.abs(there.c).max(initial=0.0)),
               float(np.abs(np.where(but, 0.0, there.slope)).max(initial=0.0)))
