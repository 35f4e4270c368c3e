# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""All requests that a worker of the trajectory server handles, by kind."""

from obc_ros.core.numerics.arrays import integrate, linalg, optimize, special
from obc_ros.core.ocp.solution import MAX_INTERVALS, Report
from obc_ros.core.tasks.minimize import minimize
from obc_ros.core.tasks.motion_planning import solve_motion
from obc_ros.workers.designing import design_regulator
from obc_ros.workers.solving import (
    answer_by,
    get_cache,
    Handler,
    Keep,
    pack_certificate,
    pack_solution,
    read_motion,
    solve_statement,
)
from obc_ros.workers.wire import Packet


def _minimize(request: Packet, time_limit: float, report: Report, keep: Keep) -> Packet:
    found = minimize(request.plain['statement'], time_limit=time_limit, report=report)
    return Packet(
        {'status': found.status.value, 'message': found.message,
         'objective': float(found.objective), 'certificate': pack_certificate(found.certificate)},
        {'x': found.x, 'lam': found.lam, 'mu': found.mu})


def _plan(request: Packet, time_limit: float, report: Report, keep: Keep) -> Packet:
    plain = request.plain
    problem, solution = solve_motion(
        read_motion(request), time_limit, report=report, cache=get_cache(plain['cache_size']),
        max_intervals=plain.get('max_intervals', MAX_INTERVALS), accept=plain.get('accept', ''),
        keep=lambda problem, path: keep(pack_solution(problem, path, plain['system'])))
    return pack_solution(problem, solution, plain['system'])


KINDS: dict[str, Handler] = {
    'solve': solve_statement,
    'minimize': _minimize,
    'plan': _plan,
    'design_lqr': design_regulator,
}
answer = answer_by(KINDS)
for module in (integrate, linalg, optimize, special):
    module.load()  # a server has time before its first request
