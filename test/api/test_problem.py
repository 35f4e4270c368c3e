# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A problem by keywords, a mapping, YAML or functions: the same problem, the same errors."""

from concurrent.futures import ThreadPoolExecutor
import copy
from functools import partial
import math
import re
import warnings

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import obc_ros as obc
from obc_ros.api.answer import PathPoint
from obc_ros.api.problem import as_statement, Problem
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.text.errors import StatementError
import problems
import pytest
from statements import changed, FAULTS, GOOD
import yaml

# The expressions of the statements as functions of the symbols by name; those that are not here
# stay texts.
EXPRESSIONS = {
    'v': lambda n: n['v'], 'u': lambda n: n['u'], 'h': lambda n: n['h'], 'g': lambda n: n['g'],
    '-g + u': lambda n: -n['g'] + n['u'], 'weight*v**2': lambda n: n['weight'] * n['v']**2,
    'h - 1': lambda n: n['h'] - 1, 'h + v*u': lambda n: n['h'] + n['v'] * n['u'],
    'u/(h - 10)': lambda n: n['u'] / (n['h'] - 10), 'sqrt(v)*u': lambda n: ca.sqrt(n['v'])*n['u'],
    'u + log(h - top)': lambda n: n['u'] + ca.log(n['h'] - n['top']),
    'u**2/(h - 10)': lambda n: n['u']**2 / (n['h'] - 10), 'log(-h)': lambda n: ca.log(-n['h'])}
# Letters of the arguments of each function, with the parameters.
FUNCTIONS = {'dynamics': 'xup', 'running_cost': 'xup', 'path_constraints': 'xup',
             'terminal_cost': 'xp', 'terminal_constraints': 'xp'}


def evaluate(value, names):
    """Return what a key has, with expressions of the symbols in place of texts."""
    if isinstance(value, dict):
        return {key: each if key in ('lower', 'upper') else evaluate(each, names)
                for key, each in value.items()}
    if isinstance(value, list):
        return [evaluate(each, names) for each in value]
    return EXPRESSIONS[value](names) if isinstance(value, str) else value


def is_usable(key, value):
    """Return whether a function may return the value of a key: of the form that a file has."""
    if key == 'dynamics':
        return isinstance(value, dict)
    if key == 'path_constraints':
        return isinstance(value, list) and all(isinstance(each, dict) for each in value)
    return isinstance(value, list) == (key == 'terminal_constraints')


def as_functions(statement):
    """Return a statement whose expressions are functions, where all of a key are known."""
    names = {letter: statement.get(key) for letter, key in zip('xup', (
        'states', 'inputs', 'parameters'), strict=True)}
    if not all(isinstance(each, list | dict) for each in names.values()):
        return statement

    def name(letters, groups):
        return {each: symbol for letter, group in zip(letters, groups, strict=True)
                for each, symbol in zip(names[letter], group, strict=True)}

    def state(value, letters):
        if letters == 'xp':
            return lambda x, p: evaluate(value, name(letters, (x, p)))
        return lambda x, u, p: evaluate(value, name(letters, (x, u, p)))

    found = dict(statement)
    for key, letters in FUNCTIONS.items():
        groups = [[ca.SX.sym(str(each)) for each in names[letter]] for letter in letters]
        try:
            evaluate(statement.get(key), name(letters, groups))
        except (KeyError, TypeError):
            continue
        if key in statement and is_usable(key, statement[key]):
            found[key] = state(statement[key], letters)
    return found


WAYS = {
    'keywords': lambda statement: Problem(**statement),
    'mapping': Problem.from_dict,
    'text': lambda statement: Problem.from_text(yaml.safe_dump(statement, sort_keys=False)),
    'functions': lambda statement: Problem.from_dict(as_functions(statement)),
}


@pytest.mark.parametrize('way', WAYS)
@pytest.mark.parametrize(('path', 'value'), [fault[:2] for fault in FAULTS],
                         ids=[f'{path}={value}'[:50] for path, value, _ in FAULTS])
