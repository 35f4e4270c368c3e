# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Statements: the keys of a problem file, and errors that name the key at fault."""

import copy
import math
import time

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.text.errors import StatementError
import problems
import pytest

GOOD = {
    'name': 'lander',
    'title': 'for people',
    'states': ['h', 'v'],
    'inputs': ['u'],
    'parameters': {'g': 1.5, 'weight': '2*g', 'top': '1e1'},
    'dynamics': {'h': 'v', 'v': '-g + u'},
    'running_cost': 'u',
    'terminal_cost': 'weight*v**2',
    'initial_state': {'h': 'top', 'v': -2},
    'terminal_constraints': ['h - 1'],
    'input_bounds': {'u': [0, '2*g']},
    'state_bounds': {'h': [0, None]},
    'path_constraints': [{'expr': 'h + v*u', 'lower': '-top', 'upper': None}],
    'final_time': {'free': True, 'lower': 0.1, 'upper': 20, 'guess': 4},
    'initial_guess': {'states': {'h': [10, 0]}, 'inputs': {'u': 'g'}, 'final_time': 5},
}


def changed(path, value):
    """Return GOOD with the entry at a dotted path replaced, or omitted if value is `...`."""
    mapping = copy.deepcopy(GOOD)
    *parents, last = path.split('.')
    inner = mapping
    for key in parents:
        inner = inner[int(key) if isinstance(inner, list) else key]
    if value is ...:
        del inner[last]
    else:
        inner[int(last) if isinstance(inner, list) else last] = value
    return mapping


def test_a_statement_is_converted_to_a_problem():
    problem = build_problem(GOOD)
    assert (problem.name, problem.states, problem.inputs) == ('lander', ('h', 'v'), ('u',))
    assert problem.parameters[:3] == ('g', 'weight', 'top')
    assert problem.p_value[:3] == pytest.approx([1.5, 3, 10])
    assert problem.x0 == pytest.approx([10, -2])
    assert (problem.n, problem.m, problem.q) == (2, 1, 1)
    assert (problem.u_lower, problem.u_upper) == (pytest.approx([0]), pytest.approx([3]))
    assert problem.x_lower.tolist() == [0, -math.inf]
    assert problem.x_upper.tolist() == [math.inf, math.inf]
    assert (problem.path_lower, problem.path_upper) == ([-10], [math.inf])
    assert (problem.final_time.free, problem.final_time.guess) == (True, 4)
    assert problem.guess.x['h'].tolist() == [10, 0]
    assert problem.guess.u['u'].tolist() == [1.5]
    evaluate = ca.Function('all', [problem.x, problem.u, problem.p],
                           [problem.f, problem.L, problem.V, problem.psi, problem.path])
    f, L, V, psi, path = evaluate([4, 5], [2], problem.p_value)
    assert f.full().ravel().tolist() == [5, 0.5]
    assert (float(L), float(V), float(psi), float(path)) == (2, 75, 3, 14)


def test_optional_keys_may_be_omitted_or_empty():
    required = {key: GOOD[key] for key in ('states', 'inputs', 'initial_state')}
    required |= {'dynamics': {'h': 'v', 'v': 'u'}, 'final_time': {'free': False, 'value': '1e-1'},
              'initial_state': {'h': 0, 'v': 0}}
    for empty in ({}, dict.fromkeys(
            ('parameters', 'terminal_constraints', 'input_bounds', 'state_bounds',
             'path_constraints', 'initial_guess', 'running_cost', 'terminal_cost'))):
        problem = build_problem(required | empty)
        assert problem.final_time.value == 0.1
        assert problem.psi.shape == (0, 1)
        assert problem.path.shape == (0, 1)
        assert problem.p.shape == (0, 1)
        assert np.all(np.isinf(problem.u_lower))


@pytest.mark.parametrize(('path', 'value'), [
    ('parameters.g', 2.5), ('initial_state.h', 7), ('terminal_constraints.0', 'h - 2.5'),
    ('input_bounds.u', [-1, 5]), ('final_time.upper', 30), ('state_bounds.h', [-1, None]),
    ('path_constraints.0.lower', -3), ('initial_guess', {}), ('name', 'other'),
    ('title', 'other')])
def test_other_numbers_keep_the_structure(path, value):
    assert (build_problem(changed(path, value)).structure
            == build_problem(GOOD).structure)


@pytest.mark.parametrize(('path', 'value'), [
    ('dynamics.v', '-g + 2*u'), ('running_cost', 'u**2'), ('terminal_constraints.0', 'v - 1'),
    ('terminal_constraints.0', 'h**2 - 1'), ('input_bounds.u', [0, None]),
    ('input_bounds.u', [1, 1]), ('state_bounds', {}), ('path_constraints', []),
    ('final_time', {'free': False, 'value': 3}), ('terminal_cost', '2*v**2')])
