# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Statement of a motion of a system from a start to a goal as an optimal control problem.

Objectives: 'time' minimises T, 'effort' the integral of (u - ug)'Qu (u - ug), 'quadratic' that of
(x - xg)'Qx (x - xg) + (u - ug)'Qu (u - ug). The terminal constraint is x(T) = xg. ug is the input
that holds the system at the goal; without one, the set point input of the system.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
import re
import time
from typing import Any

import numpy as np
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.weights import square
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import MAX_INTERVALS, Report, Solution, Status
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
from obc_ros.core.systems.equilibrium import check_numbers, find_equilibrium, linearize
from obc_ros.core.systems.registry import find_registered
from obc_ros.core.systems.system import Signal, System
from obc_ros.core.text.errors import (
    DynamicsError,
    ObcError,
    quote,
    RefusedDesignError,
    StatementError,
)
from obc_ros.core.text.expressions import parse_number

OBJECTIVES = ('time', 'effort', 'quadratic')
TIMES = (1e-3, 1e3)    # [s] bounds of the free final time of 'time'
SETTLING = 4.0         # default final time, in time constants of the slowest closed-loop pole
UNKNOWN_TIME = 1.0     # [s] default final time if no regulator stabilises the system at the goal


@dataclass(frozen=True, eq=False)
class Motion:
    """
    A motion from one state to another; see *Motions* in docs/problems.md.

    :ivar system: name of a registered system, or a system with its parameters chosen.
    :ivar start, goal: length n, x(0) and x(T).
    :ivar objective: one of OBJECTIVES.
    :ivar parameters: number or expression by the name of a parameter, as in a problem file, for a
        name.
    :ivar Qx, Qu: diagonal, or full matrix row by row; empty: the identity.
    :ivar final_time: T [s] unless the objective is 'time'; 0: from the poles of the regulator of
        Qx and Qu.
    :ivar input_bounds, state_bounds: pair of numbers or expressions by the name of an input or a
        state; None: no tighter bound.
    """

    system: str | System
    start: Sequence[float] | Array
    goal: Sequence[float] | Array
    objective: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    Qx: Sequence[float] | Array = ()
    Qu: Sequence[float] | Array = ()
    final_time: float = 0.0
    input_bounds: Mapping[str, Any] = field(default_factory=dict)
    state_bounds: Mapping[str, Any] = field(default_factory=dict)
    path_constraints: Sequence[str] = ()


def state_motion(motion: Motion) -> dict[str, Any]:
    """
    State a motion as an optimal control problem.

    :param motion: with names as users give them; all are checked here.
    :return: the keys of a problem file. All numbers are parameters, so that the next motion of the
        system has the same structure. Angles of the goal differ by at most pi from the start.
    :raises StatementError, DynamicsError: if the system, a parameter, the objective, a size or a
        number is not valid, or if the minimum time is asked for and an input lacks a bound.
    """
    if motion.objective not in OBJECTIVES:
        raise StatementError(f"objective = '{quote(motion.objective)}': wanted one of "
                             f'{", ".join(OBJECTIVES)}')
    system = motion.system if isinstance(motion.system, System) else find_registered(
        motion.system, motion.parameters)
    _check_names(system)
    start = check_numbers('start', motion.start, system.state_names)
    goal = check_numbers('goal', motion.goal, system.state_names)
    goal = np.where(system.angles, start + np.remainder(goal - start + math.pi, 2 * math.pi)
                    - math.pi, goal)
    held = _input_at(system, goal)
    bounds = _bounds(system, 'input', system.inputs, motion.input_bounds)
    goals = {f'goal_{name}': float(value)
             for name, value in zip(system.state_names, goal, strict=True)}
    found: dict[str, Any] = {
        'name': f'{system.name}_{motion.objective}',
        'system': system if motion.system is system else system.name,
        'parameters': {**motion.parameters, **goals},
        'initial_state': dict(zip(system.state_names, start.tolist(), strict=True)),
        'terminal_constraints': [f'{name} - goal_{name}' for name in system.state_names],
        'input_bounds': {name: list(pair) for name, pair in bounds.items()},
        'state_bounds': {name: list(pair) for name, pair in _bounds(
            system, 'state', system.states, motion.state_bounds).items() if any(
                each is not None for each in pair)},
        'path_constraints': [{'expr': each, 'upper': 0} for each in motion.path_constraints]}
    if motion.objective == 'time':
        return found | _least_time(system, bounds)
    Qx = square('qx', motion.Qx if len(motion.Qx) else np.ones(system.n), system.n)
    Qu = square('qu', motion.Qu if len(motion.Qu) else np.ones(system.m), system.m)
    found['parameters'] |= {f'hold_{name}': float(value) for name, value in
                            zip(system.input_names, held, strict=True)}
    terms = _quadratic(found['parameters'], 'u', system.input_names, 'hold', Qu)
    if motion.objective == 'quadratic':
        terms = _quadratic(found['parameters'], 'x', system.state_names, 'goal', Qx) + terms
    found['running_cost'] = ' + '.join(terms) or '0'
    duration = motion.final_time or _settling_time(system, goal, held, Qx, Qu)
    return found | {'final_time': {'free': False, 'value': float(duration)}}


