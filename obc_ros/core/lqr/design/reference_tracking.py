# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Tracking of a reference xd(t), ud(t) with a cost of (x - xd) and (u - ud); see docs/regulator.md.

A set point with a horizon is the special case of a constant reference.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from obc_ros.core.closed_loop.control import Horizon, Leg, Reference
from obc_ros.core.closed_loop.feedback import (
    convert_rows,
    convert_vector,
    Gains,
    interpolate_vectors,
    ReferencePoint,
    Rows,
    StateFeedback,
    Vector,
)
from obc_ros.core.lqr.design.design import Design, design_again, linearize_plant, LinearizedPlant
from obc_ros.core.lqr.sampled import discretize_cost
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.riccati import propagation
from obc_ros.core.systems.equilibrium import find_nearest_equilibrium, linearize
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, quote, RefusedDesignError, StatementError

MOST = 200_000  # samples
_INTERVALS = 300  # of the gain; in between it is interpolated
# A terminal weight changes the gain fast near the end. There the times to go decrease by the
# factor _CLOSER, _CLOSEST times, and each of the last _PERIODS periods has its own gain.
_CLOSER, _CLOSEST, _PERIODS = 2.0**(1.0 / 3.0), 60, 64
_AT_REST = 1e-5   # relative to a state: an end this near to an equilibrium is meant to be one


@dataclass(frozen=True, eq=False)
class Course:
    """
    The samples of a valid reference.

    :ivar t, x, u: (N,), (N, n), (N, m), samples; a repeated time is a jump.
    :ivar holds: whether u is constant from each sample to the next; otherwise linear in between.
    """

    reference: Reference
    t: Array
    x: Array
    u: Array
    holds: bool


def read_course(system: System, names: tuple[Sequence[str], Sequence[str]], t: Sequence[float],
                x: Sequence[float], u: Sequence[float], interpolation: str, begin: int | None
                ) -> Course:
    """
    Return the reference that is given by lists of numbers.

    :param names: names of states and inputs, in the order of x and u; empty: the order of the
        system.
    :param t, x, u: N, N*n and N*m numbers, row by row.
    :param interpolation: interpolation of u: 'linear' or 'zoh'; empty: linear.
    :param begin: stamp of t = 0 [ns]; None: that of the next state.
    :raises StatementError: if a list has a wrong length, a number is not finite, the times
        decrease, or a name is unknown.
    """
    times = np.array(t, dtype=float)
    if not 2 <= times.size <= MOST:
        raise StatementError(f'a reference has {times.size} samples; wanted 2 to {MOST}')
    if not np.isfinite(times).all() or times[0] < 0.0 or (np.diff(times) < 0.0).any():
        raise StatementError('t: wanted finite times, not negative and not decreasing')
    if times[-1] <= times[0]:
        raise StatementError('t: the last time is not after the first')
    if interpolation not in ('', 'linear', 'zoh'):
        raise StatementError(f"interpolation = '{quote(interpolation)}': wanted 'linear' or 'zoh'")
    states = _table('x', x, times.size, system.state_names, names[0])
    inputs = _table('u', u, times.size, system.input_names, names[1])
    for i, is_angle in enumerate(system.angles):
        if is_angle:
            states[:, i] = np.unwrap(states[:, i])
    return Course(Reference(begin, float(times[-1])), times, states, inputs,
                  interpolation == 'zoh')


def compute_tracking_law(along: Course, found: Design, P1: Array | None = None) -> tuple[Leg, str]:
    """
    Return the control law along a reference, and what happens at its end, as a clause.

    :param found: a design of the same system.
    :param P1: (n, n), terminal weight; default: P of the design at the end of the reference.
    :raises DynamicsError: if the system cannot be linearised along the reference.
    """
    at_end, after, ending = _end(along, found)
    grid = _grid(along.t[0], along.t[-1], found)
    gains = _gains(grid, found, _terminal(at_end, P1), lambda t: linearize(
        found.plant.system, *_sample(along, t)))
    path = LawAlongReference(convert_vector(along.t), convert_rows(along.x),
                             convert_rows(along.u), along.holds, gains)
    return Leg(along.reference, path, _settling(gains, after, at_end, P1)), ending


