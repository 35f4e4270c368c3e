# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Problems, systems and results go to other processes, also those that functions state."""

import copy
import math
import pickle

import casadi as ca
import control
import numpy as np
import obc_ros as obc
from obc_ros.api.sweep import load_numbers
from obc_ros.core.ocp.statement import build_problem, replace_functions
from obc_ros.core.solver.solve import solve
from obc_ros.core.systems import registry
from obc_ros.core.text.recorded_functions import pack_statement, unpack_statement
import pytest

GRAVITY = 9.81
PENDULUM = {
    'name': 'pendulum', 'states': ['q', 'w'], 'inputs': ['tau'], 'parameters': {'l': 0.5},
    'dynamics': lambda x, u, p: {'q': x.w, 'w': -GRAVITY / p.l * ca.sin(x.q) + u.tau},
    'running_cost': lambda x, u, p, t: u.tau**2 + 0.1 * t * x.q**2,
    'path_constraints': lambda x, u: [{'expr': x.w + x.q, 'upper': 20}],
    'terminal_cost': lambda x: 10 * (x.q**2 + x.w**2),
    'initial_state': {'q': 0.5, 'w': 0}, 'final_time': {'free': False, 'value': 1}}
STEADY = {
    'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': lambda x, u: [x.v, u.u],
    'running_cost': lambda x, u: u.u**2, 'initial_state': {'p': 0, 'v': 0},
    'terminal_constraints': lambda x: [x.p - 1, x.v], 'final_time': {'free': False, 'value': 1}}
WAYS = {'pickle': lambda value: pickle.loads(pickle.dumps(value)), 'copy': copy.deepcopy}


@pytest.fixture(name='give_back', params=WAYS)
def _give_back(request):
    return WAYS[request.param]


def test_a_checked_problem_keeps_its_expressions_and_structure(give_back):
    problem = obc.Problem(**PENDULUM).built
    other = give_back(problem)
    assert other.structure == problem.structure and other.states == problem.states
    point = np.linspace(0.3, 0.9, problem.n), np.array([0.7]), problem.p_value
    for name in ('f', 'L', 'V', 'psi', 'path'):
        one, two = (ca.Function('f', [each.x, each.u, each.p], [getattr(each, name)])(*point)
                    for each in (problem, other))
        np.testing.assert_array_equal(one.full(), two.full())
    np.testing.assert_array_equal(other.path_upper, problem.path_upper)


@pytest.mark.slow
def test_a_copied_problem_has_the_same_solution_bit_for_bit(give_back):
    problem = obc.Problem(**PENDULUM)
    one, two = (solve(each.built) for each in (problem, give_back(problem)))
    for name in ('t', 'x', 'u', 'lam'):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


@pytest.mark.slow
def test_a_copied_answer_is_the_same(give_back):
    answer = obc.solve(STEADY)
    other = give_back(answer)
    assert other.objective == answer.objective and other.certificate == answer.certificate
    assert other.at(0.4).x == answer.at(0.4).x
    assert other.x['p'].tobytes() == answer.x['p'].tobytes()


@pytest.mark.parametrize('name', registry.list_systems())
def test_systems_keep_rates_fields_and_parameters(name, give_back):
    if name == 'linear':
        system = registry.get_system(name, A=[[0.0, 1.0], [0.0, 0.0]], B=[[0.0], [1.0]])
    else:
        system = registry.get_system(name)
    other, x, u = give_back(system), np.full(system.n, 0.3), np.full(system.m, 0.2)
    np.testing.assert_array_equal(other.f(x, u), system.f(x, u))
    np.testing.assert_array_equal(other.measure(x, u)[0], system.measure(x, u)[0])
    assert other.robot.odometry == system.robot.odometry
    assert {message: list(fields) for message, fields in other.robot.commands.items()} == {
        message: list(fields) for message, fields in system.robot.commands.items()}
    for parameter in system.parameters:
        value = {parameter.name: 0.9 * parameter.value}
        np.testing.assert_array_equal(other.with_parameters(value).f(x, u),
                                      system.with_parameters(value).f(x, u))


def test_a_simulation_of_a_system_of_functions_is_copied(give_back):
    system = obc.System(**{key: PENDULUM[key] for key in (
        'name', 'states', 'inputs', 'parameters', 'dynamics')})
    found = obc.simulate(system, [0.1], [1, 0], np.linspace(0, 1, 11))
    other = give_back(found)
    np.testing.assert_array_equal(other.state_rows, found.state_rows)
    shorter = [each.system.with_parameters(l=0.2).f([0.3, 0], [0]) for each in (found, other)]
    np.testing.assert_array_equal(*shorter)
    assert shorter[0][1] == -GRAVITY / 0.2 * np.sin(0.3)


