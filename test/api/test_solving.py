# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The public `solve` and `certify`: closed forms, errors in words, and names that are lazy."""

import json
import math
from pathlib import Path
import subprocess
import sys
import time

import casadi as ca
import numpy as np
import obc_ros as obc
import obc_ros.core
from obc_ros.core.ocp.structure import make_differentiable
from obc_ros.core.solver.transcription.absolute_values import build_smooth_twin
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.example_files import find_example
from obc_ros.workers.pool import Pool
import pytest
from scipy import optimize

LEAST_TIME = {
    'name': 'least_time', 'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'},
    'running_cost': 1, 'initial_state': {'p': 1, 'v': 0}, 'terminal_constraints': ['p', 'v'],
    'input_bounds': {'u': [-1, 1]}, 'final_time': {'free': True, 'lower': 0.1, 'upper': 20}}
# Least effort from rest at 0 to rest at 1 in T = 1: u = 6 - 12 t, lam_p = -24, J = 12.
T = np.linspace(0, 1, 11)
EFFORT = {
    'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'},
    'running_cost': 'u**2', 'initial_state': {'p': 0, 'v': 0},
    'terminal_constraints': ['p - 1', 'v'], 'final_time': {'free': False, 'value': 1}}
PATH = {'t': T, 'x': {'p': 3*T**2 - 2*T**3, 'v': 6*T - 6*T**2}, 'u': {'u': 6 - 12*T},
        'lam': {'p': 0*T - 24, 'v': -12 + 24*T}, 'objective': 12}


@pytest.mark.parametrize('given', [
    lambda: obc.solve(**LEAST_TIME), lambda: obc.solve(LEAST_TIME),
    lambda: obc.solve(obc.Problem(**LEAST_TIME)),
    lambda: obc.solve(obc.Problem(**LEAST_TIME), initial_state={'p': 1, 'v': 0}),
    lambda: obc.solve(LEAST_TIME, dynamics=lambda x, u: {'p': x.v, 'v': u.u})],
    ids=['keywords', 'mapping', 'problem', 'changed', 'function'])
def test_the_least_time_from_1_to_rest_is_2(given):
    answer = given()
    assert (answer.status, answer.name) == ('solved', 'least_time')
    assert answer.objective == pytest.approx(2, abs=1e-9)
    assert answer.switching_times == pytest.approx([1], abs=1e-9)
    assert answer.x['p'][-1] == pytest.approx(0, abs=1e-9)
    assert answer.optimality.kind == 'global'
    middle = answer.at(0.5)
    assert (middle.x['p'], middle.u['u'], middle.costates['p']) == pytest.approx((0.875, -1, 1))
    assert json.loads(json.dumps(answer.as_json(), allow_nan=False))['status'] == 'solved'
    assert 'exact method: time_optimal' in str(answer.trace)


@pytest.mark.slow
def test_a_process_of_its_own_gives_the_same_answer():
    """Also its progress, its figures and values between samples, and errors in the same words."""
    seen = []
    answer = obc.solve(obc.Problem(**LEAST_TIME), initial_state={'p': np.float64(4), 'v': 0},
                       isolated=True, report=lambda *progress: bool(seen.append(progress)))
    assert (answer.status, answer.name) == ('solved', 'least_time')
    assert (answer.states, answer.inputs) == (('p', 'v'), ('u',))
    assert answer.objective == pytest.approx(4, abs=1e-9)   # 2 sqrt(p)
    assert answer.at(1.0).x['p'] == pytest.approx(3.5)
    assert answer.certificate.holds
    assert obc.certify({**LEAST_TIME, 'initial_state': {'p': 4, 'v': 0}}, answer).holds
    assert answer.plot().axes
    for changes, word in (({'dynamics': {'p': 'v', 'v': 'w'}}, 'dynamics.v'),
                          ({'dynamics': lambda x, u: {'p': x.v, 'v': x.w}}, 'dynamics: '),
                          ({'initial_state': {'p': {1}, 'v': 0}}, 'isolated: '),
                          ({'options': ['no=1']}, 'no')):
        with pytest.raises(StatementError, match=word):
            obc.solve(LEAST_TIME, isolated=True, **changes)


