# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The requests for one point of a sweep, which a solver process handles.

A request is handled within the time and memory limits of the process, as any other request of
`workers`. The answer has the numbers of the solution that the dataset keeps, not its path.
"""

from collections.abc import Callable
import time
from typing import Any

from obc_ros.core.ocp.solution import Certificate, MAX_INTERVALS, Report, Solution
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.options import read_options
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import ObcError
from obc_ros.core.text.recorded_functions import unpack_statement
from obc_ros.sweep.closed_loops import simulate_regulator
from obc_ros.workers.wire import Packet

OPTIMA = {'local': 1, 'global': 2}

_caches = [Cache()]   # of the chunk that is being solved


def answer(kind: str, request: Packet, time_limit: float, report: Report,
           keep: Callable[[Packet], None]) -> Packet:
    """
    Return the numbers of the solution at one point.

    :param kind: key of `POINT_KINDS`.
    :param request: with `fresh`: whether to forget all earlier points, so that the answers of a
        chunk do not depend on what the process has solved before.
    :param report, keep: as for `workers.requests`; the best path so far is not kept.
    :return: its status is ``malformed`` if the point has no valid problem.
    """
    begun = time.perf_counter()
    if request.plain['fresh']:
        _caches[0] = Cache()
    try:
        found = POINT_KINDS[kind](request.plain, time_limit, report)
    except ObcError as error:
        found = {'status': 'malformed', 'message': str(error)}
    return Packet(found | {'time': time.perf_counter() - begun})


def _solve_problem(plain: dict[str, Any], time_limit: float, report: Report) -> dict[str, Any]:
    solution = solve(
        build_problem(unpack_statement(plain)), method=plain['method'], time_limit=time_limit,
        report=report, cache=_caches[0], max_intervals=MAX_INTERVALS,
        options=read_options(plain['options']))
    found = {'status': solution.status.value, 'message': '' if solution.certified
             else solution.message, 'method': solution.method}
    return found | _numbers(solution) if solution.t.size else found


def _numbers(solution: Solution) -> dict[str, Any]:
    """Return what the dataset keeps of a solution with a path."""
    return {'J': float(solution.objective), 'T': float(solution.t[-1]),
            'switching_times': solution.switching_times.tolist(),
            'costates': solution.lam[0].tolist() if solution.lam.size else [],
            'inputs': solution.u[0].tolist(),
            'worst_residual': _worst(solution.certificate),
            'optimum': OPTIMA.get(solution.optimality.kind, 0) if solution.optimality else 0}


def _worst(certificate: Certificate | None) -> float:
    """Return the largest residual relative to its tolerance; infinite without a certificate."""
    if certificate is None:
        return float('inf')
    worst = certificate.worst
    return float(certificate.residuals[worst] / certificate.tolerances[worst])


POINT_KINDS: dict[str, Callable[[dict[str, Any], float, Report], dict[str, Any]]] = {
    'problem': _solve_problem,
    'regulator': lambda plain, time_limit, report: simulate_regulator(plain),
}