class Square:
    """A right-hand side for numbers."""

    def __call__(self, t, x, u, params):
        return [math.copysign(x[0]**2, u[0])]


def test_a_system_for_numbers_is_simulated_in_another_process(give_back):
    """dx/dt = -x^2, x = 1/(1 + t)."""
    plant = obc.System.from_control(control.NonlinearIOSystem(Square(), inputs=1, states=1))
    path = obc.simulate(give_back(plant), [-1], [1], [0, 1, 3])
    np.testing.assert_allclose(path.x['x1'], [1, 1/2, 1/4], rtol=1e-6)


def test_a_recorded_statement_is_plain_data_and_the_same_problem():
    packed = pack_statement(replace_functions(PENDULUM))
    stated = build_problem(unpack_statement(packed))
    assert set(packed['functions']) == {
        'dynamics', 'running_cost', 'path_constraints', 'terminal_cost'}
    assert stated.structure == build_problem(PENDULUM).structure


def test_functions_are_called_once(give_back):
    calls, problems = [], []
    for k in (1, 2, 3):
        problems.append(obc.Problem(   # a later call would take the last k
            STEADY, running_cost=lambda x, u: calls.append(1) or k * u.u))   # noqa: B023
    later = [*map(give_back, problems), *(each.replace(name='b') for each in problems)]
    numbers = [load_numbers(each).problem for each in problems]
    built = [each.built for each in (*problems, *later)] + numbers + [*map(give_back, numbers)]
    assert len(calls) == 3
    assert [float(ca.evalf(ca.jacobian(each.L, each.u))) for each in built] == 5 * [1, 2, 3]


@pytest.mark.parametrize('key', ['dynamics', 'running_cost'])
def test_a_function_is_called_once_for_another_process(key):
    calls = []
    replace_functions({**STEADY, key: lambda x, u: calls.append(1) or STEADY[key](x, u)})
    assert len(calls) == 1


@pytest.mark.parametrize(('cost', 'said'), [
    (lambda x, u: ca.vertcat(u.u, u.u), 'found a matrix of 2 x 1'),
    (lambda x, u: u.u * ca.SX.sym('y'), "the symbol 'y' is none of those")])
def test_what_cannot_be_recorded_is_refused_in_words(cost, said):
    with pytest.raises(obc.ObcError, match=f'^running_cost: .*{said}'):
        obc.solve(STEADY, running_cost=cost, isolated=True)


@pytest.mark.parametrize(('key', 'value'), [
    ('running_cost', 1), ('initial_cost', 0), ('path_constraints', []),
    ('path_constraints', ['v <= 2']), ('terminal_constraints', ['p == 1', 'v'])])
def test_a_function_may_return_no_symbol(key, value, give_back):
    problem = obc.Problem(STEADY, **{
        key: (lambda x: value) if key[0] in 'ti' else lambda x, u: value})
    assert give_back(problem).built.structure == problem.built.structure
    assert load_numbers(problem).problem.structure == problem.built.structure


def test_a_recorded_function_needs_its_names():
    problem = WAYS['pickle'](obc.Problem(**PENDULUM))
    with pytest.raises(obc.ObcError, match="dynamics: the function used 'l'"):
        problem.replace(parameters={})


@pytest.mark.slow
def test_functions_are_solved_in_another_process():
    there = obc.solve(STEADY, isolated=True)
    assert there.status == 'solved' and there.objective == pytest.approx(12.0, rel=1e-9)
    assert pickle.loads(pickle.dumps(there)).at(0.5).x['p'] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.slow
def test_another_process_starts_at_a_point_of_an_answer():
    begun = obc.solve(STEADY)   # p = 3 t**2 - 2 t**3
    answer = obc.solve(begun, initial_state=begun.at(0.5), initial_guess=begun, isolated=True)
    assert answer.at(0).x == pytest.approx({'p': 0.5, 'v': 1.5}, abs=1e-8)


@pytest.mark.slow
def test_a_sweep_takes_functions():
    bounded = STEADY | {'path_constraints': lambda x, u: [{'expr': x.v, 'upper': 9}]}
    found = obc.sweep(bounded, {'T': [1, 2], 'path_constraints.0.upper': [8, 9]}, workers=1,
                      scheduler='none')
    np.testing.assert_allclose(found['J'], [[12, 12], [1.5, 1.5]], rtol=1e-6)   # 12 / T**3
