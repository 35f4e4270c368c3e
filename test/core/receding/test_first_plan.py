# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""First plans: accepted near the set point; refused with each reason; cost beside `solve`."""

from dataclasses import replace
from typing import Any

import numpy as np
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.receding.first_plan import check_first_plan
from obc_ros.core.receding.step_solver import StepSolver
from obc_ros.core.receding.terminal_set import find_terminal_set
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import DynamicsError
import pytest
from receding_problems import make_receding

STATED = {'states': ['p', 'v'], 'inputs': ['a'], 'dynamics': {'p': 'v', 'v': 'a'},
          'running_cost': 'p**2 + 0.1*v**2 + 0.1*a**2', 'initial_state': {'p': 2, 'v': 0},
          'final_time': {'free': False, 'value': 4}, 'input_bounds': {'a': [-1, 1]},
          'state_bounds': {'v': [-0.8, 0.8]}}
PROBLEM = make_receding(STATED, horizon=200, period=0.02)
SOLVER = StepSolver(PROBLEM, compiled=False)
START, SET = np.array([2.0, 0.0]), find_terminal_set(PROBLEM)


def check_refused(reasons: str, *arguments: Any) -> None:
    """Check that a plan is refused for these reasons."""
    with pytest.raises(DynamicsError, match=f'keeps all limits: {reasons}$'):
        check_first_plan(*arguments)


def test_a_plan_that_ends_in_the_terminal_set_is_accepted() -> None:
    """All checks hold."""
    words = check_first_plan(PROBLEM, SOLVER.solve(START), SET)
    assert 'ends inside' in words and 0.0 < float(words.rpartition(' = ')[2]) <= 1.0


def test_each_defect_is_a_reason() -> None:
    """A plan is spoiled in one way after the other."""
    result = SOLVER.solve(START)
    assert result.plan is not None
    x = result.plan.x.copy()
    x[5, 0] += 1e-3
    u = result.plan.u - 1.5
    for spoiled, words in (({'x': x}, 'model'), ({'u': u}, 'outside its bounds')):
        check_refused(f'.*{words}.*', PROBLEM,
                      replace(result, plan=replace(result.plan, **spoiled)), SET)
    check_refused('it is not optimal.*', PROBLEM, replace(result, residual=1e-3), SET)


def test_limits_are_computed_from_the_plan_itself() -> None:
    """A plan whose step tells no excess is checked against narrower bounds."""
    result = SOLVER.solve(START)
    assert result.slack == {}
    narrow = make_receding({
        **STATED, 'state_bounds': {'v': [-0.5, 0.8]},
        'path_constraints': [{'expr': 'p*p', 'upper': 3.9}]}, horizon=200, period=0.02)
    check_refused(r'v is exceeded by 0\.3; path_constraints\[0\] is exceeded by 0\.1', narrow,
                  result, SET)


def test_a_plan_in_flight_may_exceed_a_limit_as_the_state_or_the_plan_before_it() -> None:
    """The state begins 0.2 outside of a bound; a plan from there exceeds it at its beginning."""
    problem = make_receding({**STATED, 'state_bounds': {'v': [-1.0, 0.8]}}, horizon=200,
                            period=0.02)
    result = StepSolver(problem, compiled=False).solve([0.5, 1.0])
    assert result.plan is not None
    check_refused(r'v is exceeded by 0\.2', problem, result, SET)
    check_first_plan(problem, result, SET, {})
    narrow = make_receding({**STATED, 'state_bounds': {'v': [-1.0, 0.8], 'p': [None, 0.5]}},
                           horizon=200, period=0.02)
    over = float(result.plan.x[:, 0].max()) - 0.5
    assert over > 1e-3
    check_refused(f'p is exceeded by {over:.3g}', narrow, result, SET, {})
    check_first_plan(narrow, result, SET, {'p': over})


def test_a_plan_may_end_outside_the_terminal_set_and_says_so() -> None:
    """Three periods are too few to get there."""
    short = replace(PROBLEM, horizon=3)
    found, result = find_terminal_set(short), StepSolver(short, compiled=False).solve(START)
    words, e = check_first_plan(short, result, found), result.plan.x[-1]
    assert 'ends outside of the set' in words
    assert float(words.rpartition(' = ')[2]) == pytest.approx(
        e @ found.P @ e / found.level, rel=1e-2)


@pytest.mark.slow
def test_the_cost_is_within_a_percent_of_the_certified_optimum() -> None:
    """The open-loop problem with the same end, solved in continuous time."""
    result = SOLVER.solve(START)
    P = PROBLEM.P
    optimum = solve(build_problem({**STATED, 'terminal_cost':
                                   f'{P[0, 0]}*p**2 + {2 * P[0, 1]}*p*v + {P[1, 1]}*v**2'}))
    assert result.plan is not None and optimum.status == 'solved'
    assert optimum.objective <= result.plan.cost + 1e-6
    assert result.plan.cost == pytest.approx(optimum.objective, rel=0.01)
