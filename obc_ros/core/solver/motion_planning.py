# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A motion of a registered system from a start to a goal, stated as an optimal control problem.

'time': least T. 'effort': least integral of (u - ug)'Qu (u - ug). 'quadratic': least integral of
(x - xg)'Qx (x - xg) + (u - ug)'Qu (u - ug). Always x(T) = xg; ug is the input that holds the
system at the goal, as far as one does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.weights import square
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems import registry
from obc_ros.core.systems.equilibrium import check_numbers, find_equilibrium, linearize
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, quote, RefusedDesignError, StatementError
from obc_ros.core.text.expressions import parse_number

OBJECTIVES = ('time', 'effort', 'quadratic')
TIMES = (1e-3, 1e3)    # [s] among which a least time is looked for
SETTLING = 4.0         # time constants of the slowest pole that a motion may take
UNKNOWN_TIME = 1.0     # [s] for a system that no regulator stabilises at the goal


@dataclass(frozen=True, eq=False)
class Motion:
    """
    What is asked for.

    `parameters` and `input_bounds` are names with numbers or expressions, as in a problem file;
    `Qx` and `Qu` a diagonal or a full matrix row by row, or empty for the identity; `final_time`
    0 leaves the choice to `state_motion`.
    """

    system: str
    start: Sequence[float] | Array
    goal: Sequence[float] | Array
    objective: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    Qx: Sequence[float] | Array = ()
    Qu: Sequence[float] | Array = ()
    final_time: float = 0.0
    input_bounds: Mapping[str, Any] = field(default_factory=dict)


def state_motion(motion: Motion) -> dict[str, Any]:
    """
    Return the problem of a motion, as a mapping of the keys of a problem file.

    Its numbers are parameters, so that the next motion of the system has the same structure. The
    goal of an angle is the representation of it that is nearest to the start.

    Raises
    ------
    StatementError, DynamicsError
        If the system, a parameter, the objective, a size or a number is not as wanted.

    """
    if motion.objective not in OBJECTIVES:
        raise StatementError(f"objective = '{quote(motion.objective)}': wanted one of "
                             f'{", ".join(OBJECTIVES)}')
    system = find_registered(motion.system, motion.parameters)
    start = check_numbers('start', motion.start, system.state_names)
    goal = check_numbers('goal', motion.goal, system.state_names)
    goal = np.where(system.angles, start + np.remainder(goal - start + math.pi, 2 * math.pi)
                    - math.pi, goal)
    held = _input_at(system, goal)
    bounds = _bounds(system, motion.input_bounds)
    goals = {f'goal_{name}': float(value)
             for name, value in zip(system.state_names, goal, strict=True)}
    found: dict[str, Any] = {
        'name': f'{system.name}_{motion.objective}', 'system': system.name,
        'parameters': {**motion.parameters, **goals},
        'initial_state': dict(zip(system.state_names, start.tolist(), strict=True)),
        'terminal_constraints': [f'{name} - goal_{name}' for name in system.state_names],
        'input_bounds': {name: list(pair) for name, pair in bounds.items()}}
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
    time = motion.final_time or _settling_time(system, goal, held, Qx, Qu)
    return found | {'final_time': {'free': False, 'value': float(time)}}


def find_registered(name: str, parameters: Mapping[str, Any]) -> System:
    """
    Return a registered system.

    Parameters
    ----------
    name : str
        Registered name; never a file's.
    parameters : mapping
        By name: a number or an expression without names; for what the system is built of (its
        options) also a list of rows.

    """
    values = {key: value if isinstance(value, list) else
              parse_number(value, {}, f'parameters.{quote(key)}') for key,
              value in parameters.items()}
    return registry.get_registered(name, {
        key: int(value) if isinstance(value, float) and value.is_integer() else value
        for key, value in values.items()})


def _input_at(system: System, goal: Array) -> Array:
    """Return the input that holds the system at the goal; the system's own where none does."""
    try:
        return find_equilibrium(system, goal).u
    except DynamicsError:
        return np.array(system.setpoint_input)


def _bounds(system: System, tighter: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return bounds by input: the system's own, the tighter ones in their place."""
    own = {signal.name: (_or_none(signal.lower), _or_none(signal.upper))
           for signal in system.inputs}
    for name, (lower, upper) in tighter.items():
        if name not in own:
            raise StatementError(f"input_bounds: '{quote(name)}' is not an input of "
                                 f'{system.name}; there {"is" if system.m == 1 else "are"} '
                                 f'{", ".join(own)}')
        low, high = own[name]
        own[name] = (_tighter(max, low, lower, name), _tighter(min, high, upper, name))
    return own


def _tighter(choose: Any, own: float | None, given: Any, name: str) -> float | None:
    if given is None:
        return own
    value = parse_number(given, {}, f'input_bounds.{name}')
    return value if own is None else choose(own, value)


def _or_none(bound: float) -> float | None:
    return bound if math.isfinite(bound) else None


def _least_time(system: System, bounds: Mapping[str, tuple[Any, Any]]) -> dict[str, Any]:
    for name, pair in bounds.items():
        for side, bound in zip(('lower', 'upper'), pair, strict=True):
            if bound is None:
                raise StatementError(
                    f"objective 'time': the input {name} of {system.name} has no {side} bound, "
                    'so that there is no least time; give one in input_bounds')
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
    """Return a time [s] in which the regulator of these weights would get there."""
    try:
        poles = lqr(*linearize(system, goal, held), Qx, Qu).E
    except (RefusedDesignError, DynamicsError):
        return UNKNOWN_TIME
    return float(SETTLING / -poles.real.max())