def test_other_expressions_change_the_structure(path, value):
    assert (build_problem(changed(path, value)).structure
            != build_problem(GOOD).structure)


def test_numbers_of_terminal_constraints_follow_the_parameters():
    problem = build_problem(changed('terminal_constraints', ['h**3 - 2*pi', 'v + g']))
    assert problem.parameters[:3] == ('g', 'weight', 'top')
    psi = ca.Function('psi', [problem.x, problem.p], [problem.psi])
    assert psi([3, 4], problem.p_value).full().ravel() == pytest.approx([27 - 2*math.pi, 5.5])


def test_an_initial_state_outside_its_bounds_is_well_formed():
    assert build_problem(changed('initial_state.h', -5)).x0[0] == -5


FAULTS = [
    # Keys and types
    ('runing_cost', 'u', r"^runing_cost: unknown key \(did you mean 'running_cost'\?\)"),
    ('horizon', 3, '^horizon: unknown key; known keys: name, system, states, inputs, '),
    ('states', ..., '^states: missing'),
    ('states', 'h', "^states: wanted a list, found str 'h'"),
    ('states', {'h': 1}, '^states: wanted a list, found a mapping'),
    ('states', [], '^states: the list is empty'),
    ('states', ['h', 'v', 'h'], "^states: 'h' occurs twice"),
    ('states', ['h', 3], '^states: a name is text'),
    ('states', ['h', True], '^states: a name is text'),
    ('states', ['h', 'v v'], "^states: 'v v' is not a name"),
    ('states', ['h', 'sin'], "^states: the name 'sin' is reserved"),
    ('states', ['h', 'pi'], "^states: the name 'pi' is reserved"),
    ('states', ['h', 'lambda'], "^states: the name 'lambda' is reserved"),
    ('states', ['h', ['v']], '^states: a name is text'),
    ('inputs', ['v'], "^inputs: 'v' is both a state and an input"),
    ('inputs', [], '^inputs: the list is empty'),
    ('name', ['a'], '^name: '),
    # Parameters
    ('parameters.h', 1, "^parameters: 'h' is both a parameter and a state"),
    ('parameters.u', 1, "^parameters: 'u' is both a parameter and an input"),
    ('parameters.cos', 1, "^parameters: the name 'cos' is reserved"),
    ('parameters.g', math.nan, r'^parameters\.g: nan is not a finite'),
    ('parameters.g', math.inf, r'^parameters\.g: inf is not a finite'),
    ('parameters.g', True, r'^parameters\.g: wanted a number or an expression, found bool'),
    ('parameters.g', None, r'^parameters\.g: .* found nothing'),
    ('parameters.g', [1], r'^parameters\.g: .* found a list'),
    ('parameters.g', 'top', r"^parameters\.g: unknown name 'top'"),
    ('parameters.g', 'h', r"^parameters\.g: unknown name 'h'"),
    ('parameters.g', '1/0', r"^parameters\.g: '1/0' divides by zero"),
    ('parameters', [1], '^parameters: wanted a mapping'),
    # Dynamics and costs
    ('dynamics', ..., '^dynamics: missing'),
    ('dynamics.v', ..., "^dynamics: no equation for the state 'v'"),
    ('dynamics.w', 'u', r"^dynamics\.w: 'w' is not a state"),
    ('dynamics.u', 'u', r"^dynamics\.u: 'u' is not a state"),
    ('dynamics.v', 'gg + u', r"^dynamics\.v: unknown name 'gg' \(did you mean 'g'\?\)"),
    ('input_bounds.u', [0, 't'], r"^input_bounds\.u \(upper\): unknown name 't'; the time is"),
    ('dynamics.v', ['u'], r'^dynamics\.v: .* found a list'),
    ('dynamics.v', True, r'^dynamics\.v: .* found bool'),
    ('dynamics.v', None, r'^dynamics\.v: .* found nothing'),
    ('dynamics.v', math.inf, r'^dynamics\.v: inf'),
    ('dynamics', ['v', 'u'], '^dynamics: wanted a mapping'),
    ('dynamics.v', 'u/(h - 10)', r'^dynamics\.v: undefined at the initial state \(h = 10'),
    ('dynamics.v', 'sqrt(v)*u', r'^dynamics\.v: undefined at the initial state'),
    ('dynamics.v', 'u + log(h - top)', r'^dynamics\.v: undefined at the initial state'),
    ('running_cost', 'u**2/(h - 10)', '^running_cost: undefined at the initial state'),
    ('running_cost', 'x', "^running_cost: unknown name 'x'"),
    ('running_cost', {'u': 1}, '^running_cost: .* found a mapping'),
    ('terminal_cost', 'u', "^terminal_cost: 'u' is an input"),
    ('terminal_cost', 'h +', "^terminal_cost: 'h \\+' is not an expression"),
    # Terminal conditions
    ('initial_state', ..., '^initial_state: missing'),
    ('initial_state', [10, -2], '^initial_state: wanted a number for each state'),
    ('initial_state.v', ..., "^initial_state: no value for the state 'v'"),
    ('initial_state.w', 1, r"^initial_state\.w: 'w' is not a state"),
    ('initial_state.v', math.nan, r'^initial_state\.v: nan'),
    ('initial_state.v', 'h', r"^initial_state\.v: unknown name 'h'"),
    ('terminal_constraints', 'h', '^terminal_constraints: wanted a list'),
    ('terminal_constraints', {'h': 1}, '^terminal_constraints: wanted a list'),
    ('terminal_constraints.0', 'u', r"^terminal_constraints\[0\]: 'u' is an input"),
    ('terminal_constraints.0', 'h - z', r"^terminal_constraints\[0\]: unknown name 'z'"),
    ('terminal_constraints.0', 0, r"^terminal_constraints\[0\]: '0' does not depend"),
    ('terminal_constraints.0', 'g', r"^terminal_constraints\[0\]: 'g' does not depend"),
    ('terminal_constraints.0', None, r'^terminal_constraints\[0\]: .* found nothing'),
    ('terminal_constraints.0', 'h/0', r'^terminal_constraints\[0\]: .* finite'),
    # Bounds
    ('input_bounds.u', [3, 0], r'^input_bounds\.u: the bounds cross: lower 3 > upper 0'),
    ('input_bounds.u', [0, '-g'], r'^input_bounds\.u: the bounds cross'),
    ('input_bounds.u', [0], r'^input_bounds\.u: wanted \[lower, upper\], found 1'),
    ('input_bounds.u', [0, 1, 2], r'^input_bounds\.u: wanted \[lower, upper\], found 3'),
    ('input_bounds.u', 3, r'^input_bounds\.u: wanted \[lower, upper\], found int'),
    ('input_bounds.u', [math.nan, 1], r'^input_bounds\.u \(lower\): nan'),
    ('input_bounds.u', [0, math.inf], r'^input_bounds\.u: upper bound inf: write null'),
    ('input_bounds.u', [0, 'v'], r"^input_bounds\.u \(upper\): unknown name 'v'"),
    ('input_bounds.v', [0, 1], r"^input_bounds\.v: 'v' is not an input"),
    ('input_bounds', [[0, 1]], '^input_bounds: wanted a mapping'),
    ('state_bounds.u', [0, 1], r"^state_bounds\.u: 'u' is not a state"),
    ('state_bounds.h', [1, 0], r'^state_bounds\.h: the bounds cross'),
    ('path_constraints', {'expr': 'h'}, '^path_constraints: wanted a list'),
    ('path_constraints.0', 'h', r'^path_constraints\[0\]: wanted a mapping'),
    ('path_constraints.0.expr', ..., r'^path_constraints\[0\]: expr is missing'),
    ('path_constraints.0.expr', 'q', r"^path_constraints\[0\]\.expr: unknown name 'q'"),
    ('path_constraints.0.expr', 'g', r'^path_constraints\[0\]\.expr: depends on no state'),
    ('path_constraints.0.lower', ..., r'^path_constraints\[0\]: wanted a lower or an upper'),
    ('path_constraints.0.upper', -11, r'^path_constraints\[0\]: the bounds cross'),
    ('path_constraints.0.max', 1, r'^path_constraints\[0\]\.max: unknown key'),
    ('path_constraints.0.expr', 'log(-h)', r'^path_constraints\[0\]: undefined at the initial'),
    # Final time
    ('final_time', ..., '^final_time: missing'),
    ('final_time', 3, '^final_time: wanted {free: false, value: 5} or'),
    ('final_time.free', ..., r'^final_time\.free: wanted true or false'),
    ('final_time.free', 'yes', r'^final_time\.free: wanted true or false'),
    ('final_time.free', 1, r'^final_time\.free: wanted true or false'),
    ('final_time', {'free': False, 'value': 0}, r'^final_time\.value: .* > 0, found 0'),
    ('final_time', {'free': False, 'value': -1}, r'^final_time\.value: .* > 0, found -1'),
    ('final_time', {'free': False, 'value': math.nan}, r'^final_time\.value: nan'),
    ('final_time', {'free': False}, r'^final_time\.value: missing'),
    ('final_time', {'free': False, 'value': 1, 'lower': 1}, r'^final_time\.lower: .* given'),
    ('final_time.value', 3, r'^final_time\.value: the final time is free'),
    ('final_time.upper', ..., r'^final_time\.upper: missing'),
    ('final_time.upper', 0.05, '^final_time: the bounds cross'),
    ('final_time.upper', 0, r'^final_time\.upper: .* > 0'),
    ('final_time.lower', -1, r'^final_time\.lower: -1 is negative'),
    ('final_time.guess', 0, r'^final_time\.guess: .* > 0'),
    ('final_time.maximum', 9, r'^final_time\.maximum: unknown key'),
    # Guess
    ('initial_guess', [1], '^initial_guess: wanted a mapping'),
    ('initial_guess.x', {}, r'^initial_guess\.x: unknown key'),
    ('initial_guess.states', [1], r'^initial_guess\.states: wanted a mapping'),
    ('initial_guess.states.w', 1, r"^initial_guess\.states\.w: 'w' is not one of the states"),
    ('initial_guess.states.h', [], r'^initial_guess\.states\.h: the list is empty'),
    ('initial_guess.states.h', [1, math.nan], r'^initial_guess\.states\.h: nan'),
    ('initial_guess.inputs.u', {'a': 1}, r'^initial_guess\.inputs\.u: .* found a mapping'),
    ('initial_guess.final_time', -1, r'^initial_guess\.final_time: .* > 0'),
    # Systems
    ('system', 'aircraft', '^states: the system defines it already'),
]