@pytest.mark.slow
def test_a_process_of_its_own_ends_at_the_limit(monkeypatch):
    """129 products of sines in each of 40 states, of which the derivatives take minutes."""
    names = [f'x{k}' for k in range(40)]
    large = {
        'name': 'large', 'states': names, 'inputs': ['u'], 'running_cost': 'u**2',
        'dynamics': {name: ' + '.join(
            f'{k}*sin({names[(row + k) % 40]}*{names[(row * k + 1) % 40]})*u'
            for k in range(1, 130)) for row, name in enumerate(names)},
        'initial_state': dict.fromkeys(names, 0.1), 'terminal_constraints': ['x0'],
        'final_time': {'free': False, 'value': 1}}
    begun, submit = [], Pool.submit

    def note_start(pool, job):
        begun.append(time.monotonic())
        submit(pool, job)

    monkeypatch.setattr(Pool, 'submit', note_start)
    answer = obc.solve(large, isolated=True, time_limit=2.0)
    assert 1.9 < time.monotonic() - begun[0] < 5.0
    assert (answer.status, answer.has_path) == ('timed_out', False)
    assert answer.message == 'no answer within 2 s'


@pytest.mark.slow
def test_a_process_of_its_own_can_be_cancelled():
    answer = obc.solve(obc.Problem.from_file(find_example('goddard')), isolated=True,
                       report=lambda *progress: True)
    assert answer.status == 'cancelled'
    with pytest.raises(ZeroDivisionError):
        obc.solve(obc.Problem.from_file(find_example('goddard')), isolated=True,
                  report=lambda *progress: 1 / 0)


@pytest.mark.slow
def test_the_brachistochrone_of_the_documentation_is_a_cycloid():
    """To (2, 1) below: T = s sqrt(R/g) with x = R (s - sin s), y = R (1 - cos s)."""
    answer = obc.solve(
        states=['x', 'y', 'v'], inputs=['theta'], parameters={'g': 9.81},
        dynamics=lambda x, u, p: {'x': x.v * ca.sin(u.theta), 'y': x.v * ca.cos(u.theta),
                                  'v': p.g * ca.cos(u.theta)},
        running_cost=1, initial_state={'x': 0, 'y': 0, 'v': 0},
        terminal_constraints=lambda x: [x.x - 2, x.y - 1],
        final_time={'free': True, 'lower': 0.1, 'upper': 10})
    low, high = 1e-3, 2 * math.pi - 1e-3
    while high - low > 1e-15 * high:
        s = (low + high) / 2
        low, high = (s, high) if (s - math.sin(s)) / (1 - math.cos(s)) < 2 else (low, s)
        if s in (low, high) and math.nextafter(low, high) >= high:
            break
    assert answer.status == 'solved'
    assert answer.objective == pytest.approx(s / math.sqrt(9.81 * (1 - math.cos(s))), abs=5e-11)
    assert f'{answer.objective:.10f}' == '0.8055638295'


def test_a_problem_without_a_solution_is_an_answer():
    answer = obc.solve(LEAST_TIME, final_time={'free': True, 'lower': 0.1, 'upper': 1.5})
    assert answer.status == 'infeasible'
    assert not answer.has_path
    assert answer.message in repr(answer)
    with pytest.raises(obc.ObcError, match='there is no path: '):
        answer.at(0)


def test_a_report_cancels():
    answer = obc.solve(EFFORT, method='transcription', report=lambda *_: True)
    assert answer.status == 'cancelled'


def test_options_may_be_a_mapping_or_texts():
    for options in ({'multistart.most': 1}, ['multistart.most=1']):
        assert obc.solve(EFFORT, method='transcription', options=options).status == 'solved'


@pytest.mark.parametrize(('arguments', 'said'), [
    ({'problem': 3}, '^problem: wanted a Problem, an answer, a mapping, a file, YAML or'),
    ({'problem': 'file.yaml'}, '^file.yaml: cannot be read'),
    ({}, '^states: missing'),
    ({'problem': LEAST_TIME, 'time_limit': 0}, '^time_limit: wanted a positive number'),
    ({'problem': LEAST_TIME, 'time_limit': math.nan}, '^time_limit: wanted'),
    ({'problem': LEAST_TIME, 'time_limit': True}, "^time_limit: wanted .* found bool 'True'"),
    ({'problem': LEAST_TIME, 'time_limit': '3'}, "^time_limit: wanted .* found str '3'"),
    ({'problem': LEAST_TIME, 'method': 'magic'}, "^method: 'magic' is unknown"),
    ({'problem': LEAST_TIME, 'method': 3}, '^method: wanted a name'),
    ({'problem': LEAST_TIME, 'options': {'speed': 3}}, "^option: 'speed' is unknown"),
    ({'problem': LEAST_TIME, 'runing_cost': 1}, r'^runing_cost: unknown key \(did you mean'),
], ids=str)
def test_a_malformed_call_is_an_error_in_words(arguments, said):
    problem = arguments.pop('problem', None)
    with pytest.raises(StatementError, match=said):
        obc.solve(problem, **arguments)


