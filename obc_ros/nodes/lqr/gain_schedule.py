# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Gain schedules of lqr_node over an input or a parameter of the plant."""

from collections.abc import Callable
import functools
import math
from typing import Any

from obc_ros.core.closed_loop.control import Schedule
from obc_ros.core.closed_loop.feedback import convert_rows, convert_vector, Gains, Vector
from obc_ros.core.lqr.design.design import (
    Design,
    linearize_plant,
    LinearizedPlant,
    schedule_gains,
)
from obc_ros.core.lqr.weights import count
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import quote, StatementError


def make_schedule(found: Design, settings: Any) -> tuple[Schedule | None, str]:
    """
    Return the schedule of a design, and the verified properties as a clause.

    :param found: the design at the set point.
    :param settings: the parameters of lqr_node.
    :return: schedule: the gains; None: the gain is constant, for want of a variable or its range;
        clause: for the sentence of the design; empty without a variable.
    :raises ObcError: if there is no such schedule.
    """
    if not settings.schedule:
        return None, ''
    is_measured = settings.state_source == 'odom'
    index = _find_variable(found.plant.system, settings.schedule, is_measured)
    if not settings.schedule_range:
        return None, f'the gain does not follow {settings.schedule} without schedule_range'
    if len(settings.schedule_range) != 2:
        raise StatementError(f'schedule_range has {count(len(settings.schedule_range))}; wanted '
                             'the lowest and the highest value')
    return _scheduled(found, settings.schedule, index, settings.schedule_range, settings.setpoint,
                      settings.setpoint_input)


def _find_variable(system: System, name: str, is_measured: bool) -> int:
    """Return the index of the input that is the scheduling variable; -1: a parameter is."""
    units = {each.name: each.unit for each in system.inputs}
    units |= {each.name: each.unit for each in system.parameters}
    if name not in units:
        raise StatementError(f"schedule: {system.name} has no input or parameter '{quote(name)}'; "
                             f'it has {", ".join(units)}')
    index = system.input_names.index(name) if name in system.input_names else -1
    if is_measured and units[name] != 'm/s':
        raise StatementError(f'schedule = {name}: odometry measures a speed in m/s only')
    if index < 0 and not is_measured:
        raise StatementError(f'schedule = {name}: a State does not contain this parameter; set '
                             'state_source = odom')
    return index


@functools.lru_cache(maxsize=4)
def _scheduled(found: Design, name: str, index: int, between: Vector, setpoint: Vector,
               setpoint_input: Vector) -> tuple[Schedule, str]:
    made = schedule_gains(found, _plant_at(found, name, index, setpoint, setpoint_input), *between)
    changes = ('for any rate of change' if made.rate == math.inf else
               f'for rates of change up to {made.rate:.3g} per second')
    n = found.plant.system.n
    gains = Gains(convert_vector(made.values),
                  tuple(convert_rows(K[:, :n]) for K in made.K),
                  tuple(convert_rows(K[:, n:]) if len(found.C) else () for K in made.K))
    low, high = between
    return Schedule(gains, index), (
        f'the gain follows {name} from {low:g} to {high:g}: {len(made.values)} gains, stability '
        f'verified on this range {changes}')


def _plant_at(found: Design, name: str, index: int, setpoint: Vector, setpoint_input: Vector
              ) -> Callable[[float], LinearizedPlant]:
    """Return the plant as a function of the value of an input or, below 0, a parameter."""
    system, ue = found.plant.system, found.plant.equilibrium.u

    def at(value: float) -> LinearizedPlant:
        if index < 0:
            return linearize_plant(system.with_parameters({name: value}), setpoint, setpoint_input)
        wanted = (*ue[:index], value, *ue[index + 1:])
        there = linearize_plant(system, setpoint, wanted)
        if there.equilibrium.u[index] != value:
            raise StatementError(f'schedule = {name}: the set point determines this input')
        return there

    return at