def _check_names(system: System) -> None:
    """Refuse a system with the name of a number of the statement."""
    own = {f'goal_{name}' for name in system.state_names}
    own |= {f'hold_{name}' for name in system.input_names}
    for name in (*system.state_names, *system.input_names, *(
            each.name for each in system.parameters)):
        if name in own or re.fullmatch(r'weight_[xu]\d+_\d+', name):
            raise StatementError(f"{system.name}: '{name}' is the name of a number of the plan; "
                                 'rename it')


def solve_motion(motion: Motion, time_limit: float, *, report: Report | None = None,
                 cache: Cache | None = None, max_intervals: int = MAX_INTERVALS, accept: str = '',
                 keep: Callable[[Problem, Solution], None] | None = None
                 ) -> tuple[Problem, Solution]:
    """
    Solve a motion; without a final time, 'effort' and 'quadratic' take twice the minimum time.

    :param motion: with names as users give them.
    :param time_limit: limit of the wall-clock time [s].
    :param report, cache, max_intervals, accept: as for `solve.solve`.
    :param keep: called with the problem and each path that is better than those before.
    :raises StatementError, DynamicsError: as `state_motion`.
    """
    begun = time.monotonic()
    if motion.objective != 'time' and not motion.final_time:
        motion = replace(motion, final_time=_ample_time(
            motion, time_limit / 2, report, cache, accept))
    problem = build_problem(state_motion(motion))
    left = max(0.0, time_limit - (time.monotonic() - begun))
    return problem, solve(
        problem, time_limit=left, report=report, cache=cache, max_intervals=max_intervals,
        accept=accept, keep=None if keep is None else lambda path: keep(problem, path))


def _ample_time(motion: Motion, time_limit: float, report: Report | None, cache: Cache | None,
                accept: str) -> float:
    """Return twice the minimum time of a motion; 0 if there is none or it is not found."""
    try:
        problem = build_problem(state_motion(replace(motion, objective='time')))
    except ObcError:
        return 0.0  # such as inputs without bounds; other errors are found again when it is solved
    solution = solve(problem, time_limit=time_limit, report=report, cache=cache, accept=accept)
    solved = solution.status in (Status.SOLVED, Status.FEASIBLE)
    return 2.0 * solution.objective if solved else 0.0


def _input_at(system: System, goal: Array) -> Array:
    """Return the input that holds the system at the goal; without one, its set point input."""
    try:
        return find_equilibrium(system, goal).u
    except DynamicsError:
        return np.array(system.setpoint_input)


def _bounds(system: System, kind: str, signals: Sequence[Signal], tighter: Mapping[str, Any]
            ) -> dict[str, tuple[float | None, float | None]]:
    """Return (lower, upper) by signal: the tighter of the system's and the given bounds."""
    own = {signal.name: (_or_none(signal.lower), _or_none(signal.upper)) for signal in signals}
    for name, (lower, upper) in tighter.items():
        if name not in own:
            article = 'an' if kind == 'input' else 'a'
            raise StatementError(f"{kind}_bounds: '{quote(name)}' is not {article} {kind} of "
                                 f'{system.name}; there {"is" if len(own) == 1 else "are"} '
                                 f'{", ".join(own)}')
        where, (low, high) = f'{kind}_bounds.{name}', own[name]
        own[name] = (_tighter(max, low, lower, where), _tighter(min, high, upper, where))
    return own


def _tighter(choose: Any, own: float | None, given: Any, where: str) -> float | None:
    if given is None:
        return own
    value = parse_number(given, {}, where)
    return value if own is None else choose(own, value)


def _or_none(bound: float) -> float | None:
    return bound if math.isfinite(bound) else None


def _least_time(system: System, bounds: Mapping[str, tuple[Any, Any]]) -> dict[str, Any]:
    for name, pair in bounds.items():
        for side, bound in zip(('lower', 'upper'), pair, strict=True):
            if bound is None:
                raise StatementError(
                    f"objective 'time': the input {name} of {system.name} has no {side} bound, "
                    'so that no minimum time exists; give one in input_bounds')
    return {'running_cost': '1',
            'final_time': {'free': True, 'lower': TIMES[0], 'upper': TIMES[1]}}


def _quadratic(parameters: dict[str, Any], letter: str, names: Sequence[str], about: str,
               Q: Array) -> list[str]:
    """Return the terms of z'Q z for z = name - about_name; the entries of Q become parameters."""
    terms = []
    for i, j in np.argwhere(Q):
        weight = f'weight_{letter}{i}_{j}'
        parameters[weight] = float(Q[i, j])
        one, other = (f'({name} - {about}_{name})' for name in (names[i], names[j]))
        terms.append(f'{weight}*{one}**2' if i == j else f'{weight}*{one}*{other}')
    return terms


def _settling_time(system: System, goal: Array, held: Array, Qx: Array, Qu: Array) -> float:
    """Return SETTLING time constants [s] of the regulator with these weights."""
    try:
        poles = lqr(*linearize(system, goal, held), Qx, Qu).E
    except (RefusedDesignError, DynamicsError):
        return UNKNOWN_TIME
    return float(SETTLING / -poles.real.max())
