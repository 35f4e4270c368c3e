# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exercise sheets: right answers pass, typical wrong ones are told why, references are right."""

import csv
from math import exp, pi, sqrt
import os
import re

import numpy as np
import obc_ros as obc
from obc_ros.book.teaching.exercises import find_end, find_extremal, STATEMENT
from obc_ros.book.teaching.question import FormulaQuestion
from obc_ros.book.teaching.sheet import check_answer, check_sheet, format_sheet, QUESTIONS
from obc_ros.cli.obc import main
from obc_ros.core.text.expressions import parse_number
import pytest
from scipy.integrate import quad, solve_bvp, solve_ivp
from scipy.linalg import solve_continuous_are
from scipy.optimize import minimize, minimize_scalar
from scipy.signal import StateSpace, step
import yaml

ASKED = {question.name.removeprefix('exercise-'): question for question in QUESTIONS}
END = find_end()
EXTREMAL = {'x': f'exp(-t) - {END}*exp(-1)*sinh(t)', 'u': f'-{END}*exp(t - 1)',
            'lam': f'{END}*exp(t - 1)'}
NAMES = [question.name for question in QUESTIONS]
SPECIAL = {'2.4-a-extremal': EXTREMAL, '2.4-a-problem': STATEMENT}
FORMULAS = [question for question in QUESTIONS if isinstance(question, FormulaQuestion)]
MISTAKES = [(question.name.removeprefix('exercise-'), answer, why) for question in FORMULAS
            for answer, why in question.mistakes]


def full(name):
    return f'exercise-{name}'


def judge(name, answer):
    return check_answer(ASKED[name], answer)


def evaluate(name, **values):
    """Return the values of a reference as an array."""
    reference = ASKED[name].reference
    rows = [[reference]] if isinstance(reference, (str, float)) else reference
    rows = [rows] if not isinstance(rows[0], (list, tuple)) else rows
    return np.array([[parse_number(each, values, name) for each in row] for row in rows])


def as_yaml(answer):
    return [as_yaml(each) for each in answer] if isinstance(answer, (list, tuple)) else answer


def write(tmp_path, answers):
    path = tmp_path / 'answers.yaml'
    path.write_text(yaml.safe_dump(as_yaml_mapping(answers)))
    return path


def as_yaml_mapping(answers):
    return {name: as_yaml(answer) for name, answer in answers.items()}


def test_the_sheet_is_yaml_with_every_question_open(tmp_path, capsys):
    path = tmp_path / 'new' / 'sheet.yaml'
    assert main(['gallery', '--sheet', str(path)]) == 0
    assert yaml.safe_load(path.read_text()) == dict.fromkeys(NAMES)
    assert max(map(len, path.read_text().splitlines())) <= 99
    assert {each.verdict for each in check_sheet(path)} == {'open'}
    assert main(['gallery', '--check', str(path)]) == 0
    assert f'{len(ASKED)} of {len(ASKED)} questions are open' in capsys.readouterr().out


def test_every_exercise_of_the_chapter_has_a_question():
    text = format_sheet('sheet.yaml')
    for number in range(1, 11):
        assert f'\nexercise-2.{number}-' in text
    assert len(ASKED) == len(QUESTIONS) > 30


def test_a_sheet_with_answers_is_not_overwritten(tmp_path, capsys):
    path = tmp_path / 'sheet.yaml'
    path.write_text('2.1-a: [3, -2]')
    assert main(['gallery', '--sheet', str(path)]) == 1
    assert 'exists; give another name' in capsys.readouterr().err
    assert path.read_text() == '2.1-a: [3, -2]'


@pytest.mark.slow
def test_right_answers_pass(tmp_path, capsys):
    answers = {question.name: SPECIAL.get(name) or question.reference
               for name, question in ASKED.items()}
    assert main(['gallery', '--check', str(write(tmp_path, answers))]) == 0
    output = capsys.readouterr().out
    assert 'wrong' not in output
    assert f'{len(ASKED)} of {len(ASKED)} answers are right; 0 of' in output


@pytest.mark.parametrize('name, answer', [
    ('2.8-b-gain', [1, '2/(a + sqrt(2 + a*a))']), ('2.8-b-gain', [[1, 'sqrt(a**2 + 2) - a']]),
    ('example-2.4-gain', ['q', '(4*q**2)**0.25']), ('2.2-cost', 9.42), ('2.2-cost', '3*pi'),
    ('2.10-A', [[0, 10], [0, 0]]), ('2.7-gain', [4, 2.83]), ('2.8-c-frequency', 1),
    ('2.4-a-end', 'x0/(exp(a*T) + b**2*c*sinh(a*T)/a)'), ('2.4-a-limit', 0)], ids=str)
def test_the_form_of_a_right_answer_is_free(name, answer):
    assert judge(name, answer).verdict == 'right'


@pytest.mark.parametrize('question', [
    each for each in FORMULAS if not each.names], ids=lambda question: question.name)
