# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solutions as plain data and named arrays."""

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from obc_ros.core.ocp.augmentation import hide_added_states
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Attempt, Certificate, Optimality, Solution
from obc_ros.workers.wire import Packet

ARRAYS = ('t', 'x', 'u', 'lam', 'hamiltonian', 'nu', 'switching_times')


def pack_solution(problem: Problem, solution: Solution, system: str) -> Packet:
    """Return a solution as plain data and named arrays, with the states of its statement."""
    solution = hide_added_states(problem, solution)
    return Packet(
        {'status': solution.status.value, 'message': solution.message, 'remark': solution.remark,
         'objective': float(solution.objective), 'interpolation': solution.interpolation,
         'method': solution.method, 'iterations': int(solution.iterations),
         'build_time': float(solution.build_time), 'solve_time': float(solution.solve_time),
         'system': system, 'states': problem.shown_states, 'inputs': problem.shown_inputs,
         'free_parameters': dict(solution.free_parameters),
         'certificate': pack_certificate(solution.certificate),
         'optimality': _optimality(solution.optimality),
         **pack_attempts(solution.attempts).plain},
        {name: getattr(solution, name) for name in ARRAYS})


def pack_attempts(attempts: Iterable[Attempt]) -> Packet:
    """Return what was tried as the part of a packed solution."""
    return Packet({'attempts': [asdict(attempt) for attempt in attempts]})


def pack_certificate(certificate: Certificate | None) -> dict[str, dict[str, float]] | None:
    """Return residuals and tolerances as plain data."""
    if certificate is None:
        return None
    return {name: {key: float(value) for key, value in getattr(certificate, name).items()}
            for name in ('residuals', 'tolerances')}


def _optimality(found: Optimality | None) -> dict[str, Any] | None:
    return None if found is None else {
        'kind': found.kind, 'reason': found.reason, 'starts': int(found.starts),
        'minima': list(map(float, found.minima))}
