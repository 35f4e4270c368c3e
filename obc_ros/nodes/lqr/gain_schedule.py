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
from obc_ros.core.text.errors import quote, StatementError


def make_schedule(found: Design, settings: Any) -> tuple[Schedule, str]:
    """
    Return the schedule of a design, and the verified properties as a clause.

    Parameters
    ----------
    found : Design
        The design at the set point.
    settings : Settings
        The parameters of lqr_node.

    Returns
    -------
    schedule : Schedule
        The gains.
    clause : str
        What was verified.

    Raises
    ------
    ObcError
        If there is no such schedule.

    """
    if len(settings.schedule_range) != 2:
        raise StatementError(f'schedule_range has {count(len(settings.schedule_range))}; wanted '
                             'the lowest and the highest value')
    return _scheduled(found, settings.schedule, settings.schedule_range, settings.setpoint,
                      settings.setpoint_input, settings.state_source == 'odom')


@functools.lru_cache(maxsize=4)
def _scheduled(found: Design, name: str, between: Vector, setpoint: Vector,
               setpoint_input: Vector, is_measured: bool) -> tuple[Schedule, str]:
    system = found.plant.system
    known = {each.name: each for each in (*system.inputs, *system.parameters)}
    if name not in known:
        raise StatementError(f"schedule: {system.name} has no input or parameter '{quote(name)}'; "
                             f'it has {", ".join(known)}')
    index = system.input_names.index(name) if name in system.input_names else -1
    if is_measured and known[name].unit != 'm/s':
        raise StatementError(f'schedule = {name}: odometry measures a speed in m/s only')
    if index < 0 and not is_measured:
        raise StatementError(f'schedule = {name}: a State does not contain this parameter; set '
                             'state_source = odom')
    made = schedule_gains(found, _plant_at(found, name, index, setpoint, setpoint_input), *between)
    changes = ('for any rate of change' if made.rate == math.inf else
               f'for rates of change up to {made.rate:.3g} per second')
    gains = Gains(convert_vector(made.values),
                  tuple(convert_rows(K[:, :system.n]) for K in made.K),
                  tuple(convert_rows(K[:, system.n:]) if len(found.C) else () for K in made.K))
    return (Schedule(gains, index),
            f'{len(made.values)} gains, stability verified on this range {changes}')


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