def test_a_malformed_statement_has_the_same_error_by_every_way(path, value, way):
    statement = changed(path, value)
    with pytest.raises(StatementError) as expected:
        build_problem(statement)
    with pytest.raises(StatementError) as found:
        WAYS[way](statement)
    assert str(found.value) == str(expected.value)


def test_the_way_by_functions_replaces_texts():
    assert {key for key, value in as_functions(GOOD).items() if callable(value)} == set(FUNCTIONS)


@pytest.mark.parametrize('way', WAYS)
@settings(max_examples=20, deadline=None)
@given(x=st.lists(st.floats(-5, 5), min_size=2, max_size=2), u=st.floats(0, 3))
def test_every_way_states_the_same_problem(way, x, u):
    expected, found = build_problem(GOOD), WAYS[way](GOOD).built
    for name in ('states', 'inputs', 'name', 'final_time', 'method'):
        assert getattr(found, name) == getattr(expected, name)
    for name in ('x0', 'x_lower', 'x_upper', 'u_lower', 'u_upper', 'path_lower', 'path_upper'):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    values = [ca.Function('all', [each.x, each.u, each.p],
                          [ca.vertcat(each.f, each.L, each.V, each.psi, each.path)])(
                              x, u, each.p_value).full() for each in (expected, found)]
    np.testing.assert_allclose(*values, rtol=1e-14, atol=1e-14)


RATES = {'h': 'v', 'v': '-g + u'}


