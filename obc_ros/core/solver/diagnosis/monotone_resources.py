# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Monotone states, such as fuel, charge and stock, and whether enough of them is available.

If dx_i/dt <= 0 for all admissible states and inputs, a lower bound of x_i holds on the whole path
if it holds at T. The problem without that bound whose cost is -x_i(T) then gives the largest final
value. The same holds for states that never decrease and their upper bounds.
"""

from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.wording import format_number, state_bound
from obc_ros.core.solver.diagnosis.feasibility import describe_shortfall, remove_bound, Solver
from obc_ros.core.solver.proofs.interval_bounds import bound_rates
from obc_ros.core.solver.proofs.singular_expressions import find_suspects


def _find_supplies(problem: Problem) -> Iterator[tuple[int, bool, Problem]]:
    """
    Yield the bounded states that change in one direction only, and whether it is upwards.

    The third item is the problem of least consumption: without the bound, or with one close to 0
    if x_i must not pass through 0.
    """
    for index, rate in enumerate(bound_rates(problem)):
        x = problem.x[index]
        for upper, key, one_way in ((False, 'x_lower', rate.high <= 0),
                                    (True, 'x_upper', rate.low >= 0)):
            bound = getattr(problem, key)[index]
            if np.isfinite(bound) and one_way:
                freed = remove_bound(problem, key, index)
                if (bound < 0 if upper else bound > 0) and any(
                        ca.depends_on(each.value, x) for each in find_suspects(problem)):
                    getattr(freed, key)[index] = 1e-2 * bound
                yield index, upper, replace(freed, L=ca.SX(0), V=x if upper else -x)


def explain_shortage(problem: Problem, solve: Solver) -> str:
    """
    Return which monotone state does not seem to suffice for the terminal constraints, else ''.

    A certified solution from `solve` is an extremal, and a better one may exist: the clause is no
    proof.
    """
    for index, upper, freed in _find_supplies(problem):
        answer = solve(freed)
        if not answer.certified or describe_shortfall(freed, answer):
            continue
        left = float(answer.x[-1, index])
        bound = float((problem.x_upper if upper else problem.x_lower)[index])
        size = max(abs(float(problem.x0[index]) - bound), abs(left - bound))
        if (left - bound if upper else bound - left) > 1e-4 * size:   # else it suffices
            final = problem.final_time
            by = f'{"by" if final.free else "at"} T = {format_number(final.latest)}'
            change, extreme = ('decreases', 'smallest') if upper else ('increases', 'largest')
            return (f'{problem.states[index]} never {change}, and the {extreme} final value found '
                    f'for it, with the terminal constraints met {by}, is {format_number(left)}, '
                    f'which violates state bound {state_bound(problem, index, upper)}')
    return ''