def test_three_digits_are_enough(question):
    right = question.evaluate(question.reference)[0]
    for answer in (np.vectorize(lambda value: float(f'{value:.3g}'))(right), 1.0019 * right):
        assert check_answer(question, answer.tolist()).verdict == 'right'


@pytest.mark.parametrize('name, answer, why', MISTAKES, ids=str)
def test_a_typical_mistake_is_told(name, answer, why):
    found = judge(name, as_yaml(answer))
    assert (found.verdict, found.why) == ('wrong', why)


@pytest.mark.parametrize('name, answer, words', [
    ('example-2.4-gain', ['1/q', 'sqrt(2/q)'], 'printed in the book, and a misprint'),
    ('2.4-a-costate', '-c*exp(a*(t-T))*exp(-a*T)*x0/(1 + b**2*c*(1 - exp(-2*a*T))/(2*a))',
     'L + lambda f is minimised'),
    ('2.4-a-input', 'b*c*exp(a*(t-T))*exp(-a*T)*x0/(1 + b**2*c*(1 - exp(-2*a*T))/(2*a))',
     'maximises H'),
    ('2.7-gain', [0.25, 0.1768], 'factor 1/rho is missing'),
    ('2.6-turn', 45, 'in degrees'), ('2.6-switching', 'lam1*sin(theta) + lam2*cos(theta)',
                                     'exchanged'),
    ('example-2.3-hamiltonian', 1, 'transversality for a free T'),
    ('2.10-gain', [0.2, 0.4], 'the factor B^T = (0, 5) is missing'),
    ('2.10-gain', [[-5, 5], [-5, -5]], 'these are the closed-loop poles'),
    ('2.8-b-gain', [1, '-a - sqrt(a**2 + 2)'], 'not positive definite'),
    ('2.2-cost', '6*pi', 'the factor 1/2 of the cost is missing'),
    ('2.4-d-optimum', '2/(1 - exp(-2))', 'twice the right answer: look for a factor 1/2'),
    ('2.10-B', [0, 5], 'the transpose'), ('2.9-a-gain', '-2*a/b', 'no minus'),
    ('2.2-speed', 'sqrt(6*pi)*180/pi', 'in degrees'),
    ('2.5-costate', '-3*a*x**2*lam', 'sign of the costate equation'),
    ('2.4-a-end', 'sqrt(-a)', 'no finite value'), ('2.10-A', [1, 2, 3], 'wanted 2 x 2'),
    ('2.10-A', [[1, 2], [3, 4]], 'differentiate f')], ids=str)
def test_a_wrong_answer_is_told_why(name, answer, words):
    found = judge(name, answer)
    assert found.verdict == 'wrong'
    assert words in found.why


@pytest.mark.parametrize('question', FORMULAS, ids=lambda question: question.name)
def test_no_advice_is_the_answer(question):
    """Each part of the words is evaluated with the numbers of the question."""
    given = dict(re.findall(r'(\w+)(?:\(0\))? = (-?\d[\d.]*(?:/\d+)?)', question.text))
    given = {'x(0)' if name == 'x' else name: value for name, value in given.items()
             if name not in question.names}
    for words in (question.advice, *(why for _, why in question.mistakes)):
        for part in re.split(r' = |[:;,.] |\b(?:is|wanted|or|are|of|for|with|by|and|in)\b', words):
            for name, value in given.items():
                part = re.sub(rf'(?<!\w){re.escape(name)}(?!\w)', f'({value})', part)
            for sign in '+-':
                found = check_answer(question, part.replace('+-', sign))
                assert found.verdict != 'right', words


@pytest.mark.parametrize('name, answer, words', [
    ('example-2.4-damping', 0.7, 'near: three significant digits are asked for'),
    ('2.4-d-optimum', 1.15, 'near: three significant digits are asked for'),
    ('2.7-gain', [4, 2.8], 'near: three significant digits are asked for'),
    ('2.10-A', [[0, 10.2], [0, 0]], 'near: three significant digits are asked for'),
    ('example-2.4-gain', ['q', '1.4142*sqrt(q)'], 'near: write numbers such as sqrt(2)'),
    ('example-2.4-gain', ['q', '-sqrt(2*q)'],
     'only the entry 2 is wrong: it has the opposite sign'),
    ('example-2.4-gain', ['q', 'q'], 'only the entry 2 is wrong'),
    ('example-2.4-gain', ['2*q', 'sqrt(2*q)'], 'only the entry 1 is wrong: it is twice'),
    ('2.10-A', [[0, 1], [2, 0]], '2 of 4 entries are wrong; the first is entry (1, 2)'),
    ('2.10-A', [[0, 10], [3, 0]], 'only the entry (2, 1) is wrong'),
    ('2.5-costate', '9*a*x**2*lam', 'with a constant factor of 3 too much'),
    ('2.5-costate', '-x**2*a*lam', 'with a constant factor of -0.3333 too much'),
    ('2.9-a-riccati', '2*a/b**3', 'it is right only for b = 1'),
    ('2.4-c-input', '(xf - x0)/(T*b) + a*x0/b', 'it is right only for a = 0 or t = 0'),
    ('2.4-a-costate', f'c*{ASKED["2.4-a-end"].reference}', 'it is right only for T = t'),
    ('2.9-a-gain', '2', 'it is right only for a = b')], ids=str)
