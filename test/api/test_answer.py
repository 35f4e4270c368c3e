# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The answer of the public interface: columns by name, JSON, text and HTML."""

import dataclasses
from html.parser import HTMLParser
import json
import math
import sys

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from obc_ros.api.answer import Answer
from obc_ros.core.ocp.solution import (
    Attempt,
    Certificate,
    Condition,
    Optimality,
    Solution,
    Status,
    Verdict,
)
from obc_ros.core.text.errors import ObcError
import pytest

T = np.array([0.0, 1.0, 2.0])
CERTIFICATE = Certificate({Condition.DYNAMICS: 1e-9, Condition.COST: math.inf},
                          {Condition.DYNAMICS: 1e-6, Condition.COST: 1e-6}, 0.25)
SOLUTION = Solution(
    Status.SOLVED, 'solved', 2.0, T, np.column_stack([T, 1 - T]), T[:, None] + 0.5,
    np.column_stack([T + 3, 4 * T]), 0 * T, certificate=CERTIFICATE, method='time_optimal',
    switching_times=np.array([1.0]), iterations=3, build_time=0.25, solve_time=0.5,
    first_path_time=0.125,
    optimality=Optimality('local', 'a search', 2, (2.0, 2.5)),
    attempts=(Attempt(1, 0, 'mesh', '', 0, 5, math.nan, 0.1, Verdict.REJECTED, 'a reason'),))
ANSWER = Answer('least time', ('p', 'v'), ('u',), SOLUTION)
NOTHING = Answer('least time', (), (), Solution(Status.MALFORMED, 'states: missing'))
HOSTILE = '<script>alert("1")</script>&\x1b[31m'
any_float = st.floats(allow_nan=True, allow_infinity=True)


class Seen(HTMLParser):
    """The tags and the text of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text = [], ''
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)

    def handle_data(self, data):
        self.text += data


@pytest.mark.slow
def test_a_table_of_pandas_has_a_row_for_each_time():
    table = ANSWER.to_dataframe()
    assert table.index.name == 't'
    np.testing.assert_array_equal(table.index, T)
    assert list(table.columns) == [
        ('x', 'p'), ('x', 'v'), ('u', 'u'), ('costates', 'p'), ('costates', 'v')]
    np.testing.assert_array_equal(table['costates', 'v'], 4 * T)


def test_without_pandas_a_table_is_refused_in_words(monkeypatch):
    monkeypatch.setitem(sys.modules, 'pandas', None)
    with pytest.raises(ObcError, match='needs pandas, which is not installed: pip install'):
        ANSWER.to_dataframe()


def test_columns_have_the_names_of_states_and_inputs():
    assert list(ANSWER.x) == list(ANSWER.costates) == ['p', 'v']
    np.testing.assert_array_equal(ANSWER.x['v'], 1 - T)
    np.testing.assert_array_equal(ANSWER.costates['v'], 4 * T)
    np.testing.assert_array_equal(ANSWER.u['u'], T + 0.5)
    assert (ANSWER.status, ANSWER.objective, ANSWER.has_path) == ('solved', 2.0, True)


def test_the_certificate_prints_as_a_table():
    assert str(ANSWER.certificate).splitlines() == [
        'condition  residual  tolerance  verdict',
        '---------  --------  ---------  -------------',
        'dynamics   1e-09     1e-06      holds',
        'cost       inf       1e-06      does not hold']


def test_the_json_has_the_documented_entries():
    assert ANSWER.as_json() == {
        'name': 'least time', 'status': 'solved', 'message': 'solved', 'remark': '',
        'objective': 2.0, 't': [0.0, 1.0, 2.0], 'x': {'p': [0.0, 1.0, 2.0], 'v': [1.0, 0.0, -1.0]},
        'u': {'u': [0.5, 1.5, 2.5]}, 'lam': {'p': [3.0, 4.0, 5.0], 'v': [0.0, 4.0, 8.0]},
        'free_parameters': {}, 'interpolation': 'linear', 'switching_times': [1.0],
        'certificate': {'holds': False, 'excess': 0.25,
                        'residuals': {'dynamics': 1e-9, 'cost': None},
                        'tolerances': {'dynamics': 1e-6, 'cost': 1e-6}},
        'optimality': {'kind': 'local', 'reason': 'a search', 'starts': 2, 'minima': [2.0, 2.5]},
        'attempts': [{'number': 1, 'parent': 0, 'method': 'mesh', 'what': '', 'begun': 0,
                      'work': 5, 'cost': None, 'loss': 0.1, 'verdict': 'rejected',
                      'why': 'a reason'}],
        'solve_time': 0.5, 'build_time': 0.25, 'first_path_time': 0.125, 'iterations': 3}


def test_the_json_without_a_path_is_empty():
    assert NOTHING.as_json() == {
        'name': 'least time', 'status': 'malformed', 'message': 'states: missing',
        'remark': '', 'objective': None, 't': [], 'x': {}, 'u': {}, 'lam': {},
        'free_parameters': {}, 'interpolation': 'linear',
        'switching_times': [],
        'certificate': {'holds': False, 'excess': None, 'residuals': {}, 'tolerances': {}},
        'optimality': {'kind': '', 'reason': '', 'starts': 0, 'minima': []}, 'attempts': [],
        'solve_time': None, 'build_time': None, 'first_path_time': None, 'iterations': 0}


@given(st.lists(st.tuples(any_float, any_float, any_float), min_size=1, max_size=5), any_float,
       st.text())
def test_the_json_of_any_numbers_is_json(rows, objective, message):
    x = np.array(rows)
    answer = dataclasses.replace(ANSWER, solution=dataclasses.replace(
        SOLUTION, message=message, objective=objective, t=x[:, 0], x=x[:, :2], u=x[:, 2:],
        lam=x[:, 1:]))
    text = json.dumps(answer.as_json(), allow_nan=False)
    back = json.loads(text)
    assert back == answer.as_json()
    for column, values in zip(('p', 'v'), x.T[:2], strict=True):
        assert back['x'][column] == [v if math.isfinite(v) else None for v in values.tolist()]


def test_the_texts_are_short():
    assert repr(ANSWER) == '<Answer least time: solved, J = 2: solved>'
    assert repr(NOTHING) == '<Answer least time: malformed: states: missing>'
    assert str(ANSWER.trace).splitlines()[1].split() == ['mesh', '1e-01', '5', 'rejected:', 'a',
                                                         'reason']


@pytest.mark.parametrize('answer', [ANSWER, NOTHING], ids=['path', 'none'])
def test_the_html_is_a_table_and_escapes_what_a_user_wrote(answer):
    certificate = Certificate({HOSTILE: 1.0}, {HOSTILE: 2.0})
    hostile = dataclasses.replace(
        answer, name=HOSTILE, solution=dataclasses.replace(
            answer.solution, message=HOSTILE, certificate=certificate))
    plain, seen = Seen(answer._repr_html_()), Seen(hostile._repr_html_())
    assert plain.tags[0] == 'table'
    assert set(seen.tags) <= {'table', 'caption', 'thead', 'tbody', 'tr', 'th', 'td'}
    assert seen.text.count('<script>alert("1")</script>&') == 3
    assert '\x1b' not in seen.text + repr(hostile) + str(certificate)


@pytest.mark.parametrize('answer, words', [
    (NOTHING, 'there is no path: states: missing'), (ANSWER, 'does not have its problem')])
def test_a_figure_without_a_path_or_a_problem_is_refused_in_words(answer, words):
    with pytest.raises(ObcError, match=words):
        answer.plot()
