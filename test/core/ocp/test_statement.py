# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Statements: the keys of a problem file, and errors that name the key at fault."""

import copy
import math
import re
import time

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.text.errors import StatementError
import problems
import pytest
from statements import changed, FAULTS, GOOD
import yaml


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


def test_an_initial_state_may_be_a_list_in_the_order_of_the_states():
    named = build_problem({**GOOD, 'initial_state': {'v': [0, 1], 'h': '2*3'}})
    listed = build_problem({**GOOD, 'initial_state': ['2*3', [0, 1]]})
    assert named.structure == listed.structure
    assert (listed.states[:2], listed.x0.tolist()) == (('h', 'v'), named.x0.tolist())
    assert listed.statement['initial_state'] == {'h': '2*3', 'v': [0, 1]}
    with pytest.raises(StatementError, match='^initial_state: wanted a number for each state'):
        build_problem({**GOOD, 'initial_state': [0]})


def test_an_initial_state_outside_its_bounds_is_well_formed():
    assert build_problem(changed('initial_state.h', -5)).x0[0] == -5


@pytest.mark.parametrize(('path', 'value', 'said'), FAULTS,
                         ids=[f'{path}={value}'[:50] for path, value, _ in FAULTS])
def test_errors_name_the_key_at_fault(path, value, said):
    with pytest.raises(StatementError, match=said) as error:
        build_problem(changed(path, value))
    assert len(str(error.value)) < 500
    assert '\n' not in str(error.value)   # no other error follows from this one


def collect_lines(*faults):
    """Return the lines of the error of GOOD with some faults."""
    statement = copy.deepcopy(GOOD)
    for path, value, _ in faults:
        statement = changed(path, value, statement)
    with pytest.raises(StatementError) as error:
        build_problem(statement)
    return str(error.value).split('\n')


# Each by itself, in the order of the file: nothing else depends on it.
APART = [fault for fault in FAULTS if fault[0] in (
    'runing_cost', 'colour', 'dynamics.v', 'running_cost', 'terminal_cost', 'initial_state.v',
    'terminal_constraints.0', 'input_bounds.u', 'path_constraints.0.expr', 'final_time.lower',
    'initial_guess.states.h') and 'undefined at' not in fault[2]]


@given(st.lists(st.sampled_from(APART), min_size=2, max_size=6, unique_by=lambda fault: fault[0]))
@settings(max_examples=40)
def test_independent_errors_are_told_together(faults):
    alone = [line for fault in faults for line in collect_lines(fault)]
    together = collect_lines(*faults)
    assert len(together) == len(faults)
    for line in together:   # of several unknown keys, the first one lists those that are known
        assert any(each.startswith(line) for each in alone)
    keys = [re.split(r'[.:\[]', line)[0] for line in together]
    order = [*GOOD, 'runing_cost', 'colour']
    known = [key for key in keys if key in GOOD]
    assert known == sorted(known, key=order.index)


@pytest.mark.parametrize('faults, lines', [
    ([('parameters.g', 'a/', ''), ('input_bounds.v', 1, '')], 2),   # weight, u need g
    ([('states', 'h', ''), ('final_time', [3], '')], 2),            # the others need states
    ([('inputs', ..., ''), ('controls', ['u'], '')], 1)])           # it is not missing
def test_what_depends_on_a_malformed_entry_is_not_reported(faults, lines):
    assert len(collect_lines(*faults)) == lines


def test_at_most_twenty_errors_are_told():
    lines = collect_lines(*((f'colour{k}', 1, '') for k in range(30)))
    assert len(lines) == 20
    assert lines[-1] == 'and 11 more errors'


@given(st.lists(st.sampled_from(FAULTS), min_size=2, max_size=4, unique_by=lambda fault: fault[0]))
@settings(max_examples=40)
def test_several_faults_are_a_statement_error(faults):
    try:
        lines = collect_lines(*faults)
    except (KeyError, TypeError, ValueError):   # a fault has removed the place of another one
        return
    assert 1 <= len(lines) <= 20
    assert all(': ' in line for line in lines)


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


