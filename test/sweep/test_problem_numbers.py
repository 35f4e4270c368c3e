# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a problem by key: each can be varied, and nothing else changes with it."""

import json

import casadi as ca
import numpy as np
from obc_ros.api.plants import System
from obc_ros.api.problem import Problem
from obc_ros.api.sweep import load_numbers, sweep
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.program_cache import collect_numbers
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.recorded_functions import unpack_statement
from obc_ros.sweep.problem_numbers import ProblemNumbers
import pytest

STATEMENT = {
    'name': 'cart', 'states': ['p', 'v'], 'inputs': ['a'], 'units': {'p': 'm', 'm': 'kg'},
    'parameters': {'m': 2.0, 'T': 3.0, 'half': 'm/2'}, 'dynamics': {'p': 'v', 'v': 'a/m*T/T'},
    'running_cost': 'a**2', 'initial_state': {'p': 1, 'v': 0},
    'terminal_constraints': ['p-0.25', 'v'], 'state_bounds': {'v': [-9, None]},
    'path_constraints': [{'expr': 'p+half*v', 'lower': -7, 'upper': 8}],
    'final_time': {'free': False, 'value': 5}}
FREE = {**STATEMENT, 'running_cost': '1', 'input_bounds': {'a': ['-half', 1]},
        'final_time': {'free': True, 'lower': 0.1, 'upper': 50, 'guess': 4}}


def changed(statement, key, value):
    """Return the numbers of the problem before and after, where they differ."""
    numbers = ProblemNumbers(statement)
    numbers.check_key(key)
    before = collect_numbers(build_problem(statement))
    after = collect_numbers(build_problem(numbers.vary({key: value})['statement']))
    different = ~((before == after) | (np.isnan(before) & np.isnan(after)))
    return list(zip(before[different], after[different], strict=True))


@pytest.mark.parametrize(('key', 'expected'), [
    ('x0.p', [(1.0, 0.5)]), ('x0.v', [(0.0, 0.5)]), ('T', [(5.0, 0.5)]),
    ('final_time.value', [(5.0, 0.5)]), ('parameters.T', [(3.0, 0.5)]),
    ('m', [(2.0, 0.5), (1.0, 0.25)]), ('half', [(1.0, 0.5)]),   # half = m/2 follows m
    ('input_bounds.a.upper', [(np.inf, 0.5)]), ('input_bounds.a.lower', [(-np.inf, 0.5)]),
    ('state_bounds.v.lower', [(-9.0, 0.5)]), ('state_bounds.p.upper', [(np.inf, 0.5)]),
    ('path_constraints.0.upper', [(8.0, 0.5)]), ('path_constraints.0.lower', [(-7.0, 0.5)])])
def test_each_number_can_be_varied_alone(key, expected):
    assert changed(STATEMENT, key, 0.5) == expected


def test_numbers_of_a_free_final_time_and_bounds_that_are_expressions():
    assert changed(FREE, 'final_time.lower', 0.5) == [(0.1, 0.5)]
    assert changed(FREE, 'final_time.upper', 9.0) == [(50.0, 9.0)]
    assert changed(FREE, 'input_bounds.a.upper', 0.5) == [(1.0, 0.5)]
    assert changed(FREE, 'm', 4.0) == [(2.0, 4.0), (1.0, 2.0), (-1.0, -2.0)]


def test_bounds_of_a_registered_system_stay():
    statement = {
        'system': 'vehicle', 'running_cost': '1',
        'initial_state': {'px': 0, 'py': 0, 'theta': 0}, 'terminal_constraints': ['px-9'],
        'input_bounds': {'v': [0, 5]}, 'final_time': {'free': True, 'lower': 0.1, 'upper': 50}}
    problem = build_problem(statement)
    index = problem.inputs.index('phi')
    varied = build_problem(ProblemNumbers(statement).vary(
        {'input_bounds.phi.upper': 0.25})['statement'])
    assert varied.u_upper[index] == 0.25 and varied.u_lower[index] == problem.u_lower[index] < 0
    assert changed(statement, 'l', 3.0) == [(2.0, 3.0)]
    assert ProblemNumbers(statement).unit('l') == 'm'


def test_the_statement_itself_does_not_change():
    numbers = ProblemNumbers(STATEMENT)
    copy = {**STATEMENT, 'initial_state': dict(STATEMENT['initial_state'])}
    numbers.vary(dict.fromkeys(numbers.places, 0.5))
    assert copy == STATEMENT == numbers.statement


@pytest.mark.parametrize(('statement', 'key', 'words'), [
    (STATEMENT, 'x0.q', "did you mean 'x0."), (STATEMENT, 'mm', "did you mean 'm'?"),
    (STATEMENT, 'final_time.upper', 'no number'), (FREE, 'T', 'no number'),
    (STATEMENT, 'path_constraints.1.upper', 'path_constraints.0.upper'),
    (STATEMENT, 'dynamics.p', 'no number'), (STATEMENT, '', 'no number'),
    (STATEMENT, 'x0.p\x1b[31m' + 'x' * 999, 'no number'),
    (STATEMENT, 'terminal_constraints[0]#1', 'no number')])
def test_an_unknown_key_is_refused_in_words(statement, key, words):
    with pytest.raises(StatementError) as caught:
        ProblemNumbers(statement).check_key(key)
    assert words in str(caught.value) and len(str(caught.value)) < 400
    assert str(caught.value).isprintable()


def test_a_problem_without_inputs_has_numbers_of_states_only():
    numbers = ProblemNumbers({
        **STATEMENT, 'inputs': [], 'dynamics': {'p': 'v', 'v': '-v/m'}, 'running_cost': 'v**2'})
    assert numbers.dimensions == {'state': ('p', 'v'), 'input': ()}
    assert not [key for key in numbers.places if key.startswith('input_bounds')]


def test_units_are_those_of_the_statement():
    numbers = ProblemNumbers(STATEMENT)
    assert [numbers.unit(key) for key in ('x0.p', 'm', 'x0.v', 'T')] == ['m', 'kg', '', 's']


def test_a_problem_of_the_library_is_swept_by_its_statement():
    assert isinstance(load_numbers(Problem(**STATEMENT)), ProblemNumbers)
    stated = load_numbers(Problem(**STATEMENT | {'running_cost': lambda x, u: u.a**2}))
    request = json.loads(json.dumps(stated.vary({'m': 3.0})))   # workers read plain data
    problem = build_problem(unpack_statement(request))
    assert dict(zip(problem.parameters, problem.p_value, strict=True))['m'] == 3.0
    assert ca.is_equal(problem.L, problem.u[0]**2, 2)


def test_what_other_processes_cannot_read_is_refused():
    """A System is an object of this process: a worker that is sent it would never answer."""
    di = System(states=['p', 'v'], inputs=['u'], dynamics={'p': 'v', 'v': 'u'})
    problem = Problem(system=di, running_cost='u**2', initial_state={'p': 1, 'v': 0},
                          terminal_constraints=['p', 'v'],
                          final_time={'free': False, 'value': 1})
    with pytest.raises(StatementError, match='a system by its name'):
        sweep(problem, {'x0.p': [0, 0.5]})