@pytest.mark.parametrize(('key', 'function', 'said'), [
    ('dynamics', lambda state: {},
     r'^dynamics: wanted a function of x, u \(and p, t if needed\), found one of 1 argument$'),
    ('terminal_cost', lambda: 0,
     r'^terminal_cost: wanted a function of x \(and p, t if needed\), found one of 0 arguments'),
    ('dynamics', lambda x, u: {'h': x.w, 'v': u.u},
     "^dynamics: 'w' is not the name of a state; there are h, v"),
    ('dynamics', lambda x, u, p: {'h': x.v, 'v': u['uu']},
     r"^dynamics: 'uu' is not the name of an input \(did you mean 'u'\?\); there are u"),
    ('running_cost', lambda x, u, p: p.q, "^running_cost: 'q' is not the name of a parameter"),
    ('dynamics', lambda x, u: {'h': x.v}, "^dynamics: no equation for the state 'v'"),
    ('dynamics', lambda x, u: [x.v], '^dynamics: the function returned 1 expressions for 2'),
    ('dynamics', lambda x, u: 3, "^dynamics: the function returned int '3'; wanted an expression"),
    ('dynamics', lambda x, u: {'h': x.v, 'v': math.nan}, r'^dynamics\.v: nan is not a finite'),
    ('dynamics', lambda x, u: {'h': x.v, 'v': u.u / 0}, r'^dynamics\.v: inf is not a finite'),
    ('dynamics', lambda x, u: {'h': x.v, 'v': u.u * 1e200}, r'^dynamics\.v: 1e\+200 is too large'),
    ('dynamics', lambda x, u: {'h': x.v, 'v': ca.SX.sym('z')},
     r"^dynamics\.v: the symbol 'z' is none of those"),
    ('dynamics', lambda x, u: {'h': x.v, 'v': ca.SX.sym('u')},
     r"^dynamics\.v: the symbol 'u' is none of those"),
    ('dynamics', lambda x, u: {'h': x.v, 'v': ca.MX.sym('u')},
     r'^dynamics\.v: wanted a number or an expression, found a MX'),
    ('dynamics', lambda x, u: {'h': x.v, 'v': ca.vertcat(u.u, u.u)},
     r'^dynamics\.v: wanted one expression, found a matrix of 2 x 1'),
    ('dynamics', lambda x, u: {'h': x.v, 'v': ca.fmax(u.u, x.h)},
     r'^dynamics\.v: an expression may not contain fmax\(a, b\); write \(a \+ b'),
    ('dynamics', lambda x, u: {'h': x.v, 'v': ca.if_else(x.h > 0, u.u, 0)},
     r'^dynamics\.v: comparisons and if_else are not supported'),
    ('dynamics', lambda x, u: {'h': x.v, 'v': ca.floor(u.u)},
     r'^dynamics\.v: an expression may not contain floor\(a\), which jumps'),
    ('dynamics', lambda x, u: {'h': x.v, 'v': ca.erf(u.u)},
     r'^dynamics\.v: an operation is not supported; an expression may contain \+'),
    ('dynamics', lambda x, u: {'h': x.v, 'v': math.sin(x.h)},
     r'^dynamics: math\.sin takes numbers: write numpy\.sin$'),
    ('running_cost', lambda x, u: u.u**2 + max(0, math.sin(x.h)), '^running_cost: math.sin takes'),
    ('running_cost', lambda x, u: 1 if math.sin(x.h) > 0 else 0, '^running_cost: math.sin takes'),
    ('running_cost', lambda x, u: math.pow(u.u + 0, 2), 'write numpy.power$'),
    ('running_cost', lambda x, u: math.fsum([x.h, u.u]), 'math.fsum takes numbers, not symbols$'),
    ('running_cost', lambda x, u: math.isclose(x.h, 1), 'math.isclose takes numbers, not symb'),
    ('running_cost', lambda x, u: u.u * np.asarray(x.h, dtype=float), 'takes numbers'),
    ('running_cost', lambda x, u: max(0, x.h),
     r"^running_cost: 'max\(0, x.h\)': if, and, or, max, min and a < b < c need numbers, not sym"),
    ('running_cost', lambda x, u: x.h if 0 < x.v < 1 else 0, 'write the larger of two as'),
    ('running_cost', lambda x, u: np.where(x.v > 0, x.v, 0), 'nor numpy.where; write'),
    ('running_cost', lambda x, u: np.maximum(x.v, 0), r'write \(a \+ b \+ fabs\(a - b\)\)/2'),
    ('running_cost', lambda x, u: np.sign(x.v), r'sign\(a\), nor cbrt\(a\), which has it; write'),
    ('running_cost', lambda x, u: np.cbrt(x.v), r'a\*\*\(1/3\) for a positive a'),
    ('running_cost', lambda x, u: np.arcsinh(x.v), r'asinh\(a\); write log'),
    ('running_cost', lambda x, u: x + 1,
     r"^running_cost: x has names, it is no number: write x.h, x\['h'\] or x\[0\]; numpy.array"),
    ('running_cost', lambda x, u: 1 if x == 0 else 2, '^running_cost: x has names'),
    ('running_cost', lambda x, u: 1 if x != 0 else 2, '^running_cost: x has names'),
    ('running_cost', lambda x, u: 1 if u else 2, '^running_cost: u has names'),
    ('running_cost', lambda x, u: x @ x, '^running_cost: x has names'),
    ('running_cost', lambda x, u: {x: 1}, 'unhashable'),
    ('running_cost', lambda x, u: 2 * u, r"write u\.u, u\['u'\] or u\[0\]"),
    ('running_cost', lambda x, u: x[2], '^running_cost: 2 is not the number of a state; there '),
    ('running_cost', lambda t, s, a: t * a.u, "^running_cost: .* found 't' in the place of x, b"),
    ('running_cost', lambda u, s: u.u, "found 'u' in the place of x, .* name all arguments x, u"),
    ('terminal_cost', lambda s, t: s.h, "found 't' in the place of p"),
    ('terminal_cost', lambda x, u: 0, "^terminal_cost: wanted a function of x .*, found one of '"),
    ('dynamics', lambda x, u: 1 / 0, '^dynamics: the function raised ZeroDivisionError: '),
    ('dynamics', lambda x, u: {'h': x.v, 'v': u.u if x.h > 0 else 0}, "^dynamics: 'x.h > 0': "),
    ('running_cost', lambda x, u: None, '^running_cost: the function returned nothing'),
    ('running_cost', lambda x, u: {'u': 1}, '^running_cost: .* found a mapping'),
    ('running_cost', lambda x, u: 1 / (x.h - 10), '^running_cost: undefined at the initial state'),
    ('terminal_constraints', lambda x: [1], r"^terminal_constraints\[0\]: '1' does not depend"),
    ('terminal_constraints', lambda x: 'h', r'^terminal_constraints: wanted a list'),
    ('path_constraints', lambda x, u: [x.h], r'^path_constraints\[0\]: wanted a mapping'),
    ('path_constraints', lambda x, u: [{'expr': x.h}], r'^path_constraints\[0\]: wanted a lower'),
    ('path_constraints', lambda x, u, p: [{'expr': p.g, 'upper': 1}],
     r'^path_constraints\[0\]\.expr: depends on no state'),
])
def test_a_function_at_fault_is_named_by_its_key(key, function, said):
    with pytest.raises(StatementError, match=said) as error:
        Problem(**GOOD | {key: function})
    assert len(str(error.value)) < 500