def compute_horizon_law(found: Design, time: float, P1: Array | None = None) -> Horizon:
    """
    Return the gains over a horizon to a set point, followed by the constant gain of the design.

    :param time: horizon T [s].
    :param P1: (n, n), terminal weight; default: P of the design, which makes the gain constant.
    """
    plant = found.plant
    gains = _gains(_grid(0.0, time, found), found, _terminal(found, P1),
                   lambda _: (plant.A, plant.B))
    return Horizon(time, _continued(gains, found))


@dataclass(frozen=True, eq=False)
class LawAlongReference:
    """The control law along a reference: the samples of a `Course`, and gains over t."""

    t: Vector
    x: Rows
    u: Rows
    holds: bool
    gains: Gains

    def at(self, t: float) -> ReferencePoint:
        """Return reference and gain at time t [s]; t is clipped to the range of the samples."""
        t = min(max(t, self.t[0]), self.t[-1])
        k = min(bisect_right(self.t, t), len(self.t) - 1) - 1
        while self.t[k] == self.t[k + 1]:
            k -= 1  # the time of the last sample is repeated
        part = (t - self.t[k]) / (self.t[k + 1] - self.t[k])
        u = self.u[k] if self.holds else interpolate_vectors(self.u[k], self.u[k + 1], part)
        return ReferencePoint(interpolate_vectors(self.x[k], self.x[k + 1], part), u,
                              *self.gains.at(t))


def _end(along: Course, found: Design) -> tuple[Design, StateFeedback, str]:
    """Return the design at the end, the feedback after the end, and the clause on the ending."""
    system, x = found.plant.system, along.x[-1]
    try:
        there = _place(system, along)
    except DynamicsError as error:
        return found, found.regulator, f'then the set point is held: {error}'
    try:
        held = design_again(found, there)
    except RefusedDesignError as error:
        still = StateFeedback(
            convert_vector(x), there.rest, ((0.0,) * system.n,) * system.m, (0.0,) * system.n,
            ((0.0,) * len(found.C),) * system.m)
        return found, still, f'then the input at rest is applied without feedback: {error}'
    return held, held.regulator, 'then its end is held'


def _place(system: System, along: Course) -> LinearizedPlant:
    """Return the plant at the end of a reference, or at an equilibrium next to it."""
    x, u, size = along.x[-1], along.u[-1], np.abs(along.x).max(axis=0)
    try:
        return linearize_plant(system, x.tolist(), u.tolist())
    except DynamicsError:
        near = find_nearest_equilibrium(system, x, u)
        if (np.abs(near.x - x) > _AT_REST * np.maximum(size, 1e-2 * size.max())).any():
            raise
        return linearize_plant(system, near.x.tolist(), near.u.tolist())


def _terminal(found: Design, P1: Array | None) -> Array:
    """Return the terminal weight of the plant augmented with the integrals."""
    P, n = found.lqr.P, found.plant.system.n
    if P1 is None:
        return P
    whole = np.zeros_like(P)
    whole[:n, :n], whole[n:, n:] = P1, P[n:, n:]
    return whole


def _settling(gains: Gains, after: StateFeedback, at_end: Design,
              P1: Array | None) -> StateFeedback:
    """Return the feedback after the end; its gain begins with the last one of the reference."""
    if P1 is None or after.K != at_end.regulator.K:
        return after
    return replace(after, gains=_continued(
        Gains((0.0,), gains.K[-1:], gains.Ki[-1:]), at_end)) if gains.grid[-1] else after


def _continued(gains: Gains, found: Design) -> Gains:
    """Append the gain of a design, after the time constant of its fastest pole."""
    speed, period = np.abs(found.lqr.E), found.lqr.period
    if period:
        speed = np.abs(np.log(np.maximum(speed, 1e-12))) / period
    time = max(period, 1.0 / float(speed.max()))
    last = found.regulator
    return Gains((*gains.grid, gains.grid[-1] + time), (*gains.K, last.K), (*gains.Ki, last.Ki))


