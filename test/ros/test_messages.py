# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of problems and solutions to ROS messages and back, without loss."""

import dataclasses
import math
import subprocess
import sys

import numpy as np
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.solution import (
    Attempt,
    Certificate,
    Optimality,
    Solution,
    Status,
    Verdict,
)
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import NamedBounds, NamedExpression, NamedValues, OptimalControlProblem
from obc_ros.ros import messages
from obc_ros.srv import DesignLqr, Minimize, PlanMotion, SolveOptimalControl
from obc_ros.workers.solving import pack_solution
from obc_ros.workers.wire import pack, Packet, unpack
import problems
import pytest
from rclpy.serialization import deserialize_message, serialize_message

EVERYTHING = {
    'name': 'everything', 'states': ['x', 'v'], 'inputs': ['u', 'w'],
    'parameters': {'a': 0.1, 'b': 'a/3', 'c': 1e-17},
    'dynamics': {'x': 'v', 'v': 'u - a*v + b*w'},
    'running_cost': 'u**2 + w**2', 'terminal_cost': 'c*x**2',
    'initial_state': {'x': 'b', 'v': -0.30000000000000004},
    'terminal_constraints': ['x - 1', 'v'],
    'input_bounds': {'u': [None, '2*a'], 'w': None}, 'state_bounds': {'v': [-3, None]},
    'path_constraints': [{'expr': 'x + u', 'lower': None, 'upper': 5},
                         {'expr': 'x*v', 'lower': '-a'}],
    'final_time': {'free': True, 'lower': 0.5, 'upper': 10, 'guess': 'a*30'},
    'initial_guess': {'states': {'x': [0, 'a', 1]}, 'inputs': {'u': 0.5}, 'final_time': 2},
}
BEYOND = {
    'name': 'beyond', 'states': ['x', 'v', 'w'], 'inputs': ['u'], 'parameters': {'a': 0.1},
    'free_parameters': {'m': [1, '30*a'], 'k': None},
    'dynamics': {'x': 'v', 'v': 'u/m + sin(t)', 'w': 'k*v'}, 'running_cost': 'u**2*(1 + t)',
    'initial_cost': '(x - 1)**2 + k**2', 'initial_constraints': ['x + v - 3'],
    'initial_state': {'x': None, 'v': [0.1, '7*a'], 'w': [None, 3]}, 'periodic': ['w'],
    'boundary_constraints': ['x - 2*v_0'],
    'terminal_constraints': ['x - m*t'], 'final_time': {'free': False, 'value': 1},
    'initial_guess': {'states': {'x': [0, 1]}, 'parameters': {'m': 2.5}},
}
IN_PHASES = {
    'name': 'in phases', 'states': ['x', 'v'], 'inputs': ['u'], 'parameters': {'a': 0.1},
    'dynamics': {'x': 'v', 'v': 'u'}, 'running_cost': 'u**2', 'initial_state': {'x': 0, 'v': 'a'},
    'terminal_constraints': ['x - 2'], 'state_bounds': {'v': [None, 3]},
    'phases': [
        {'name': 'first', 'duration': '10*a', 'terminal_constraints': ['x - 1'],
         'terminal_cost': 'v**2', 'input_bounds': {'u': [-1, None]}},
        {'duration': {'free': True, 'lower': 0.5, 'upper': 2, 'guess': 1},
         'dynamics': {'x': 'v', 'v': 'u - t'}, 'running_cost': 'u**2 + t',
         'link': {'x': 'x + a', 'v': None}, 'path_constraints': [{'expr': 'x + u', 'upper': 9}],
         'initial_guess': {'states': {'x': [1, 2]}, 'inputs': {'u': 0.5}}}],
}
LINEAR = {
    'name': 'linear', 'system': 'linear',
    'parameters': {'A': [[0, 1], [0, 0]], 'B': [0, 1], 'goal': '1/3'},
    'running_cost': 'u1**2', 'initial_state': {'x1': 0, 'x2': 0},
    'terminal_constraints': ['x1 - goal', 'x2'], 'final_time': {'free': False, 'value': 1}}
STATEMENTS = {each['name']: each for each in (EVERYTHING, BEYOND, IN_PHASES, LINEAR)}
NUMBERS = ('p_value', 'x0', 'x_lower', 'x_upper', 'u_lower', 'u_upper', 'path_lower', 'path_upper')


def serialized_and_back(message):
    """Return a message after serialisation and deserialisation, as over DDS."""
    return deserialize_message(serialize_message(message), type(message))