def test_a_near_miss_is_told_what_is_missing(name, answer, words):
    found = judge(name, answer)
    assert found.verdict == 'wrong'
    assert words in found.why


@pytest.mark.parametrize('name, answer', [
    ('2.4-a-limit', 0.01), ('2.4-a-limit', 0.004), ('example-2.3-hamiltonian', 0.02),
    ('2.10-A', [[0.1, 10], [0, 0]]), ('2.2-cost', 9.8),
    ('2.5-costate', 0), ('2.8-c-frequency', 3)], ids=str)
def test_another_answer_is_no_near_miss(name, answer):
    found = judge(name, answer)
    assert found.verdict == 'wrong'
    for words in ('near', 'constant factor', 'it is right'):
        assert words not in found.why


@pytest.mark.slow
@pytest.mark.parametrize('change, words', [
    ({}, ''), ({'running_cost': 'u**2', 'terminal_cost': 'x**2'}, 'both factors 1/2'),
    ({'terminal_cost': 'x**2'}, 'factor 1/2 of the terminal cost'),
    ({'running_cost': 'u**2'}, 'factor 1/2 of the running cost'),
    ({'dynamics': {'x': 'x + u'}}, 'the sign of the dynamics'),
    ({'initial_state': {'x': 2}}, 'its minimum cost is 0.188972'),
    ({'final_time': {'free': True, 'lower': 0.5, 'upper': 1}},
     'T = 1 s is the upper bound of final_time: this bound decides'),
    ({'initial_state': {'x': [1, 2]}}, 'x(0) = 1 is the lower bound of initial_state'),
    ({'dynamics': {'x': '0*u'}, 'terminal_cost': f'{END * exp(-1) / 2!r}*x'},
     'the optimum of the exercise is not one of this problem'),
    ({'input_bounds': {'u': [1, 2]}, 'terminal_constraints': ['x + 5']},
     'no certified solution')], ids=str)
def test_a_statement_is_solved_and_certified(change, words):
    found = judge('2.4-a-problem', STATEMENT | change)
    assert words in found.why
    assert found.verdict == ('wrong' if words else 'right')


@pytest.mark.parametrize('name, answer, words', [
    ('2.8-b-gain', [1, 'sqrt(z)'], "unknown name 'z'"), ('2.2-cost', 'x' * 100_000, '2.2-cost'),
    ('2.2-cost', float('nan'), 'nan'), ('2.2-cost', '1/0', '2.2-cost'),
    ('2.2-cost', '__import__("os")', '2.2-cost'), ('2.2-cost', {'a': 1}, 'a mapping'),
    ('2.2-cost', [], 'an empty list'), ('2.2-cost', [[]], '2.2-cost'),
    ('2.2-cost', True, '2.2-cost'), ('2.10-A', [[1, 2], [3]], 'different lengths'),
    ('2.10-A', [[1] * 30] * 30, 'more than 100 entries'), ('2.10-A', [[[1]]], '2.10-A'),
    ('2.4-a-extremal', 3, 'wanted formulas of x, u, lam'),
    ('2.4-a-extremal', {'x': 't'}, '2.4-a-extremal.u: missing'),
    ('2.4-a-extremal', {'lambda': 't'}, "(did you mean 'lam'?)"),
    ('2.4-a-extremal', {**EXTREMAL, 'x': 'w'}, "unknown name 'w'"),
    ('2.4-a-problem', [1], 'wanted the keys of a problem file'),
    ('2.4-a-problem', {'states': ['x']}, '2.4-a-problem: '),
    ('2.4-a-problem', {1: 2}, '2.4-a-problem: '),
    ('2.2-cost', '\x1b[31m', 'the character U+001B')], ids=lambda each: str(each)[:40])
def test_an_unreadable_answer_is_refused_in_words(name, answer, words):
    found = judge(name, answer)
    assert found.verdict == 'unreadable'
    assert words in found.why
    assert found.why.isprintable()


@pytest.mark.parametrize('text, words', [
    ('exercise-2.2-costs: 3', "no question 'exercise-2.2-costs' (did you mean"),
    ('[1]', 'a list of 1'), ('1: 2', "no question '1'"),
    ('2.2-cost: 1\nexercise-2.2-cost: 2', "'2.2-cost' and 'exercise-2.2-cost' are one question"),
    ('exercise-2.2-cost:\n2.2-cost: 2', 'are one question'),
    ('', 'obc gallery --sheet FILE writes a sheet'), ('a: {', 'answers.yaml'),
    ('2.2-cost: 1\n2.2-cost: 2', 'occurs twice'), ('2.2-cost: *a', 'answers.yaml'), ('\0', '')])
