# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Costs without a minimum are recognised at once, and no others."""

from pathlib import Path

from obc_ros.core.ocp.solution import Status
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.proofs.existence import (
    advise_bounds,
    explain_no_minimum,
    find_constant_cost,
)
from obc_ros.core.solver.solve import solve
import pytest

BLOCK = {
    'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
    'running_cost': 'u**2', 'initial_state': {'x': 0, 'v': 0},
    'terminal_constraints': ['x - 1', 'v'], 'final_time': {'free': False, 'value': 3}}
FREE = {'terminal_constraints': []}
PROBLEMS = sorted((Path(__file__).parents[3] / 'problems').glob('*.yaml'))


def problem(**changes):
    """Return a double integrator's problem with changes."""
    return build_problem(BLOCK | changes)


@pytest.mark.parametrize('changes', [
    {'running_cost': '-u**2'}, {'running_cost': 'x**2 - 0.1*u**2'},
    FREE | {'running_cost': '-x'}, FREE | {'running_cost': 'u'},
    FREE | {'running_cost': '0', 'terminal_cost': '-x'},
    {'running_cost': 'x', 'terminal_constraints': ['x - 1']},
    # x at T is given, which leaves the integral of x free as long as v at T is.
    {'running_cost': 'x + v'}])
def test_a_cost_that_falls_without_end(changes):
    stated = problem(**changes)
    assert explain_no_minimum(stated).startswith('the cost has no lower bound: ')
    found = solve(stated)
    assert found.status is Status.NOT_CONVERGED
    assert found.message == explain_no_minimum(stated)


@pytest.mark.parametrize('changes', [
    {}, {'running_cost': '-u**2', 'input_bounds': {'u': [-1, 1]}},
    # The integral of v is x(T) - x(0), and that of u is v(T) - v(0): the same for every path.
    {'running_cost': 'v'}, {'running_cost': 'u'}, {'running_cost': '3'},
    {'running_cost': 'x**2'}, {'running_cost': 'abs(u)'}])
def test_a_cost_with_a_lower_bound(changes):
    assert explain_no_minimum(problem(**changes)) == ''


@pytest.mark.parametrize('path', PROBLEMS, ids=lambda path: path.stem)
def test_no_problem_with_an_answer_is_accused(path):
    for mapping in load_file(path):
        assert explain_no_minimum(build_problem(mapping)) == ''


def test_a_contradiction_comes_first():
    found = solve(problem(running_cost='-u**2', state_bounds={'x': [1, 2]}))
    assert found.status is Status.INFEASIBLE
    assert found.message == 'initial state x = 0 and state bound x >= 1 exclude each other'


def test_advice_to_bound_an_input():
    assert 'nothing keeps u from growing' in advise_bounds(problem(running_cost='x**2'))
    assert advise_bounds(problem()) == advise_bounds(problem(input_bounds={'u': [-1, 1]},
                                                             running_cost='x')) == ''


@pytest.mark.parametrize('final_time', [
    {'free': False, 'value': 3}, {'free': True, 'lower': 0.1, 'upper': 10}])
def test_where_every_path_costs_the_same_each_is_an_answer(final_time):
    stated = problem(running_cost='0', input_bounds={'u': [-1, 1]}, final_time=final_time)
    assert find_constant_cost(stated) == 0.0
    found = solve(stated)
    assert found.status is Status.SOLVED, found.message
    assert found.objective == 0.0
    assert not found.lam.any()