@pytest.mark.parametrize('statement', [*STATEMENTS, *(
    name for name in problems.NAMES if name != 'house_and_battery')])
def test_a_statement_is_unchanged_by_the_message(statement):
    mapping = STATEMENTS.get(statement) or problems.read(statement)
    problem = build_problem(mapping)
    message = serialized_and_back(messages.build_problem_message(mapping, problem.guess))
    arrived = build_problem(unpack(pack(Packet(messages.read_statement(message)))).plain)
    assert arrived.name == problem.name
    assert arrived.structure == problem.structure
    assert (arrived.states, arrived.inputs) == (problem.states, problem.inputs)
    for name in NUMBERS:
        assert np.array_equal(getattr(arrived, name), getattr(problem, name)), name
    assert np.array_equal(arrived.start_box, problem.start_box)
    assert (arrived.free_parameters, arrived.added) == (problem.free_parameters, problem.added)
    assert arrived.phases == problem.phases
    assert repr(arrived.final_time) == repr(problem.final_time)
    assert arrived.guess.final_time == problem.guess.final_time
    for part in ('x', 'u'):
        guess = getattr(problem.guess, part)
        assert getattr(arrived.guess, part).keys() == guess.keys()
        for name, values in guess.items():
            assert np.array_equal(getattr(arrived.guess, part)[name], values)


def test_a_message_takes_bounds_at_the_end_but_no_data():
    mapping = problems.read('house_and_battery')
    with pytest.raises(StatementError, match='^tables: a message has none'):
        messages.build_problem_message(mapping, Guess())
    rows = [{'expr': 'x1', 'lower': 0, 'upper': 'goal'}, {'expr': 'x2', 'upper': 1}]
    mapping = LINEAR | {'terminal_constraints': rows}
    message = messages.build_problem_message(mapping, Guess())
    assert list(message.terminal_constraints) == ['0 <= x1 <= goal', 'x2 <= 1']
    arrived = build_problem(messages.read_statement(message))
    assert arrived.structure == build_problem(mapping).structure


@pytest.mark.parametrize('field, entries', [
    ('parameters', [NamedExpression(name='a', expression='1')] * 2),
    ('dynamics', [NamedExpression(name='x', expression='u')] * 2),
    ('input_bounds', [NamedBounds(name='u', lower='0', upper='1')] * 2),
    ('initial_state', [NamedExpression(name='', expression='')] * 2),
])
def test_a_repeated_name_is_refused(field, entries):
    message = OptimalControlProblem(**{field: entries})
    with pytest.raises(StatementError, match=f'^{field}: .* is given twice'):
        messages.read_statement(message)


@pytest.mark.parametrize('text', ['[', '[1, 2', '[[1], x]', '[' * 10_000])
def test_a_malformed_list_is_refused(text):
    message = OptimalControlProblem(parameters=[NamedExpression(name='A', expression=text)])
    with pytest.raises(StatementError, match=r'^parameters\.A: .* is no list of numbers'):
        messages.read_statement(message)


@pytest.mark.parametrize('kind, make', [
    ('solve', lambda: SolveOptimalControl.Request(
        problem=OptimalControlProblem(running_cost='u' * 11_000_000))),
    ('solve', lambda: SolveOptimalControl.Request(
        problem=OptimalControlProblem(terminal_constraints=['x' * 9] * 800_000))),
    ('minimize', lambda: Minimize.Request(cost='x' * 11_000_000)),
    ('plan', lambda: PlanMotion.Request(start=[0.0] * 1_300_000)),
    ('design_lqr', lambda: DesignLqr.Request(a=[0.0] * 2_000_000)),
])
def test_an_oversized_request_is_refused(kind, make):
    with pytest.raises(StatementError, match=r'has \d+ bytes of text and numbers; at most'):
        messages.read_request(kind, make())