def test_a_malformed_sheet_exits_with_2(tmp_path, capsys, text, words):
    path = tmp_path / 'answers.yaml'
    path.write_text(text)
    assert main(['gallery', '--check', str(path)]) == 2
    told = capsys.readouterr()
    assert told.out == ''
    assert told.err.startswith('obc gallery: ')
    assert words in told.err


def test_a_missing_sheet_exits_with_2(capsys):
    assert main(['gallery', '--check', 'missing.yaml']) == 2
    assert 'cannot be read' in capsys.readouterr().err


def test_former_names_of_questions_are_read(tmp_path):
    path = tmp_path / 'answers.yaml'
    path.write_text('2.2-cost: 9.42\nexample-2.3-time: 2\n2.6-turn:\n')
    verdicts = {each.name: each.verdict for each in check_sheet(path)}
    assert set(verdicts) == set(NAMES)
    assert verdicts['exercise-2.2-cost'] == verdicts['example-2.3-time'] == 'right'
    assert verdicts['exercise-2.6-turn'] == 'open'


def test_a_partial_sheet_is_checked(tmp_path, capsys):
    path = write(tmp_path, {'2.2-cost': 9.42, '2.6-turn': 45, '2.1-a': None, '2.2-speed': 'y'})
    assert main(['gallery', '--check', str(path)]) == 2
    output = capsys.readouterr().out
    assert '\nexercise-2.2-cost   right\n' in output
    assert '\nexercise-2.6-turn   wrong\n' in output
    assert '\nexercise-2.6-turn: the angle is in degrees' in output
    assert '\nexercise-2.2-speed  unreadable\n' in output
    assert '1 of 3 answers are right' in output


@pytest.fixture
def sheets(tmp_path):
    """Return the sheets of four students: right, wrong, an unreadable answer, no YAML."""
    files = []
    for name, text in (('ada', '2.2-cost: 3*pi'), ('bob', '2.6-turn: 45\n2.2-cost: 3*pi'),
                       ('eve', '2.2-cost: "1 +"'), ('zoe', 'a: {')):
        files.append(tmp_path / f'{name}.yaml')
        files[-1].write_text(text)
    return files


@pytest.mark.parametrize('chosen, status', [
    ([0, 0], 0), ([0, 1], 1), ([1, 0], 1), ([2, 1], 2), ([0, 3, 0], 2)], ids=str)
def test_a_class_has_the_worst_exit_status(sheets, chosen, status):
    assert main(['gallery', '--check', *(str(sheets[each]) for each in chosen)]) == status


