# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Expressions: accepted syntax, and quick rejection of everything else with a message."""

import gc
import math
import time

import casadi as ca
from hypothesis import given
from hypothesis import strategies as st
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.expressions import (
    check_name,
    insert_numbers,
    MAX_DEPTH,
    parse_expression,
    parse_number,
)
import pytest

VALUES = {'x': 0.7, 'v': -1.3, 'theta_1': 0.4}
SYMBOLS = {name: ca.SX.sym(name) for name in VALUES}


def value(text):
    """Return the parsed expression evaluated at VALUES."""
    f = ca.Function('f', list(SYMBOLS.values()), [parse_expression(text, SYMBOLS, 'key')])
    return float(f(*VALUES.values()))


X, V, THETA = VALUES.values()
GOOD = {
    '1': 1, '-1': -1, '.5': 0.5, '5.': 5, '1e-3': 1e-3, '2E+2': 200, 'x': X, ' x ': X, '(x)': X,
    'x + v': X + V, 'x - v - 1': X - V - 1, 'x*v/2': X*V/2, 'x / v / 2': X / V / 2,
    'x**2': X**2, '2**x': 2**X, '2**3**2': 512, '-x**2': -X**2, '(-x)**2': X**2, '--x': X,
    '+-+x': -X, '2**-1': 0.5, 'x**0.5': math.sqrt(X), '1/9': 1/9, 'pi': math.pi,
    'sin(pi/6)': 0.5, 'cos(x)*tan(v)': math.cos(X)*math.tan(V),
    'asin(x) + acos(x) + atan(v)': math.pi/2 + math.atan(V), 'atan2(v, x)': math.atan2(V, X),
    'sinh(x) - cosh(x)': -math.exp(-X), 'tanh(x)': math.tanh(X), 'exp(v)': math.exp(V),
    'log(x)': math.log(X), 'sqrt(x)': math.sqrt(X), 'abs(v)': -V, 'theta_1*theta_1': THETA**2,
    '0.5*(x**2 + v**2) - 3*(1 - x)**3': 0.5*(X**2 + V**2) - 3*(1 - X)**3, '10 - -1': 11,
    'x*\n  v': X*V, '\tx': X,
    # What f'{value!r}' makes of scalars of NumPy 2.
    'np.float64(1.2)*x': 1.2*X, 'x**np.int64(2) - np.float32(-1.5)': X**2 + 1.5,
}


@pytest.mark.parametrize(('text', 'expected'), GOOD.items())
def test_arithmetic_has_its_value(text, expected):
    assert value(text) == pytest.approx(expected, rel=4e-15)
    assert parse_number(text, VALUES, 'key') == pytest.approx(expected, rel=4e-15)


@pytest.mark.parametrize(('plain', 'expected'), [(3, 3.0), (-0.25, -0.25), ('1e-3', 1e-3)])
def test_numbers_are_read_as_yaml_gives_them(plain, expected):
    assert parse_number(plain, {}, 'key') == expected
    assert float(parse_expression(plain, {}, 'key')) == expected


def test_result_is_symbolic_and_differentiable():
    x, v = SYMBOLS['x'], SYMBOLS['v']
    derivative = ca.jacobian(parse_expression('x**2*v', SYMBOLS, 'key'), x)
    assert float(ca.Function('f', [x, v], [derivative])(3.0, 2.0)) == pytest.approx(12.0)


HOSTILE = {
    '9**9**9**9': 'finite|large',
    '(' * 9000 + 'x' + ')' * 9000: 'complex',
    '(' * 20_000 + 'x' + ')' * 20_000: '40001 characters',
    '(' * (MAX_DEPTH + 1) + 'x' + ')' * (MAX_DEPTH + 1): 'brackets',
    '+'.join(['x'] * 1_000_000): '1999999 characters',
    '+'.join(['x'] * 5_000): 'complex',
    '+'.join(['1e308'] * 1_900): 'finite|large',
    '-' * (MAX_DEPTH + 1) + 'x': 'complex',
    '- +' * 26 + 'x': 'complex',
    '-' * 3_900 + 'x': 'complex',
    'x' + '**x' * (MAX_DEPTH + 1): 'complex',
    '(-' * 26 + 'x' + ')' * 26: 'complex',
    'x**(-' * 17 + 'x' + ')' * 17: 'complex',
    '1' * 500: 'finite|large',
    '1' * 10_000: 'finite|large|not an expression',
    '10**400': 'finite|large',
    '1e999': 'finite',
    'x.__class__': 'attributes',
    'x.__class__.__bases__': 'attributes',
    '__import__("os")': r"""'"' in '__import__\("os"\)' is not understood""",
    'v + a_name_of_18_chars;another_name - v': "';' in 'a_name_of_18_chars;another_name' is not",
    '__import__(x)': "'__import__' is not a function",
    'eval(x)': 'not a function',
    'math.sin(x)': 'attributes',
    'x(2)': "'x' is not a function",
    'max(x, 0)': r"'max' is not a function \(did you mean '\(a \+ b \+ abs",
    '(1)(2)': 'not a function',
    'lambda: x': 'not understood',
    'lambda x': 'not an expression',
    '"x"': 'not understood',
    'f"{x}"': 'not understood',
    'x < 1': 'comparisons',
    'x == 1': 'comparisons',
    'x and v': 'not arithmetic',
    'not x': 'not arithmetic',
    'True': 'not arithmetic',
    'None': 'not arithmetic',
    'x if v else 1': 'not arithmetic',
    '(x := 1)': 'not understood',
    'x = 1': 'comparisons',
    '[x]': r'write \(',
    '(x, v)': 'not arithmetic',
    'sin(*x)': 'not arithmetic',
    'sin(x=1)': 'comparisons',
    'sin(x, v)': 'sin takes 1 argument',
    'sin()': 'sin takes 1 argument',
    'atan2(x)': 'atan2 takes 2 arguments',
    'sin': 'needs its argument',
    '1j': "'1j' is not a number",
    '0x10': 'not a number',
    '1_000': 'not a number',
    '2x': "'2x' is not a number",
    '007': 'not an expression',
    'x % v': 'not understood',
    'x // v': 'not arithmetic',
    'x @ v': 'not understood',
    '~x': 'not understood',
    'x^2': r'write \*\*',
    'x v': 'not an expression',
    'x +': 'not an expression',
    '': 'empty',
    '   ': 'empty',
    'x;v': 'not understood',
    'x # v': 'not understood',
    'x\x00': r'U\+0000',
    'ｘ': r'U\+FF58',
    'x − v': 'write -',
    'x\u200b': r'U\+200B',
    '1/0': 'zero|finite',
    'x/0': 'zero|finite',
    '0**-1': 'zero|finite',
    'sqrt(-1)': 'undefined|finite',
    '(-8)**(1/3)': 'finite',
    'log(0)': 'undefined|finite',
    'acos(2)': 'undefined|finite',
    'exp(1000)': 'large|finite',
    'xx': r"unknown name 'xx' \(did you mean 'x'\?\); known names: x, v, theta_1",
    'theta1': "did you mean 'theta_1'",
    'sinn(x)': "did you mean 'sin'",
    'ln(x)': "did you mean 'log'",
    't': 'the time is known in dynamics, costs',
    'nan': 'unknown name',
}


