# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the page shows of a loop: frames, and the names and units of its signals."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import LqrDesign, Trajectory

AT_REST = 1e-6   # largest rate of a set point that does not move


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

    @property
    def units(self) -> dict[str, str]:
        """Return the units by the names of states and inputs."""
        return {each.name: each.unit for each in (*self.states, *self.inputs)}


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


@dataclass(frozen=True, eq=False)
class FollowedPath:
    """
    A reference that lqr_node follows.

    Attributes
    ----------
    begin : float
        Time of its first sample [s], in the time of the frames.
    path : Trajectory
        The message, as received.

    """

    begin: float
    path: Trajectory

    def pack(self, plant: Plant, most: int) -> list[list[float | None]]:
        """Return at most `most` rows of time and states of a plant; none for another one's."""
        names, t = list(map(str, self.path.state_names)), np.asarray(self.path.t)
        if (sorted(names) != sorted(plant.state_names) or not len(t)
                or len(self.path.x) != len(t) * len(names)):
            return []
        keep = np.unique(np.linspace(0, len(t) - 1, most).astype(int))
        order = [names.index(name) for name in plant.state_names]
        x = np.reshape(self.path.x, (len(t), -1))[np.ix_(keep, order)]
        return [_finite([self.begin + time, *row]) for time, row in zip(t[keep], x, strict=True)]


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


class SetPoint:
    """
    The set point of a design, seen from a state.

    One that moves, such as that of the vehicle, is drawn beside the plant: where it is now only
    the regulator knows, so that there is no cost-to-go.

    Parameters
    ----------
    design : LqrDesign
        The design.

    """

    def __init__(self, design: LqrDesign) -> None:
        self._design, self._xe = design, np.asarray(design.xe, dtype=float)
        self._drift = _find_drift(design)

    def locate(self, x: Sequence[float]) -> Sequence[float]:
        """Return the set point; of one that moves, the point of its course nearest to x."""
        if not self._drift.any() or len(x) != len(self._xe):
            return list(self._xe)
        along = self._drift @ (np.asarray(x) - self._xe) / (self._drift @ self._drift)
        return list(self._xe + along * self._drift)

    def measure_cost(self, x: Sequence[float]) -> float:
        """Return the cost-to-go; NaN for a set point that moves."""
        return math.nan if self._drift.any() else measure_cost(self._design, x)


def _find_drift(design: LqrDesign) -> Array:
    """Return dx/dt at the set point of a registered system; zeros: at rest, or not known."""
    xe, ue = np.asarray(design.xe, dtype=float), np.asarray(design.ue, dtype=float)
    try:
        system = registry.get_system(design.system)
    except ObcError:
        return np.zeros(len(xe))
    if (len(xe), len(ue)) != (system.n, system.m):
        return np.zeros(len(xe))
    drift = np.asarray(system.f(xe, ue), dtype=float)
    moves = np.isfinite(drift).all() and np.abs(drift).max() > AT_REST
    return drift if moves else np.zeros(len(xe))


def measure_cost(design: LqrDesign, x: Sequence[float]) -> float:
    """Return the cost-to-go (x - xe)' P (x - xe) of a design."""
    if len(x) != len(design.xe):
        return math.nan
    error = np.asarray(x) - np.asarray(design.xe)
    return float(error @ np.reshape(design.p, (len(x), len(x))) @ error)
