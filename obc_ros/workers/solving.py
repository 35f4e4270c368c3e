# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests to solve a problem."""

from obc_ros.core.ocp.augmentation import name_attempts
from obc_ros.core.ocp.solution import MAX_INTERVALS, Report
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.options import read_options
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
from obc_ros.workers.kinds import answer_by, Keep
from obc_ros.workers.solutions import pack_attempts, pack_solution
from obc_ros.workers.wire import Packet

_caches: dict[int, Cache] = {}


def solve_statement(request: Packet, time_limit: float, report: Report, keep: Keep) -> Packet:
    """
    Return the solution of a statement, packed.

    :param request: ``statement``, ``method`` (empty: that of the statement) and ``cache_size``;
        optional are ``options`` and ``max_intervals``.
    :param time_limit: limit of the wall-clock time [s].
    :param report, keep: see `kinds.answer_by`.
    :return: as `pack_solution` returns it.
    :raises ObcError: if the request is invalid.
    """
    plain = request.plain
    problem, options = build_problem(plain['statement']), read_options(plain.get('options', ()))
    system = plain['statement'].get('system') or ''
    solution = solve(problem, method=plain['method'], time_limit=time_limit,
                     report=report, cache=get_cache(plain['cache_size']),
                     max_intervals=plain.get('max_intervals', MAX_INTERVALS),
                     keep=lambda path: keep(pack_solution(problem, path, system)),
                     note=lambda attempts: keep(pack_attempts(name_attempts(problem, attempts))),
                     options=options)
    return pack_solution(problem, solution, system)


def get_cache(size: int) -> Cache:
    """Return the cache that requests share; a change of its size clears it."""
    if size not in _caches:
        _caches.clear()
        _caches[size] = Cache(size)
    return _caches[size]


answer = answer_by({'solve': solve_statement})
