# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Convex problems, for which Pontryagin's conditions are sufficient for a global minimum."""

from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.solve import solve
import problems
import pytest

BLOCK = {
    'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
    'running_cost': 'x**2 + u**2', 'terminal_cost': '(x - v)**2',
    'initial_state': {'x': 1, 'v': 0},
    'input_bounds': {'u': [-0.5, 0.5]}, 'state_bounds': {'v': [-0.3, None]},
    'path_constraints': [{'expr': 'v + u', 'upper': 0.6}],
    'final_time': {'free': False, 'value': 3}}


def convex(**changes):
    problem = problems.build(BLOCK, **changes)
    return ProgramCache(problem).convex(problem)


@pytest.mark.parametrize('changes', [
    {}, {'running_cost': 'u'}, {'running_cost': '1e-8*x**2 + 1e6*(u + 3*x)**2'},
    {'running_cost': '(x - 2*v + 3*u)**2'}, {'terminal_constraints': ['x - v']},
    {'parameters': {'k': -1}, 'running_cost': 'u**2 - k*x**2'}])
def test_convex_problems_are_recognised(changes):
    assert convex(**changes)


@pytest.mark.parametrize('changes', [
    {'running_cost': 'u**2 - 1e-8*x**2'},                   # slightly concave in x
    {'running_cost': 'u**2 + x*v'},                         # concave along x = -v
    {'running_cost': 'u**2', 'terminal_cost': '-v**2'},
    {'terminal_cost': '(x**2 - 1)**2'},                     # nonconvex in part of the range
    {'running_cost': 'u**2 + abs(x)'}, {'running_cost': '-abs(u)'},
    {'parameters': {'k': 1}, 'running_cost': 'u**2 - k*x**2'},
    {'dynamics': {'x': 'v', 'v': 'u*x'}}, {'terminal_constraints': ['x**2 - 1']},
    {'path_constraints': [{'expr': 'u**2', 'lower': 0.01}]},
    {'final_time': {'free': True, 'lower': 1, 'upper': 3}}])
def test_nonconvex_problems_are_not_taken_for_convex(changes):
    assert not convex(**changes)


@pytest.mark.slow
@pytest.mark.parametrize(('changes', 'is_one'), [
    ({}, True), ({'dynamics': {'x': 'v', 'v': 'u*(1 + x**2)'}}, False)])
def test_only_convex_problems_are_solved_from_one_start(changes, is_one):
    solution = solve(problems.build(BLOCK, **changes))
    assert solution.status is Status.SOLVED, solution.message
    assert (solution.optimality.starts == 1) is is_one
