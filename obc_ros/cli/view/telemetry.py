# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the page shows of a loop: frames, and the names and units of its signals."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import LqrDesign


@dataclass(frozen=True)
class Named:
    """Name, unit and limits of a state or an input."""

    name: str
    unit: str = ''
    angle: bool = False
    lower: float = -math.inf
    upper: float = math.inf


@dataclass(frozen=True)
class Plant:
    """The signals of a plant, and the plane in which it moves: 'horizontal', 'vertical' or ''."""

    system: str
    states: tuple[Named, ...]
    inputs: tuple[Named, ...]
    plane: str = ''

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the states."""
        return tuple(each.name for each in self.states)


@dataclass(frozen=True)
class Frame:
    """
    A loop at one instant.

    Attributes
    ----------
    time : float
        Stamp of the state [s].
    x, u : sequence of float
        Last state and last command; empty: none yet.
    goal : sequence of float
        Set point of the design in use; empty: none yet.
    cost : float
        Cost-to-go of the design in use at this state; NaN: no design yet.
    latency : float
        From the last answered state to its command [s], as published; NaN: unknown.

    """

    time: float
    x: Sequence[float]
    u: Sequence[float] = ()
    goal: Sequence[float] = ()
    cost: float = math.nan
    latency: float = math.nan

    def pack(self, number: int) -> dict[str, Any]:
        """Return the frame as JSON values; numbers that are not finite become None."""
        return {'n': number, 't': self.time, 'x': _finite(self.x), 'u': _finite(self.u),
                'goal': _finite(self.goal), 'cost': _finite([self.cost])[0],
                'latency': _finite([1e3 * self.latency])[0]}


def _finite(values: Sequence[float]) -> list[float | None]:
    return [float(each) if math.isfinite(each) else None for each in values]


def describe_plant(design: LqrDesign) -> Plant:
    """Return the signals of the plant of a design, with units and limits of a registered one."""
    names = tuple(map(str, design.state_names)), tuple(map(str, design.input_names))
    try:
        system = registry.get_system(design.system)
    except ObcError:
        return Plant(design.system, *(tuple(map(Named, group)) for group in names))
    if (system.state_names, system.input_names) != names:
        return Plant(design.system, *(tuple(map(Named, group)) for group in names))
    return Plant(
        system.name, tuple(Named(each.name, each.unit, each.angle) for each in system.states),
        tuple(Named(each.name, each.unit, False, each.lower, each.upper)
              for each in system.inputs), system.plane)


def measure_cost(design: LqrDesign, x: Sequence[float]) -> float:
    """Return the cost-to-go (x - xe)' P (x - xe) of a design."""
    if len(x) != len(design.xe):
        return math.nan
    error = np.asarray(x) - np.asarray(design.xe)
    return float(error @ np.reshape(design.p, (len(x), len(x))) @ error)
