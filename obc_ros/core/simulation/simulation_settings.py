# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conditions of a simulation: step, actuators, delay, noise and disturbances."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math

from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError

INTEGRATORS = ('rk4', 'adaptive')
SMALLEST_TOLERANCE = 1e-12
SMALLEST_TIME = 1e-9  # [s]


@dataclass(frozen=True)
class Gust:
    """
    A single disturbance amplitude * (1 - cos(2 pi (t - start) / duration)) / 2.

    `amplitude` (n,) is in units of each state per second, `start` and `duration` in seconds.
    """

    amplitude: tuple[float, ...] = ()
    start: float = 0.0
    duration: float = 1.0

    def shape(self, time: float) -> float:
        """Return the gust at a time [s] as a fraction of its amplitude."""
        phase = (time - self.start) / self.duration
        return (1.0 - math.cos(2 * math.pi * phase)) / 2 if 0.0 < phase < 1.0 else 0.0


@dataclass(frozen=True)
class Conditions:
    """
    Conditions of a simulation besides the dynamics.

    A list has one number for each state or input, one for all, or none, which means zeros.

    :ivar dt: step [s].
    :ivar integrator: 'rk4' (fixed step) or 'adaptive' (Dormand and Prince, order 5).
    :ivar tolerance: for 'adaptive': bound of the estimated error per second of simulated time, in
        each state relative to max(1, |x|).
    :ivar actuator_lag: (m,) time constant of each actuator [s]; 0: none.
    :ivar input_delay: from a command to its effect [s].
    :ivar noise: (n,) standard deviation of each published state.
    :ivar disturbance: (n,) constant addition to each state's derivative.
    """

    dt: float = 1e-3
    integrator: str = 'rk4'
    tolerance: float = 1e-9
    actuator_lag: tuple[float, ...] = ()
    input_delay: float = 0.0
    noise: tuple[float, ...] = ()
    disturbance: tuple[float, ...] = ()
    gust: Gust = field(default_factory=Gust)
    seed: int = 0

    def fitted(self, system: System) -> 'Conditions':
        """Return these conditions with every list at its full length."""
        if self.integrator not in INTEGRATORS:
            raise StatementError(f"integrator = '{self.integrator}': wanted "
                                 f'{" or ".join(map(repr, INTEGRATORS))}')
        _at_least('dt', self.dt, SMALLEST_TIME)
        _at_least('tolerance', self.tolerance, SMALLEST_TOLERANCE)
        _at_least('input_delay', self.input_delay, 0.0)
        _at_least('seed', self.seed, 0)
        _at_least('gust start', self.gust.start, -math.inf)
        _at_least('gust duration', self.gust.duration, SMALLEST_TIME)
        states, inputs = system.state_names, system.input_names
        return replace(
            self,
            actuator_lag=_spread('actuator_lag', self.actuator_lag, inputs, 0.0),
            noise=_spread('noise', self.noise, states, 0.0),
            disturbance=_spread('disturbance', self.disturbance, states, -math.inf),
            gust=replace(self.gust, amplitude=_spread(
                'gust amplitude', self.gust.amplitude, states, -math.inf)))


def _at_least(name: str, value: float, least: float) -> None:
    if not (math.isfinite(value) and value >= least):
        wanted = f'of at least {least:g}' if math.isfinite(least) else 'that is finite'
        raise StatementError(f'{name} = {value:g}: wanted a number {wanted}')


def _spread(what: str, values: Sequence[float], names: Sequence[str],
            least: float) -> tuple[float, ...]:
    if len(values) not in (0, 1, len(names)):
        raise StatementError(f'{what}: wanted {len(names)} numbers ({", ".join(names)}), '
                             f'found {len(values)}')
    spread = tuple(map(float, values)) if len(values) == len(names) else (
        (float(values[0]) if values else 0.0,) * len(names))
    for name, value in zip(names, spread, strict=True):
        _at_least(f'{what} of {name}', value, least)
    return spread
