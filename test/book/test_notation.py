# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The notation of sheets: as printed in them; two readings and hostile texts are refused."""

from math import e, pi, sqrt

import casadi as ca
from hypothesis import given
from hypothesis import strategies as st
from obc_ros.book.teaching.notation import parse_answer, split_answer, write_plainly
from obc_ros.book.teaching.sheet import check_answer, QUESTIONS
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.expressions import parse_number
import pytest

ASKED = {question.name.removeprefix('exercise-'): question for question in QUESTIONS}
VALUES = {'q': 1.7, 'a': 0.6, 'b': 2.3, 'T': 1.1, 't': 0.4, 'x0': 0.9, 'xf': -1.2, 'lam': 0.8,
          'lam1': -0.3, 'theta': 0.5}


def read(text, unit=''):
    symbols = {name: ca.SX.sym(name) for name in VALUES}
    found = parse_answer(text, symbols, 'answer', unit)
    return float(ca.Function('value', list(symbols.values()), [found])(*VALUES.values()))


q, a, b, T, t, x0, xf, lam, lam1, theta = VALUES.values()


@pytest.mark.parametrize('text, value', [
    ('q^2', q**2), ('2q', 2 * q), ('2 q', 2 * q), ('q b', q * b), ('(q + 1)(q - 1)', q**2 - 1),
    ('2(q + 1)', 2 * q + 2), ('q (a - b)', q * (a - b)), ('q(a - b)', q * (a - b)),
    ('(a - b)q', q * (a - b)), ('(a) 3', 3 * a), ('3pi', 3 * pi), ('3π', 3 * pi),
    ('2πq', 2 * pi * q), ('√2', sqrt(2)), ('√(2q)', sqrt(2 * q)), ('3√q', 3 * sqrt(q)),
    ('q√2', q * sqrt(2)), ('sqrt(2 q)', sqrt(2 * q)), ('2 sqrt(q)', 2 * sqrt(q)),
    ('e^(-a T)', e**(-a * T)), ('e^{-a T}', e**(-a * T)), ('e^-a', e**-a), ('e^2', e**2),
    ('e**(a (t - T))', e**(a * (t - T))), ('b e^(a t)x0', b * e**(a * t) * x0), ('2e', 2 * e),
    ('b^2 q^2', b**2 * q**2), ('2 a q - b^2 q^2', 2 * a * q - b**2 * q**2), ('q²b', q**2 * b),
    ('q^-2', q**-2), ('-q^2', -q**2), ('q^a^2', q**(a**2)), ('a/b * q', a / b * q),
    ('(a/b) q', a / b * q), ('a/(2 b)', a / (2 * b)), ('q − a·b', q - a * b), ('ln(q)', 0.530628),
    ('arctan(q)', 1.039072), ('K = q', q), ('u(t) = -q', -q), ("lambda2' = q^2", q**2),
    ('x1* = a/2', a / 2), ('lambda', lam), ('3 a λ', 3 * a * lam), ('lambda1 cos(theta)', None),
    ('λ1', lam1), ('θ', theta), ('x_0', x0), ('x_f - x(0)', xf - x0), ('50 %', 0.5),
    ('aπ b', a * pi * b), ('√2 q', sqrt(2) * q), ('√2(a + b)', sqrt(2) * (a + b)),
    ('2e3', 2000), ('2 e-3', 2 * e - 3),
    ('sqrt 2', None), ('{q}', q), ('[q + 1](2)', 2 * (q + 1))], ids=str)
def test_the_notation_of_the_sheet_is_read(text, value):
    if value is None:
        value = {'lambda1 cos(theta)': lam1 * 0.8775825619}.get(text)
    if value is None:
        with pytest.raises(StatementError, match='put the argument of sqrt in brackets'):
            read(text)
    else:
        assert read(text) == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize('text, unit, value', [
    ('2.0 s', 's', 2), ('2s', 's', 2), ('1e-3 s', 's', 1e-3), ('(1/2) m', 'm', 0.5),
    ('2 rad/s', 'rad/s', 2), ('2 1/s', 'rad/s', 2), ('90°', 'rad', pi / 2),
    ('90 deg', 'rad', pi / 2), ('pi rad', 'rad', pi)])