@pytest.mark.parametrize('limit', [np.int64(5), np.float32(5), np.array(5)])
def test_a_time_limit_may_be_a_number_of_numpy(limit):
    assert obc.solve(EFFORT, time_limit=limit).objective == pytest.approx(12, abs=1e-8)


def test_the_path_of_another_solver_is_certified():
    certificate = obc.certify(EFFORT, **PATH)
    assert certificate.holds
    assert certificate.residuals.keys() == {
        'dynamics', 'start', 'end', 'bounds', 'costate', 'minimum', 'transversality',
        'hamiltonian', 'cost'}
    arrays = {name: np.column_stack(list(PATH[name].values())) for name in ('x', 'u', 'lam')}
    assert obc.certify(obc.Problem(**EFFORT), **PATH | arrays).holds


@pytest.mark.parametrize(('changes', 'failed'), [
    ({'u': {'u': 6 - 11*T}}, 'dynamics'), ({'objective': 12.01}, 'cost'),
    ({'lam': {'p': 0*T - 24, 'v': -11 + 24*T}}, 'minimum'),
    ({'lam': {'p': 0*T + 24, 'v': -12 + 24*T}}, 'costate'),
    ({'x': {'p': 0.1 + 3*T**2 - 2*T**3, 'v': 6*T - 6*T**2}}, 'start')])
def test_a_wrong_path_is_not_certified(changes, failed):
    certificate = obc.certify(EFFORT, **PATH | changes)
    assert not certificate.holds
    assert certificate.residuals[failed] > certificate.tolerances[failed]


def test_an_answer_is_certified_again():
    problem = obc.Problem(**LEAST_TIME)
    answer = obc.solve(problem)
    assert obc.certify(problem, answer).residuals == answer.certificate.residuals
    assert not obc.certify(problem.replace(initial_state={'p': 2, 'v': 0}), answer).holds


# x' = u + t from 0 to 1 in T = 1 with J = integral of u^2 + (k - 2)^2: u = 1/2, k = 2, J = 1/4.
TIMED = {
    'states': ['x'], 'inputs': ['u'], 'free_parameters': {'k': None}, 'dynamics': {'x': 'u + t'},
    'running_cost': 'u**2 + (k - 2)**2', 'initial_state': {'x': 0},
    'terminal_constraints': ['x - 1'], 'final_time': {'free': False, 'value': 1}}
TIMED_PATH = {'t': T, 'x': {'x': T/2 + T**2/2}, 'u': {'u': 0*T + 0.5}, 'lam': {'x': 0*T - 1},
              'objective': 0.25, 'free_parameters': {'k': 2}}


@pytest.mark.parametrize(('changes', 'failed'), [
    ({}, set()), ({'interpolation': 'zoh'}, set()), ({'nu': [-1]}, set()),
    ({'free_parameters': {'k': 2.1}, 'objective': 0.26}, {'transversality'}),
    ({'x': {'x': T/2 + T**2/2 + 0.1}}, {'start', 'end'})])
def test_costates_of_the_time_and_of_parameters_are_computed(changes, failed):
    certificate = obc.certify(TIMED, **TIMED_PATH | changes)
    assert {name for name in ('dynamics', 'start', 'end', 'costate', 'transversality', 'minimum',
                              'hamiltonian')
            if certificate.residuals[name] > certificate.tolerances[name]} == failed


