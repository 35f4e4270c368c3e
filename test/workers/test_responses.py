# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Responses to requests, with and without the answer of a worker."""

import numpy as np
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
