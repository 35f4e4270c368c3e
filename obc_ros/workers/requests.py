# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The requests that a worker handles, by kind.

Requests are not trusted: an invalid one is answered with the status ``malformed``, and any other
fault ends the worker only.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import lru_cache
import json
import math
import time
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.lqr.design.design import design, linearize_plant, LinearizedPlant, Sampling
from obc_ros.core.lqr.design.report import Change, report_fields
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import (
    Certificate,
    MAX_INTERVALS,
    Optimality,
    Report,
    Solution,
    Status,
)
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.motion_planning import find_registered, Motion, state_motion
from obc_ros.core.solver.nlp.minimize import minimize
from obc_ros.core.solver.options import read_options
from obc_ros.core.solver.solve import Cache, solve
from obc_ros.core.systems.equilibrium import Equilibrium
from obc_ros.core.systems.system import Signal, System
from obc_ros.core.text.errors import ObcError, RefusedDesignError, StatementError
from obc_ros.workers.wire import Packet

Keep = Callable[[Packet], None]

_caches: dict[int, Cache] = {}


def _forget(path: Packet) -> None:
    """Ignore a path."""


def answer(kind: str, request: Packet, time_limit: float, report: Report,
           keep: Keep = _forget) -> Packet:
    """
    Return the answer to a request; the status of an invalid request is ``malformed``.

    `keep` is called with the best path so far, packed as an answer, whenever it changes.
    """
    try:
        if kind not in KINDS:
            raise StatementError(f'{kind}: there is no such kind of request')
        return KINDS[kind](request, time_limit, report, keep)
    except ObcError as error:
        return Packet({'status': 'malformed', 'message': str(error)})


def pack_solution(problem: Problem, solution: Solution, system: str) -> Packet:
    """Return a solution as plain data and named arrays."""
    return Packet(
        {'status': solution.status.value, 'message': solution.message,
         'objective': float(solution.objective), 'interpolation': solution.interpolation,
         'method': solution.method, 'iterations': int(solution.iterations),
         'build_time': float(solution.build_time), 'solve_time': float(solution.solve_time),
         'system': system, 'states': problem.states, 'inputs': problem.inputs,
         'certificate': _conditions(solution.certificate),
         'optimality': _optimality(solution.optimality),
         'attempts': [asdict(attempt) for attempt in solution.attempts]},
        {name: getattr(solution, name)
         for name in ('t', 'x', 'u', 'lam', 'hamiltonian', 'nu', 'switching_times')})


def _conditions(certificate: Certificate | None) -> dict[str, dict[str, float]] | None:
    if certificate is None:
        return None
    return {name: {key: float(value) for key, value in getattr(certificate, name).items()}
            for name in ('residuals', 'tolerances')}


def _optimality(found: Optimality | None) -> dict[str, Any] | None:
    return None if found is None else {
        'kind': found.kind, 'reason': found.reason, 'starts': int(found.starts),
        'minima': list(map(float, found.minima))}


def _solve(request: Packet, time_limit: float, report: Report, keep: Keep) -> Packet:
    plain = request.plain
    problem, options = build_problem(plain['statement']), read_options(plain.get('options', ()))
    system = plain['statement'].get('system', '')
    solution = solve(problem, method=plain['method'], time_limit=time_limit,
                     report=report, cache=_cache(plain['cache_size']),
                     max_intervals=plain.get('max_intervals', MAX_INTERVALS),
                     keep=lambda path: keep(pack_solution(problem, path, system)),
                     options=options)
    return pack_solution(problem, solution, system)


def _minimize(request: Packet, time_limit: float, report: Report, keep: Keep) -> Packet:
    found = minimize(request.plain['statement'], time_limit=time_limit, report=report)
    return Packet(
        {'status': found.status.value, 'message': found.message,
         'objective': float(found.objective), 'certificate': _conditions(found.certificate)},
        {'x': found.x, 'lam': found.lam, 'mu': found.mu})