@pytest.mark.parametrize(('path', 'value', 'said'), FAULTS,
                         ids=[f'{path}={value}'[:50] for path, value, _ in FAULTS])
def test_errors_name_the_key_at_fault(path, value, said):
    with pytest.raises(StatementError, match=said) as error:
        build_problem(changed(path, value))
    assert len(str(error.value)) < 500


VEHICLE = {
    'system': 'vehicle', 'parameters': {'l': 3, 'reach': '2*l'},
    'running_cost': 'reach*phi**2', 'initial_state': {'px': 0, 'py': -2, 'theta': 0},
    'final_time': {'free': False, 'value': 1}}


def test_a_registered_system_gives_states_inputs_and_dynamics():
    problem = build_problem(VEHICLE)
    assert problem.states == ('px', 'py', 'theta')
    assert problem.angles == (False, False, True)
    assert dict(zip(problem.parameters, problem.p_value, strict=True)) == {'l': 3, 'reach': 6}
    f = ca.Function('f', [problem.x, problem.u, problem.p], [problem.f, problem.L])
    rate, L = f([0, 0, math.pi/2], [6, 0.1], problem.p_value)
    assert rate.full().ravel() == pytest.approx([0, 6, 2*math.tan(0.1)], abs=1e-12)
    assert float(L) == pytest.approx(0.06)


