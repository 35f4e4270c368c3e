# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests to solve a problem, and what other kinds of requests share with them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import Any

from obc_ros.core.ocp.augmentation import hide_added_states, name_attempts
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import (
    Attempt,
    Certificate,
    MAX_INTERVALS,
    Report,
    Solution,
)
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.options import read_options
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
from obc_ros.core.systems.file import build_plant
from obc_ros.core.systems.registry import find_registered
from obc_ros.core.tasks.motion_planning import Motion
from obc_ros.core.text.errors import ObcError, quote, StatementError
from obc_ros.core.text.recorded_functions import unpack_statement
from obc_ros.workers.wire import Packet

ARRAYS = ('t', 'x', 'u', 'lam', 'hamiltonian', 'nu', 'switching_times')
Keep = Callable[[Packet], None]
Handler = Callable[[Packet, float, Report, Keep], Packet]
Answering = Callable[[str, Packet, float, Report, Keep], Packet]
_caches: dict[int, Cache] = {}


def answer_by(handlers: Mapping[str, Handler]) -> Answering:
    """
    Return the function `answer` of a module that a pool's workers import.

    Requests are not trusted: the status of an invalid one is ``malformed``, and any other fault
    ends the worker only.

    :param handlers: by kind, what makes the answer of a request, a time limit [s], `report` and
        `keep`. It calls `keep` with the best path so far, packed as an answer, or with a part of
        an answer, whenever that changes.
    :return: ``answer(kind, request, time_limit, report, keep) -> Packet``.
    """
    def answer(kind: str, request: Packet, time_limit: float, report: Report,
               keep: Keep = lambda path: None) -> Packet:
        try:
            if kind not in handlers:
                raise StatementError(f'{kind}: there is no such kind of request')
            return handlers[kind](request, time_limit, report, keep)
        except ObcError as error:
            return Packet({'status': 'malformed', 'message': str(error)})

    return answer


def solve_statement(request: Packet, time_limit: float, report: Report, keep: Keep) -> Packet:
    """
    Return the solution of a statement, packed.

    :param request: ``statement``, ``method`` (empty: that of the statement) and ``cache_size``;
        optional are ``accept`` (as ``method``), ``functions`` (see `recorded_functions`),
        ``options`` and ``max_intervals``.
    :param time_limit, report, keep: see `answer_by`.
    """
    plain = request.plain
    problem = build_problem(unpack_statement(plain))
    options = read_options(plain.get('options', ()))
    system = plain['statement'].get('system') or ''
    solution = solve(problem, method=plain['method'], time_limit=time_limit,
                     report=report, cache=get_cache(plain['cache_size']),
                     max_intervals=plain.get('max_intervals', MAX_INTERVALS),
                     accept=plain.get('accept', ''),
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


def read_motion(request: Packet) -> Motion:
    """
    Return the motion that a request asks for.

    :param request: as `messages.read_request` returns it. Optional are ``plant``, the keys of a
        plant that is not registered, and ``start_names``, the names of the states of the start.
    :raises ObcError: if there is no such plant, a parameter is not valid, or the start is that of
        another plant.
    """
    plain, arrays = request.plain, request.arrays
    system = build_plant(plain['plant'], plain['parameters']) if 'plant' in plain else (
        find_registered(plain['system'], plain['parameters']))
    if (names := plain.get('start_names')) and tuple(names) != system.state_names:
        raise StatementError(f'start: the state of the plant has {quote(", ".join(names), 200)}; '
                             f'wanted {", ".join(system.state_names)}')
    return Motion(
        system=system, start=arrays['start'], goal=arrays['goal'], objective=plain['objective'],
        Qx=arrays['qx'], Qu=arrays['qu'], final_time=plain['final_time'],
        input_bounds=plain['input_bounds'], state_bounds=plain['state_bounds'],
        path_constraints=plain['path_constraints'])


def pack_solution(problem: Problem, solution: Solution, system: str) -> Packet:
    """Return a solution as plain data and named arrays, with the states of its statement."""
    solution = hide_added_states(problem, solution)
    return Packet(
        {'status': solution.status.value, 'message': solution.message, 'remark': solution.remark,
         'objective': float(solution.objective), 'interpolation': solution.interpolation,
         'method': solution.method, 'iterations': int(solution.iterations),
         'build_time': float(solution.build_time), 'solve_time': float(solution.solve_time),
         'first_path_time': float(solution.first_path_time),
         'system': system, 'states': problem.shown_states, 'inputs': problem.shown_inputs,
         'free_parameters': dict(solution.free_parameters),
         'certificate': pack_certificate(solution.certificate),
         'optimality': solution.optimality and asdict(solution.optimality),
         **pack_attempts(solution.attempts).plain},
        {name: getattr(solution, name) for name in ARRAYS})


def pack_attempts(attempts: Iterable[Attempt]) -> Packet:
    """Return what was tried as the part of a packed solution."""
    return Packet({'attempts': [asdict(attempt) for attempt in attempts]})


def pack_certificate(certificate: Certificate | None) -> dict[str, Any] | None:
    """Return residuals, tolerances and the estimate of the excess as plain data."""
    if certificate is None:
        return None
    return {'excess': float(certificate.excess), **{
        name: {key: float(value) for key, value in getattr(certificate, name).items()}
        for name in ('residuals', 'tolerances')}}


answer = answer_by({'solve': solve_statement})
