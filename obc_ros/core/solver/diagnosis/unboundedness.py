# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Searches for a cost that decreases without limit as the bounds of inputs increase.

The bounds are |u| <= 10, 100 and 1000. `existence` proves the linear case without a search.
"""

from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.solver.diagnosis.feasibility import (
    describe_shortfall,
    guess_from_inputs,
    is_path,
    Solver,
)
from obc_ros.core.solver.proofs.existence import advise_bounds, find_growing_inputs


def explain_larger_inputs(problem: Problem, found: Solution, solve: Solver) -> str:
    """
    Return a sentence if larger inputs cost much less than those of a certified solution.

    If H is linear in an input without bounds, a solution that diverges to infinity has residuals
    that are small relative to its size. '' is returned if larger inputs do not cost much less, or
    if the cost limits all inputs.
    """
    if not advise_bounds(problem):
        return ''
    if name := _impulsive(problem, found):
        return f'no minimum was found: {name} approaches an impulse, ever larger and shorter'
    largest = np.abs(found.u).max(axis=0)
    room = 3 * np.maximum(largest, 1e-6 * largest.max())
    other = solve(_boxed(problem, room if largest.any() else np.ones(problem.m)))
    if not is_path(other):
        return explain_unbounded(problem, solve, None)
    if problem.q and describe_shortfall(problem, other) or (
            found.objective - other.objective <= 0.1 * abs(found.objective)):
        return ''
    return (f'no minimum was found: the cost is {found.objective:.4g} with inputs up to '
            f'{largest.max():.4g} and {other.objective:.4g} with larger inputs; '
            f'{advise_bounds(problem)}')


def explain_unbounded(problem: Problem, solve: Solver, found: Solution | None) -> str:
    """
    Return a sentence if the cost keeps decreasing as the bounds of inputs increase, else ''.

    The inputs of a path that was found are the initial guess, clipped to the bounds.
    """
    free = ~problem.boxed
    if not free.any():
        return ''
    size = np.maximum(1.0, np.abs(np.where(np.isfinite(problem.u_lower), problem.u_lower, 0.0)))
    costs, full, rooms = [], True, (10.0, 100.0, 1000.0)
    for room in rooms:
        boxed = _boxed(problem, room * size)
        answer = solve(boxed if found is None else guess_from_inputs(boxed, found))
        if not is_path(answer) or (problem.q and describe_shortfall(problem, answer)):
            return ''
        costs.append(float(answer.objective))
        full &= bool((np.abs(answer.u).max(axis=0) >= 0.99 * room * size)[free].any())
    first, second = costs[0] - costs[1], costs[1] - costs[2]
    names = ', '.join(f'|{name}|' for name, yes in zip(problem.inputs, free, strict=True) if yes)
    listed = ', '.join(f'{cost:.4g} with {names} <= {room:g}'
                       for cost, room in zip(costs, rooms, strict=True))
    if costs[2] < 0 and first > 0 and second > 3*first:
        return (f'no minimum was found: the cost decreases ever faster as the input bounds '
                f'increase: {listed}')
    if full and first > 0 and second > 0.1 * abs(costs[1]):
        return (f'no minimum was found: the cost keeps decreasing as the input bounds increase: '
                f'{listed}')
    return ''


def _boxed(problem: Problem, room: Array) -> Problem:
    """Return a problem with inputs of at most the given magnitude."""
    return replace(problem, structure='', u_lower=np.maximum(problem.u_lower, -room),
                   u_upper=np.minimum(problem.u_upper, room))


def _impulsive(problem: Problem, found: Solution) -> str:
    """Return an unbounded input with much of its integral in a very short time, or ''."""
    h, much = np.diff(found.t), 0.1   # of the largest input, and of its integral
    for name in find_growing_inputs(problem):
        size = np.abs(found.u[:, problem.inputs.index(name)])
        high = np.maximum(size[:-1], size[1:])
        short = high > much * size.max()
        work = h * (size[:-1] + size[1:])
        if (size.max() * found.t[-1] > 0 and h[short].sum() < 1e-4 * found.t[-1]
                and work[short].sum() > much * work.sum()):
            return name
    return ''