def test_a_registered_system_gives_default_input_bounds():
    problem = build_problem(VEHICLE)
    assert (problem.u_lower.tolist(), problem.u_upper.tolist()) == ([0, -0.6], [math.inf, 0.6])
    problem = build_problem(VEHICLE | {'input_bounds': {'phi': [None, 0.1]}})
    assert (problem.u_lower.tolist(), problem.u_upper.tolist()) == ([0, -math.inf],
                                                                    [math.inf, 0.1])


def test_parameters_may_contain_options_of_a_system():
    problem = build_problem(VEHICLE | {
        'system': 'linear', 'parameters': {'A': [[0, 1], [0, 0]], 'B': [[0], [1]], 'w': 2},
        'running_cost': 'w*u1**2', 'initial_state': {'x1': 0, 'x2': 0}})
    assert (problem.states, problem.inputs, problem.parameters) == (
        ('x1', 'x2'), ('u1',), ('w',))


@pytest.mark.parametrize(('change', 'said'), [
    ({'system': 'vehicel'}, r"^system: unknown system 'vehicel' \(did you mean 'vehicle'"),
    ({'system': '/etc/system.yaml'}, "^system: unknown system '/etc/system.yaml'"),
    ({'system': 3}, '^system: wanted a name'),
    ({'system': 'linear', 'parameters': {'A': [['x']]}}, '^system: linear.A: '),
    ({'parameters': {'l': -1}}, '^parameters: vehicle.l = -1'),
    ({'parameters': {'l': '2*w', 'w': 1}}, r"^parameters\.l: unknown name 'w'"),
    ({'parameters': {'w': '2*l', 'l': 1}}, r"^parameters\.w: unknown name 'l'"),
    ({'parameters': {'px': 1}}, "^parameters: 'px' is both a parameter and a state"),
    ({'states': ['px']}, '^states: the system defines it already'),
    ({'dynamics': {'px': 'v'}}, '^dynamics: the system defines it already'),
], ids=str)
def test_errors_name_the_key_at_fault_beside_a_system(change, said):
    with pytest.raises(StatementError, match=said):
        build_problem(VEHICLE | change)


