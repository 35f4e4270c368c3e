# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""First plans: accepted near the set point; refused with each reason; cost beside `solve`."""

from dataclasses import replace

import numpy as np
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.receding.first_plan import check_first_plan
from obc_ros.core.receding.step_solver import StepSolver
from obc_ros.core.receding.terminal_set import find_terminal_set
from obc_ros.core.solver.solve import solve
import pytest
from receding_problems import make_receding

STATED = {'states': ['p', 'v'], 'inputs': ['a'], 'dynamics': {'p': 'v', 'v': 'a'},
          'running_cost': 'p**2 + 0.1*v**2 + 0.1*a**2', 'initial_state': {'p': 2, 'v': 0},
          'final_time': {'free': False, 'value': 4}, 'input_bounds': {'a': [-1, 1]},
          'state_bounds': {'v': [-0.8, 0.8]}}
PROBLEM = make_receding(STATED, horizon=200, period=0.02)
SOLVER = StepSolver(PROBLEM, compiled=False)
START = np.array([2.0, 0.0])


def test_a_plan_that_ends_in_the_terminal_set_is_accepted() -> None:
    """All checks hold."""
    report = check_first_plan(PROBLEM, SOLVER.solve(START), find_terminal_set(PROBLEM))
    assert report.accepted and report.reasons == () and 0.0 < report.end <= 1.0


def test_each_defect_is_a_reason() -> None:
    """A plan is spoiled in one way after the other."""
    result = SOLVER.solve(START)
    assert result.plan is not None
    x = result.plan.x.copy()
    x[5, 0] += 1e-3
    for change, words in (({'x': x}, 'model'), ({'u': result.plan.u - 1.5}, 'outside its bounds'),
                          ({'residual': 1e-3}, 'not optimal')):
        report = check_first_plan(PROBLEM, replace(result, plan=replace(result.plan, **change)))
        assert not report.accepted and words in report.words


def test_limits_are_computed_from_the_plan_itself() -> None:
    """A plan whose step tells no excess is checked against narrower bounds."""
    result = SOLVER.solve(START)
    assert result.plan is not None and result.plan.slack == {}
    narrow = make_receding({
        **STATED, 'state_bounds': {'v': [-0.5, 0.8]},
        'path_constraints': [{'expr': 'p*p', 'upper': 3.9}]}, horizon=200, period=0.02)
    assert check_first_plan(narrow, result).reasons == (
        'v is exceeded by 0.3', 'path_constraints[0] is exceeded by 0.1')


def test_a_plan_in_flight_may_exceed_a_limit_as_the_state_or_the_plan_before_it() -> None:
    """The state begins 0.2 outside of a bound; a plan from there exceeds it at its beginning."""
    problem = make_receding({**STATED, 'state_bounds': {'v': [-1.0, 0.8]}}, horizon=200,
                            period=0.02)
    result = StepSolver(problem, compiled=False).solve([0.5, 1.0])
    assert result.plan is not None
    assert check_first_plan(problem, result).reasons == ('v is exceeded by 0.2',)
    assert check_first_plan(problem, result, present={}).accepted
    narrow = make_receding({**STATED, 'state_bounds': {'v': [-1.0, 0.8], 'p': [None, 0.5]}},
                           horizon=200, period=0.02)
    over = float(result.plan.x[:, 0].max()) - 0.5
    assert over > 1e-3
    assert check_first_plan(narrow, result, present={}).reasons == (
        f'p is exceeded by {over:.3g}',)
    assert check_first_plan(narrow, result, present={'p': over}).accepted


def test_a_plan_that_ends_outside_the_terminal_set_is_refused() -> None:
    """Three periods are too few to get there."""
    short = replace(PROBLEM, horizon=3)
    found, result = find_terminal_set(short), StepSolver(short, compiled=False).solve(START)
    report = check_first_plan(short, result, found)
    assert not report.accepted and report.end > 1.0
    assert 'ends outside of the set' in report.words
    report = check_first_plan(short, result, found, must_end_in_set=False)
    assert report.accepted and 'ends outside of the set' in report.words
    e = result.plan.x[-1]
    assert report.end == pytest.approx(e @ found.P @ e / found.level)


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
