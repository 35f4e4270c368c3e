# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Certified answers that a bound of the search or a missing part decided say so, everywhere."""

import dataclasses

import obc_ros as obc
import pytest

REST = {
    'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'},
    'initial_state': {'p': 1, 'v': 0}, 'terminal_constraints': ['p', 'v']}
MOVE = {'states': ['p'], 'inputs': ['u'], 'dynamics': {'p': 'u'}, 'initial_state': {'p': 1},
        'input_bounds': {'u': [-1, 1]}}
BOUNDED = {'input_bounds': {'u': [-1, 1]}}


def free(lower, upper):
    return {'final_time': {'free': True, 'lower': lower, 'upper': upper}}


@pytest.mark.parametrize(('statement', 'objective', 'words'), [
    ({**REST, 'running_cost': 1, **free(0.1, 20)}, 0.1,
     ['T = 0.1 s is the lower bound of final_time', 'neither input_bounds nor the cost limit u']),
    ({**REST, 'running_cost': 1, **BOUNDED, **free(3, 20)}, 3.0,
     ['T = 3 s is the lower bound of final_time']),
    # Least effort over a distance of 1 is 12/T^3.
    ({**REST, 'running_cost': 'u**2', **free(0.1, 2)}, 1.5,
     ['T = 2 s is the upper bound of final_time']),
    ({**MOVE, 'running_cost': 1, **free(0.1, 2)}, 0.1,
     ['T = 0.1 s is the lower', 'there is neither a terminal constraint nor a terminal cost']),
    ({**MOVE, 'final_time': {'free': False, 'value': 2}}, 0.0,
     ['all paths cost 0: the cost depends on neither states nor inputs']),
    ({**MOVE, 'running_cost': 3, 'final_time': {'free': False, 'value': 2}}, 6.0,
     ['all paths cost 6: ']),
    # k costs k^2 - 10 k.
    ({**MOVE, 'dynamics': {'p': 'u - p'}, 'initial_state': {'p': 0}, 'running_cost': 'p**2 + u**2',
      'free_parameters': {'k': [0, 2]}, 'terminal_cost': 'k**2 - 10*k',
      'final_time': {'free': False, 'value': 1}}, -16.0, ['k = 2 is its upper bound']),
    ({**REST, 'terminal_constraints': [], 'running_cost': 'u**2',
      'final_time': {'free': False, 'value': 2}}, 0.0,
     ['nothing is asked of the states: none is in the cost or in a constraint']),
    ({**REST, 'inputs': ['u', 'w'], 'running_cost': 'u**2', 'input_bounds': {'w': [-1, 1]},
      'final_time': {'free': False, 'value': 1}}, 12.0,
     ['the input w occurs in neither dynamics, cost nor constraints: its values are arbitrary']),
    # From p to 0 in 1 s with least effort: p^2.
    ({**MOVE, 'input_bounds': {}, 'initial_state': {'p': [1, 2]}, 'running_cost': 'u**2',
      'terminal_constraints': ['p'], 'final_time': {'free': False, 'value': 1}}, 1.0,
     ['p(0) = 1 is the lower bound of initial_state: this bound decides the answer']),
    # From p to 3, and a part of the cost at the start: (3 - p)^2 + (p - 4)^2 falls up to 3.5.
    ({**MOVE, 'input_bounds': {}, 'initial_state': {'p': [1, 2]}, 'running_cost': 'u**2',
      'initial_cost': '(p - 4)**2', 'terminal_constraints': ['p - 3'],
      'final_time': {'free': False, 'value': 1}}, 5.0,
     ['p(0) = 2 is the upper bound of initial_state: this bound decides the answer'])],
    ids=['no bounds of inputs', 'lower', 'upper', 'no end', 'no cost', 'constant', 'parameter',
         'effort only', 'unused input', 'start', 'cost of the start'])
def test_what_decided_an_answer_is_said(statement, objective, words):
    answer = obc.solve(statement)
    assert answer.status == 'solved'
    assert answer.objective == pytest.approx(objective, abs=1e-5)
    assert all(each in answer.remark for each in words), answer.remark
    assert answer.message.endswith(answer.remark)
    assert answer.remark in repr(answer)
    assert answer.remark in answer._repr_html_()
    assert answer.as_json()['remark'] == answer.remark


def test_a_figure_has_the_remark_in_its_title():
    answer = obc.solve({**REST, 'running_cost': 1, **BOUNDED, **free(3, 20)})
    title = ' '.join(answer.plot().get_suptitle().split())
    assert answer.remark in title


@pytest.mark.parametrize('statement', [
    {**REST, 'running_cost': 1, **BOUNDED, **free(0.1, 20)},
    {**REST, 'running_cost': 'u**2', 'final_time': {'free': False, 'value': 2}},
    # (p - 1)^2 + p^2: the best start lies inside, at 1/2, or on a bound that costs nothing.
    *({**MOVE, 'input_bounds': {}, 'initial_state': {'p': box}, 'running_cost': 'u**2',
       'initial_cost': '(p - 1)**2', 'terminal_constraints': ['p'],
       'final_time': {'free': False, 'value': 1}} for box in ([0, 2], [0.5, 2], [0, None])),
    {**MOVE, 'dynamics': {'p': 'u - p'}, 'running_cost': 'p**2 + (u - k)**2',
     'free_parameters': {'k': [-9, None]}, 'final_time': {'free': False, 'value': 1}}])
def test_an_answer_that_the_cost_decided_has_no_remark(statement):
    answer = obc.solve(statement)
    assert (answer.status, answer.remark) == ('solved', '')
    assert repr(dataclasses.replace(answer, name='it')) == (
        f'<Answer it: solved, J = {answer.objective:.10g}>')
