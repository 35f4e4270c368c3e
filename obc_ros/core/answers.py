# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What a worker answers, by the kind of the request.

Nothing is trusted here: a fault of the question comes back as the status ``malformed``, anything
worse ends the worker and nothing else.
"""

from collections.abc import Callable
from dataclasses import replace
import math
import time

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.equilibrium import Equilibrium, equilibrium, linearize
from obc_ros.core.errors import ObcError, RefusedDesignError, StatementError
from obc_ros.core.lqr import lqr, LqrDesign
from obc_ros.core.planning import Motion, registered, statement
from obc_ros.core.problem import Problem
from obc_ros.core.solution import Report, Solution, Status
from obc_ros.core.solve import Cache, solve
from obc_ros.core.statement import problem_from_mapping
from obc_ros.core.system import System
from obc_ros.core.weights import choose
from obc_ros.core.wire import Packet

Array = NDArray[np.float64]

_caches: dict[int, Cache] = {}


def answer(kind: str, request: Packet, time_limit: float, report: Report) -> Packet:
    """Return the answer to a request; its status is ``malformed`` when the question is."""
    try:
        return KINDS[kind](request, time_limit, report)
    except ObcError as error:
        return Packet({'status': 'malformed', 'message': str(error)})


def solution_packet(problem: Problem, solution: Solution, system: str) -> Packet:
    """Return an answer as plain data, with the names that its arrays go by."""
    certificate = solution.certificate
    return Packet(
        {'status': solution.status.value, 'message': solution.message,
         'objective': float(solution.objective), 'interpolation': solution.interpolation,
         'method': solution.method, 'iterations': int(solution.iterations),
         'build_time': float(solution.build_time), 'solve_time': float(solution.solve_time),
         'system': system, 'states': problem.states, 'inputs': problem.inputs,
         'certificate': certificate and {
             name: {key: float(value) for key, value in getattr(certificate, name).items()}
             for name in ('residuals', 'tolerances')}},
        {name: getattr(solution, name)
         for name in ('t', 'x', 'u', 'lam', 'hamiltonian', 'nu', 'switching_times')})


def _solve(request: Packet, time_limit: float, report: Report) -> Packet:
    plain = request.plain
    problem = problem_from_mapping(plain['statement'])
    solution = solve(problem, method=plain['method'] or 'auto', time_limit=time_limit,
                     report=report, cache=_cache(plain['cache_size']))
    return solution_packet(problem, solution, plain['statement'].get('system', ''))


def _plan(request: Packet, time_limit: float, report: Report) -> Packet:
    plain, arrays = request.plain, request.arrays
    motion = Motion(plain['system'], arrays['start'], arrays['goal'], plain['objective'],
                    plain['parameters'], arrays['qx'], arrays['qu'], plain['final_time'],
                    plain['input_bounds'])
    cache = _cache(plain['cache_size'])
    begun = time.monotonic()
    if motion.objective != 'time' and not motion.final_time:
        motion = replace(motion, final_time=_ample_time(motion, time_limit / 2, report, cache))
    problem = problem_from_mapping(statement(motion))
    left = time_limit - (time.monotonic() - begun)
    solution = solve(problem, time_limit=left, report=report, cache=cache)
    return solution_packet(problem, solution, motion.system)


def _design_lqr(request: Packet, time_limit: float, report: Report) -> Packet:
    plain, arrays = request.plain, request.arrays
    system = registered(plain['system'], plain['parameters']) if plain['system'] else None
    if system:
        at = equilibrium(system, _or_default(arrays['setpoint']),
                         _or_default(arrays['setpoint_input']))
        A, B = linearize(system, at.x, at.u)
    else:
        A, B = _plant(arrays['a'], arrays['b'])
        at = Equilibrium(np.zeros(len(A)), np.zeros(B.shape[1]), np.zeros(len(A)))
    n, m = B.shape
    cost = choose(
        n, m, weights=plain['weights'] or 'matrices', rho=plain['rho'] or 1.0,
        Qx=arrays['qx'] if arrays['qx'].size else np.ones(n),
        Qu=arrays['qu'] if arrays['qu'].size else np.ones(m), cross=arrays['cross'],
        x_max=arrays['x_max'], u_max=arrays['u_max'], H=arrays['h'], stability=plain['stability'])
    try:
        design = lqr(A, B, cost.Qx, cost.Qu, cross=cost.cross, stability=cost.stability)
    except RefusedDesignError as error:
        return Packet({'status': 'refused', 'message': str(error)})
    return design_packet(design, at, system)


def design_packet(design: LqrDesign, at: Equilibrium, system: System | None) -> Packet:
    """Return a design as the fields of its message, with the names that its arrays go by."""
    n, m = design.B.shape
    damping = -design.E.real / np.abs(design.E)
    slowest = design.E[np.argmax(design.E.real)]
    sentence = (f'the closed loop is stable: its slowest mode decays in {-1 / slowest.real:.3g} s,'
                f' its least damping ratio is {damping.min():.3g}')
    fields = {
        'system': system.name if system else '', 'residual': float(design.residual),
        'state_names': system.state_names if system else [f'x{i + 1}' for i in range(n)],
        'input_names': system.input_names if system else [f'u{j + 1}' for j in range(m)],
        'design': 'continuous', 'sentence': sentence}
    return Packet(
        {'status': 'solved', 'message': sentence, 'design': fields},
        {'xe': at.x, 'ue': at.u, 'a': design.A, 'b': design.B, 'qx': design.Qx, 'qu': design.Qu,
         'k': design.K, 'p': design.P, 'poles_real': design.E.real, 'poles_imag': design.E.imag,
         'damping': damping})


def _or_default(values: Array) -> Array | None:
    return values if values.size else None


def _plant(a: Array, b: Array) -> tuple[Array, Array]:
    """Return A (n, n) and B (n, m) of their numbers row by row."""
    n = math.isqrt(a.size)
    if not n or n * n != a.size:
        raise StatementError(f'a has {a.size} numbers: wanted n*n, row by row')
    if not b.size or b.size % n:
        raise StatementError(f'b has {b.size} numbers: wanted {n}*m, row by row')
    return a.reshape(n, n), b.reshape(n, -1)


def _ample_time(motion: Motion, time_limit: float, report: Report, cache: Cache) -> float:
    """Return twice the least time of a motion; 0 where there is none or it is not found."""
    try:
        problem = problem_from_mapping(statement(replace(motion, objective='time')))
    except ObcError:
        return 0.0  # inputs without bounds; what else is wrong with the motion is seen again
    solution = solve(problem, time_limit=time_limit, report=report, cache=cache)
    return 2.0 * solution.objective if solution.status is Status.SOLVED else 0.0


def _cache(size: int) -> Cache:
    """Return what is kept from request to request; it starts anew when its size is changed."""
    if size not in _caches:
        _caches.clear()
        _caches[size] = Cache(size)
    return _caches[size]


KINDS: dict[str, Callable[[Packet, float, Report], Packet]] = {
    'solve': _solve,
    'plan': _plan,
    'design_lqr': _design_lqr,
}