def test_a_function_may_return_columns_and_numbers_of_numpy():
    problem = Problem(**GOOD | {
        'dynamics': lambda x, u, p, scale=2: ca.vertcat(x.v, scale * u.u - p.g),
        'terminal_constraints': lambda x: ca.vertcat(x.h - np.float64(1), x.v),
        'running_cost': lambda x, u: np.int64(3)})
    built = problem.built
    values = ca.Function('f', [built.x, built.u, built.p], [built.f, built.psi, built.L])(
        [4, 5], [2], built.p_value)
    assert [value.full().ravel().tolist() for value in values] == [[5, 2.5], [3, 5], [3]]


@pytest.mark.filterwarnings('error')
def test_functions_of_numpy_are_those_of_casadi():
    built = [Problem(**GOOD | {'running_cost': root}).built for root in (
        lambda x, u: np.sqrt(1 + u.u**2) * np.sin(x.h),
        lambda x, u: ca.sqrt(1 + u.u**2) * ca.sin(x.h))]
    one, other = (ca.Function('L', [each.x, each.u, each.p], [each.L])([0.3, 5], [2], each.p_value)
                  for each in built)
    assert one == other


@pytest.mark.parametrize(('one', 'other'), [
    (lambda x, u: np.hypot(x.h, u.u), lambda x, u: ca.sqrt(x.h**2 + u.u**2)),
    (lambda x, u: np.log1p(x.h), lambda x, u: ca.log(1 + x.h)),
    (lambda x, u: 2 * np.expm1(x.h) + x.v, lambda x, u: 2 * (ca.exp(x.h) - 1) + x.v),
    (lambda t, x, u: u.u + t, lambda x, u, p, t: u.u + t),
    (lambda u: u.u**2, lambda x, u: u.u**2),
    (lambda p, u, x: x.h * p.g, lambda x, u, p: x.h * p.g),
    (lambda state, force: state.h * force.u, lambda x, u: x.h * u.u),
    (lambda x, u: x[0] + x[-1] * u[0], lambda x, u: x.h + x.v * u.u),
    (lambda x, u: np.array([1, 2]) @ x, lambda x, u: x.h + 2 * x.v)])
def test_what_means_the_same_is_the_same_problem(one, other):
    found, wanted = (Problem(**GOOD | {'running_cost': each}).built for each in (one, other))
    along = [ca.Function('L', [each.x, each.u, each.p], [each.L])(
        np.arange(1, each.n + 1) / 3, [2], each.p_value) for each in (found, wanted)]
    assert along[0] == along[1]