def _plan(request: Packet, time_limit: float, report: Report, keep: Keep) -> Packet:
    plain, arrays = request.plain, request.arrays
    motion = Motion(
        system=plain['system'], start=arrays['start'], goal=arrays['goal'],
        objective=plain['objective'], parameters=plain['parameters'], Qx=arrays['qx'],
        Qu=arrays['qu'], final_time=plain['final_time'], input_bounds=plain['input_bounds'])
    cache = _cache(plain['cache_size'])
    begun = time.monotonic()
    if motion.objective != 'time' and not motion.final_time:
        motion = replace(motion, final_time=_ample_time(motion, time_limit / 2, report, cache))
    problem = build_problem(state_motion(motion))
    left = time_limit - (time.monotonic() - begun)
    solution = solve(problem, time_limit=left, report=report, cache=cache,
                     max_intervals=plain.get('max_intervals', MAX_INTERVALS),
                     keep=lambda path: keep(pack_solution(problem, path, motion.system)))
    return pack_solution(problem, solution, motion.system)


def _design_lqr(request: Packet, time_limit: float, report: Report, keep: Keep) -> Packet:
    plain, arrays = request.plain, request.arrays
    for name in ('sample_time', 'delay'):
        if not 0.0 <= plain[name] < math.inf:
            raise StatementError(f'{name} = {plain[name]:g}: wanted 0 or a positive number')
    sampling = Sampling(plain['sample_time'], plain['delay'], exact=plain['sample_time'] > 0.0)
    if plain['system']:
        of = linearize_plant(_system(plain['system'], json.dumps(plain['parameters'])),
                             arrays['setpoint'].tolist(), arrays['setpoint_input'].tolist())
    else:
        of = _given_plant(arrays['a'], arrays['b'])
    weights = {name: arrays[name.lower()].tolist()
               for name in ('Qx', 'Qu', 'cross', 'x_max', 'u_max', 'H')}
    try:
        found = design(of, {
            **weights, 'weights': plain['weights'] or 'matrices', 'rho': plain['rho'] or 1.0,
            'stability': plain['stability']}, sampling=sampling)
    except RefusedDesignError as error:
        return Packet({'status': 'refused', 'message': str(error)})
    entries = report_fields(found, Change(), None)
    arrays = {name: value for name, value in entries.items() if isinstance(value, np.ndarray)}
    message = {name: value for name, value in entries.items() if name not in arrays}
    message['sentence'] = message['sentence'].removeprefix(': ')  # matrices have no name
    return Packet({'status': 'solved', 'message': message['sentence'], 'design': message}, arrays)


@lru_cache(32)
def _system(name: str, parameters: str) -> System:
    """Return a registered system; cached, since building it takes longer than a design."""
    return find_registered(name, json.loads(parameters))


def _given_plant(a: Array, b: Array) -> LinearizedPlant:
    """Return the plant of A (n, n) and B (n, m), given row by row."""
    n = math.isqrt(a.size)
    if not n or n * n != a.size:
        raise StatementError(f'a has {a.size} numbers: wanted n*n, row by row')
    if not b.size or b.size % n:
        raise StatementError(f'b has {b.size} numbers: wanted {n}*m, row by row')
    m = b.size // n
    system = System(
        name='', states=tuple(Signal(f'x{i + 1}') for i in range(n)),
        inputs=tuple(Signal(f'u{j + 1}') for j in range(m)), parameters=(), x=ca.SX.sym('x', n),
        u=ca.SX.sym('u', m), p=ca.SX(0, 1), xdot=ca.SX(n, 1), setpoint=(0.0,) * n,
        setpoint_input=(0.0,) * m)
    rest = Equilibrium(np.zeros(n), np.zeros(m), np.zeros(n))
    return LinearizedPlant(system, rest, a.reshape(n, n), b.reshape(n, m), (0.0,) * m)


def _ample_time(motion: Motion, time_limit: float, report: Report, cache: Cache) -> float:
    """Return twice the minimum time of a motion; 0 if there is none or it is not found."""
    try:
        problem = build_problem(state_motion(replace(motion, objective='time')))
    except ObcError:
        return 0.0  # such as inputs without bounds; other errors are found again when it is solved
    solution = solve(problem, time_limit=time_limit, report=report, cache=cache)
    return 2.0 * solution.objective if solution.status is Status.SOLVED else 0.0


def _cache(size: int) -> Cache:
    """Return the cache that requests share; a change of its size clears it."""
    if size not in _caches:
        _caches.clear()
        _caches[size] = Cache(size)
    return _caches[size]


KINDS: dict[str, Callable[[Packet, float, Report, Keep], Packet]] = {
    'solve': _solve,
    'minimize': _minimize,
    'plan': _plan,
    'design_lqr': _design_lqr,
}