def test_an_answer_with_time_and_parameters_is_certified_again():
    problem = obc.Problem(**TIMED)
    answer = obc.solve(problem)
    assert answer.status == 'solved'
    assert (list(answer.x), list(answer.costates)) == (['x'], ['x'])
    assert answer.free_parameters == pytest.approx({'k': 2}, abs=1e-6)
    assert answer.objective == pytest.approx(0.25, abs=1e-7)
    assert answer.at(0.5).x['x'] == pytest.approx(0.375, abs=1e-6)
    assert obc.certify(problem, answer).holds


@pytest.mark.parametrize(('changes', 'said'), [
    ({'t': None}, '^t: missing; wanted an answer, or t, x, u, lam and objective'),
    ({'objective': None}, '^objective: missing'),
    ({'t': T[::-1]}, '^t: wanted at least two times that do not decrease'),
    ({'t': [0]}, '^t: wanted at least two'),
    ({'t': 'soon'}, "^t: wanted numbers, found str 'soon'"),
    ({'x': T}, r'^x: wanted an array of shape \(11, 2\), found \(11,\)'),
    ({'u': np.zeros((11, 2))}, r'^u: wanted an array of shape \(11, 1\), found \(11, 2\)'),
    ({'x': {'p': T}}, "^x: no values for 'v'"),
    ({'x': {'p': T, 'v': [1]}}, '^x: wanted numbers, equally many for each name'),
    ({'lam': np.full((11, 2), np.nan)}, '^lam: wanted finite numbers'),
    ({'nu': [1]}, r'^nu: wanted an array of shape \(2\), found \(1,\)'),
    ({'interpolation': 'cubic'}, "^interpolation: wanted one of linear, zoh, found str 'cubic'"),
    ({'answer': 3}, '^answer: wanted an Answer, or the arrays'),
    ({'state_multipliers': np.zeros((11, 3))}, '^state_multipliers: wanted an array'),
], ids=str)
def test_a_malformed_path_is_an_error_in_words(changes, said):
    with pytest.raises(StatementError, match=said):
        obc.certify(EFFORT, **PATH | changes)


def test_the_value_of_a_free_parameter_is_needed():
    with pytest.raises(StatementError, match=r'^free_parameters\.k: missing'):
        obc.certify(TIMED, **TIMED_PATH | {'free_parameters': None})


def test_the_answer_to_another_problem_is_not_certified():
    other = obc.Problem(**LEAST_TIME | {
        'states': ['a', 'v'], 'dynamics': {'a': 'v', 'v': 'u'}, 'initial_state': {'a': 1, 'v': 0},
        'terminal_constraints': ['a', 'v']})
    with pytest.raises(StatementError, match='its states and inputs are not those'):
        obc.certify(other, obc.solve(LEAST_TIME))


def test_the_import_loads_nothing_heavy():
    program = ('import sys, obc_ros as obc; assert dir(obc) == obc.__all__\n'
               'print(sorted({"numpy", "casadi", "scipy", "control", "matplotlib", "rclpy"} & '
               'set(sys.modules)))\n'
               'obc.Problem, obc.Answer; print("scipy" in sys.modules, "control" in sys.modules)')
    assert subprocess.check_output([sys.executable, '-c', program], text=True).split('\n') == [
        '[]', 'False False', '']


def test_every_public_name_is_found_documented_and_stubbed():
    stub = Path(obc.__file__).with_suffix('.pyi').read_text(encoding='utf-8')
    for name in obc.__all__:
        assert getattr(obc, name).__doc__, name
        assert f' as {name}\n' in stub or f'\n{name}: ' in stub, name
    assert stub.count(' as ') + stub.count(': ') - stub.count('SPDX') == len(
        [*obc.__all__, '__version__'])
    with pytest.raises(AttributeError, match="module 'obc_ros' has no attribute 'solv'"):
        obc.solv  # noqa: B018


def test_the_former_place_of_the_names_works_with_a_warning():
    with pytest.warns(DeprecationWarning, match='write import obc_ros as obc, and obc.solve'):
        former = obc_ros.core.solve
    assert former is obc.solve
    with pytest.raises(AttributeError, match="module 'obc_ros.core' has no attribute 'solv'"):
        obc_ros.core.solv  # noqa: B018