def test_the_unit_that_is_asked_for_is_read(text, unit, value):
    assert read(text, unit) == pytest.approx(value)


@pytest.mark.parametrize('text', [
    'q**2', '2*q - a/b', '1e-3', '-q', '2.5', 'sqrt(2*q)', 'exp(-a*T)*x0/(1 + b**2)', 'pi/2'])
def test_the_notation_of_problem_files_has_its_meaning(text):
    assert read(text) == parse_number(text, VALUES, 'text')
    assert read(write_plainly(text, VALUES, 'text')) == read(text)


@pytest.mark.parametrize('text, words', [
    ('1/2q', "'/2q' can be read in two ways"), ('1/2 q', "'/2 q' can be read in two ways"),
    ('a/(2b)(q)', 'two ways'), ('e^2t', "'^2t' can be read"), ('e^-2 t', 'two ways'),
    ('e^a t', 'two ways'), ('q^2b', 'two ways'), ('√2q', 'two ways'), ('√6π', 'two ways'),
    ('1/√2 sqrt(q)', "'/ ... √2 sqrt' can be read"), ('2/b^2 a', "'/ ... ^2 a' can be read"),
    ('√sin(q)', 'under the root'),
    ('sin^2(q)', 'put the argument of sin in brackets'), ('2 3', 'is not an expression'),
    ('z q', "unknown name 'z'"), ('foo(q)', "'foo' is not a function"), ('a = b = q', "'='"),
    ('q &^ 2', "'&'"), ('2q +', 'is not an expression'), ('(2q', 'is not an expression'),
    ('2q)', 'is not an expression'), ('2 kg', "unknown name 'kg'"), ('q^', 'is not an expression'),
    ('√', 'under the root'), ('', 'empty'), ('\x1b[31m2q', 'U+001B'), ('2q\u202e', 'U+202E')])
def test_a_text_that_is_not_understood_gets_a_sentence(text, words):
    with pytest.raises(StatementError) as refused:
        read(text)
    assert words in str(refused.value)
    assert str(refused.value).startswith('answer: ')
    assert str(refused.value).isprintable()


@pytest.mark.parametrize('text, unit, words', [
    ('2 m', 's', 'in m, wanted s'), ('90 deg', 's', 'in deg, wanted s'),
    ('2 s', 'rad', 'in s, wanted rad'), ('5 %', 's', 'in %, wanted s'),
    ('2 m', '', 'in m, but no unit is asked for'), ('90 deg', '', 'but no unit is asked for')])
def test_another_unit_than_the_one_asked_for_is_refused(text, unit, words):
    with pytest.raises(StatementError, match=words):
        read(text, unit)


@pytest.mark.parametrize('answer, rows', [
    ('(1, 2)', ['1', ' 2']), ('[1, 2]', ['1', ' 2']), ('1, 2', ['1', ' 2']),
    ('K = [q, sqrt(2 q)]', ['q', ' sqrt(2 q)']),
    ('A = [[0, 10], [0, 0]]', [['0', '10'], ['0', '0']]),
    ('l1 = 3, l2 = -2', ['3', '-2']), (['(1, 2)', '(3, 4)'], [['1', ' 2'], ['3', ' 4']]),
    ('atan2(1, 2)', 'atan2(1, 2)'), ('(a + b)(a, b)', '(a + b)(a, b)'), (3, 3), ('q', 'q'),
    ([1, 'q'], [1, 'q'])], ids=str)
def test_rows_are_read_from_text(answer, rows):
    def strip(each):
        return list(map(strip, each)) if isinstance(each, list) else (
            each.strip() if isinstance(each, str) else each)

    assert strip(split_answer(answer, False, 'answer')) == strip(rows)