def _grid(begin: float, end: float, found: Design) -> Array:
    """Return the times of the gains: equidistant, and closer towards the end."""
    length, period = end - begin, found.lqr.period
    if not period:
        last = 10.0 * length / _INTERVALS / _CLOSER**np.arange(_CLOSEST)
        return np.union1d(np.linspace(begin, end, _INTERVALS + 1), end - last)
    count = int(length / period * (1.0 + 1e-9))
    stride = max(1, -(-(count - _PERIODS) // _INTERVALS))
    to_go = np.union1d(np.arange(min(count, _PERIODS) + 1), np.arange(count, 0, -stride))
    times = end - period * to_go[::-1] if count else (begin, end)
    return np.array(times, dtype=float)


def _gains(grid: Array, found: Design, P1: Array,
           linear: Callable[[float], tuple[Array, Array]]) -> Gains:
    """Return the gains at the times of a grid, backwards from P1 at the last."""
    n, P, gains = found.plant.system.n, P1, []
    step = _sampled_step if found.lqr.period else _step
    for k in range(len(grid) - 1, -1, -1):
        # An interval is linearised at its midpoint.
        is_end = k == len(grid) - 1
        time = grid[k] if is_end else 0.5 * (grid[k] + grid[k + 1])
        A, B = found.augmented(*linear(float(time)))
        P, K = step(A, B, found, P, 0.0 if is_end else float(grid[k + 1] - grid[k]))
        gains.append(K)
    if not all(np.isfinite(K).all() for K in gains):
        raise DynamicsError('the gain along the reference is not finite')
    gains.reverse()
    return Gains(convert_vector(grid), tuple(convert_rows(K[:, :n]) for K in gains),
                 tuple(convert_rows(K[:, n:]) if len(found.C) else () for K in gains))


def _step(A: Array, B: Array, found: Design, P: Array, time: float) -> tuple[Array, Array]:
    """Return P at a time [s] before, and the gain at that time."""
    weights = found.cost
    N = np.zeros_like(B) if weights.cross is None else weights.cross
    right = np.linalg.solve(weights.Qu, np.hstack([B.T, N.T]))
    B_right, N_right = right[:, :len(A)], right[:, len(A):]
    if time:
        M = A - B @ N_right + weights.stability * np.eye(len(A))
        P = propagation.propagate_back(propagation.build_stretch(
            M, B @ B_right, weights.Qx - N @ N_right, time), P[None])[0]
    return P, B_right @ P + N_right


def _sampled_step(A: Array, B: Array, found: Design, P: Array, time: float
                  ) -> tuple[Array, Array]:
    """Return P at a time [s] before, rounded to whole periods, and the gain at that time."""
    period = found.lqr.period
    A, B, cost = discretize_cost(A, B, found.cost, period)
    N = np.zeros_like(B) if cost.cross is None else cost.cross
    growth, K = np.exp(2.0 * cost.stability * period), None
    for _ in range(round(time / period)):
        before, BP = P, growth * B.T @ P
        right = BP @ A + N.T
        K = np.linalg.solve(cost.Qu + BP @ B, right)
        P = growth * A.T @ P @ A + cost.Qx - right.T @ K
        P = 0.5 * (P + P.T)
        if np.abs(P - before).max() <= 1e-13 * np.abs(P).max():
            break
    BP = growth * B.T @ P
    return P, np.linalg.solve(cost.Qu + BP @ B, BP @ A + N.T) if K is None else K


def _sample(along: Course, t: float) -> tuple[Array, Array]:
    x = interpolate_columns(t, along.t, along.x)
    if along.holds:
        return x, along.u[max(0, int(np.searchsorted(along.t, t, 'right')) - 1)]
    return x, interpolate_columns(t, along.t, along.u)


def _table(name: str, numbers: Sequence[float], count: int, wanted: tuple[str, ...],
           given: Sequence[str]) -> Array:
    if given and sorted(given) != sorted(wanted):
        raise StatementError(f'{name}: the reference has {quote(", ".join(given), 200)}; wanted '
                             f'{", ".join(wanted)}')
    values = np.array(numbers, dtype=float)
    if values.size != count * len(wanted):
        raise StatementError(f'{name} has {values.size} numbers; wanted {count} x {len(wanted)}')
    if not np.isfinite(values).all():
        raise StatementError(f'{name}: wanted finite numbers')
    table = values.reshape(count, len(wanted))
    return table[:, [list(given).index(each) for each in wanted]] if given else table
