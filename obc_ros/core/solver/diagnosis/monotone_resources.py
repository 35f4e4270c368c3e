# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Fuel, charge, stock: states that only fall or only rise, and whether there is enough of them.

Where dx_i/dt <= 0 wherever a path may be, a bound below x_i holds on all of a path if it holds at
T. Without that bound the path that meets the terminal constraints with the largest x_i(T) says how
much is left at best. Likewise upwards.
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

_NEXT_TO_0 = 1e-2   # of a bound
_SHORT = 1e-4   # of its size: what a supply has to lack


@dataclass(frozen=True)
class Supply:
    """A state that only falls or rises towards a bound; `problem`: to spend least of it."""

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
    """Return a problem without a bound, or with one next to 0 where x_i must not pass through."""
    key = 'x_upper' if upper else 'x_lower'
    freed, x = remove_bound(problem, key, index), problem.x[index]
    if (bound < 0 if upper else bound > 0) and any(
            ca.depends_on(each.value, x) for each in find_suspects(problem)):
        getattr(freed, key)[index] = _NEXT_TO_0 * bound
    return freed


def explain_shortage(problem: Problem, solve: Solver) -> str:
    """
    Return which supply seems not to suffice for the terminal constraints, with numbers, or ''.

    Parameters
    ----------
    problem : Problem
        The one that has no answer.
    solve : callable
        Returns a Solution for a problem, with care. A certificate shows an extremal, so that there
        may be a better one: the finding is no proof.

    """
    for supply in find_supplies(problem):
        answer = solve(supply.problem)
        if not answer.certified or describe_shortfall(supply.problem, answer):
            continue
        left = float(answer.x[-1, supply.index])
        bound = float((problem.x_upper if supply.upper else problem.x_lower)[supply.index])
        size = max(abs(float(problem.x0[supply.index]) - bound), abs(left - bound))
        if (left - bound if supply.upper else bound - left) > _SHORT * size:
            name = problem.states[supply.index]
            final = problem.final_time
            by = f'{"by" if final.free else "at"} T = ' + format_number(
                final.upper if final.free else final.value)
            return (f'{name} only {"rises" if supply.upper else "falls"}, and where the '
                    f'terminal constraints are met {by} it is {format_number(left)} at '
                    f'{"least" if supply.upper else "most"}, beyond state bound '
                    f'{state_bound(problem, supply.index, supply.upper)}')
    return ''
