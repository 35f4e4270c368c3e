# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Sensors of a simulated plant: noise, bias, rate, drop-outs and delay of each output.

Outputs with the same rate, drop-outs and delay are one sensor, whose measurements come in one
message. The same seed gives the same numbers, whatever is dropped.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError


@dataclass(frozen=True)
class OutputConditions:
    """
    How an output is measured.

    :ivar rate: measurements per simulated second [Hz]; 0: the output is not measured.
    :ivar noise, bias: standard deviation and mean of the error, in the unit of the output.
    :ivar dropout: probability with which a measurement is lost.
    :ivar delay: from the instant of the measurement to its publication [s].
    """

    rate: float = 0.0
    noise: float = 0.0
    bias: float = 0.0
    dropout: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class Reading:
    """A measurement: stamp [ns], names of the outputs, and their values."""

    stamp: int
    names: tuple[str, ...]
    y: Array


@dataclass(frozen=True, eq=False)
class _Sensor:
    """Outputs that are measured together; `every` and `delay` count published states."""

    at: Array
    names: tuple[str, ...]
    noise: Array
    bias: Array
    every: int
    delay: int
    dropout: float


class Sensors:
    """
    The sensors of a plant whose states come at a fixed rate.

    :param state_rate: states per simulated second [Hz], a multiple of each rate.
    :ivar settings: what the measurements depend on, to compare two objects.
    """

    def __init__(self, system: System, outputs: Mapping[str, OutputConditions],
                 state_rate: float, seed: int = 0) -> None:
        self.system, self._seed = system, seed
        self.settings = system.p_value.tolist(), dict(outputs), seed
        groups: dict[tuple[float, float, float], list[str]] = {}
        for name in system.output_names:
            given = outputs.get(name, OutputConditions())
            if given.rate:
                groups.setdefault((given.rate, given.dropout, given.delay), []).append(name)
        self._sensors = tuple(self._group(names, outputs, state_rate)
                              for names in groups.values())
        self.reset()

    def __repr__(self) -> str:
        return f'Sensors{self.settings}'

    def __len__(self) -> int:
        return len(self._sensors)

    def reset(self) -> None:
        """Repeat noise and drop-outs; forget what is not yet published."""
        self._random = np.random.default_rng((self._seed, 1))
        self._waiting: list[tuple[int, Reading]] = []
        self._last = -1

    def take(self, count: int, stamp: int, x: Array, u: Array) -> list[Reading]:
        """
        Measure a state, and return the measurements that are due for publication.

        :param count: number of the state since the start; one that was taken before gives nothing.
        :param stamp: of the state [ns].
        """
        if count == self._last or not self._sensors:
            return []
        self._last = count
        y = None
        for sensor in self._sensors:
            if count % sensor.every:
                continue
            y = self.system.measure(x, u)[0] if y is None else y
            noise = self._random.standard_normal(len(sensor.at))
            is_lost = self._random.random() < sensor.dropout
            if not is_lost:
                self._waiting.append((count + sensor.delay, Reading(
                    stamp, sensor.names, y[sensor.at] + sensor.bias + sensor.noise * noise)))
        due = [reading for at, reading in self._waiting if at <= count]
        self._waiting = [each for each in self._waiting if each[0] > count]
        return due

    def _group(self, names: list[str], outputs: Mapping[str, OutputConditions],
               state_rate: float) -> _Sensor:
        first = outputs[names[0]]
        every = round(state_rate / first.rate)
        if every < 1 or abs(every * first.rate - state_rate) > 1e-9 * state_rate:
            raise StatementError(f'measurement.{names[0]}.rate = {first.rate:g} Hz: wanted '
                                 f'publish_rate = {state_rate:g} Hz divided by a whole number')
        at = [self.system.output_names.index(name) for name in names]
        return _Sensor(
            np.array(at), tuple(names), np.array([outputs[name].noise for name in names]),
            np.array([outputs[name].bias for name in names]), every,
            math.ceil(first.delay * state_rate - 1e-9), first.dropout)
