# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The tree that ``obc solve --trace`` prints, and the figure of the costs of a search."""

import math

from obc_ros.api.figures.path import draw_search
from obc_ros.api.search_tree import SearchTree, TREE_HEADER
from obc_ros.core.ocp.solution import Attempt, Optimality, Solution, Status, Verdict
import pytest


def attempt(number, parent, method, what='', *, verdict='converged', **fields):
    """Return an attempt."""
    return Attempt(number, parent, method, what, verdict=Verdict(verdict), **{
        'cost': math.nan, 'loss': math.nan, 'work': 0, 'begun': 0, 'why': '', **fields})


SEARCH = [
    attempt(1, 0, 'coarse mesh', cost=5.0, work=30, verdict='accepted'),
    attempt(2, 1, 'initial guess', 'straight line', cost=5.0, work=30),
    attempt(3, 2, 'collocation', '16 intervals', cost=5.0, work=30),
    attempt(4, 0, 'descent', cost=4.5, work=20, begun=30, verdict='certified'),
    attempt(5, 4, 'mesh', '40 intervals', cost=4.5, loss=1e-3, work=12, begun=30,
            verdict='rejected', why='a reason'),
    attempt(6, 5, 'collocation', 'one', work=6, begun=30),
    attempt(7, 5, 'collocation', 'two', work=6, begun=36),
]


TREE = SearchTree(SEARCH)


def test_branches_and_columns_are_aligned():
    lines = str(TREE).splitlines()
    assert lines[0].split() == list(TREE_HEADER)
    assert [line[:12] for line in lines[1:]] == [
        'coarse mesh ', ' └─ initial ', 'descent     ', ' └─ mesh: 40', '    ├─ collo',
        '    └─ collo']
    end = lines[0].index('result')
    assert [line[end:] for line in lines[1:]] == [
        'accepted', 'converged', 'certified', 'rejected: a reason', 'converged', 'converged']
    assert lines[4].split()[-6:-3] == ['4.5', '1e-03', '12']


def test_a_collocation_alone_in_an_attempt_is_not_printed():
    shown = str(TREE)
    assert '16 intervals' not in shown
    assert 'collocation: one' in shown
    assert 'collocation: two' in shown


def test_a_number_that_is_not_known_is_left_blank():
    assert 'nan' not in str(TREE)


def test_a_line_is_cut_at_a_width_and_its_control_characters_are_escaped():
    tree = SearchTree([attempt(1, 0, 'mesh', 'a\x1b[31m\nb', verdict='rejected')])
    assert {len(line) for line in TREE.format(30).splitlines()} <= set(range(31))
    assert len(str(tree).splitlines()) == 2
    assert '\x1b' not in str(tree)


def test_a_tree_without_attempts_is_a_sentence():
    assert str(SearchTree()) == 'nothing: the request was answered without a search'
    assert repr(TREE) == '<SearchTree: 7 attempts; print() shows the tree>'


@pytest.mark.parametrize('attempts, costs', [(SEARCH, 2), (SEARCH[:3], 1), ([], 0)])
def test_a_search_has_as_many_costs_as_it_found(attempts, costs):
    """The attempt that was rejected has no cost of its own."""
    assert SearchTree(attempts).costs == costs


def test_the_figure_shows_costs_and_minima(tmp_path):
    figure = draw_search(Solution(
        Status.SOLVED, '', 4.5, optimality=Optimality('local', '', 1, (4.5, 4.9)),
        attempts=tuple(SEARCH)), 'a name')
    [axes] = figure.axes
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        'initial guess, coarse mesh', 'finer mesh', 'certified', 'local minima']
    figure.savefig(tmp_path / 'search.png')
    assert (tmp_path / 'search.png').read_bytes().startswith(b'\x89PNG')
