# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Checks of a set point: whether it moves, by which states and inputs, and whether it is given.

Also the parameter `u_limits`: its conversion, and its error messages.
"""

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.closed_loop.feedback import convert_vector, Vector
from obc_ros.core.lqr.design.design import LinearizedPlant
from obc_ros.core.lqr.weights import count
from obc_ros.core.systems.system import Signal, System
from obc_ros.core.text.errors import StatementError

SetPointValues = Sequence[float] | NDArray[np.float64]

_SPEEDS = ('m/s', 'rad/s')
_STILL = 1e-9  # [1/s] a smaller rate is a rounding error of 0
_AS_GIVEN = 1e-5  # relative; inputs are printed with six digits


def check_set_point(plant: LinearizedPlant, setpoint: Sequence[float],
                    setpoint_input: Sequence[float]) -> None:
    """
    Check that a moving set point is given explicitly, and that the given input holds it.

    :param setpoint, setpoint_input: the given n and m numbers; empty: those of the system.
    :raises StatementError: if the set point moves by a default state or input of the system, or if
        the given input is not the one that holds it. The message contains the line to write.
    """
    system, at = plant.system, plant.equilibrium
    for signal, given, value in zip(
            system.inputs, setpoint_input or at.u, at.u, strict=True):
        if abs(given - value) > _AS_GIVEN * max(1.0, abs(value)):
            raise StatementError(
                f'setpoint_input: {signal.name} = {given:g} is not used, because the set point '
                f'determines {_list_values([signal], [value])}; write this value, or omit '
                'setpoint_input')
    lines = []
    by_state, by_input = _movers(plant)
    if by_state and not setpoint:
        lines.append(f'setpoint: {_line(at.x)}')
    if by_input and not setpoint_input:
        lines.append(f'setpoint_input: {_line(at.u)}')
    if lines:
        raise StatementError(
            f'the set point of {system.name} moves, {_motion(plant)}, and must be given: '
            f'add {" and ".join(lines)} ({_list_values(system.states, at.x)}; '
            f'{_list_values(system.inputs, at.u)}), or another set point')


def describe_set_point(plant: LinearizedPlant) -> tuple[str, str]:
    """Describe the set point xe with its motion, and its input ue."""
    system, at = plant.system, plant.equilibrium
    motion = f', moving: {_motion(plant)}' if any(_movers(plant)) else ''
    return (f'xe: {_list_values(system.states, at.x)}{motion}',
            f'ue: {_list_values(system.inputs, at.u)}')


def _movers(plant: LinearizedPlant) -> tuple[bool, bool]:
    """Return whether a state and whether an input makes the set point move."""
    system, at = plant.system, plant.equilibrium
    fx, fu = system.jacobians(at.x, at.u)
    moving = at.drift != 0.0
    by_state = bool((moving @ (abs(fx * at.x) > _STILL)).any() or _speeds(system.states, at.x))
    by_input = bool((moving @ (abs(fu * at.u) > _STILL)).any() or _speeds(system.inputs, at.u))
    return by_state or bool(moving.any()) and not by_input, by_input


def _speeds(signals: Sequence[Signal], values: SetPointValues) -> list[str]:
    return [f'{signal.name} = {value:g} {signal.unit}'
            for signal, value in zip(signals, values, strict=True)
            if signal.unit in _SPEEDS and abs(value) > _STILL]


def _motion(plant: LinearizedPlant) -> str:
    system, at = plant.system, plant.equilibrium
    rates = [f'd{signal.name}/dt = {rate:g} {signal.unit or "1"}/s'
             for signal, rate in zip(system.states, at.drift, strict=True) if rate]
    return ', '.join(rates or [*_speeds(system.states, at.x), *_speeds(system.inputs, at.u)])


def _list_values(signals: Sequence[Signal], values: SetPointValues) -> str:
    return ', '.join(f'{signal.name} = {value:.6g} {signal.unit}'.rstrip()
                     for signal, value in zip(signals, values, strict=True))


def _line(values: SetPointValues) -> str:
    return f'[{", ".join(str(float(f"{value:.6g}")) for value in values)}]'


def resolve_input_limits(plant: LinearizedPlant, given: Sequence[float]) -> tuple[Vector, Vector]:
    """
    Return lower and upper limits of the inputs, shape (m,) each.

    :param given: m numbers: the maximum absolute value of each input, within the limits of the
        system. 2 m numbers: lower and upper limit of each input in turn, in place of those of the
        system; infinite: the limit of the system. Empty: the limits of the system.
    :raises StatementError: if the number of limits is wrong, or they exclude the input of the set
        point.
    """
    system = plant.system
    m, own = system.m, list(zip(system.u_min.tolist(), system.u_max.tolist(), strict=True))
    if len(given) not in (0, m, 2 * m):
        raise StatementError(
            f'u_limits has {count(len(given))}; wanted {m}, the maximum absolute value of each, '
            f'or {2 * m}, lower and upper limit of each, for {", ".join(system.input_names)}')
    bounds = own
    if len(given) == m:
        for name, size in zip(system.input_names, given, strict=True):
            if not size > 0.0:
                raise StatementError(f'u_limits of {name}: {size:g}; wanted a positive number, or '
                                     f'lower and upper limit of each input ({2 * m} numbers)')
        bounds = [(max(low, -size), min(high, size))
                  for size, (low, high) in zip(given, own, strict=True)]
    elif given:
        bounds = [(low if new_low == -math.inf else new_low, high if new_high == math.inf
                   else new_high) for new_low, new_high, (low, high) in zip(
                       given[::2], given[1::2], own, strict=True)]
    source = 'u_limits' if given else f'the limits of {system.name}'
    for name, value, (low, high) in zip(
            system.input_names, plant.equilibrium.u, bounds, strict=True):
        if not low < high:
            raise StatementError(f'{source} of {name}: the lower limit {low:g} is not below the '
                                 f'upper limit {high:g}')
        if not low <= value <= high:
            raise StatementError(f'the input of the set point, {name} = {value:.6g}, is outside '
                                 f'{source}, [{low:g}, {high:g}]')
    return convert_vector(low for low, _ in bounds), convert_vector(high for _, high in bounds)


def check_all_limited(plant: LinearizedPlant, given: Sequence[float], lower: Vector, upper: Vector
                      ) -> None:
    """
    Check that every input has both limits; the parameters are those of `resolve_input_limits`.

    :raises StatementError: if a limit is missing; the message contains the line to write.
    """
    free = [signal.name for signal, low, high in zip(
        plant.system.inputs, lower, upper, strict=True) if not math.isfinite(high - low)]
    if not free:
        return
    pairs = ', '.join(
        str(float(f'{bound:.6g}')) if math.isfinite(bound) else f'{word}_{signal.name}'
        for signal, low, high in zip(plant.system.inputs, lower, upper, strict=True)
        for word, bound in (('LOWEST', low), ('HIGHEST', high)))
    units = ', '.join(f'{signal.name} [{signal.unit or "1"}]' for signal in plant.system.inputs)
    what = f'u_limits leaves {" and ".join(free)} unlimited' if given else 'u_limits is missing'
    raise StatementError(
        f'the inputs of {plant.system.name} need limits, and {what}: add u_limits: [{pairs}] '
        f'(lower and upper limit of {units}), or unlimited: true if the plant is simulated')


def translate_former_limits(system: System, given: Mapping[str, Any]) -> str:
    """
    Return an error message that replaces the former parameters u_min and u_max by u_limits.

    :param given: values of u_min, u_max or both, of any type.
    """
    lower = _numbers(given.get('u_min')) or system.u_min.tolist()
    upper = _numbers(given.get('u_max')) or system.u_max.tolist()
    pairs = ', '.join(f'LOWEST_{name}, HIGHEST_{name}' for name in system.input_names)
    if len(lower) == len(upper) == system.m:
        pairs = ', '.join(str(bound).replace('inf', '.inf')   # of YAML
                          for both in zip(lower, upper, strict=True) for bound in both)
    names = ' and '.join(given)
    return (f'{names} {"do" if len(given) > 1 else "does"} not limit the inputs: write '
            f'u_limits: [{pairs}]')


def _numbers(given: Any) -> list[float]:
    try:
        return [float(each) for each in given] if not isinstance(given, str) else []
    except (TypeError, ValueError):
        return []