def made_up_solution(problem, **changes):
    """Return a solution of the right shapes with made-up numbers."""
    N, (n, m, q) = 5, (problem.n, problem.m, problem.q)
    numbers = np.random.default_rng(1).normal
    return Solution(**{
        'status': Status.SOLVED, 'message': 'words', 'objective': 1.5, 't': np.arange(N) * 0.1,
        'x': numbers(size=(N, n)), 'u': numbers(size=(N, m)), 'lam': numbers(size=(N, n)),
        'hamiltonian': numbers(size=N), 'nu': numbers(size=q), 'interpolation': 'zoh',
        'switching_times': np.array([0.25]), 'method': 'm', 'iterations': np.int64(7),
        'build_time': 0.5, 'solve_time': 0.25,
        'certificate': Certificate({'start': 0.0, 'end': 1e-9}, {'start': 1e-6, 'end': 1e-6}),
        'optimality': Optimality('local', 'why', 4, (1.5, 2.5)),
        'attempts': (Attempt(1, 0, 'descent', 'words', 20, 30, 1.5, np.nan, Verdict.CERTIFIED, ''),
                     Attempt(2, 1, 'mesh', '', 20, 30, 1.5, 1e-9, Verdict.REJECTED, 'why')),
        **changes})


def fill_response(response, **changes):
    """Return the made-up solution, and the response that carries it after serialisation."""
    problem = build_problem(EVERYTHING)
    solution = made_up_solution(problem, **changes)
    packet = unpack(pack(pack_solution(problem, solution, 'aircraft')))
    messages.fill_answer(response, packet)
    return solution, serialized_and_back(response)


def test_a_solution_is_unchanged_by_pipe_and_message():
    solution, response = fill_response(SolveOptimalControl.Response())
    assert response.success
    assert (response.status, response.message, response.objective, response.method) == (
        'solved', 'words', 1.5, 'm')
    assert (response.iterations, response.build_time, response.solve_time) == (7, 0.5, 0.25)
    path = response.trajectory
    assert (path.system, path.state_names, path.input_names, path.interpolation) == (
        'aircraft', ['x', 'v'], ['u', 'w'], 'zoh')
    for name in ('t', 'x', 'u', 'lam', 'hamiltonian', 'switching_times'):
        assert np.array_equal(getattr(path, name), getattr(solution, name).ravel()), name
    assert np.array_equal(response.nu, solution.nu)
    certificate = response.certificate
    assert certificate.holds
    assert certificate.conditions == ['start', 'end']
    assert [*certificate.residuals, *certificate.tolerances] == [0.0, 1e-9, 1e-6, 1e-6]
    assert certificate.sentence.startswith('all 2 conditions hold')
    known = response.optimality
    assert (known.kind, known.reason, known.starts, known.minima.tolist()) == (
        'local', 'why', 4, [1.5, 2.5])
    first, second = response.attempts
    assert (first.number, first.parent, first.method, first.what) == (1, 0, 'descent', 'words')
    assert (first.begun, first.work, first.cost, first.verdict) == (20, 30, 1.5, 'certified')
    assert math.isnan(first.loss)
    assert (second.parent, second.loss, second.verdict, second.why) == (1, 1e-9, 'rejected', 'why')


def test_a_solution_is_read_back_from_its_message():
    solution, response = fill_response(SolveOptimalControl.Response())
    found = messages.read_solution(response)
    for field in dataclasses.fields(Solution):
        expected, value = getattr(solution, field.name), getattr(found, field.name)
        if isinstance(expected, np.ndarray):
            np.testing.assert_array_equal(value, expected, field.name)
        elif field.name == 'iterations':
            assert value == expected
        else:   # a loss that was not measured is nan
            assert repr(value) == repr(expected)


def test_a_message_without_a_path_is_read_as_a_solution_without_one():
    response = SolveOptimalControl.Response()
    messages.fill_answer(response, Packet({'status': 'malformed', 'message': 'why'}))
    found = messages.read_solution(response)
    assert (found.status, found.message, found.certificate, found.optimality) == (
        Status.MALFORMED, 'why', None, None)
    assert not found.t.size


def test_a_response_has_the_states_of_the_statement_and_the_free_parameters():
    problem = build_problem(BEYOND)
    solution = made_up_solution(problem)
    response = SolveOptimalControl.Response()
    messages.fill_answer(response, unpack(pack(pack_solution(problem, solution, ''))))
    answer = messages.read_solution(serialized_and_back(response))
    assert response.trajectory.state_names == ['x', 'v', 'w']
    assert problem.states[3:6] == ('t', 'm', 'k')
    assert answer.free_parameters == {'m': solution.x[0, 4], 'k': solution.x[0, 5]}
    assert np.array_equal(answer.x, solution.x[:, :3])
    assert np.array_equal(answer.lam, solution.lam[:, :3])
    assert np.array_equal(answer.hamiltonian, solution.hamiltonian - solution.lam[:, 3])


