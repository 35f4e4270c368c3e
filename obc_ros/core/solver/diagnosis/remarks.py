# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The remark on a certified answer that something else than the cost has decided.

A bound of T, of a duration or of a free parameter often only limits the search, and a part of the
statement may be missing. The certificate holds all the same: the answer is that of the statement.
"""

from collections.abc import Iterator

import casadi as ca
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.ocp.wording import format_number
from obc_ros.core.solver.proofs.existence import find_constant_cost


def find_remark(problem: Problem, found: Solution) -> str:
    """
    Return what decided a certified answer, if that was a bound of the search or a missing part.

    :param problem: as stated.
    :param found: certified, with the states of the problem.
    :return: a sentence with the number that decided; '' if the cost alone decided.
    """
    if find_constant_cost(problem) is not None:
        return (f'all paths cost {format_number(found.objective)}: the cost depends on neither '
                'states nor inputs, so that this path is one of many')
    bounds = [*_list_final_time(problem, found), *_list_parameters(problem, found)]
    if not bounds:
        return ''
    decides = 'this bound decides' if len(bounds) == 1 else 'these bounds decide'
    return ', and '.join([f'{" and ".join(bounds)}: {decides} the answer',
                          *_list_missing(problem)])


def _list_final_time(problem: Problem, found: Solution) -> Iterator[str]:
    final, T = problem.final_time, float(found.t[-1])
    if not final.free or final.lower == final.upper:
        return
    for side, bound in (('lower', final.lower), ('upper', final.upper)):
        if abs(T - bound) <= 1e-9 * bound:   # as in the certificate
            yield f'T = {format_number(bound)} s is the {side} bound of final_time'


def _list_parameters(problem: Problem, found: Solution) -> Iterator[str]:
    lower, upper = problem.start_box
    for name in problem.free_parameters:
        k = problem.states.index(name)
        for side, bound in (('lower', lower[k]), ('upper', upper[k])):
            if lower[k] < upper[k] and abs(found.x[0, k] - bound) <= 1e-6 * (upper[k] - lower[k]):
                yield f'{name} = {format_number(bound)} is its {side} bound'


def _list_missing(problem: Problem) -> Iterator[str]:
    """Yield the parts of a statement without which only a bound ends the search."""
    if not problem.q and not ca.depends_on(problem.V, problem.x):
        yield 'there is neither a terminal constraint nor a terminal cost'
    names = [name for name, u, boxed in zip(
        problem.inputs, ca.vertsplit(problem.u), problem.boxed, strict=True)
        if not (boxed or ca.depends_on(ca.vertcat(problem.L, problem.path), u))]
    if names:
        yield f'neither input_bounds nor the cost limit {", ".join(names)}'
