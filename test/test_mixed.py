# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Path constraints that hold inputs: where they do, where not, and several inputs at once."""

import numpy as np
from obc_ros.core.solution import Status
from obc_ros.core.solve import solve
from obc_ros.core.statement import problem_from_mapping
import pytest


def test_a_constraint_on_inputs_that_holds_nowhere_changes_nothing():
    """Power of at most 9/10, of which the best path, which is curved, takes less than 0.8."""
    free = {'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u - v**2/10'},
            'running_cost': 'u**2', 'initial_state': {'x': 0, 'v': 0},
            'terminal_constraints': ['x - 6', 'v'], 'input_bounds': {'u': [-1, 2]},
            'final_time': {'free': False, 'value': 6}}
    without = solve(problem_from_mapping(free))
    assert np.max(without.u[:, 0] * without.x[:, 1]) < 0.8
    limited = solve(problem_from_mapping(
        free | {'path_constraints': [{'expr': 'u*v', 'upper': 0.9}]}))
    assert limited.status is without.status is Status.SOLVED
    assert limited.objective == pytest.approx(without.objective, rel=1e-7)


@pytest.mark.parametrize('T', [3.1, 4.3])
def test_modes_whose_parts_add_up_to_one_switch_together(T):
    """Idle, then y to 1, which costs half of what x does, then x to 1: 2 (1/2) + 1/2 + 1."""
    solution = solve(problem_from_mapping({
        'states': ['x', 'y'], 'inputs': ['u', 'v', 'w'], 'dynamics': {'x': 'u', 'y': 'v'},
        'running_cost': '2*x + y', 'initial_state': {'x': 0, 'y': 0},
        'terminal_constraints': ['x - 1', 'y - 1'],
        'input_bounds': {'u': [0, 1], 'v': [0, 1], 'w': [0, 1]},
        'path_constraints': [{'expr': 'u + v + w', 'lower': 1, 'upper': 1}],
        'final_time': {'free': False, 'value': T}}))
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(2.5, abs=1e-9)
    np.testing.assert_allclose(solution.switching_times, [T - 2, T - 1], atol=1e-9)


def test_an_equality_whose_sides_are_zero_weighs_all_the_same():
    """From (1, 1) to x = 2 along rays of the origin only: y = x and twice the cost of x alone."""
    solution = solve(problem_from_mapping({
        'states': ['x', 'y'], 'inputs': ['u', 'w'], 'dynamics': {'x': 'u', 'y': 'w'},
        'running_cost': 'u**2 + w**2', 'initial_state': {'x': 1, 'y': 1},
        'terminal_constraints': ['x - 2'], 'final_time': {'free': False, 'value': 1},
        'path_constraints': [{'expr': 'u*y - w*x', 'lower': 0, 'upper': 0}]}), max_intervals=300)
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(2.0, rel=1e-6)
