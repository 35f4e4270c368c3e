# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Monotone states, such as fuel, charge and stock, and whether enough of them is available.

If dx_i/dt <= 0 for all admissible states and inputs, a lower bound of x_i holds on the whole path
if it holds at T. The problem without that bound whose cost is -x_i(T) then gives the largest final
value. The same holds for states that never decrease and their upper bounds.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.wording import format_number, state_bound
from obc_ros.core.solver.diagnosis.feasibility import describe_shortfall, remove_bound, Solver
from obc_ros.core.solver.proofs.interval_bounds import bound_rates
from obc_ros.core.solver.proofs.singular_expressions import find_suspects


@dataclass(frozen=True)
class Supply:
    """A monotone state with a bound in its direction; `problem`: minimise its consumption."""

    index: int
    upper: bool
    problem: Problem


def find_supplies(problem: Problem) -> Iterator[Supply]:
    """Yield the bounded states that change in one direction only."""
    for index, rate in enumerate(bound_rates(problem)):
        for upper, bound, one_way in (
                (False, problem.x_lower[index], rate.high <= 0),
                (True, problem.x_upper[index], rate.low >= 0)):
            if np.isfinite(bound) and one_way:
                freed = _freed(problem, index, upper, bound)
                yield Supply(index, upper, replace(
                    freed, L=ca.SX(0), V=(1 if upper else -1) * problem.x[index]))


def _freed(problem: Problem, index: int, upper: bool, bound: float) -> Problem:
    """Return a problem without a bound, or with one close to 0 if x_i must not pass through 0."""
    key = 'x_upper' if upper else 'x_lower'
    freed, x = remove_bound(problem, key, index), problem.x[index]
    if (bound < 0 if upper else bound > 0) and any(
            ca.depends_on(each.value, x) for each in find_suspects(problem)):
        getattr(freed, key)[index] = 1e-2 * bound
    return freed


def explain_shortage(problem: Problem, solve: Solver) -> str:
    """
    Return which monotone state does not seem to suffice for the terminal constraints, else ''.

    A certified solution from `solve` is an extremal, and a better one may exist: the clause is no
    proof.
    """
    for supply in find_supplies(problem):
        answer = solve(supply.problem)
        if not answer.certified or describe_shortfall(supply.problem, answer):
            continue
        left = float(answer.x[-1, supply.index])
        bound = float((problem.x_upper if supply.upper else problem.x_lower)[supply.index])
        size = max(abs(float(problem.x0[supply.index]) - bound), abs(left - bound))
        if (left - bound if supply.upper else bound - left) > 1e-4 * size:   # else it suffices
            name = problem.states[supply.index]
            final = problem.final_time
            by = f'{"by" if final.free else "at"} T = {format_number(final.latest)}'
            change, extreme = ('decreases', 'smallest') if supply.upper else (
                'increases', 'largest')
            return (f'{name} never {change}, and the {extreme} final value found for it, with '
                    f'the terminal constraints met {by}, is {format_number(left)}, which violates '
                    f'state bound {state_bound(problem, supply.index, supply.upper)}')
    return ''
