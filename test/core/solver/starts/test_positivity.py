# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""States that stay nonnegative under the dynamics ("amounts")."""

import numpy as np
from obc_ros.core.ocp.solution import Verdict
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.starts.positivity import find_amounts, keep_amounts_positive
import problems
import pytest

# Monod growth in a fed batch; the growth rate has a pole at s = -0.2.
FED_BATCH = {
    'states': ['b', 's', 'v'], 'inputs': ['u'],
    'dynamics': {'b': '0.4*s/(s + 0.2)*b - u*b/v',
                 's': '-4*s/(s + 0.2)*b + u*(150 - s)/v', 'v': 'u'},
    'running_cost': 0, 'terminal_cost': '-b*v', 'initial_state': {'b': 1, 's': 150, 'v': 10},
    'input_bounds': {'u': [0, 12]}, 'final_time': {'free': False, 'value': 10}}
SEEN = np.array([10.0, 150.0, 20.0])


def test_concentrations_and_volumes_are_nonnegative():
    assert find_amounts(problems.build(FED_BATCH), SEEN).tolist() == [True, True, True]


@pytest.mark.parametrize('changes, found', [
    ({'input_bounds': {'u': [-1, 12]}}, [True, False, False]),   # outflow empties the volume
    ({'initial_state': {'b': 1, 's': -0.1, 'v': 10}}, [True, False, True])])
def test_states_that_may_become_negative_are_not_amounts(changes, found):
    assert find_amounts(problems.build(FED_BATCH, **changes), SEEN).tolist() == found


def test_a_position_is_not_an_amount():
    problem = problems.pose({'x': 'v', 'v': 'u'}, 'u**2', (0, 1), 1)
    assert not find_amounts(problem, np.ones(2)).any()


def test_positions_of_a_car_are_not_amounts():
    problem = problems.pose(
        {'x': 'cos(a)', 'y': 'sin(a)', 'a': 'u'}, 1, (0.002, 0, 0.003),
        {'free': True, 'lower': 0.1, 'upper': 30}, input_bounds={'u': [-1, 1]})
    path = np.array([[0.002, 0, 0.003], [-1.5, 1.5, 4.0]])
    assert keep_amounts_positive(problem, [path]) is problem


def test_positions_with_a_heading_of_whole_turns_are_not_amounts():
    problem = problems.pose(
        {'x': 'cos(b) + 0.8', 'y': 'sin(b)'}, '-y*(cos(b) + 0.8)', (0, 0), 3, inputs=['b'],
        input_bounds={'b': [-6.283185307179586, 6.283185307179586]},
        terminal_constraints=['x', 'y'])
    assert not find_amounts(problem, np.ones(2)).any()


def test_a_rate_with_a_pole_does_not_hide_other_rates():
    """The deviation y may become negative; its rate is unbounded at x = -0.02."""
    problem = problems.pose(
        {'x': '-100*u*x - 0.25*u', 'y': '0.5*(1 - exp(25*x/(x + 0.02))) - y'},
        'x**2 + y**2 + u**2', (0.0009, 1), 1)
    assert not find_amounts(problem, np.array([0.0009, 1.0]))[1]


def test_bounds_are_added_only_to_states_that_became_negative():
    problem = problems.build(FED_BATCH)
    good = np.array([[1.0, 150.0, 10.0], [9.0, -0.1, 20.0]])
    assert keep_amounts_positive(problem, [good]) is problem
    bad = good + [[0, 0, 0], [0, -60, 0]]
    assert keep_amounts_positive(problem, [good, bad]).x_lower.tolist() == [-np.inf, 0.0, -np.inf]


@pytest.mark.slow
def test_a_fed_batch_with_sharp_kinetics_is_solved_with_bounds():
    """On coarse meshes s steps over the pole at s = -0.02; without bounds this takes 39 s."""
    found = solve(problems.build(FED_BATCH, dynamics={
        'b': '0.4*s/(s + 0.02)*b - u*b/v', 's': '-4*s/(s + 0.02)*b + u*(150 - s)/v', 'v': 'u'}))
    assert found.certified
    assert [each.verdict for each in found.attempts if each.method == 'positivity'] == [
        Verdict.ACCEPTED]
    assert found.x.min() >= -1e-6 * 150
