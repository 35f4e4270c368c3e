# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Newton's method from a neighbour's answer, with the unknowns at their bounds held there.

After every step an unknown that went past a bound is held at it, and one whose multiplier has
the wrong sign is let go. Near an answer this takes a few steps where an interior-point method
takes many: to go on from an answer it must first leave the bounds. Without a line search it may
fail, which is found out soon.

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

_MOST = 20       # steps
_PATIENCE = 3    # steps without progress
_LOST = 1.0      # scaled: a residual after which none is hoped for
_QUADRATIC = 1e-2   # of the residual before: left by a step that shows quadratic convergence


def follow_active_set(program: NewtonProgram, bounds: tuple[Array, Array], y: Array, side: Side,
                      goal: StoppingRule,
                      watch: Callable[[float, float], bool]) -> tuple[Array, ProgramValues,
                                                                      int] | None:
    """
    Return y and what the program is there and the number of steps; None without success.

    Parameters
    ----------
    program : Program
        At whose answer to arrive.
    bounds : pair of ndarray
        Of y; those of multipliers are infinite, those of fixed unknowns equal.
    y : ndarray
        Where to start.
    side : ndarray of int8
        -1 or 1 where an unknown is held at its lower or upper bound, else 0.
    goal : Goal
        What is near enough.
    watch : callable
        Called with cost and infeasibility; True stops.

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
        # What is held is let go where the cost falls inwards.
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
        # What a step leaves is known once they converge quadratically: it is not looked at.
        if (not (free.any() or met.any()) and wrong < _QUADRATIC * before
                and wrong * (wrong / before)**2 <= 1e-3 * min(goal.optimal, goal.feasible)):
            there = replace(there, f=there.f + float(there.cost_slope @ step))
            return (y, there, steps) if _least(program, there, held) else None
        before, side = wrong, (side + met).astype(np.int8)


def _least(program: NewtonProgram, there: ProgramValues, held: NDArray[np.bool_]) -> bool:
    """Return whether the cost has curvature upwards wherever unknowns may move."""
    return program.convex(there, held, np.where(program.is_row | held, 1.0, 0.0))


def _misses(there: ProgramValues, but: NDArray[np.bool_]) -> float:
    """Return the largest residual of the rows and of the slope of free unknowns."""
    return max(float(np.abs(there.c).max(initial=0.0)),
               float(np.abs(np.where(but, 0.0, there.slope)).max(initial=0.0)))
