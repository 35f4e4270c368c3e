# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Limits of the inputs: conversion of the parameter `u_limits`, and its error messages."""

from collections.abc import Mapping, Sequence
import math
from typing import Any

from obc_ros.core.closed_loop.feedback import convert_vector, Vector
from obc_ros.core.lqr.design.design import LinearizedPlant
from obc_ros.core.lqr.weights import count
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError


def resolve_input_limits(plant: LinearizedPlant, given: Sequence[float]) -> tuple[Vector, Vector]:
    """
    Return lower and upper limits of the inputs, shape (m,) each.

    :param plant: the plant at a set point; its input must lie within the limits.
    :param given: m numbers: the maximum absolute value of each input, within the limits of the
        system. 2 m numbers: lower and upper limit of each input in turn, in place of those of the
        system; infinite: the limit of the system. Empty: the limits of the system.
    :return: lower, upper: (m,) each.
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
    Check that every input has both limits.

    :param plant: the plant at a set point.
    :param given: as for `resolve_input_limits`.
    :param lower, upper: (m,) the limits that follow.
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
    lower, upper = system.u_min.tolist(), system.u_max.tolist()
    lower = _numbers(given.get('u_min')) or lower
    upper = _numbers(given.get('u_max')) or upper
    pairs = ', '.join(f'LOWEST_{name}, HIGHEST_{name}' for name in system.input_names)
    if len(lower) == len(upper) == system.m:
        pairs = ', '.join(_yaml(bound) for both in zip(lower, upper, strict=True)
                          for bound in both)
    names = ' and '.join(given)
    return (f'{names} {"do" if len(given) > 1 else "does"} not limit the inputs: write '
            f'u_limits: [{pairs}]')


def _numbers(given: Any) -> list[float]:
    try:
        return [float(each) for each in given] if not isinstance(given, str) else []
    except (TypeError, ValueError):
        return []


def _yaml(value: float) -> str:
    return str(value).replace('inf', '.inf')
