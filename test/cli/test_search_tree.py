# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The tree that ``obc solve --trace`` prints, and the figure of the costs of a search."""

from dataclasses import dataclass, field
import math

from obc_ros.cli import figures
from obc_ros.cli.ask.problem_requests import Question
from obc_ros.cli.ask.search_tree import format_tree, HEADER
from obc_ros.msg import Attempt, Optimality, Trajectory
import pytest


def attempt(number, parent, method, what='', **fields):
    """Return the message of an attempt."""
    return Attempt(number=number, parent=parent, method=method, what=what, **{
        'cost': math.nan, 'loss': math.nan, 'verdict': 'converged', **fields})


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


@dataclass
class Result:
    """The fields of a result that the figure needs."""

    attempts: list = field(default_factory=lambda: SEARCH)
    objective: float = 4.5
    optimality: Optimality = field(default_factory=lambda: Optimality(minima=[4.5, 4.9]))
    trajectory: Trajectory = field(default_factory=Trajectory)


def test_branches_and_columns_are_aligned():
    lines = format_tree(SEARCH)
    assert lines[0].split() == list(HEADER)
    assert [line[:12] for line in lines[1:]] == [
        'coarse mesh ', ' └─ initial ', 'descent     ', ' └─ mesh: 40', '    ├─ collo',
        '    └─ collo']
    end = lines[0].index('result')
    assert [line[end:] for line in lines[1:]] == [
        'accepted', 'converged', 'certified', 'rejected: a reason', 'converged', 'converged']
    assert lines[4].split()[-6:-3] == ['4.5', '1e-03', '12']


def test_a_collocation_alone_in_an_attempt_is_not_printed():
    shown = '\n'.join(format_tree(SEARCH))
    assert '16 intervals' not in shown
    assert 'collocation: one' in shown
    assert 'collocation: two' in shown


def test_a_number_that_is_not_known_is_left_blank():
    assert 'nan' not in '\n'.join(format_tree(SEARCH))


@pytest.mark.parametrize('attempts, expected', [(SEARCH, True), (SEARCH[:3], False), ([], False)])
def test_a_search_has_at_least_two_costs(attempts, expected):
    assert figures.has_search(Result(attempts)) is expected


def test_the_figure_shows_costs_and_minima(tmp_path):
    question = Question('a name', '', 'a_name', result=Result())
    figures.draw_search(tmp_path / 'search.png', question)
    assert (tmp_path / 'search.png').read_bytes().startswith(b'\x89PNG')
