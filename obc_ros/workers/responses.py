# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What surrounds the work of a worker, without CasADi.

That is, which worker gets a request, what is answered without one, and solutions from packets.
"""

from contextlib import closing
import json
import re
from typing import Any

from obc_ros.core.ocp.solution import (
    Attempt,
    Certificate,
    Optimality,
    Report,
    Solution,
    Status,
    Verdict,
)
from obc_ros.core.text.errors import ObcError
from obc_ros.workers.pool import Pool, RequestAnswer, RequestOutcome
from obc_ros.workers.wire import Packet

STATUS = {RequestOutcome.REFUSED: 'cancelled', RequestOutcome.TIMED_OUT: 'timed_out',
          RequestOutcome.CANCELLED: 'cancelled', RequestOutcome.DIED: 'not_converged'}


def respond(answer: RequestAnswer) -> Packet:
    """Return the response; without an answer the reason, and the best path that was kept."""
    kept = answer.packet
    if answer.outcome is RequestOutcome.ANSWERED:
        return kept
    message = '; the best path so far: '.join(
        filter(None, (answer.message, kept.plain.get('message'))))
    status = STATUS[answer.outcome]
    if kept.plain.get('status') == 'feasible' and answer.outcome in (
            RequestOutcome.TIMED_OUT, RequestOutcome.DIED):
        status = 'feasible'   # such a path is accepted
    return Packet({**kept.plain, 'status': status, 'message': message},
                  kept.arrays)


def unpack_solution(packet: Packet) -> Solution:
    """Return the solution of a packet, or one with a status and a message only."""
    plain, certificate = packet.plain, packet.plain.get('certificate')
    optimality = plain.get('optimality')
    numbers: dict[str, Any] = {**packet.arrays, **{name: plain[name] for name in (
        'objective', 'interpolation', 'method', 'iterations', 'build_time', 'solve_time',
        'free_parameters', 'remark', 'first_path_time')
        if name in plain}}
    return Solution(
        status=Status(plain['status']), message=plain['message'], **numbers,
        certificate=Certificate(**certificate) if certificate else None,
        optimality=Optimality(**{**optimality, 'minima': tuple(optimality['minima'])})
        if optimality else None,
        attempts=tuple(Attempt(**{**attempt, 'verdict': Verdict(attempt['verdict'])})
                       for attempt in plain.get('attempts', ())))


def solve_in_process(request: dict[str, Any], time_limit: float, report: Report | None = None
                     ) -> tuple[Solution, tuple[str, ...], tuple[str, ...]]:
    """
    Solve a problem in a process of its own, which ends with it.

    :param request: as `solving.solve_statement` wants it.
    :param time_limit: from the start of the process on [s]. Then the process is ended, whatever it
        does.
    :param report: called as report(phase, iteration, cost, infeasibility); True cancels.
    :return: solution: with the status 'malformed' if the request is invalid. It has no multipliers
        of state bounds and path constraints; states, inputs: names of its columns; empty if the
        process was ended without a path.
    :raises ObcError: if no process starts.
    """
    with closing(Pool('obc_ros.workers.solving', 1, niceness=0)) as pool:
        while not pool.wait_for_start(1.0):
            pass
        if pool.fault:
            raise ObcError(f'no process starts: {pool.fault}')
        response = respond(pool.ask('solve', Packet(request), time_limit, report=report))
    states, inputs = (tuple(response.plain.get(name, ())) for name in ('states', 'inputs'))
    return unpack_solution(response), states, inputs


def compute_affinity(request: Packet) -> str:
    """Return a text that is equal for statements which differ in numbers only, for `Job`."""
    given = request.plain.get('statement', {})
    shape = [given.get(key) for key in (
        'system', 'states', 'inputs', 'dynamics', 'running_cost', 'terminal_cost',
        'terminal_constraints', 'initial_cost', 'initial_constraints', 'boundary_constraints',
        'periodic', 'phases')]
    start = given.get('initial_state')
    shape.append(sorted(name for name, value in start.items() if value is None or isinstance(
        value, list)) if isinstance(start, dict) else None)
    names = [sorted(section) for section in map(given.get, (
        'parameters', 'free_parameters', 'input_bounds', 'state_bounds'))
        if isinstance(section, dict)]
    return re.sub(r'[\d.]+', '0', json.dumps([shape, names, given.get('path_constraints')]))
