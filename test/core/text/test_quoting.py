# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Quotations of user input in messages: on one line and without control characters."""

from collections.abc import Callable
from typing import Any
import unicodedata

from hypothesis import given
from hypothesis import strategies as st
from obc_ros.core.lqr import weights
from obc_ros.core.ocp import statement
from obc_ros.core.solver import solve
from obc_ros.core.systems import registry
from obc_ros.core.tasks import minimize
from obc_ros.core.text.errors import JoinedStatementError, ObcError, quote
from obc_ros.core.text.expressions import parse_expression, parse_number
from obc_ros.core.text.yaml_files import read_entries
import pytest

GOOD: dict[str, Any] = {
    'name': 'good', 'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'},
    'running_cost': 'u**2', 'initial_state': {'x': 1}, 'final_time': {'free': False, 'value': 1}}
# Escape sequences of 7 and 8 bits, a bell, line ends, reversed text, a lone surrogate.
SIGNS = ['\x1b[2J', '\x9b31m', '\x07', '\n', '\r', '\t', '\u2028', '\u202e', '\x7f', '\ud800',
         'x', ' ', "'", '+', '1', 'ü']
TEXTS = st.text(max_size=5) | st.lists(
    st.sampled_from(SIGNS), min_size=1, max_size=90).map(''.join)


def find_control_characters(text: str) -> list[str]:
    """Return the characters other than letters, digits, marks, symbols and plain spaces."""
    return [each for each in text if unicodedata.category(each) in (
        'Cc', 'Cf', 'Cs', 'Co', 'Cn', 'Zl', 'Zp')]


def problem(**changes: Any) -> Callable[[], Any]:
    return lambda: statement.build_problem({**GOOD, **changes})


def build_requests(text: str) -> list[Callable[[], Any]]:
    """Return requests that contain a text in each possible place."""
    one, pair = {text: 1}, {text: [0, 1]}
    return [
        problem(**one), problem(states=[text]), problem(inputs=[text]), problem(system=text),
        problem(dynamics={text: 'u'}), problem(dynamics={'x': text}), problem(parameters=one),
        problem(parameters={'p': text}), problem(running_cost=text), problem(terminal_cost=text),
        problem(initial_state=one), problem(initial_state={'x': text}), problem(input_bounds=pair),
        problem(state_bounds=pair), problem(terminal_constraints=[text]), problem(name=text),
        problem(path_constraints=[{'expr': text, text: 1}]), problem(final_time=one),
        problem(initial_guess=one), problem(initial_guess={'states': one}),
        lambda: parse_number(text, {}, text), lambda: parse_expression(text, {}, text),
        lambda: minimize.minimize({'variables': ['x'], 'cost': text, 'bounds': pair}),
        lambda: minimize.minimize({'variables': [text], 'cost': '1'}),
        lambda: registry.find_registered(text, {}),
        lambda: registry.find_registered('aircraft', one),
        lambda: registry.get_system(text),
        lambda: solve.solve(statement.build_problem(GOOD), method=text),
        lambda: weights.square('Qx', [text], 1), lambda: list(read_entries(text))]


@given(TEXTS, st.none() | st.integers(4, 80))
def test_quotations_contain_no_control_characters(text: str, longest: int | None) -> None:
    assert not find_control_characters(quote(text, longest))
    assert quote(quote(text, None), None) == quote(text, None)
    if text.isascii() and text.isprintable():
        assert quote(text, None) == text


@pytest.mark.slow
@given(TEXTS)
def test_error_messages_contain_no_control_characters(text: str) -> None:
    """Check every request, wherever it contains the text."""
    assert not find_control_characters(str(ObcError(text)))
    rejected = 0
    for question in build_requests(text):
        try:
            question()
        except ObcError as error:
            rejected += 1
            assert str(error)
            # Several errors of a statement are lines; the text adds none to them.
            lines = error.args if isinstance(error, JoinedStatementError) else [error]
            assert str(error).count('\n') == len(lines) - 1
            assert not any(find_control_characters(each) for each in str(error).split('\n'))
    assert rejected
