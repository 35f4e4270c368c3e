# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Costs without a minimum: detection before solving, no false positives."""

from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.proofs.existence import (
    advise_bounds,
    explain_no_minimum,
    find_constant_cost,
)
from obc_ros.core.solver.solve import solve
import problems
import pytest

BLOCK = problems.DOUBLE_INTEGRATOR
FREE = {'terminal_constraints': []}


@pytest.mark.parametrize('changes', [
    {'running_cost': '-u**2'}, {'running_cost': 'x**2 - 0.1*u**2'},
    FREE | {'running_cost': '-x'}, FREE | {'running_cost': 'u'},
    FREE | {'running_cost': '0', 'terminal_cost': '-x'},
    {'running_cost': 'x', 'terminal_constraints': ['x - 1']},
    # x(T) fixes the integral of v, but not that of x.
    {'running_cost': 'x + v'}])
def test_an_unbounded_cost_is_detected_before_solving(changes):
    problem = problems.build(BLOCK, **changes)
    assert explain_no_minimum(problem).startswith('the cost has no lower bound: ')
    found = solve(problem)
    assert found.status is Status.NOT_CONVERGED
    assert found.message == explain_no_minimum(problem)


@pytest.mark.parametrize('changes', [
    {}, {'running_cost': '-u**2', 'input_bounds': {'u': [-1, 1]}},
    # The integrals of v and u are x(T) - x(0) and v(T) - v(0), the same for every path.
    {'running_cost': 'v'}, {'running_cost': 'u'}, {'running_cost': '3'},
    {'running_cost': 'x**2'}, {'running_cost': 'abs(u)'}])
def test_a_bounded_cost_is_not_called_unbounded(changes):
    assert explain_no_minimum(problems.build(BLOCK, **changes)) == ''


@pytest.mark.parametrize('name', problems.NAMES)
def test_problems_with_a_solution_are_not_called_unbounded(name):
    assert explain_no_minimum(problems.build(name)) == ''


def test_a_contradiction_is_reported_before_an_unbounded_cost():
    found = solve(problems.build(BLOCK, running_cost='-u**2', state_bounds={'x': [1, 2]}))
    assert found.status is Status.INFEASIBLE
    assert found.message == 'initial state x = 0 and state bound x >= 1 exclude each other'


def test_bounds_are_advised_for_an_input_without_cost():
    assert 'the cost does not limit u ' in advise_bounds(
        problems.build(BLOCK, running_cost='x**2'))
    assert advise_bounds(problems.build(BLOCK)) == ''
    assert advise_bounds(
        problems.build(BLOCK, running_cost='x', input_bounds={'u': [-1, 1]})) == ''


@pytest.mark.parametrize('final_time', [
    {'free': False, 'value': 3}, {'free': True, 'lower': 0.1, 'upper': 10}])
def test_any_feasible_path_solves_a_constant_cost(final_time):
    problem = problems.build(
        BLOCK, running_cost='0', input_bounds={'u': [-1, 1]}, final_time=final_time)
    assert find_constant_cost(problem) == 0.0
    found = solve(problem)
    assert found.status is Status.SOLVED, found.message
    assert found.objective == 0.0
    assert not found.lam.any()