def test_an_answer_with_phases_has_their_states_in_order_of_time():
    statement = {
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'u**2',
        'initial_state': {'x': 0}, 'terminal_constraints': ['x - 3'],
        'phases': [{'duration': 1}, {'duration': 1, 'link': {'x': '2*x'}}]}
    answer = obc.solve(statement)
    # From 0 by 6/5 to 6/5, from 12/5 by 3/5 to 3: see test_phases.py.
    assert answer.objective == pytest.approx(9/5, rel=1e-8)
    assert (answer.states, answer.t[-1]) == (('x',), 2)
    assert answer.x['x'][[0, -1]] == pytest.approx([0, 3], abs=1e-9)
    assert len(answer.plot().axes) == 3   # x, u, lam
    with pytest.raises(StatementError, match='phases'):
        obc.certify(statement, answer)


def test_an_answer_does_not_depend_on_the_one_before():
    """The same bits alone and after a neighbour; with a cache the neighbour is followed."""
    def arrays(answer):
        solution = answer.solution
        return [solution.t, solution.x, solution.u, solution.lam]

    problem = {**EFFORT, 'dynamics': {'p': 'v', 'v': 'u - v**3'}}
    alone = obc.solve(problem)
    obc.solve(problem, terminal_constraints=['p - 1.01', 'v'])
    for one, other in zip(arrays(alone), arrays(obc.solve(problem)), strict=True):
        np.testing.assert_array_equal(one, other)
    cache = obc.Cache()
    obc.solve(problem, terminal_constraints=['p - 1.01', 'v'], cache=cache)
    cached = obc.solve(problem, cache=cache)
    assert 'neighbour' in str(cached.trace)
    assert 'neighbour' not in str(alone.trace)
    assert cached.objective == pytest.approx(alone.objective, rel=1e-6)
    with pytest.raises(StatementError, match='^cache: wanted a Cache, found a mapping'):
        obc.solve(problem, cache={})


# Through (1, 0.5): x = exp(-k t), so that k = ln 2.
FIT = """
name: fit
states: [x]
inputs: []
free_parameters: {k: [0, 5]}
dynamics: {x: -k*x}
terminal_cost: (x - 0.5)**2
initial_state: {x: 1}
final_time: {free: false, value: 1}
"""


@pytest.mark.parametrize('given', [
    lambda: obc.solve(FIT), lambda: obc.solve(FIT, dynamics=lambda x, p: [-p.k*x.x]),
    lambda: obc.solve(FIT, dynamics={'x': '-k*x + sin(t) - sin(t)'}),
    pytest.param(lambda: obc.solve(FIT, isolated=True), marks=pytest.mark.slow)],
    ids=['file', 'function', 'time', 'isolated'])
def test_a_problem_without_inputs_fits_a_parameter(given):
    answer = given()
    assert (answer.status, answer.remark) == ('solved', '')
    assert answer.free_parameters['k'] == pytest.approx(math.log(2), abs=1e-7)
    assert answer.at(0.5).x['x'] == pytest.approx(math.sqrt(0.5), abs=1e-7)
    assert (answer.inputs, answer.u, answer.solution.u.shape[1]) == ((), {}, 0)
    assert answer.as_json()['u'] == {}
    assert {'transversality', 'costate'} <= set(answer.certificate.residuals)
    assert 'minimum' not in answer.certificate.residuals
    assert obc.certify(answer).holds
    figure = answer.plot(show=False)
    assert {axes.get_ylabel() for axes in figure.axes} <= {'states', 'costates', 'Hamiltonian'}


def test_a_problem_without_inputs_fits_an_initial_state():
    """x(1) = x(0)/e is to be 0.5."""
    answer = obc.solve(FIT, free_parameters=None, dynamics={'x': '-x'}, initial_state=[None])
    assert answer.at(0).x['x'] == pytest.approx(math.e/2, abs=1e-7)


@pytest.mark.parametrize(('k', 'holds'), [(math.log(2), True), (0.7, False)])
def test_a_fit_of_another_solver_is_certified(k, holds):
    certificate = obc.certify(
        FIT, t=T, x={'x': np.exp(-k*T)}, lam={'x': 2*(np.exp(-k) - 0.5)*np.exp(k*(T - 1))},
        objective=(np.exp(-k) - 0.5)**2, free_parameters={'k': k})
    assert certificate.holds == holds
    assert holds or certificate.worst == 'transversality'