@pytest.mark.parametrize('name', [name for name in dir(math) if name[0] != '_'])
def test_what_is_named_in_place_of_a_function_of_math_is_the_same(name):
    if not callable(function := getattr(math, name)):
        return
    for count in (1, 2):
        try:
            Problem(**GOOD | {'running_cost': lambda x, u, n=count: function(*[x.h / 9, u.u][:n])})
        except StatementError as error:
            if found := re.search(r'write numpy\.(\w+)', str(error)):
                instead = getattr(np, found[1])
                built = Problem(**GOOD | {
                    'running_cost': lambda x, u, n=count, instead=instead: instead(
                        *[x.h / 9, u.u][:n])}).built
                value = ca.Function('L', [built.x, built.u, built.p], [built.L])(
                    [4, 5], 2, built.p_value)
                assert float(value) == pytest.approx(function(*[4 / 9, 2][:count]), rel=1e-12)


def test_symbols_have_values_again_after_a_statement():
    symbol = ca.SX.sym('x')
    with pytest.raises(StatementError):
        Problem(**GOOD | {'running_cost': lambda x, u: math.sin(x.h)})
    assert math.isnan(float(symbol))


def test_other_threads_are_free_while_a_function_runs():
    filters, symbol = list(warnings.filters), ca.SX.sym('x')

    def cost(x, u):
        assert warnings.filters == filters
        with ThreadPoolExecutor(1) as other:
            assert math.isnan(other.submit(float, symbol).result(9))
            assert other.submit(Problem, GOOD).result(9).states == ('h', 'v')
            with pytest.raises(RuntimeError):   # of CasADi itself
                other.submit(bool, symbol > 0).result(9)
        return math.sin(x.h)
    with pytest.raises(StatementError, match='math.sin'):
        Problem(**GOOD | {'running_cost': cost})


def test_functions_may_take_free_parameters_and_the_time():
    """J = the integral of (x - k t)^2 + u^2 with k to be found; V0 = k^2."""
    problem = Problem(
        states=['x'], inputs=['u'], dynamics=lambda x, u, p, t: {'x': u.u + t},
        free_parameters={'k': [0, 2]}, running_cost=lambda x, u, p, t: (x.x - p.k*t)**2 + u.u**2,
        initial_cost=lambda x, p: x.x**2 + p.k**2, initial_constraints=lambda x: [x.x - 1],
        terminal_cost=lambda x, p, t: t * x.x, terminal_constraints=lambda x, p, t: [x.x - t],
        initial_state={'x': None}, final_time={'free': False, 'value': 1})
    texts = Problem(
        states=['x'], inputs=['u'], dynamics={'x': 'u + t'}, free_parameters={'k': [0, 2]},
        running_cost='(x - k*t)**2 + u**2', initial_cost='x**2 + k**2',
        initial_constraints=['x - 1'], terminal_cost='t*x', terminal_constraints=['x - t'],
        initial_state={'x': None}, final_time={'free': False, 'value': 1})
    values = []
    for built in (problem.built, texts.built):
        assert problem.states == ('x',)
        assert built.free_parameters == ('k',)
        values.append(ca.Function('all', [built.x, built.u, built.p], [
            ca.vertcat(built.f, built.L, built.V, built.psi)])(
                np.linspace(0.3, 0.8, built.n), 0.7, built.p_value).full())
    np.testing.assert_allclose(*values, rtol=1e-14)


def test_a_function_of_the_time_needs_its_name():
    with pytest.raises(StatementError, match="gives the name 't' another meaning"):
        Problem(**GOOD | {'parameters': {**GOOD['parameters'], 't': 1},
                          'running_cost': lambda x, u, p, t: t})


def test_symbols_are_iterated_in_their_order():
    def dynamics(x, u):
        h, v = x
        [force] = u
        assert (len(x), x['h'].name(), h.name()) == (2, 'h', 'h')
        return {'h': v, 'v': force}
    assert Problem(**GOOD | {'dynamics': dynamics}).states == ('h', 'v')


