# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Path constraints on inputs: active, inactive, and coupling several inputs."""

import math

import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.solve import solve
import problems
import pytest
from scipy.optimize import brentq


def test_an_inactive_constraint_does_not_change_the_cost():
    """The bound on the power is 9/10; along the optimal path it stays below 0.8."""
    free = {'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u - v**2/10'},
            'running_cost': 'u**2', 'initial_state': {'x': 0, 'v': 0},
            'terminal_constraints': ['x - 6', 'v'], 'input_bounds': {'u': [-1, 2]},
            'final_time': {'free': False, 'value': 6}}
    without = solve(problems.build(free))
    assert np.max(without.u[:, 0] * without.x[:, 1]) < 0.8
    limited = solve(problems.build(free, path_constraints=[{'expr': 'u*v', 'upper': 0.9}]))
    assert limited.status is without.status is Status.SOLVED
    assert limited.objective == pytest.approx(without.objective, rel=1e-7)


@pytest.mark.parametrize('T', [3.1, 4.3])
def test_inputs_with_unit_sum_switch_together(T):
    """Idle, then y to 1 at half the price of x, then x to 1: J = 2 (1/2) + 1/2 + 1."""
    solution = solve(problems.pose(
        {'x': 'u', 'y': 'v'}, '2*x + y', (0, 0), T, inputs=['u', 'v', 'w'],
        terminal_constraints=['x - 1', 'y - 1'],
        input_bounds={'u': [0, 1], 'v': [0, 1], 'w': [0, 1]},
        path_constraints=[{'expr': 'u + v + w', 'lower': 1, 'upper': 1}]))
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(2.5, abs=1e-9)
    np.testing.assert_allclose(solution.switching_times, [T - 2, T - 1], atol=1e-9)


def test_an_equality_with_zero_sides_has_a_multiplier():
    """Motion is along rays from the origin: from (1, 1), y = x at twice the cost of x alone."""
    solution = solve(problems.pose(
        {'x': 'u', 'y': 'w'}, 'u**2 + w**2', (1, 1), 1, inputs=['u', 'w'],
        terminal_constraints=['x - 2'],
        path_constraints=[{'expr': 'u*y - w*x', 'lower': 0, 'upper': 0}]), max_intervals=300)
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(2.0, rel=1e-6)


def test_thrusters_with_unit_sum_switch_once():
    """Full thrust of one, then of the other; at their bounds the inputs satisfy the equality."""
    solution = solve(problems.pose(
        {'s': 'v', 'v': 'a - b'}, 1, (0, 0), {'free': True, 'lower': 0.1, 'upper': 20},
        inputs=['a', 'b'], terminal_constraints=['s - 1', 'v'],
        input_bounds={'a': [0, 1], 'b': [0, 1]},
        path_constraints=[{'expr': 'a + b', 'lower': 1, 'upper': 1}]))
    assert solution.status is Status.SOLVED, solution.message
    assert solution.objective == pytest.approx(2, abs=1e-7)
    np.testing.assert_allclose(solution.switching_times, [1], atol=1e-6)


@pytest.mark.slow
def test_thrust_in_a_disc_reverses_at_the_switching_time():
    """Repeat in other units and with drag, along a line: x_line' = v, v' = u - v with |u| <= 1."""
    found = solve(problems.build('thrust_in_a_disc'))
    np.testing.assert_allclose(found.switching_times, [math.sqrt(5)], atol=1e-5)
    found = solve(problems.build(
        'thrust_in_a_disc', terminal_constraints=['x - 6e10', 'y - 8e10', 'vx', 'vy'],
        path_constraints=[{'expr': 'ux**2 + uy**2', 'lower': None, 'upper': 1e-6}],
        final_time={'free': True, 'lower': 1e5, 'upper': 1e9, 'guess': 1e7}))
    assert found.status is Status.SOLVED, found.message
    assert found.objective == pytest.approx(2e7, rel=1e-6)
    found = solve(problems.build('thrust_in_a_disc', dynamics={
        'x': 'vx', 'y': 'vy', 'vx': 'ux - vx', 'vy': 'uy - vy'}))
    switch = brentq(lambda t: t - math.log(2 - math.exp(-t)) - 5, 1, 20)
    assert found.status is Status.SOLVED, found.message
    assert found.objective == pytest.approx(switch + math.log(2 - math.exp(-switch)), rel=1e-4)