@pytest.mark.parametrize(('keys', 'said'), [
    ({'dynamics': {'x': '-k*x + u'}}, "^dynamics.x: unknown name 'u'; known names: x, k, t, T$"),
    ({'input_bounds': {'u': [0, 1]}}, "^input_bounds.u: 'u' is not an input; there are none$"),
    ({'final_time': None, 'phases': [{'duration': 1}, {'duration': 1}]},
     '^inputs: the list is empty; .* only a problem without phases may have none')])
def test_a_problem_without_inputs_has_none(keys, said):
    with pytest.raises(StatementError, match=said):
        obc.Problem(FIT, **keys)


# With x(1) = c and constant u the cost is c^2/2 - 40 exp(-400 (c - 5)^2): minima near 0 and 5.
WELL = {'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'u**2/2',
        'terminal_cost': '-40*exp(-400*(x - 5)**2)', 'initial_state': [0],
        'final_time': {'free': False, 'value': 1}}


@pytest.mark.parametrize('isolated', [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_start_leads_to_the_minimum_that_the_search_does_not_find(isolated):
    near_5 = optimize.minimize_scalar(lambda c: c**2/2 - 40*np.exp(-400*(c - 5)**2),
                                      bounds=(4.9, 5.1), options={'xatol': 1e-9})
    start, poor = {'states': {'x': [0, 4.95]}, 'inputs': {'u': 4.95}}, {'states': {'x': [0, -3]}}
    alone = obc.solve(WELL)
    assert (alone.status, alone.objective) == ('solved', pytest.approx(0, abs=1e-9))
    answer = obc.solve(WELL, starts=[start, poor], isolated=isolated)
    assert (answer.status, answer.objective) == ('solved', pytest.approx(near_5.fun, rel=1e-9))
    tried = [each.what for each in answer.solution.attempts if each.method == 'initial guess']
    assert tried[:3] == ['straight line', 'starts[0]', 'starts[1]']
    again = obc.solve(obc.Problem(WELL, starts=[answer]), isolated=isolated)
    assert again.objective == pytest.approx(near_5.fun, rel=1e-9)


def test_a_start_of_an_input_under_abs_is_split_at_its_kink():
    problem = obc.Problem(WELL, running_cost='abs(u - 1)', starts=[{'inputs': {'u': [3, -2]}}])
    twin = build_smooth_twin(make_differentiable(problem.built))
    u = twin.problem(problem.built).starts[0].u
    assert {name: values.tolist() for name, values in u.items()} == {'u#+': [2, 0], 'u#-': [0, 3]}


def test_starts_are_tried_although_a_neighbour_was_solved():
    cache, start = obc.Cache(), {'states': {'x': [0, 4.95]}, 'inputs': {'u': 4.95}}
    assert obc.solve(WELL, cache=cache).objective == pytest.approx(0, abs=1e-9)
    assert obc.solve(WELL, cache=cache, starts=[start]).objective < -27


def test_a_start_without_a_path_is_refused_in_words():
    with pytest.raises(StatementError, match=r'^starts\[0\]: wanted an answer with a path'):
        obc.Problem(WELL, starts=[obc.solve(WELL, terminal_constraints=['x - 1', 'x - 2'])])


@pytest.mark.slow
def test_an_answer_is_an_initial_guess():
    """Its path from one end to the other, in equal steps, with its free numbers."""
    stated = {'states': ['p'], 'inputs': ['u'], 'free_parameters': {'k': [0, 2]},
              'dynamics': {'p': 'k*u'}, 'running_cost': 'u**2 + k**2',
              'initial_state': {'p': 0}, 'terminal_constraints': ['p - 1'],
              'final_time': {'free': True, 'lower': 0.5, 'upper': 2}}
    answer = obc.solve(stated)
    guess = obc.Problem(stated, initial_guess=answer).built.guess
    times = np.linspace(0, answer.t[-1], len(guess.x['p']))
    np.testing.assert_allclose(guess.x['p'], answer.at(times).x['p'], atol=1e-4)
    assert guess.final_time == answer.t[-1]
    assert guess.x['k'] == pytest.approx(answer.free_parameters['k'])
    again = obc.solve(stated, initial_guess=answer)
    assert again.objective == pytest.approx(answer.objective, rel=1e-6)
    with pytest.raises(StatementError, match='^initial_guess: wanted an answer with a path'):
        obc.Problem(stated, initial_guess=obc.solve(
            stated, terminal_constraints=['p - 1', 'p - 2']))