def test_a_problem_starts_at_a_point_at_one_time():
    at = [PathPoint(t, {'h': 7 + 0 * t, 'v': 0 * t}, {}, {}) for t in (0.5, np.array([0, 0.5]))]
    assert as_statement(GOOD, {'initial_state': at[0]})['initial_state'] == {'h': 7, 'v': 0}
    assert Problem(GOOD).replace(initial_state=at[0]).built.x0.tolist() == [7, 0]
    for refuse in (Problem(GOOD).replace, partial(Problem, GOOD), partial(obc.solve, GOOD)):
        with pytest.raises(StatementError, match='^initial_state: .* at one time, found one at 2'):
            refuse(initial_state=at[1])


def test_numbers_of_numpy_are_numbers():
    problem = Problem(**GOOD | {
        'initial_state': {'h': np.int64(7), 'v': np.float32(0.5)},
        'initial_guess': {'states': {'h': np.linspace(7, 1, 3)}}})
    assert problem.built.x0.tolist() == [7.0, 0.5]
    assert problem.built.guess.x['h'].tolist() == [7.0, 4.0, 1.0]
    assert problem.statement['initial_guess'] == {'states': {'h': [7.0, 4.0, 1.0]}}


def test_keys_are_replaced_and_the_original_stays():
    problem = Problem(**GOOD)
    other = problem.replace(initial_state={'h': 3, 'v': 0})
    assert (problem.built.x0.tolist(), other.built.x0.tolist()) == ([10, -2], [3, 0])
    with pytest.raises(StatementError, match=r'^running_cos: unknown key \(did you mean'):
        problem.replace(running_cos=1)


def test_a_system_object_gives_states_inputs_and_dynamics():
    from obc_ros.core.systems.registry import get_system
    keys = {'running_cost': 'u**2', 'initial_state': {'q': 0, 'dq': 1},
            'final_time': {'free': False, 'value': 1}}
    system = get_system('double_integrator')
    keys['initial_state'] = dict.fromkeys(system.state_names, 1)
    keys['running_cost'] = f'{system.input_names[0]}**2'
    assert Problem(system=system, **keys).built.structure == Problem(
        system='double_integrator', **keys).built.structure


def test_a_problem_is_read_from_a_file_by_name(tmp_path):
    file = tmp_path / 'two.yaml'
    file.write_text(yaml.safe_dump([GOOD, GOOD | {'name': 'other', 'running_cost': 'u**2'}]))
    assert Problem.from_file(file, 'other').statement['running_cost'] == 'u**2'
    assert Problem.from_text(file.read_text(), 'lander').name == 'lander'
    for name, said in ((None, r': 2 entries, wanted one: lander, other'),
                       ('othre', r": no entries have the name 'othre' \(did you mean 'other'\?\)"),
                       ('\x1b', ': no entries have the name')):
        with pytest.raises(StatementError, match=said):
            Problem.from_file(file, name)
    file.write_text(yaml.safe_dump({**GOOD, 'name': None}))
    assert Problem.from_file(file).name == 'two'
    with pytest.raises(StatementError, match='cannot be read'):
        Problem.from_file(tmp_path / 'none.yaml')


@pytest.mark.parametrize(('text', 'said'), [
    ('a: [', '^the text: line 1'), ('', '^the text: wanted a mapping'), (3, '^text: wanted YAML'),
    ('a: 1\na: 2', "^the text: .*'a' occurs twice"), ('[]', '^the text: the list is empty'),
    ('\ud800', '^the text: '), ('x' * 300_000, '^the text: longer than')],
    ids=lambda value: str(value)[:12].encode('ascii', 'replace'))
def test_a_text_that_is_no_problem_is_refused(text, said):
    with pytest.raises(StatementError, match=said):
        Problem.from_text(text)


def test_a_problem_is_shown_in_a_line_and_is_built_again_from_its_statement():
    problem = Problem.from_file(problems.FOLDER / 'brachistochrone.yaml')
    assert repr(problem) == ('<Problem brachistochrone: states x, y, v; inputs theta; '
                             'free final time in [0.1, 10] s>')
    again = copy.deepcopy(problem)   # as by pickle
    assert again.built is not problem.built
    assert again.built.structure == problem.built.structure
    assert again.statement == problem.statement
