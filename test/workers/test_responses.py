# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Responses to requests, with and without the answer of a worker."""

import numpy as np
from obc_ros.core.ocp.solution import Attempt, Verdict
from obc_ros.core.solver.solve import solve
from obc_ros.workers import solving
from obc_ros.workers.pool import RequestAnswer, RequestOutcome
from obc_ros.workers.responses import compute_affinity, respond
from obc_ros.workers.wire import Packet
import pytest

STATEMENT = {
    'states': ['x', 'v'], 'inputs': ['u', 'w'], 'parameters': {'a': 0.1, 'b': 'a/3', 'c': 1e-17},
    'dynamics': {'x': 'v', 'v': 'u - a*v + b*w'}, 'running_cost': 'u**2 + w**2',
    'initial_state': {'x': 'b', 'v': -0.3}, 'terminal_constraints': ['x - 1', 'v'],
    'state_bounds': {'v': [-3, None]},
    'path_constraints': [{'expr': 'x + u', 'lower': None, 'upper': 5}]}


def test_affinity_depends_on_the_structure_not_on_the_numbers():
    def affinity(**changes):
        return compute_affinity(Packet({'statement': {**STATEMENT, **changes}}))
    same = affinity()
    assert affinity(parameters={'a': 0.2, 'b': 3, 'c': -1}, terminal_constraints=['x - 21.5', 'v'],
                    initial_state={'x': 7, 'v': 8}) == same
    assert affinity(running_cost='u**2 + v**2') != same
    assert affinity(state_bounds={}) != same


def test_the_answer_of_a_worker_is_the_response():
    packet = Packet({'status': 'solved', 'message': 'words'}, {'t': np.arange(3.0)})
    assert respond(RequestAnswer(RequestOutcome.ANSWERED, '', packet)) is packet


@pytest.mark.parametrize(('outcome', 'status'), [
    (RequestOutcome.TIMED_OUT, 'timed_out'), (RequestOutcome.CANCELLED, 'cancelled'),
    (RequestOutcome.REFUSED, 'cancelled'), (RequestOutcome.DIED, 'not_converged')])
def test_without_an_answer_the_response_has_the_reason_and_the_best_path(outcome, status):
    bare = respond(RequestAnswer(outcome, 'the reason'))
    assert bare == Packet({'status': status, 'message': 'the reason'})
    path = Packet({'status': 'not_converged', 'message': 'cost 2'}, {'t': np.arange(3.0)})
    kept = respond(RequestAnswer(outcome, 'the reason', path))
    assert kept.plain == {'status': status,
                          'message': 'the reason; the best path so far: cost 2'}
    assert kept.arrays is path.arrays


@pytest.mark.parametrize(('outcome', 'status'), [
    (RequestOutcome.TIMED_OUT, 'feasible'), (RequestOutcome.DIED, 'feasible'),
    (RequestOutcome.CANCELLED, 'cancelled')])
def test_a_path_that_is_accepted_is_the_answer_when_the_time_is_up(outcome, status):
    path = Packet({'status': 'feasible', 'message': 'cost 2'}, {'t': np.arange(3.0)})
    assert respond(RequestAnswer(outcome, 'the reason', path)).plain['status'] == status


def test_what_was_tried_is_kept_in_the_words_of_the_statement(monkeypatch):
    """Only the names of a joined problem tell phases apart: a lost worker leaves no such name."""
    statement = {
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'u**2',
        'initial_state': {'x': 0}, 'phases': [{'duration': 1, 'name': 'climb'}, {
            'duration': 1, 'terminal_constraints': ['x - 1']}]}
    tried = Attempt(1, 0, 'descent', 'arc of x__1', 0, 1, 1.0, 0.0, Verdict.REJECTED,
                    'terminal_constraints[0] is violated: u__2(0) at t = 0.5')

    def solve_and_note(problem, *, note, **others):
        note((tried,))
        return solve(problem, **others)

    kept = []
    monkeypatch.setattr(solving, 'solve', solve_and_note)
    solving.solve_statement(
        Packet({'statement': statement, 'method': '', 'cache_size': 1}), 10.0,
        lambda *progress: False, kept.append)
    [found] = kept[0].plain['attempts']
    assert found['what'] == 'arc of x of phase climb'
    assert found['why'] == ('phases[1].terminal_constraints[0] is violated: u of phase 2 at its '
                            'start at 0.5 of each phase')
