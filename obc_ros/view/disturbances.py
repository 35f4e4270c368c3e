# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which disturbances of the simulated plant act at a time, from its parameters."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
import math
from typing import Any

PREFIXES = 'disturbance.', 'noise.'
DIRECTIONS = {'px': (1.0, 0.0), 'vx': (1.0, 0.0), 'py': (0.0, 1.0), 'vy': (0.0, 1.0)}


@dataclass(frozen=True)
class Acting:
    """
    What acts on a plant.

    :ivar words: such as 'gust on vx'; empty: nothing.
    :ivar is_gust: whether a gust is among it.
    :ivar push: direction in the plane, its parts along px and py; empty: none.
    """

    words: tuple[str, ...] = ()
    is_gust: bool = False
    push: tuple[float, ...] = ()


class Disturbances:
    """
    The parameters `disturbance.*` and `noise.*` of a plant_simulator.

    :ivar epoch: stamp of the simulated time 0 [s].
    """

    def __init__(self) -> None:
        self.epoch = 0.0
        self._values: dict[str, float] = {}

    def take(self, values: Mapping[str, Any]) -> None:
        """Take over all parameters of a plant; others than those of disturbances are left out."""
        self._values = {
            name: value for name, value in values.items()
            if name.startswith(PREFIXES) and isinstance(value, float) and math.isfinite(value)}

    def change(self, values: Mapping[str, Any], gone: Collection[str]) -> None:
        """Take over new values of parameters, and forget those that are `gone`."""
        self.take({**{name: value for name, value in self._values.items() if name not in gone},
                   **values})

    def find(self, stamp: float) -> Acting:
        """Return what acts on the state of a stamp [s]."""
        phase = ((stamp - self.epoch - self._values.get('disturbance.gust_start', 0.0))
                 / max(self._values.get('disturbance.gust_duration', 1.0), 1e-9))
        gusts = self._list('disturbance.gust.') if 0.0 < phase < 1.0 else {}
        constants = self._list('disturbance.constant.')
        words = [f'{what} on {", ".join(found)}' for what, found in (
            ('gust', gusts), ('constant', constants)) if found]
        if self._list('noise.'):
            words.append('noise')
        push = [sum(found[name] * DIRECTIONS[name][axis] for found in (gusts, constants)
                    for name in found if name in DIRECTIONS) for axis in (0, 1)]
        return Acting(tuple(words), bool(gusts), tuple(push) if any(push) else ())

    def _list(self, prefix: str) -> dict[str, float]:
        """Return the values other than 0 of a group by the names of their states."""
        return {name.removeprefix(prefix): value for name, value in self._values.items()
                if name.startswith(prefix) and value}