@pytest.mark.parametrize('value', [None, 3, 'text', [GOOD], True], ids=str)
def test_a_problem_that_is_not_a_mapping_is_rejected(value):
    with pytest.raises(StatementError, match='^problem: wanted a mapping'):
        build_problem(value)


def test_the_total_size_of_expressions_is_bounded():
    states = [f'x{index}' for index in range(900)]
    huge = GOOD | {'states': states, 'dynamics': dict.fromkeys(states, '+'.join(['u'] * 1900))}
    started = time.process_time()
    with pytest.raises(StatementError, match='in total'):
        build_problem(huge)
    with pytest.raises(StatementError, match='1001 entries'):
        build_problem(GOOD | {'states': [f'x{index}' for index in range(1001)]})
    assert time.process_time() - started < 0.5


_ANYTHING = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5),
              st.sampled_from(['h', 'u', 'g', 'v', 'h - 1', '1/0', 'sqrt(-h)'])),
    lambda inner: st.one_of(st.lists(inner, max_size=3),
                            st.dictionaries(st.sampled_from(['h', 'u', 'expr', 'free', 3, None]),
                                            inner, max_size=3)), max_leaves=4)


@pytest.mark.slow
@settings(max_examples=300)
@given(st.sampled_from([key for key in GOOD if key != 'system']), _ANYTHING)
def test_any_value_gives_a_problem_or_a_statement_error(key, value):
    try:
        build_problem(GOOD | {key: value})
    except StatementError as error:
        assert ': ' in str(error)


@pytest.mark.parametrize('name', problems.NAMES)
def test_the_problem_files_are_well_formed(name):
    [mapping] = load_file(problems.FOLDER / f'{name}.yaml')
    problem = build_problem(mapping)
    assert problem.n
    assert problem.m
    assert set(mapping['expected']) >= {'objective', 'tolerance'}


# Files

def write_file(tmp_path, text):
    """Write a text to a file and return its path."""
    path = tmp_path / 'case.yaml'
    path.write_text(text, encoding='utf-8')
    return path


def test_a_file_contains_one_mapping_or_a_list(tmp_path):
    assert load_file(write_file(tmp_path, 'states: [x]')) == [{'states': ['x'], 'name': 'case'}]
    names = [entry['name'] for entry in load_file(write_file(tmp_path, '- {name: a}\n- {b: 1}'))]
    assert names == ['a', 'case_2']


@pytest.mark.parametrize(('text', 'said'), [
    ('a: 1\nb: 2\na: 3', "the key 'a' occurs twice"),
    ('a: {b: 1, b: 2}', "the key 'b' occurs twice"),
    ('', 'wanted a mapping'),
    ('3', 'wanted a mapping'),
    ('[]', 'the list is empty'),
    ('- a: 1\n- 2', 'case.yaml, entry 2: wanted a mapping'),
    ('a: [1', 'case.yaml: '),
    ('a: !!python/object/apply:os.getpid []', 'could not determine a constructor'),
    ('a: &a {x: 1}\nb: {<<: *a}', 'merge keys'),
    ('[' * 100_000, 'nested too deeply'),
    ('- ' * 100_000, 'nested too deeply'),
    ('a: 1\n---\nb: 2', 'single document'),
    ('a: ' + 'x' * 300_000, 'longer than 250000 bytes'),
    ('a: 2001-99-99', 'case.yaml: '),
    ('\x07', 'case.yaml: '),
], ids=lambda text: text[:12])
def test_errors_name_the_file_at_fault(tmp_path, text, said):
    with pytest.raises(StatementError, match=said) as error:
        load_file(write_file(tmp_path, text))
    assert 'case.yaml' in str(error.value)
    assert len(str(error.value)) < 1000


def test_errors_name_a_file_that_cannot_be_read(tmp_path):
    for path in (tmp_path / 'absent.yaml', tmp_path, 'a\x00b'):
        with pytest.raises(StatementError, match='cannot be read'):
            load_file(path)
    (tmp_path / 'bytes.yaml').write_bytes(b'\xff\xfe\x00\x81')
    with pytest.raises(StatementError, match=r'bytes\.yaml'):
        load_file(tmp_path / 'bytes.yaml')
