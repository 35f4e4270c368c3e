# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What surrounds the work of a worker: which one gets a request, and what is answered without."""

import json
import re

from obc_ros.workers.pool import RequestAnswer, RequestOutcome
from obc_ros.workers.wire import Packet

STATUS = {RequestOutcome.REFUSED: 'cancelled', RequestOutcome.TIMED_OUT: 'timed_out',
          RequestOutcome.CANCELLED: 'cancelled', RequestOutcome.DIED: 'not_converged'}


def respond(answer: RequestAnswer) -> Packet:
    """
    Return the response to a request: status, message and, if there is one, the solution.

    Parameters
    ----------
    answer : RequestAnswer
        Of the pool. Without an answer of a worker the response has the reason for that, and the
        best path that the worker has kept.

    Returns
    -------
    Packet
        With a status and a message at least.

    """
    kept = answer.packet
    if answer.outcome is RequestOutcome.ANSWERED:
        return kept
    message = '; the best path so far: '.join(
        filter(None, (answer.message, kept.plain.get('message'))))
    return Packet({**kept.plain, 'status': STATUS[answer.outcome], 'message': message},
                  kept.arrays)


def compute_affinity(request: Packet) -> str:
    """
    Return a text that is equal for statements which differ in numbers only.

    Parameters
    ----------
    request : Packet
        Of any kind; it may be invalid.

    Returns
    -------
    str
        For `pool.Job.affinity`.

    """
    given = request.plain.get('statement', {})
    shape = [given.get(key) for key in ('system', 'states', 'inputs', 'dynamics', 'running_cost',
                                        'terminal_cost', 'terminal_constraints')]
    shape += [given.get(key) for key in (
        'initial_cost', 'initial_constraints', 'boundary_constraints', 'periodic', 'phases')]
    start = given.get('initial_state')
    shape.append(sorted(name for name, value in start.items() if value is None or isinstance(
        value, list)) if isinstance(start, dict) else None)
    names = [sorted(section) for section in map(given.get, (
        'parameters', 'free_parameters', 'input_bounds', 'state_bounds'))
        if isinstance(section, dict)]
    return re.sub(r'[\d.]+', '0', json.dumps([shape, names, given.get('path_constraints')]))
