# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Amounts that cannot become negative by themselves."""

import numpy as np
from obc_ros.core.ocp.positivity import find_amounts, keep_amounts_positive
import problems
import pytest

# Monod growth on a feed, with a pole of the rate at s = -0.2.
FED_BATCH = {
    'states': ['b', 's', 'v'], 'inputs': ['u'],
    'dynamics': {'b': '0.4*s/(s + 0.2)*b - u*b/v',
                 's': '-4*s/(s + 0.2)*b + u*(150 - s)/v', 'v': 'u'},
    'running_cost': 0, 'terminal_cost': '-b*v', 'initial_state': {'b': 1, 's': 150, 'v': 10},
    'input_bounds': {'u': [0, 12]}, 'final_time': {'free': False, 'value': 10}}
SEEN = np.array([10.0, 150.0, 20.0])


def test_concentrations_and_volumes_are_amounts():
    assert find_amounts(problems.build(FED_BATCH), SEEN).tolist() == [True, True, True]


@pytest.mark.parametrize('changes, found', [
    ({'input_bounds': {'u': [-1, 12]}}, [True, False, False]),   # what flows out may be missing
    ({'initial_state': {'b': 1, 's': -0.1, 'v': 10}}, [True, False, True])])
def test_what_may_become_negative_is_no_amount(changes, found):
    assert find_amounts(problems.build(FED_BATCH, **changes), SEEN).tolist() == found


def test_a_position_is_no_amount():
    problem = problems.pose({'x': 'v', 'v': 'u'}, 'u**2', (0, 1), 1)
    assert not find_amounts(problem, np.ones(2)).any()


def test_a_place_is_no_amount_though_a_car_that_hardly_turns_does_not_get_behind_itself():
    problem = problems.pose(
        {'x': 'cos(a)', 'y': 'sin(a)', 'a': 'u'}, 1, (0.002, 0, 0.003),
        {'free': True, 'lower': 0.1, 'upper': 30}, input_bounds={'u': [-1, 1]})
    path = np.array([[0.002, 0, 0.003], [-1.5, 1.5, 4.0]])
    assert keep_amounts_positive(problem, [path]) is problem


def test_a_place_is_no_amount_where_bounds_of_a_heading_are_whole_turns():
    problem = problems.pose(
        {'x': 'cos(b) + 0.8', 'y': 'sin(b)'}, '-y*(cos(b) + 0.8)', (0, 0), 3, inputs=['b'],
        input_bounds={'b': [-6.283185307179586, 6.283185307179586]},
        terminal_constraints=['x', 'y'])
    assert not find_amounts(problem, np.ones(2)).any()


def test_rates_next_to_a_pole_hide_no_others():
    """What is deviation from rest may become negative, though a rate at x = -0.02 has no end."""
    problem = problems.pose(
        {'x': '-100*u*x - 0.25*u', 'y': '0.5*(1 - exp(25*x/(x + 0.02))) - y'},
        'x**2 + y**2 + u**2', (0.0009, 1), 1)
    assert not find_amounts(problem, np.array([0.0009, 1.0]))[1]


def test_only_what_went_astray_is_kept():
    problem = problems.build(FED_BATCH)
    good = np.array([[1.0, 150.0, 10.0], [9.0, -0.1, 20.0]])
    assert keep_amounts_positive(problem, [good]) is problem
    bad = good + [[0, 0, 0], [0, -60, 0]]
    assert keep_amounts_positive(problem, [good, bad]).x_lower.tolist() == [-np.inf, 0.0, -np.inf]
