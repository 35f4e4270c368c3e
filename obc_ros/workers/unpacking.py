# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solutions from plain data and named arrays, without CasADi."""

from typing import Any

from obc_ros.core.ocp.solution import (
    Attempt,
    Certificate,
    Optimality,
    Solution,
    Status,
    Verdict,
)
from obc_ros.workers.wire import Packet


def unpack_solution(packet: Packet) -> Solution:
    """
    Return the solution that a packet contains.

    :param packet: as `solutions.pack_solution` returns it, or with a status and a message only. It
        has no multipliers of state bounds and path constraints.
    """
    plain, certificate = packet.plain, packet.plain.get('certificate')
    optimality = plain.get('optimality')
    numbers: dict[str, Any] = {**packet.arrays, **{name: plain[name] for name in (
        'objective', 'interpolation', 'method', 'iterations', 'build_time', 'solve_time',
        'free_parameters', 'remark')
        if name in plain}}
    return Solution(
        status=Status(plain['status']), message=plain['message'], **numbers,
        certificate=Certificate(**certificate) if certificate else None,
        optimality=Optimality(**{**optimality, 'minima': tuple(optimality['minima'])})
        if optimality else None,
        attempts=tuple(Attempt(**{**attempt, 'verdict': Verdict(attempt['verdict'])})
                       for attempt in plain.get('attempts', ())))
