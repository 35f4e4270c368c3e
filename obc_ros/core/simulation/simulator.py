# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A simulated plant that holds each command until the next one.

A command is clipped to the limits and takes effect after the input delay and the actuator lag. No
clock is used: time is the number of steps times dt.
"""

from collections import deque
from collections.abc import Sequence
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.simulation.flow import Conditions, PlantFlow, snap_to_grid
from obc_ros.core.systems.equilibrium import check_numbers, find_equilibrium
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, StatementError

NumberList = Sequence[float] | Array


class Simulator:
    """
    A plant that is advanced by whole steps; equal calls give bitwise equal results.

    :param x0: (n,), optional, initial state; the system's set point if left out.
    :param u0: (m,), optional, input until the first command; `compute_resting_input` of x0 if left
        out.
    :ivar system, conditions: those in use; the lists of the conditions have their full length.
    :ivar rest: (m,) the input until the first command.
    :ivar steps: steps since the start.
    :ivar target: (m,) the command in effect, within the limits.
    """

    def __init__(self, system: System, x0: NumberList | None = None,
                 conditions: Conditions | None = None, u0: NumberList | None = None) -> None:
        self.system = system
        self.conditions = (conditions or Conditions()).fitted(system)
        self._flow = PlantFlow(system, self.conditions)
        self.reset(system.setpoint if x0 is None else x0, u0)

    @property
    def time(self) -> float:
        """Return the simulated time [s]."""
        return self.steps * self.conditions.dt

    @property
    def x(self) -> Array:
        """Return a copy of the state, shape (n,)."""
        return np.array(self._flow.x)

    @property
    def u(self) -> Array:
        """Return the present output of the actuators, shape (m,)."""
        return np.array(self._flow.delivered(self.steps))

    def slope(self, x: Array) -> Array:
        """Return dx/dt, shape (n,), of a state x (n,) with the present input and disturbance."""
        gust = self.conditions.gust
        return (self.system.f(x, self.u) + self.conditions.disturbance
                + gust.shape(self.time) * np.array(gust.amplitude))

    def measure(self) -> Array:
        """Return the state with new noise, shape (n,)."""
        if not any(self.conditions.noise):
            return self.x
        noise = np.array(self.conditions.noise)
        return self.x + noise * self._random.standard_normal(self.system.n)

    def reset(self, x0: NumberList | None = None, u0: NumberList | None = None) -> None:
        """Return to the initial state, or to another one; forget commands and repeat the noise."""
        if x0 is not None:
            self._x0 = check_numbers('x0', x0, self.system.state_names)
            self.rest = clip_input(compute_resting_input(self.system, self._x0) if u0 is None
                                   else check_numbers('u0', u0, self.system.input_names),
                                   self.system)
        self.steps = 0
        self.target = self.rest
        self._waiting: deque[tuple[float, tuple[float, ...]]] = deque()
        self._random = np.random.default_rng(self.conditions.seed)
        self._flow.restart(self._x0)
        self._flow.drive(0, self.target)
        self._flow.deliver(self.target)

    def configure(self, system: System, conditions: Conditions) -> None:
        """Change parameters and conditions, not dt, from now on; state and time stay."""
        if (system.state_names, system.input_names, conditions.dt) != (
                self.system.state_names, self.system.input_names, self.conditions.dt):
            raise StatementError('the states, the inputs and dt of a simulator cannot change')
        conditions = conditions.fitted(system)
        flow = PlantFlow(system, conditions)
        flow.restart(self.x)
        flow.drive(self.steps, self.target)
        flow.deliver(self.u)
        if conditions.seed != self.conditions.seed:
            self._random = np.random.default_rng(conditions.seed)
        self.system, self.conditions, self._flow = system, conditions, flow

    def command(self, u: NumberList) -> None:
        """Receive a command u (m,): clip it, and apply it after the input delay."""
        values = self._limited(u)
        delay = self.conditions.input_delay / self.conditions.dt
        if delay or self._waiting:
            # After the delay was shortened, a command must not overtake an earlier one.
            earliest = self._waiting[-1][0] if self._waiting else 0.0
            self._waiting.append((max(snap_to_grid(self.steps + delay), earliest), values))
        else:
            self._take_effect(self.steps, values)

    def advance(self, steps: int = 1) -> None:
        """Integrate a number of steps; with a DynamicsError, state and time are unchanged."""
        flow, before = self._flow, self._flow.x[:]
        now, end = float(self.steps), float(self.steps + steps)
        try:
            while now < end:
                stop = end
                if self._waiting or flow.edges:
                    self._take_due(now)
                    stop = min([end, *(at for at, _ in self._waiting),
                                *(edge for edge in flow.edges if edge > now)])
                flow.run(now, stop)
                now = stop
            self._take_due(now)
            if not math.isfinite(sum(flow.x)):
                raise DynamicsError('it exceeds the range of double precision')
        except DynamicsError as error:
            flow.x = before
            raise DynamicsError(f'the state cannot be integrated from t = {self.time:.6g} s: '
                                f'{error}') from None
        self.steps += steps

    def hold(self, steps: int) -> None:
        """Let a number of steps pass in which the state stays as it is."""
        self.steps += steps

    def _take_due(self, now: float) -> None:
        while self._waiting and self._waiting[0][0] <= now:
            self._take_effect(now, self._waiting.popleft()[1])

    def _take_effect(self, now: float, u: tuple[float, ...]) -> None:
        self._flow.drive(now, u)
        self.target = u

    def _limited(self, u: NumberList) -> tuple[float, ...]:
        try:
            values = tuple(map(float, u))
            sound = len(values) == self.system.m and math.isfinite(sum(values))
        except (TypeError, ValueError):
            sound = False
        if not sound:  # or so large that only the sum is infinite
            values = tuple(check_numbers('u', u, self.system.input_names))
        return clip_input(values, self.system)


def compute_resting_input(system: System, x: NumberList) -> Array:
    """
    Return the input that holds a state.

    If there is none, the input of the set point is returned, and the guess of the system if that
    is not an equilibrium either.
    """
    for state in (x, None):
        try:
            return find_equilibrium(system, state).u
        except DynamicsError:
            continue
    return np.array(system.setpoint_input)


def clip_input(u: NumberList, system: System) -> tuple[float, ...]:
    """Clip an input (m,) to the limits of the actuators."""
    return tuple([min(max(float(value), signal.lower), signal.upper)
                  for value, signal in zip(u, system.inputs, strict=True)])