def test_a_class_is_a_line_for_each_sheet(sheets, capsys):
    assert main(['gallery', '--check', *map(str, sheets)]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ['file', 'right', 'wrong', 'unreadable', 'open']
    rows = [line.split() for line in lines[2:]]
    count = len(ASKED)
    assert rows[:3] == [[str(sheets[0]), '1', '0', '0', str(count - 1)],
                        [str(sheets[1]), '1', '1', '0', str(count - 2)],
                        [str(sheets[2]), '0', '0', '1', str(count - 1)]]
    assert rows[3] == [str(sheets[3])]
    assert lines[-1].startswith(f'{sheets[3]}: line 1')


@pytest.mark.parametrize('count', [1, 3, 4])
def test_a_class_is_written_as_csv(sheets, tmp_path, count):
    path = tmp_path / 'new' / 'class.csv'
    main(['gallery', '--check', *map(str, sheets[:count]), '--csv', str(path)])
    with path.open(newline='') as file:
        rows = list(csv.DictReader(file))
    assert [row['file'] for row in rows] == list(map(str, sheets[:count]))
    assert (rows[0]['right'], rows[0][full('2.2-cost')], rows[0][full('2.6-turn')]) == (
        '1', 'right', 'open')
    assert set(NAMES) < set(rows[0])
    if count > 1:
        assert (rows[1]['wrong'], rows[1][full('2.6-turn')], rows[1]['error']) == (
            '1', 'wrong', '')
    if count > 3:
        assert (rows[3]['right'], rows[3][full('2.2-cost')]) == ('', '')
        assert 'zoe.yaml: line 1' in rows[3]['error']


def test_a_name_with_control_characters_is_shown_escaped(sheets, tmp_path, capsys):
    names = ['\x1b[31m.yaml', os.fsdecode(b'\xff.yaml')]
    assert main(['gallery', '--check', *names, '--csv', str(tmp_path / 'class.csv')]) == 2
    assert capsys.readouterr().out.replace('\n', '').isprintable()
    assert (tmp_path / 'class.csv').read_text().replace('\n', '').isprintable()


def test_the_table_of_a_class_replaces_no_sheet(sheets, capsys):
    one = str(sheets[0])
    assert main(['gallery', '--check', one, '--csv', one]) == 2
    assert 'would overwrite' in capsys.readouterr().err
    link = sheets[0].with_name('linked.yaml')
    link.symlink_to(sheets[0])
    assert main(['gallery', '--check', one, '--csv', str(link)]) == 2
    assert sheets[0].read_text() == '2.2-cost: 3*pi'


@pytest.mark.parametrize(('name', 'answer'), [
    ('2.10-B', '[[0], [5]]'), ('2.10-B', 'B = [[0], [5]]'),
    ('2.7-gain', 'K = [[4, 2.8284271]]'), ('2.7-gain', '(4), (2.8284271)')])
def test_rows_of_one_entry_and_single_rows_are_read(name, answer):
    assert judge(name, answer).verdict == 'right'


# The references, by other means.

def chain(rate=1.0, gain=1.0, drag=0.0):
    return np.array([[0.0, rate], [0.0, -drag]]), np.array([[0.0], [gain]])


@pytest.mark.parametrize('name, values, plant, Q, R', [
    *(('example-2.4-gain', {'q': q}, chain(), np.diag([q**2, 0]), 1.0) for q in (0.3, 1.0, 4.0)),
    ('2.7-gain', {}, chain(), np.diag([1.0, 0.0]), 1 / 16),
    *(('2.8-b-gain', {'a': a, 'b': 1.0}, chain(drag=a), np.diag([1.0, 0.0]), 1.0)
      for a in (0.5, 3.0)),
    ('2.10-gain', {}, chain(10.0, 5.0), np.diag([1.0, 0.0]), 1.0)], ids=str)
def test_a_gain_solves_the_riccati_equation(name, values, plant, Q, R):
    A, B = plant
    P = solve_continuous_are(A, B, Q, [[R]])
    K = B.T @ P / R
    assert evaluate(name, **values) == pytest.approx(K, abs=1e-9)
    poles = np.sort_complex(np.linalg.eigvals(A - B @ K))[::-1]
    frequency, damping = abs(poles[0]), -poles[0].real / abs(poles[0])
    if name.startswith('example'):
        assert evaluate('example-2.4-frequency', **values) == pytest.approx(frequency)
        assert evaluate('example-2.4-damping') == pytest.approx(damping)
    if name.startswith('2.7'):
        assert evaluate('2.7-poles') == pytest.approx(np.c_[poles.real, poles.imag])
    if name.startswith('2.8') and poles[0].imag:
        assert evaluate('2.8-c-frequency', **values) == pytest.approx(frequency)
        assert evaluate('2.8-c-damping', **values) == pytest.approx(damping)


@pytest.mark.parametrize('a, q, r', [(0.7, 1.3, 0.4), (-1.5, 0.3, 2.0)])
def test_the_scalar_filter_solves_the_riccati_equation_of_the_dual(a, q, r):
    P = solve_continuous_are([[a]], [[1.0]], [[q]], [[r]]).item()
    for name, wanted in (('variance', P), ('gain', P / r), ('pole', a - P / r)):
        found = evaluate(f'estimation-1-{name}', a=a, q=q, r=r).item()
        assert found == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize('w', [0.4, 2.0])
def test_the_filter_of_the_double_integrator_solves_the_riccati_equation_of_the_dual(w):
    A, C = chain()[0], np.array([[1.0, 0.0]])
    P = solve_continuous_are(A.T, C.T, np.diag([0.0, w**4]), [[1.0]])
    assert evaluate('estimation-2-gain', w=w) == pytest.approx(C @ P, abs=1e-9)
    pole = np.linalg.eigvals(A - P @ C.T @ C)[0]
    assert evaluate('estimation-2-damping').item() == pytest.approx(-pole.real / abs(pole))


@pytest.mark.parametrize('q, s', [(1.0, 3.0), (100.0, 10.0)])
def test_the_margin_of_doyle_is_where_a_pole_vanishes(q, s):
    A, ones = np.array([[1.0, 1.0], [0.0, 1.0]]), np.ones((2, 2))
    B, C = np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    K = B.T @ solve_continuous_are(A, B, q * ones, [[1.0]])
    L = solve_continuous_are(A.T, C.T, s * ones, [[1.0]]) @ C.T
    f, d = (evaluate('estimation-3-gain', q=each).item() for each in (q, s))
    assert pytest.approx(f * np.ones((1, 2)), rel=1e-9) == K
    assert pytest.approx(d * np.ones((2, 1)), rel=1e-9) == L
    m = evaluate('estimation-3-margin', d=d, f=f).item()
    loop = np.block([[A, -m * B @ K], [L @ C, A - B @ K - L @ C]])
    assert abs(np.linalg.eigvals(loop)).min() < 1e-6


@pytest.mark.parametrize('a, b', [(0.7, 1.3), (2.0, 0.5)])
def test_the_gain_of_exercise_2_9_moves_the_pole_to_its_mirror_image(a, b):
    P, k = (evaluate(f'2.9-a-{name}', a=a, b=b).item() for name in ('riccati', 'gain'))
    assert 2 * a * P == pytest.approx(b**2 * P**2)
    assert k == pytest.approx(b * P)
    assert a - b * k == pytest.approx(-a)


@pytest.mark.parametrize('values', [
    {'a': 0.6, 'b': 1.7, 'c': 0.9, 'x0': 1.4, 'T': 1.2},
    {'a': 2.0, 'b': 0.5, 'c': 2.0, 'x0': 1.0, 'T': 2.0}], ids=str)
def test_exercise_2_4_solves_its_boundary_value_problem(values):
    a, b, c, x0, T = values.values()
    found = solve_bvp(lambda t, y: [-a * y[0] - b**2 * y[1], a * y[1]],
                      lambda start, end: [start[0] - x0, end[1] - c * end[0]],
                      np.linspace(0, T, 50), np.ones((2, 50)), tol=1e-9, max_nodes=20_000)
    assert found.success
    assert evaluate('2.4-a-end', **values).item() == pytest.approx(found.sol(T)[0], abs=1e-8)
    for t in (0.0, 0.3, T):
        lam = found.sol(t)[1]
        assert evaluate('2.4-a-costate', **values, t=t).item() == pytest.approx(lam, abs=1e-8)
        assert evaluate('2.4-a-input', **values, t=t).item() == pytest.approx(-b * lam, abs=1e-8)


def test_the_extremal_of_exercise_2_4_is_certified():
    t = np.linspace(0, 1, 2001)
    x, u, lam = find_extremal(t)
    cost = quad(lambda s: find_extremal(np.array([0.0, s]))[1][1, 0]**2 / 2, 0, 1)[0] + END**2 / 2
    assert obc.certify(STATEMENT, t=t, x=x, u=u, lam=lam, objective=cost).holds
    assert ASKED['2.4-a-problem'].cost == pytest.approx(cost)


def test_the_end_of_exercise_2_9_solves_its_boundary_value_problem():
    a, b, c = 2.0, 0.5, 10.0
    found = solve_bvp(lambda t, y: [a * y[0] - b**2 * y[1], -a * y[1]],
                      lambda start, end: [start[0] - 4.0, end[1] - c * end[0]],
                      np.linspace(0, 1, 50), np.ones((2, 50)), tol=1e-9, max_nodes=20_000)
    assert evaluate('2.9-b-end').item() == pytest.approx(found.sol(1.0)[0], abs=1e-8)


def test_the_flat_trajectories_reach_the_end():
    values = {'a': 0.8, 'b': 1.6, 'x0': 0.4, 'xf': 1.9, 'T': 1.3}
    for name, power in (('2.4-c-input', 1), ('2.5-c-input', 3)):
        for t in (0.0, 0.5, 1.3):
            x = 0.4 + 1.5 * t / 1.3
            u = evaluate(name, **values, t=t).item()
            assert -0.8 * x**power + 1.6 * u == pytest.approx(1.5 / 1.3)


@pytest.mark.parametrize('values', [
    {'a': 0.6, 'b': 1.7, 'c': 0.9, 'x0': 1.4, 'T': 1.2},
    {'a': 1.5, 'b': 0.5, 'c': 2.0, 'x0': 1.0, 'T': 1.0}], ids=str)
def test_example_2_2_solves_its_boundary_value_problem(values):
    a, b, c, x0, T = values.values()
    x, u, lam = solve_example_2_2(a, b, x0, T, lambda end, costate: costate - c * end)
    assert evaluate('example-2.2-end', **values).item() == pytest.approx(x(T), abs=1e-8)
    for t in (0.0, 0.3, T):
        assert evaluate('example-2.2-costate', **values, t=t).item() == pytest.approx(
            lam(t), abs=1e-8)
        assert evaluate('example-2.2-input', **values, t=t).item() == pytest.approx(
            u(t), abs=1e-8)
    x, u, _ = solve_example_2_2(a, b, x0, T, lambda end, costate: end)
    del values['c']
    assert evaluate('example-2.2-limit').item() == pytest.approx(x(T), abs=1e-8)
    for t in (0.0, 0.3, T):
        assert evaluate('example-2.2-limit-input', **values, t=t).item() == pytest.approx(
            u(t), abs=1e-8)


def solve_example_2_2(a, b, x0, T, end):
    """Return x, u and lambda as functions, with a condition on x(T) and lambda(T)."""
    found = solve_bvp(lambda t, y: [a * y[0] - b**2 * y[1], -a * y[1]],
                      lambda start, at: [start[0] - x0, end(*at)],
                      np.linspace(0, T, 50), np.ones((2, 50)), tol=1e-9, max_nodes=20_000)
    assert found.success
    return (lambda t: found.sol(t)[0]), (lambda t: -b * found.sol(t)[1]), (
        lambda t: found.sol(t)[1])


def test_the_aircraft_of_example_2_5_hovers_with_its_gain():
    x, u = np.zeros(6), evaluate('example-2.5-equilibrium', m=MASS, g=9.8)[0]
    assert np.abs(fly(x, u)).max() < 1e-12
    A, B = differentiate(lambda at: fly(at, u), x), differentiate(lambda at: fly(x, at), u)
    Qx, Qu = np.diag([100, 1, 2 * pi / 9, 0, 0, 0]), 0.1 * np.eye(2)
    K = np.linalg.solve(Qu, B.T @ solve_continuous_are(A, B, Qx, Qu))
    assert evaluate('example-2.5-gain').item() == pytest.approx(K[1, 1], rel=1e-6)


MASS = 4.0


def fly(x, u):
    """Return x' of (x, y, theta, vx, vy, omega): Feedback Systems, Example 2.9."""
    s, c = np.sin(x[2]), np.cos(x[2])
    return np.array([x[3], x[4], x[5], (u[0] * c - u[1] * s - 0.05 * x[3]) / MASS,
                     (u[0] * s + u[1] * c - 0.05 * x[4]) / MASS - 9.8, 0.25 * u[0] / 0.0475])


def differentiate(f, at):
    steps = 1e-4 * np.eye(at.size)
    return np.column_stack([(f(at + step) - f(at - step)) / 2e-4 for step in steps])


def test_the_weights_of_example_2_5_make_errors_equally_bad():
    weight = evaluate('example-2.5-weight').item()
    assert weight * np.radians(5.0)**2 == pytest.approx(100 * 0.01**2) == pytest.approx(0.1**2)


def test_the_formulas_of_example_2_6_are_derivatives_of_the_hamiltonian():
    names = ('lam1', 'lam2', 'lam3', 'x2', 'u1', 'u2')
    at = dict(zip(names, (0.4, -0.7, 1.3, 0.8, -0.6, 0.9), strict=True))

    def slope(name):
        values = [evaluate_hamiltonian(**at | {name: at[name] + step}) for step in (0.5, -0.5)]
        return values[0] - values[1]   # exact: H is linear in each

    assert evaluate('example-2.6-costate', **at).item() == pytest.approx(-slope('x2'))
    assert evaluate('example-2.6-switching', **at).item() == pytest.approx(slope('u1'))


def evaluate_hamiltonian(lam1, lam2, lam3, x2, u1, u2, lam0=1.0):
    return lam0 + lam1 * u1 + lam2 * u2 + lam3 * x2 * u1


def test_the_line_of_example_2_6_is_certified_and_singular_in_one_input():
    rho = 1.7
    T = evaluate('example-2.6-time', rho=rho).item()
    line = {'lam1': -1.0, 'lam2': 0.0, 'lam3': 0.0}
    assert evaluate('example-2.6-line').tolist() == [list(line.values())]
    t = np.linspace(0, T, 201)
    zero = 0 * t
    found = obc.certify(
        {'system': 'nonholonomic_integrator', 'running_cost': '1',
         'initial_state': {'x1': 0, 'x2': 0, 'x3': 0},
         'terminal_constraints': [f'x1 - {rho}', 'x2', 'x3'],
         'final_time': {'free': True, 'lower': 0.1, 'upper': 10}},
        t=t, x=np.column_stack([t, zero, zero]), u=np.column_stack([zero + 1, zero]),
        lam=np.tile([-1.0, 0.0, 0.0], (201, 1)), objective=T)
    assert found.holds
    H = {(u1, u2): evaluate_hamiltonian(**line, x2=0.0, u1=u1, u2=u2)
         for u1 in (-1, 1) for u2 in (-1, 1)}
    assert H[1, -1] == H[1, 1] == min(H.values()) < max(H.values())
    assert evaluate('example-2.6-singular').item() == 2
    lam0 = evaluate('example-2.6-multiplier').item()
    assert evaluate_hamiltonian(**line, x2=0.0, u1=1.0, u2=0.0, lam0=lam0) == 0.0


def test_the_loop_of_exercise_2_10_has_the_step_and_the_margins():
    A, B = chain(10.0, 5.0)
    K = evaluate('2.10-gain')
    t = np.linspace(0, 1.5, 20_001)
    closed = StateSpace(A - B @ K, B @ K @ [[1.0], [0.0]], [[1.0, 0.0]], [[0.0]])
    y = step(closed, T=t)[1]
    assert evaluate('2.10-overshoot').item() == pytest.approx(y.max() - 1, abs=1e-6)
    rise = np.diff(np.interp([0.1, 0.9], y[:np.argmax(y)], t[:np.argmax(y)])).item()
    assert evaluate('2.10-rise').item() == pytest.approx(rise, abs=1e-6)
    w = evaluate('2.10-bandwidth').item()
    T = K[0, 0] * np.linalg.solve(1j * w * np.eye(2) - A + B @ K, B)[0, 0]
    assert abs(T) == pytest.approx(1 / sqrt(2))
    w = evaluate('2.10-crossover').item()
    L = (K @ np.linalg.solve(1j * w * np.eye(2) - A, B)).item()
    assert abs(L) == pytest.approx(1.0)
    assert evaluate('2.10-margin').item() == pytest.approx(np.angle(-L))


def test_the_feedforward_of_exercise_2_10_drives_along_the_slalom():
    def drive(t, x):
        w = 2 * pi
        phi = evaluate('2.10-b-steering', dr=w * np.cos(w * t), ddr=-w**2 * np.sin(w * t)).item()
        return [10 * np.sin(x[1]), 5 * np.tan(phi)]

    start = evaluate('2.10-b-heading', dr=2 * pi).item()
    found = solve_ivp(drive, (0, 1), [0.0, start], rtol=1e-8, atol=1e-8, dense_output=True)
    t = np.linspace(0, 1, 11)
    assert found.sol(t)[0] == pytest.approx(np.sin(2 * pi * t), abs=1e-6)
    headings = [evaluate('2.10-b-heading', dr=2 * pi * np.cos(2 * pi * each)).item() for each in t]
    assert found.sol(t)[1] == pytest.approx(headings, abs=1e-6)


def test_the_multiplier_of_an_inequality_is_the_slope_of_the_minimum():
    a, b = 2.5, -0.4

    def find_minimum(p):
        return minimize(lambda x: (x[0] - a)**2 + (x[1] - b)**2, [0.0, 0.0], method='SLSQP',
                        constraints={'type': 'ineq', 'fun': lambda x: p - x[0] + x[1]}, tol=1e-12)

    slope = (find_minimum(0.501).fun - find_minimum(0.499).fun) / 0.002
    assert evaluate('example-2.1-inequality', a=a, b=b, p=0.5).item() == pytest.approx(-slope)


def test_the_linear_feedback_of_theorem_2_2_is_the_best():
    plant = {'a': 0.5, 'b': 1.3, 'q': 2.0, 'r': 0.7}

    def find_cost(k):
        rate = plant['a'] - plant['b'] * k
        return quad(lambda t: (plant['q'] + plant['r'] * k**2) * (1.5 * exp(rate * t))**2, 0,
                    30 / -rate)[0]

    for k in (0.8, 2.0):
        assert evaluate('theorem-2.2-cost', **plant, k=k, x0=1.5).item() == pytest.approx(
            find_cost(k))
    best = minimize_scalar(find_cost, (0.6, 1.5, 4.0), method='brent', tol=1e-10).x
    assert evaluate('theorem-2.2-gain', **plant).item() == pytest.approx(best, rel=1e-6)


def test_the_tracking_law_follows_a_trajectory_at_the_least_cost():
    plant = {'a': 0.5, 'b': 1.3, 'q': 2.0, 'r': 0.7}
    P = solve_continuous_are([[0.5]], [[1.3]], [[2.0]], [[0.7]]).item()

    def follow(t, z):   # xd = sin t, and the cost of the deviations
        xd, ud = np.sin(t), (np.cos(t) - 0.5 * np.sin(t)) / 1.3
        u = evaluate('section-2.2-tracking', **plant, x=z[0], xd=xd, ud=ud).item()
        return [0.5 * z[0] + 1.3 * u, 2.0 * (z[0] - xd)**2 + 0.7 * (u - ud)**2]

    found = solve_ivp(follow, (0, 8), [0.8, 0.0], rtol=1e-6, atol=1e-9)
    assert found.y[0, -1] == pytest.approx(np.sin(8), abs=1e-5)
    assert found.y[1, -1] == pytest.approx(P * 0.8**2, rel=1e-4)
    ud = evaluate('section-2.2-input', a=0.5, b=1.3, xd=0.9).item()
    assert 0.5 * 0.9 + 1.3 * ud == pytest.approx(0.0)


def test_the_costs_of_exercise_2_4_d():
    flat = quad(lambda t: (1 + t)**2 / 2, 0, 1)[0]
    gramian = quad(lambda t: exp(-2 * (1 - t)), 0, 1)[0]
    assert evaluate('2.4-d-cost').item() == pytest.approx(flat)
    assert evaluate('2.4-d-optimum').item() == pytest.approx(1 / (2 * gramian))


def test_the_loop_of_exercise_2_2_encloses_the_area():
    speed = evaluate('2.2-speed').item()

    def turn(t):   # of q1 u2 - q2 u1 on the circle through 0
        q = speed / (2 * pi) * np.array([np.sin(2 * pi * t), 1 - np.cos(2 * pi * t)])
        u = speed * np.array([np.cos(2 * pi * t), np.sin(2 * pi * t)])
        return q[0] * u[1] - q[1] * u[0]

    assert abs(quad(turn, 0, 1)[0]) == pytest.approx(sqrt(1 + 4 + 4))
    assert evaluate('2.2-cost').item() == pytest.approx(speed**2 / 2)