@pytest.mark.parametrize(('text', 'said'), HOSTILE.items(), ids=[key[:20] for key in HOSTILE])
@pytest.mark.parametrize(('read', 'names'), [(parse_expression, SYMBOLS), (parse_number, VALUES)])
def test_hostile_texts_are_rejected_quickly_with_a_message(text, said, read, names):
    gc.freeze()  # keeps objects of other tests out of the timed collections
    started = time.process_time()
    with pytest.raises(StatementError, match=said) as error:
        read(text, names, 'dynamics.v')
    assert time.process_time() - started < 0.2
    gc.unfreeze()
    assert str(error.value).startswith('dynamics.v: ')
    assert len(str(error.value)) < 400


@pytest.mark.parametrize('plain', [
    True, None, [1], {'a': 1}, (1,), b'1', 1j, math.nan, math.inf, -math.inf, 10**400, -1e101,
    object()],
    ids=lambda plain: type(plain).__name__)
def test_values_other_than_numbers_and_texts_are_rejected(plain):
    with pytest.raises(StatementError, match=r'^initial_state\.x: '):
        parse_number(plain, {}, 'initial_state.x')
    with pytest.raises(StatementError, match=r'^initial_state\.x: '):
        parse_expression(plain, {}, 'initial_state.x')


@given(st.text(alphabet='xv01.e+-*/() ,^[]sincoab\n\'"_:=', max_size=60))
def test_any_text_gives_a_value_or_a_statement_error(text):
    for read, names in ((parse_expression, SYMBOLS), (parse_number, VALUES)):
        try:
            result = read(text, names, 'key')
        except StatementError as error:
            assert str(error).startswith('key: ')
        else:
            assert read is parse_expression or math.isfinite(result)


@pytest.mark.parametrize(('text', 'expected'), [
    ('+'.join(['x'] * 1999), 1999 * X), ('-x' * 1999, -1999 * X), ('x*-1/-1' + '*1' * 900, X),
    ('-' * MAX_DEPTH + 'x', X), ('(' * MAX_DEPTH + 'x' + ')' * MAX_DEPTH, X),
    ('1' + '**x' * MAX_DEPTH, 1.0), ('+'.join(['(-x)**2'] * 200), 200 * X**2)])
def test_long_and_deep_expressions_within_limits_are_evaluated(text, expected):
    assert parse_number(text, VALUES, 'key') == pytest.approx(expected)
    assert value(text) == pytest.approx(expected)


@pytest.mark.parametrize('name', [
    'pi', 'sin', 'lambda', 'True', '1x', 'x y', 'x.y', '', 'é', 'x' * 65, 3, None, ['x']])
def test_invalid_names_are_rejected(name):
    with pytest.raises(StatementError, match='^states: '):
        check_name(name, 'states')


@pytest.mark.parametrize('name', ['x', 'x_1', '_x', 'L', 't', 'e', 'theta', 'match'])
def test_valid_names_are_accepted(name):
    assert check_name(name, 'states') == name


@pytest.mark.parametrize(('text', 'wanted'), [
    ('-r**2 + x*r', '-(-0.5)**2 + x*(-0.5)'), ('2.e5*e5 + e5x', '2.e5*(7.0) + e5x'),
    ('sin(x)\n  + r', 'sin(x) + (-0.5)'), ('xr', 'xr'), (3, '3'), (0.25, '0.25')])
def test_numbers_take_the_place_of_names(text, wanted):
    assert insert_numbers(text, {'r': -0.5, 'e5': 7.0}) == wanted


@given(st.floats(-1e50, 1e50), st.floats(-2.0, 2.0))
def test_an_expression_with_a_number_in_place_of_a_name_has_its_value(r, x):
    text = 'x - r + (x*r - 2*r)/(1 + r**2) - -r'
    inserted = insert_numbers(text, {'r': r})
    assert parse_number(inserted, {'x': x}, 'it') == parse_number(text, {'x': x, 'r': r}, 'it')