@pytest.mark.parametrize('path, value, line', [
    ('inputs', 'u', '[u]'),
    ('states', 'h, v', '[h, v]'),
    ('dynamics', ['v', 'u - g'], '{h: v, v: u - g}'),
    ('terminal_constraints', 'h - 1', '[h - 1]'),
    ('terminal_constraints', {'h': 1, 'v': 0}, '[h - 1, v]'),
    ('terminal_constraints', {'v': -1}, '[v + 1]'),
    ('input_bounds.u', 4, '[-4, 4]'),
    ('input_bounds.u', {'lower': 0, 'upper': '2*g'}, '[0, 2*g]'),
    ('input_bounds.u', {'max': 3}, '[null, 3]'),
    ('input_bounds.u', [0, 'inf'], '[0, null]'),
    ('state_bounds.v', [-math.inf, math.inf], '[null, null]'),
    ('input_bounds', [0, 3], '{u: [0, 3]}'),
    ('state_bounds', [[0, math.inf], [-9, 9]], '{h: [0, null], v: [-9, 9]}'),
    ('final_time', 'free', '{free: true, lower: 0, upper: 20}'),
    ('final_time', {'free': True}, '{free: true, lower: 0, upper: 20}'),
    ('final_time', {'free': True, 'upper': 5}, '{free: true, lower: 0, upper: 5}'),
    ('final_time', {'lower': 1, 'upper': '2*g'}, '{free: true, lower: 1, upper: 2*g}'),
    ('final_time', {'value': 2}, '{free: false, value: 2}')])
def test_an_error_says_what_to_write_and_it_is_valid(path, value, line):
    [told] = collect_lines((path, value, ''))
    assert told.endswith(f'; write {line}')
    build_problem(changed(path, yaml.safe_load(line)))


@pytest.mark.parametrize('path, value, words', [
    ('parameters', ['g', 'top'], 'write {g: 1, top: 1}'),
    ('maximize', 'h', r'^maximize: unknown key; write running_cost: -\(h\)$'),
    ('minimize', 'u**2', r'^minimize: unknown key; write running_cost: u\*\*2$'),
    ('dynamics.v', '2u - g', r"'2u' is not a number; write 2\*u$"),
    ('dynamics.v', '0x10 + u', 'write decimal digits'),
    ('states', ['h', True], 'a name is text, not a YAML truth value .* write it in quotes$'),
    # Nothing is guessed where it is not clear what is meant.
    ('dynamics', ['v'], 'found a list of 1$'), ('inputs', {'u u': 1}, 'found a mapping$'),
    ('states', [], 'at least one name$'), ('input_bounds.u', -1, "found int '-1'$"),
    ('terminal_constraints', {'h': [0, 1]}, 'found a mapping$'),
    ('final_time', True, "found bool 'True'$")])
def test_an_error_says_what_to_write_in_words(path, value, words):
    lines = collect_lines((path, value, ''))
    assert re.search(words, lines[0] if path != 'maximize' else '\n'.join(lines), re.M), lines


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
    | st.sampled_from(['h', 'u', 'inf', 'free', 'lower', 'upper']),
    lambda inside: st.lists(inside, max_size=3) | st.dictionaries(
        st.sampled_from(['h', 'u', 'lower', 'upper', 'free', 'value']) | st.text(max_size=3),
        inside, max_size=3))


@given(st.sampled_from([
    'states', 'inputs', 'parameters', 'dynamics', 'initial_state', 'terminal_constraints',
    'boundary_constraints', 'input_bounds', 'input_bounds.u', 'final_time', 'path_constraints',
    'free_parameters', 'initial_guess', 'units', 'phases', 'maximize']), junk)
@settings(max_examples=60)
def test_any_value_gives_a_sentence_or_a_problem(path, value):
    statement = changed(path, value)
    try:
        build_problem(statement)
    except StatementError as error:
        assert all(line.isprintable() and ': ' in line for line in str(error).split('\n'))
    assert repr(statement) == repr(changed(path, value))