@pytest.mark.parametrize('answer', [
    ['-1.414 + 1.414j', '-1.414 - 1.414j'], '-1.414 ± 1.414j',
    '-1.414 - 1.414i, -1.414 + 1.414i',
    '(-sqrt(2) + sqrt(2) j, -sqrt(2) - sqrt(2) j)', '-√2(1 - j), -√2(1 + j)',
    '-1.414±j1.414', '-sqrt(2) ± j sqrt(2)', [[-1.414, 1.414], [-1.414, -1.414]],
    's = -√2 ± √2 j'], ids=str)
def test_poles_may_be_complex_numbers(answer):
    assert check_answer(ASKED['2.7-poles'], answer).verdict == 'right'


def test_a_product_of_imaginary_units_is_refused():
    found = check_answer(ASKED['2.7-poles'], '(1 + j)*(1 + j), 2')
    assert found.verdict == 'unreadable'
    assert 'is not a complex number such as -1 + 2j' in found.why


@pytest.mark.parametrize('name, answer', [
    ('2.1-a', '3 - 2j'), ('2.2-cost', '9.42 + 0j'), ('2.10-A', ['10j', '0j'])], ids=str)
def test_a_complex_number_is_wrong_where_real_ones_are_asked_for(name, answer):
    found = check_answer(ASKED[name], answer)
    assert (found.verdict, found.why) == ('wrong', 'it is complex; wanted real numbers')


@pytest.mark.parametrize('answer', ['9,42', '-9,42 s', '9,42s'])
def test_a_decimal_comma_is_refused(answer):
    found = check_answer(ASKED['2.2-cost'], answer)
    assert 'write 9.42, or [9, 42] for two numbers' in found.why


@pytest.mark.parametrize('name, answer', [
    ('example-2.4-gain', '[q, sqrt(2 q)]'), ('example-2.4-gain', ['q', '√(2q)']),
    ('2.1-a', '(3, -2)'), ('2.3-costate', 'λ = (-6, -8)'), ('2.2-cost', 'J = 3π'),
    ('example-2.3-time', '2.0 s'), ('2.5-costate', '3 a x^2 lambda'), ('2.6-turn', 'pi/4 s'),
    ('2.8-b-gain', 'K = (1, √(a^2 + 2) - a)'), ('2.10-A', '[[0, 10], [0, 0]]'),
    ('2.9-b-end', '4 e^2/(1 + 0.25*10 (e^4 - 1)/4)'),
    ('2.4-a-end', 'e^(-a T) x0/(1 + b^2 c (1 - e^(-2 a T))/(2 a))')], ids=str)
def test_answers_in_the_notation_of_the_sheet_are_right(name, answer):
    assert check_answer(ASKED[name], answer).verdict == 'right'


PIECES = st.sampled_from([
    'q', '2', '^', '**', '(', ')', '[', ']', '{', '}', ',', '=', 'e', '√', 'π', ' ', '/', '-', '+',
    'j', '±', 's', '%', '°', 'sin', 'x_0', '\x1b[31m', '\u202e', '\0', '²', 'λ', "'", '9' * 400,
    '(' * 300, '-' * 300, '^2' * 300, '2 ' * 3000, ' ' * 30_000, 'a' * 30_000, '1e999', '\n'])


@pytest.mark.slow
@given(text=st.lists(PIECES, max_size=12).map(''.join) | st.text(max_size=40),
       name=st.sampled_from(['2.2-cost', '2.7-poles', 'example-2.4-gain', '2.4-a-extremal']))
def test_any_text_gets_a_verdict_that_can_be_shown(text, name):
    answer = {'x': text, 'u': text, 'lam': text} if name == '2.4-a-extremal' else text
    found = check_answer(ASKED[name], answer)
    assert found.verdict in ('right', 'wrong', 'unreadable')
    assert found.why.isprintable()
    assert len(found.why) < 600
