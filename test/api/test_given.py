# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Every function accepts a system, a state and a problem in every form, with the same result."""


import copy
import inspect

import control
import numpy as np
import obc_ros as obc
from obc_ros.api import given
from obc_ros.core.ocp.statement import FOR_THE_SOLVER
from obc_ros.core.systems.file import FOR_PEOPLE, OF_A_PLANT, PLANT_KEYS
from obc_ros.core.systems.file import TASK as TASK_KEYS
from obc_ros.core.tasks.minimize import KEYS
from obc_ros.core.text.errors import StatementError
import pytest
import yaml

PLANT = {'name': 'mass', 'states': ['p', 'v'], 'inputs': ['F'], 'parameters': {'m': 2},
         'dynamics': {'p': 'v', 'v': 'F/m'}}
MASS = obc.System(**PLANT)
TASK = {'running_cost': 'F**2', 'initial_state': {'p': 0, 'v': 0},
        'terminal_constraints': ['p - 1', 'v'], 'final_time': {'free': False, 'value': 1}}
PROBLEM = obc.Problem(**PLANT, **TASK)
T = np.linspace(0, 1, 5)


def write(folder, statement):
    file = folder / 'mass.yaml'
    file.write_text(yaml.safe_dump(statement))
    return file


SYSTEMS = {
    'core': lambda folder: MASS.model,
    'path': lambda folder: write(folder, PLANT),
    'name of a file': lambda folder: str(write(folder, PLANT)),
    'file of a problem': lambda folder: write(folder, PLANT | TASK),
    'mapping': lambda folder: PLANT,
    'mapping of a problem': lambda folder: PLANT | TASK,
    'problem': lambda folder: PROBLEM,
    'core problem': lambda folder: PROBLEM.built,
    'state space': lambda folder: control.ss(
        [[0, 1], [0, 0]], [[0], [0.5]], np.eye(2), 0, name='mass', states=['p', 'v'],
        inputs=['F'], outputs=2),
    'nonlinear': lambda folder: MASS.to_control(),
    'its problem': lambda folder: obc.Problem(system=MASS, **TASK)}
OF_SYSTEMS = {
    'lqr': lambda system: obc.lqr(system, [1, 2], [1]).K,
    'lqr at': lambda system: obc.lqr(system, [1, 2], [1], at={'v': 0, 'p': 3}).K,
    'dlqr': lambda system: obc.dlqr(system, [1, 2], [1], period=0.1).K,
    'finite_horizon': lambda system: obc.finite_horizon(system, [1, 2], [1], [0, 0], 1.0).K,
    'simulate': lambda system: obc.simulate(system, [1.0], [0, 1], T).state_rows,
    'equilibrium': lambda system: obc.equilibrium(system, [2, 0]).x,
    'plan': lambda system: obc.plan(system, [0, 0], [1, 0], 'effort', final_time=1).objective,
    'Problem': lambda system: obc.solve(obc.Problem(system=system, **TASK)).objective,
    'solve': lambda system: obc.solve(system=system, **TASK).objective}


