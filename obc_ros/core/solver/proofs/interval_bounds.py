# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Bounds of states and of expressions along all paths, by interval arithmetic.

A constraint that these bounds exclude is proved to be violated. If none is excluded nothing
follows, because intervals are wider than the true ranges.
"""

from collections.abc import Iterator

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.enclosures.interval_arithmetic import (
    add_intervals,
    enclose_outputs,
    Interval,
    multiply_intervals,
)
from obc_ros.core.numerics.instructions import find_dependence
from obc_ros.core.ocp.certificate.certificate import COUNTS_AS_MET
from obc_ros.core.ocp.least_time_form import find_affine_dynamics
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.wording import describe_terminal, format_number
from obc_ros.core.solver.proofs.singular_expressions import find_steep_operands


def find_lower_bounds(problem: Problem) -> Array:
    """
    Return lower bounds of the states on all paths, shape (n,): their bounds, or 0.

    0 is returned for states that remain nonnegative, such as amounts, populations and
    concentrations: x_i(0) >= 0, and dx_i/dt >= 0 whenever x_i = 0 and the other such states are
    nonnegative (M. Nagumo, 1942). States on which a root, or another function with an infinite
    slope, acts in a rate are excluded: x' = -sqrt(abs(x)) is 0 at x = 0, but x can become
    negative from there.
    """
    steep = [value for where, value in find_steep_operands(problem)
             if where.startswith('dynamics.')]
    stays = np.array([start >= 0 and not any(ca.depends_on(value, x) for value in steep)
                      for start, x in zip(problem.start_box[0], ca.vertsplit(problem.x),
                                          strict=True)])
    while stays.any():
        before, low = stays.copy(), np.where(stays, 0.0, problem.x_lower)
        for i in np.flatnonzero(before):
            high = problem.x_upper.copy()
            high[i] = 0.0
            at_0 = np.where(np.arange(problem.n) == i, 0.0, low)
            stays[i] = _values(problem, problem.f, at_0, high)[i].low >= 0
        if np.array_equal(stays, before):
            break
    return np.where(stays, np.maximum(problem.x_lower, 0.0), problem.x_lower)


def bound_rates(problem: Problem) -> list[Interval]:
    """Return bounds of dx_i/dt for all states and inputs within their bounds."""
    return _values(problem, problem.f, find_lower_bounds(problem), problem.x_upper)


def find_unsatisfiable(problem: Problem) -> Iterator[str]:
    """
    Yield path and terminal constraints that hold at no state within the bounds.

    Bounds of dx/dt bound the states that are reachable by the last admissible T, which may give
    tighter bounds of dx/dt. Terminal constraints that hold at no reachable state are yielded, too.
    """
    low, high = find_lower_bounds(problem), problem.x_upper
    for row, found in enumerate(_values(problem, problem.path, low, high)):
        for excess, words, sign, bound in (
                (found.low - problem.path_upper[row], f'at least {format_number(found.low)}', '<=',
                 problem.path_upper[row]),
                (problem.path_lower[row] - found.high, f'at most {format_number(found.high)}',
                 '>=', problem.path_lower[row])):
            if excess > _margin(found):
                yield (f'path_constraints[{row}] is {words} for all admissible states and '
                       f'inputs but must be {sign} {format_number(bound)}')
    # For linear systems the check of the minimum time gives more.
    curved = bool(problem.q) and find_affine_dynamics(problem) is None
    for tightened in (False, True)[:1 + curved]:
        for _ in range(problem.n * tightened):
            low, high = _reachable(problem, low, high)
        for row, found in enumerate(_values(problem, problem.psi, low, high)):
            margin = _margin(found)
            if found.low > margin or found.high < -margin:
                more = _explain_range(problem, row, low, high, tightened=bool(tightened))
                nearest = found.low if found.low > 0 else found.high
                yield (f'the terminal constraint {describe_terminal(problem, row)} cannot be met'
                       f'{more}: it is missed by at least {format_number(abs(nearest))}')


def _reachable(problem: Problem, low: Array, high: Array) -> tuple[Array, Array]:
    """Return tighter bounds of the states until the last admissible T, by those of their rates."""
    T = Interval(problem.final_time.latest, problem.final_time.latest)
    ends = [add_intervals(Interval(float(least), float(most)), multiply_intervals(
                T, Interval(min(rate.low, 0.0), max(rate.high, 0.0))))
            for least, most, rate in zip(
                *problem.start_box, _values(problem, problem.f, low, high), strict=True)]
    return (np.maximum(low, [each.low for each in ends]),
            np.minimum(high, [each.high for each in ends]))


def _values(problem: Problem, expressions: ca.SX, low: Array, high: Array) -> list[Interval]:
    """Return bounds of expressions for states within the given bounds and admissible inputs."""
    function = ca.Function('values', [problem.x, problem.u, problem.p], [ca.densify(expressions)])
    return enclose_outputs(function, [(low, high), (problem.u_lower, problem.u_upper),
                                      (problem.p_value, problem.p_value)])


def _margin(found: Interval) -> float:
    ends = (abs(each) for each in (found.low, found.high) if np.isfinite(each))
    return COUNTS_AS_MET * (1 + sum(ends))


def _explain_range(problem: Problem, row: int, low: Array, high: Array, *, tightened: bool) -> str:
    """Return, as text, which states of a terminal constraint stay nonnegative, or their ranges."""
    used = find_dependence(problem.psi[row], problem.x)[0]
    if not tightened:
        names = [problem.states[k] for k in np.flatnonzero(used & (low > problem.x_lower))]
        return f' because no input takes {" or ".join(names)} below 0' if names else ''
    parts = [
        f'{problem.states[k]} stays between {format_number(low[k])} and {format_number(high[k])}'
        for k in np.flatnonzero(used & np.isfinite(low) & np.isfinite(high))]
    how_far = f' ({", ".join(parts)})' if parts else ''
    return f' by T = {problem.final_time.latest:.6g}{how_far}'
