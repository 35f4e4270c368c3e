# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Conditions of a simulation, and integration between two jumps of the command, compiled.

    dx/dt = f(x, a(t)) + d(t)

a is the output of the actuators, da/dt = (target - a) / lag. It is known in closed form, and so is
the disturbance d, a constant plus a gust. One step is one CasADi function on buffers that creates
no Python object: a step of the aircraft takes half a microsecond.

Times are counted in steps of dt and need not be integers.
"""

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
import math

import casadi as ca
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.runge_kutta import DORMAND_PRINCE, RK4, Slope, take_step
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, StatementError

INTEGRATORS = ('rk4', 'adaptive')
SMALLEST_TOLERANCE = 1e-12
SMALLEST_TIME = 1e-9  # [s]

Kernel = tuple[Callable[[], None], Callable[[], None]]

_SNAP = 1e-9            # of a step: an event this near to the grid is moved to it
_LAST_WHOLE = 2.0**53   # every larger double is an integer
_ROUNDING = 1e-15       # relative rounding error of a step; a smaller step does not reduce it
_SMALLEST_STEP = 1e-13  # [s]
_MOST_STEPS = 100_000   # between two jumps; more would block the caller


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
    Conditions of a simulation besides the dynamics; see plant_simulator in docs/parameters.md.

    A list has one number for each state or input, one for all, or none, which means zeros.

    :ivar dt: step [s].
    :ivar integrator: 'rk4' (fixed step) or 'adaptive' (Dormand and Prince, order 5).
    :ivar tolerance: for 'adaptive': bound of the estimated error per second of simulated time, in
        each state relative to max(1, |x|).
    :ivar noise: (n,) standard deviation of each published state.
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


def snap_to_grid(time: float) -> float:
    """Return a time [steps], rounded to the grid if it is within 1e-9 steps of it."""
    if not abs(time) < _LAST_WHOLE:
        return time
    whole = round(time)
    return float(whole) if abs(time - whole) <= _SNAP else time


class PlantFlow:
    """
    A state, its input and its disturbance.

    :ivar edges: start and end of the gust [steps]; empty if there is none.
    """

    def __init__(self, system: System, conditions: Conditions) -> None:
        n, m = system.n, system.m
        self._system, self._conditions = system, conditions
        self._buffers = array('d', bytes(8 * n)), array('d', bytes(8 * n))
        self._here = 0  # which buffer holds the state
        self._span = array('d', [0.0, conditions.dt])  # time since the drive began, step [s]
        self._error = array('d', [0.0])
        gust = conditions.gust
        # target, delivered when the drive began, disturbance, gust: amplitude, start, duration
        self._drive = array('d', [*bytes(2 * m), *conditions.disturbance, *gust.amplitude,
                                  0.0, gust.duration])
        self._began = 0.0
        self._proposed = conditions.dt
        self._lagging = any(conditions.actuator_lag)
        self.edges = tuple(snap_to_grid(time / conditions.dt) for time in (
            gust.start, gust.start + gust.duration)) if any(gust.amplitude) else ()
        self._kernels: dict[bool, Kernel] = {}
        self._kept: list[object] = []  # kernels have raw pointers to these objects

    @property
    def x(self) -> 'array[float]':
        """Return the buffer of the state; the next step may overwrite it."""
        return self._buffers[self._here]

    @x.setter
    def x(self, x: Sequence[float] | Array) -> None:
        self._buffers[self._here][:] = array('d', x)

    def restart(self, x: Sequence[float] | Array) -> None:
        """Begin with a state (n,) and the initial step size."""
        self.x = x
        self._proposed = self._conditions.dt

    def drive(self, now: float, target: Sequence[float]) -> None:
        """Let the actuators follow a target (m,) from now on."""
        m = self._system.m
        if self._lagging:
            self._drive[m:2 * m] = array('d', self.delivered(now))
        self._drive[:m] = array('d', target)
        self._drive[-2] = self._conditions.gust.start - now * self._conditions.dt
        self._began = now

    def deliver(self, u: Sequence[float] | Array) -> None:
        """Set the output of the actuators (m,) at the last call of `drive`."""
        self._drive[self._system.m:2 * self._system.m] = array('d', u)

    def delivered(self, now: float) -> tuple[float, ...]:
        """Return the output of the actuators, (m,)."""
        m = self._system.m
        s = (now - self._began) * self._conditions.dt
        return tuple(c + (a - c) * math.exp(-s / lag) if lag else c for c, a, lag in zip(
            self._drive[:m], self._drive[m:2 * m], self._conditions.actuator_lag, strict=True))

    def run(self, now: float, stop: float) -> None:
        """Integrate from now to stop [steps]; inputs and gust must not jump in between."""
        gusty = bool(self.edges) and self.edges[0] <= now < self.edges[1]
        if gusty not in self._kernels:
            self._kernels[gusty] = self._compiled(gusty)
        kernel = self._kernels[gusty]
        if self._conditions.integrator == 'adaptive':
            self._adapt(kernel, now, stop)
        else:
            self._march(kernel, now, stop, steady=not (gusty or self._lagging))

    def _march(self, kernel: Kernel, now: float, stop: float, steady: bool) -> None:
        """Take the steps of the grid; the first and the last may be shorter."""
        while now < stop:
            whole = int(stop - now) if now == int(now) else 0
            if whole and steady:
                self._repeat(kernel, whole)
                now += whole
            else:
                until = now + 1.0 if whole else min(float(int(now) + 1), stop)
                self._step(kernel, now, until - now)
                self._here ^= 1
                now = until

    def _step(self, kernel: Kernel, now: float, length: float) -> None:
        dt = self._conditions.dt
        self._span[0], self._span[1] = (now - self._began) * dt, length * dt
        kernel[self._here]()

    def _repeat(self, kernel: Kernel, count: int) -> None:
        """Take whole steps with a constant input and disturbance."""
        self._span[1] = self._conditions.dt
        there, back = kernel[self._here], kernel[self._here ^ 1]
        for _ in range(count // 2):
            there()
            back()
        if count % 2:
            there()
            self._here ^= 1

    def _adapt(self, kernel: Kernel, now: float, stop: float) -> None:
        """Keep the estimated error of each step below the tolerance times its length [s]."""
        dt, tolerance = self._conditions.dt, self._conditions.tolerance
        for _ in range(_MOST_STEPS):
            if now >= stop:
                return
            wanted = self._proposed
            length = wanted if now + wanted / dt < stop else (stop - now) * dt
            self._step(kernel, now, length / dt)
            error, bound = self._error[0], max(tolerance * length, _ROUNDING)
            if error <= bound:
                self._here ^= 1
                now = now + length / dt if length == wanted else stop
                growth = min(5.0, 0.9 * (bound / max(error, 1e-300))**0.25)
                # A step that was shortened for an event must not reduce the next step.
                self._proposed = max(growth * length, 0.0 if length == wanted else wanted)
                continue
            shrinkage = 0.9 * (bound / error)**0.25 if math.isfinite(error) else 0.0
            self._proposed = max(0.2, shrinkage) * length
            if self._proposed < _SMALLEST_STEP:
                raise DynamicsError(f'the tolerance requires a step below {_SMALLEST_STEP:g} s')
        raise DynamicsError(f'the tolerance requires more than {_MOST_STEPS} steps')

    def _compiled(self, gusty: bool) -> Kernel:
        """Return the step from the first buffer to the second, and the one back."""
        x = self._system.x
        span, drive = ca.SX.sym('span', 2), ca.SX.sym('drive', len(self._drive))
        slope = self._slope(drive, gusty)
        if self._conditions.integrator == 'adaptive':
            after, difference = take_step(DORMAND_PRINCE, slope, x, span[0], span[1])
            error = ca.SX(0)
            for each in ca.vertsplit(
                    ca.fabs(difference) / ca.fmax(1.0, ca.fmax(ca.fabs(x), ca.fabs(after)))):
                error = ca.fmax(error, each)
            # fmax ignores NaN, a sum does not.
            results = [after, ca.if_else(ca.sum1(difference) == ca.sum1(difference),
                                         error, math.inf)]
        else:
            results = [take_step(RK4, slope, x, span[0], span[1])[0]]
        function = ca.Function('step', [x, span, drive], [ca.densify(each) for each in results])
        return self._bound(function, 0), self._bound(function, 1)

    def _slope(self, drive: ca.SX, gusty: bool) -> Slope:
        """Return dx/ds of x and the time s since the drive began."""
        system, conditions = self._system, self._conditions
        n, m = system.n, system.m
        f = ca.Function('f', [system.x, system.u],
                        [ca.substitute(system.xdot, system.p, ca.DM(system.p_value))])
        target, before, constant, amplitude, start, duration = ca.vertsplit(
            drive, [0, m, 2 * m, 2 * m + n, 2 * m + 2 * n, 2 * m + 2 * n + 1, len(self._drive)])

        def slope(x: ca.SX, s: ca.SX) -> ca.SX:
            delivered = ca.vertcat(*(
                target[j] + (before[j] - target[j]) * ca.exp(-s / lag) if lag else target[j]
                for j, lag in enumerate(conditions.actuator_lag)))
            shape = (1 - ca.cos(2 * math.pi * (s - start) / duration)) / 2 if gusty else 0
            return f(x, delivered) + constant + amplitude * shape

        return slope

    def _bound(self, function: ca.Function, source: int) -> Callable[[], None]:
        """Return a call without arguments that steps from one buffer to the other."""
        buffer, evaluate = function.buffer()
        for index, values in enumerate((self._buffers[source], self._span, self._drive)):
            buffer.set_arg(index, memoryview(values))  # type: ignore[call-arg] # as in C++
        for index, values in enumerate((self._buffers[source ^ 1], self._error)):
            if index < function.n_out():
                buffer.set_res(index, memoryview(values))  # type: ignore[call-arg] # as in C++
        self._kept.append(buffer)
        step: Callable[[], None] = evaluate
        return step


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
