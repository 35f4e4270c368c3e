# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of a set point: whether it moves, by which states and inputs, and whether it is given."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.lqr.design.design import LinearizedPlant
from obc_ros.core.systems.system import Signal
from obc_ros.core.text.errors import StatementError

SetPointValues = Sequence[float] | NDArray[np.float64]

_SPEEDS = ('m/s', 'rad/s')
_STILL = 1e-9  # [1/s] a smaller rate is a rounding error of 0
_AS_GIVEN = 1e-5  # relative; inputs are printed with six digits


def check_set_point(plant: LinearizedPlant, setpoint: Sequence[float],
                    setpoint_input: Sequence[float]
                    ) -> None:
    """
    Check that a moving set point is given explicitly, and that the given input holds it.

    :param plant: the plant at the set point.
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
    """
    Describe the set point xe with its motion, and its input ue.

    :param plant: the plant at the set point.
    """
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