def test_a_response_has_its_phases_in_order_of_time():
    problem = build_problem(IN_PHASES)
    solution = made_up_solution(problem, t=np.linspace(0, 1, 5))
    response = SolveOptimalControl.Response()
    messages.fill_answer(response, unpack(pack(pack_solution(problem, solution, ''))))
    path, length = response.trajectory, solution.x[0, problem.states.index('duration__2')]
    assert (path.state_names, path.input_names) == (['x', 'v'], ['u'])
    assert path.t == pytest.approx([*np.linspace(0, 1, 5), *(1 + length * np.linspace(0, 1, 5))])
    assert np.array_equal(path.x, np.vstack([solution.x[:, :2], solution.x[:, 2:4]]).ravel())
    assert [(each.name, *each.values) for each in response.free_parameters] == [
        ('duration of phase 2', length)]


def test_a_plan_response_has_the_proof_of_optimality():
    _, response = fill_response(PlanMotion.Response(), optimality=Optimality('global', 'convex'))
    assert (response.optimality.kind, response.optimality.reason) == ('global', 'convex')
    _, response = fill_response(PlanMotion.Response(), optimality=None)
    assert response.optimality.kind == ''


@pytest.mark.parametrize('changes', [
    {'certificate': None},
    {'certificate': Certificate({'end': np.inf}, {'end': 1e-6})},
    {'status': Status.NOT_CONVERGED},
])
def test_only_a_certified_solution_is_a_success(changes):
    _, response = fill_response(PlanMotion.Response(), **changes)
    assert not response.success


def test_a_failed_certificate_names_its_worst_condition():
    _, response = fill_response(SolveOptimalControl.Response(), certificate=Certificate(
        {'start': 1e-5, 'costate': 0.3}, {'start': 1e-6, 'costate': 1e-3}))
    assert not response.certificate.holds
    assert response.certificate.sentence == (
        'costate does not hold: its residual is 0.3, over 0.001')


def test_a_refused_problem_has_no_trajectory():
    response = SolveOptimalControl.Response()
    messages.fill_answer(response, Packet({'status': 'malformed', 'message': 'why'}))
    assert str(serialized_and_back(response)) == str(SolveOptimalControl.Response(   # with nan
        status='malformed', message='why', certificate=response.certificate,
        first_path_time=np.nan))


def test_a_problem_without_inputs_has_none_in_a_message():
    mapping = {'states': ['x'], 'inputs': [], 'free_parameters': {'k': [0, 5]},
               'dynamics': {'x': '-k*x'}, 'terminal_cost': '(x - 0.5)**2',
               'initial_state': {'x': 1}, 'final_time': {'free': False, 'value': 1}}
    problem = build_problem(mapping)
    message = serialized_and_back(messages.build_problem_message(mapping, problem.guess))
    arrived = build_problem(messages.read_statement(message))
    assert (arrived.structure, arrived.shown_inputs) == (problem.structure, ())


def test_starts_are_not_left_out_of_a_message_silently():
    mapping = {**problems.read('lq_scalar_unit'), 'starts': [{}]}
    with pytest.raises(StatementError, match='^starts: a message has none'):
        messages.build_problem_message(mapping, build_problem(mapping).guess)


def test_a_guess_is_read_from_names_and_values():
    message = OptimalControlProblem()
    message.initial_guess.states = [NamedValues(name='x', values=[1.0, 2.0])]
    assert messages.read_statement(message)['initial_guess'] == {'states': {'x': [1.0, 2.0]}}
    assert messages.read_statement(OptimalControlProblem()) == {'final_time': {'free': False}}


def test_the_server_node_does_not_import_casadi():
    program = ('import sys, obc_ros.nodes.trajectory_server\n'
               'print(sorted({"casadi", "scipy", "control", "matplotlib"} & set(sys.modules)))')
    assert subprocess.check_output([sys.executable, '-c', program], text=True) == '[]\n'


def test_a_response_contains_an_uncertified_path_but_no_success():
    problem = problems.build('vanderpol_bounded')
    found = solve(problem, max_intervals=10)
    for response in (SolveOptimalControl.Response(), PlanMotion.Response()):
        messages.fill_answer(response, pack_solution(problem, found, ''))
        assert not response.success
        assert not response.certificate.holds
        assert response.status == 'not_converged'
        assert response.objective == found.objective
        assert len(response.trajectory.t) == len(found.t)
        assert len(response.trajectory.lam) == found.lam.size
        assert dict(zip(response.certificate.conditions, response.certificate.residuals,
                        strict=True)) == found.certificate.residuals
        assert response.message == found.message
        assert response.optimality.kind == ''
