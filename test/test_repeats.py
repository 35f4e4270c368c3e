# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The same question again with other numbers: one cache and none answer alike."""

import numpy as np
from obc_ros.core.solution import Status
from obc_ros.core.solve import Cache, solve
from obc_ros.core.statement import problem_from_mapping
import pytest

# What the condition of the Hamiltonian's minimum lets a certified cost be too high, relative.
SAME_COST = 1e-5


def least_fuel(start, dynamics):
    return problem_from_mapping({
        'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': dynamics},
        'running_cost': 'abs(u)', 'initial_state': {'x': start, 'v': 0},
        'terminal_constraints': ['x', 'v'], 'input_bounds': {'u': [-1, 1]},
        'final_time': {'free': False, 'value': 6}})


def test_least_fuel_again_and_again():
    """Of the double integrator: 2 v, v being the speed while coasting, v (T - v) = x(0)."""
    cache = Cache()
    for start in (2.0, 1.9, 2.0):
        solution = solve(least_fuel(start, 'u'), cache=cache)
        assert solution.status is Status.SOLVED
        assert solution.objective == pytest.approx(6 - np.sqrt(36 - 4 * start), rel=1e-5)


def test_least_fuel_of_an_oscillator_again_and_again():
    cache = Cache()
    for start in (2.0, 1.9, 2.0):
        shared, alone = (solve(least_fuel(start, 'u - x'), cache=kept) for kept in (cache, None))
        assert shared.status is alone.status is Status.SOLVED
        assert shared.objective == pytest.approx(alone.objective, rel=SAME_COST)