@pytest.mark.parametrize('form', SYSTEMS)
@pytest.mark.parametrize('function', OF_SYSTEMS)
def test_a_function_takes_a_system_in_every_form(function, form, tmp_path):
    expected = OF_SYSTEMS[function](MASS)
    np.testing.assert_allclose(OF_SYSTEMS[function](SYSTEMS[form](tmp_path)), expected,
                               rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize('function', ['lqr', 'dlqr', 'finite_horizon', 'simulate', 'equilibrium'])
def test_a_name_is_the_registered_system(function):
    name = 'double_integrator'
    expected = OF_SYSTEMS[function](obc.systems[name])
    np.testing.assert_array_equal(OF_SYSTEMS[function](name), expected)
    problem = obc.Problem(system=name, **TASK | {'running_cost': 'u**2', 'initial_state': [0, 0],
                                                 'terminal_constraints': ['x1 - 1', 'x2']})
    np.testing.assert_array_equal(OF_SYSTEMS[function](problem), expected)


POINT = obc.solve(PROBLEM).at(0.25)
STATES = {'mapping': dict(POINT.x), 'list': [POINT.x['p'], POINT.x['v']],
          'tuple': (POINT.x['p'], POINT.x['v']), 'other order': {'v': POINT.x['v'],
                                                                 'p': POINT.x['p']},
          'point': POINT}
OF_STATES = {
    'simulate': lambda x: obc.simulate(MASS, [1.0], x, T).state_rows,
    'plan start': lambda x: obc.plan(MASS, x, [0, 0], 'effort', final_time=1).objective,
    'plan goal': lambda x: obc.plan(MASS, [0, 0], x, 'effort', final_time=1).objective,
    'f': lambda x: MASS.f(x, [1]),
    'design': lambda x: obc.lqr(MASS, [1, 1], [1])(0.0, x),
    'solve': lambda x: obc.solve(PROBLEM, initial_state=x).objective,
    'Problem': lambda x: obc.solve(obc.Problem(**PLANT | TASK | {'initial_state': x})).objective,
    'replace': lambda x: obc.solve(PROBLEM.replace(initial_state=x)).objective}


@pytest.mark.parametrize('form', STATES)
@pytest.mark.parametrize('function', OF_STATES)
def test_a_function_takes_a_state_in_every_form(function, form):
    expected = OF_STATES[function](np.array(STATES['list']))
    np.testing.assert_allclose(OF_STATES[function](STATES[form]), expected, rtol=1e-12)


@pytest.mark.parametrize('form', [
    {'p': 3, 'v': 0}, [3, 0], obc.equilibrium(MASS, [3, 0])], ids=['mapping', 'list', 'rest'])
def test_a_set_point_is_taken_in_every_form(form):
    assert obc.equilibrium(MASS, form).x.tolist() == [3, 0]
    assert obc.lqr(MASS, [1, 1], [1], at=form).xe.tolist() == [3, 0]
    np.testing.assert_array_equal(MASS.linearize(form, {'F': 0})[1], [[0], [0.5]])


PROBLEMS = {
    'core': lambda folder: PROBLEM.built,
    'answer': lambda folder: obc.solve(PROBLEM),
    "an answer's problem": lambda folder: obc.solve(PROBLEM).problem,
    'mapping': lambda folder: PLANT | TASK,
    'path': lambda folder: write(folder, PLANT | TASK),
    'name of a file': lambda folder: str(write(folder, PLANT | TASK)),
    'copied': lambda folder: copy.deepcopy(obc.Problem(**PLANT | TASK | {
        'dynamics': lambda x, u, p: {'p': x.v, 'v': u.F/p.m},
        'terminal_constraints': lambda x: [x.p - 1, x.v]}).built),
    'text': lambda folder: yaml.safe_dump(PLANT | TASK),
    'list': lambda folder: write(folder, PLANT | TASK | {'initial_state': [0, 0]})}
OF_PROBLEMS = {
    'solve': lambda problem: obc.solve(problem).objective,
    'change': lambda problem: obc.solve(problem, parameters={'m': 3}).objective,
    'certify': lambda problem: obc.certify(problem, obc.solve(PROBLEM)).residuals['dynamics'],
    'equilibrium': lambda problem: obc.equilibrium(obc.Problem.from_dict(
        obc.Problem(**PLANT | TASK).statement)).x}


@pytest.mark.parametrize('form', PROBLEMS)
@pytest.mark.parametrize('function', OF_PROBLEMS)
def test_a_function_takes_a_problem_in_every_form(function, form, tmp_path):
    expected = OF_PROBLEMS[function](PROBLEM)
    assert OF_PROBLEMS[function](PROBLEMS[form](tmp_path)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize('form', PROBLEMS)
def test_a_sweep_takes_a_problem_in_every_form(form, tmp_path):
    """With T = 1, J = 12 m^2 (p(T) - p(0))^2."""
    found = obc.sweep(PROBLEMS[form](tmp_path), {'x0.p': [0, 0.5]}, workers=1, scheduler='none')
    assert found.J.values == pytest.approx([48, 12])


def test_an_answer_is_certified_again():
    answer = obc.solve(PROBLEM)
    assert obc.certify(answer).residuals == answer.certificate.residuals


@pytest.mark.parametrize(('x', 'found'), [
    ([1], 'a list of 1'), (3, "int '3'"), ('fast', "str 'fast'"), (None, 'nothing'),
    (np.eye(2), r'an array of shape \(2, 2\)'), ({'p': 1}, "nothing for 'v'"),
    ({'p': 1, 'v': 0, 'w': 1}, "'w'"), ({'p': 1, 'v': 'fast'}, 'a mapping')])
def test_a_state_is_refused_with_its_names(x, found):
    with pytest.raises(StatementError, match=(
            r'^x0: wanted numbers for p, v, such as \[0, 0\] or \{p: 0, v: 0\}; found ' + found)):
        obc.simulate(MASS, [1.0], x, T)


@pytest.mark.parametrize('function', OF_SYSTEMS)
def test_what_is_no_system_is_refused(function):
    with pytest.raises(StatementError, match='^system: wanted a System, a name, a file'):
        OF_SYSTEMS[function]({'aircraft'})


def test_the_text_of_a_problem_names_no_file(tmp_path):
    """A text may be of another person, who must not be able to read files."""
    statement = {'system': str(write(tmp_path, PLANT)), **TASK}
    with pytest.raises(StatementError, match='^system: unknown system'):
        obc.Problem.from_text(yaml.safe_dump(statement))
    with pytest.raises(StatementError, match='^system: unknown system'):
        obc.solve(statement)


KEYWORDS = {'problem', 'self', 'others'}
OF_SOLVE = {'time_limit', 'options', 'report', 'isolated', 'cache'}


def list_keywords(function):
    return set(inspect.signature(function).parameters) - KEYWORDS


def test_keywords_are_the_keys_of_a_statement():
    assert list_keywords(obc.Problem) == set(FOR_THE_SOLVER)
    assert list_keywords(obc.solve) - OF_SOLVE == set(FOR_THE_SOLVER)
    assert list_keywords(obc.System) == set(PLANT_KEYS)
    assert list_keywords(obc.minimize) - {'statement', 'time_limit'} == set(KEYS)
    others = set(given.KeysOfPlant.__annotations__)
    assert others == {*OF_A_PLANT, *FOR_PEOPLE}
    task = set(given.KeysOfTask.__annotations__)
    assert task == {*TASK_KEYS, *FOR_PEOPLE}


def test_every_argument_has_a_name_and_a_type():
    """For completion in editors: no function takes `*arguments`, and `**others` are typed."""
    for name in obc.__all__:
        function = getattr(obc, name)
        if not inspect.isroutine(function) and function not in (obc.Problem, obc.System):
            continue
        for each in inspect.signature(function).parameters.values():
            assert each.kind is not each.VAR_POSITIONAL, (name, each)
            assert each.kind is not each.VAR_KEYWORD or 'Unpack' in str(each.annotation), name


def test_a_key_that_is_none_replaces_another():
    """Without its terminal constraints, the least effort is none."""
    assert obc.solve(PROBLEM, terminal_constraints=None).objective == pytest.approx(0, abs=1e-9)
    other = obc.Problem(PROBLEM, initial_state=[0.5, 0])
    assert other.built.x0[:2].tolist() == [0.5, 0]
    with pytest.raises(StatementError, match=r'^runing_cost: unknown key \(did you mean'):
        obc.Problem(PROBLEM, runing_cost=1)


def test_signatures_name_the_types_of_the_library_in_short():
    """A union of every form that is accepted is longer than a screen."""
    for name in obc.__all__:
        if inspect.isfunction(found := getattr(obc, name)):
            assert 'collections.abc' not in str(inspect.signature(found)), name
