# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Problems of which no path is better than one that satisfies Pontryagin's conditions."""

from obc_ros.core.ocp.solution import Status
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.program_cache import Kit
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.starts import multistart
import pytest

BLOCK = {
    'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
    'running_cost': 'x**2 + u**2', 'terminal_cost': '(x - v)**2',
    'initial_state': {'x': 1, 'v': 0},
    'input_bounds': {'u': [-0.5, 0.5]}, 'state_bounds': {'v': [-0.3, None]},
    'path_constraints': [{'expr': 'v + u', 'upper': 0.6}],
    'final_time': {'free': False, 'value': 3}}


def convex(**changes):
    problem = build_problem(BLOCK | changes)
    return Kit(problem).convex(problem)


@pytest.mark.parametrize('changes', [
    {}, {'running_cost': 'u'}, {'running_cost': '1e-8*x**2 + 1e6*(u + 3*x)**2'},
    {'running_cost': '(x - 2*v + 3*u)**2'}, {'terminal_constraints': ['x - v']},
    {'parameters': {'k': -1}, 'running_cost': 'u**2 - k*x**2'}])
def test_convex(changes):
    assert convex(**changes)


@pytest.mark.parametrize('changes', [
    {'running_cost': 'u**2 - 1e-8*x**2'},                   # curved downwards, in other units
    {'running_cost': 'u**2 + x*v'},                         # likewise, along x = -v
    {'running_cost': 'u**2', 'terminal_cost': '-v**2'},
    {'terminal_cost': '(x**2 - 1)**2'},                     # curved otherwise elsewhere
    {'running_cost': 'u**2 + abs(x)'}, {'running_cost': '-abs(u)'},
    {'parameters': {'k': 1}, 'running_cost': 'u**2 - k*x**2'},
    {'dynamics': {'x': 'v', 'v': 'u*x'}}, {'terminal_constraints': ['x**2 - 1']},
    {'path_constraints': [{'expr': 'u**2', 'lower': 0.01}]},
    {'final_time': {'free': True, 'lower': 1, 'upper': 3}}])
def test_not_to_be_taken_for_convex(changes):
    assert not convex(**changes)


@pytest.mark.slow
def test_nothing_better_is_looked_for_where_there_is_nothing(monkeypatch):
    monkeypatch.setattr(multistart, 'interleave_rollouts', None)
    monkeypatch.setattr(multistart, '_enough', None)
    assert solve(build_problem(BLOCK)).status is Status.SOLVED
    with pytest.raises(TypeError):
        solve(build_problem(BLOCK | {'dynamics': {'x': 'v', 'v': 'u*(1 + x**2)'}}))
