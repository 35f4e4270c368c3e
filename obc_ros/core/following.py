# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Following a reference xd(t), ud(t): the cost in terms of (x - xd) and (u - ud).

u = ud(t) - K(t) (x - xd(t)), where K = Qu^-1 (B'P + N') and P solves the Riccati differential
equation (2.7) along the path, backwards from the design that holds its end.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from obc_ros.core import stretches
from obc_ros.core.control import Leg, Reference
from obc_ros.core.design import Design, design_again, Plant, plant
from obc_ros.core.equilibrium import linearize, nearest
from obc_ros.core.errors import DynamicsError, RefusedDesignError, StatementError
from obc_ros.core.regulator import Point, Regulator, Rows, rows, Vector, vector
from obc_ros.core.sampled import discretised
from obc_ros.core.system import System

Array = NDArray[np.float64]

MOST = 200_000  # samples
_INTERVALS = 300  # of the gain; in between it is interpolated
_AT_REST = 1e-5   # of a state's size: how near to rest an answer ends that is to end at rest


@dataclass(frozen=True, eq=False)
class Course:
    """
    A reference that was found to be well formed.

    Attributes
    ----------
    reference : Reference
        When it begins.
    t, x, u : ndarray, shape (N,), (N, n), (N, m)
        Samples; a time that stands twice is a jump.
    holds : bool
        Whether u is constant from each sample on; linear in between otherwise.

    """

    reference: Reference
    t: Array
    x: Array
    u: Array
    holds: bool


def course(system: System, names: tuple[Sequence[str], Sequence[str]], t: Sequence[float],
           x: Sequence[float], u: Sequence[float], interpolation: str, begin: int | None
           ) -> Course:
    """
    Return the reference that is given by plain numbers.

    Parameters
    ----------
    system : System
        Whose states and inputs these are.
    names : tuple of sequence of str
        Names of states and inputs, in the order of x and u; empty: that of the system.
    t, x, u : sequence of float
        N, N*n and N*m numbers, row by row.
    interpolation : str
        Of u: 'linear' or 'zoh'; empty: linear.
    begin : int, optional
        Stamp of t = 0 [ns]; None: the first state from now on.

    Raises
    ------
    StatementError
        If something does not fit.

    """
    times = np.array(t, dtype=float)
    if not 2 <= times.size <= MOST:
        raise StatementError(f'a reference has {times.size} samples; wanted 2 to {MOST}')
    if not np.isfinite(times).all() or times[0] < 0.0 or (np.diff(times) < 0.0).any():
        raise StatementError('t: wanted finite times from 0 on that do not decrease')
    if times[-1] <= times[0]:
        raise StatementError('t: the last time is not after the first')
    if interpolation not in ('', 'linear', 'zoh'):
        raise StatementError(f"interpolation = '{interpolation[:60]}': wanted 'linear' or 'zoh'")
    states = _table('x', x, times.size, system.state_names, names[0])
    inputs = _table('u', u, times.size, system.input_names, names[1])
    for i, is_angle in enumerate(system.angles):
        if is_angle:
            states[:, i] = np.unwrap(states[:, i])
    return Course(Reference(begin, float(times[-1])), times, states, inputs,
                  interpolation == 'zoh')


def leg(along: Course, found: Design) -> tuple[Leg, str]:
    """
    Return the law along a reference, with the weights of a design, and how it ends in words.

    Raises
    ------
    DynamicsError
        If the system cannot be linearised along it.

    """
    after, P1, ending = _end(along, found)
    length, period = along.t[-1] - along.t[0], found.lqr.period
    cells = min(_INTERVALS, len(along.t) - 1)
    if period:
        cells = max(1, min(cells, int(length / period)))
    grid = np.linspace(along.t[0], along.t[-1], cells + 1)
    return Leg(along.reference, Path(
        vector(along.t), rows(along.x), rows(along.u), along.holds, vector(grid),
        tuple(rows(K) for K in _gains(along, found, grid, P1))), after), ending


@dataclass(frozen=True, eq=False)
class Path:
    """
    The law along a reference.

    Attributes
    ----------
    t, x, u, holds
        As of a `Course`.
    grid : tuple of float
        Equidistant times of the gains.
    gains : tuple
        An (m, n) gain for each of them.

    """

    t: Vector
    x: Rows
    u: Rows
    holds: bool
    grid: Vector
    gains: tuple[Rows, ...]

    def at(self, t: float) -> Point:
        """Return reference and gain at time t [s]; before the first sample that one."""
        t = min(max(t, self.t[0]), self.t[-1])
        k = min(bisect_right(self.t, t), len(self.t) - 1) - 1
        while self.t[k] == self.t[k + 1]:
            k -= 1  # the last sample stands twice
        part = (t - self.t[k]) / (self.t[k + 1] - self.t[k])
        u = self.u[k] if self.holds else _between(self.u[k], self.u[k + 1], part)
        place = (t - self.grid[0]) / (self.grid[-1] - self.grid[0]) * (len(self.grid) - 1)
        j = min(int(place), len(self.grid) - 2)
        K = tuple([_between(a, b, place - j)
                   for a, b in zip(self.gains[j], self.gains[j + 1], strict=True)])
        return Point(_between(self.x[k], self.x[k + 1], part), u, K)


def _between(a: Vector, b: Vector, part: float) -> Vector:
    return tuple([p + part * (q - p) for p, q in zip(a, b, strict=True)])


def _end(along: Course, found: Design) -> tuple[Regulator, Array, str]:
    """Return the regulator that goes on from the end, its P, and what it does in words."""
    system, x = found.plant.system, along.x[-1]
    try:
        there = _place(system, along)
    except DynamicsError as error:
        return found.regulator, found.lqr.P, f'then the set point is held, as {error}'
    try:
        held = design_again(found, there)
    except RefusedDesignError as error:
        still = Regulator(vector(x), there.rest, ((0.0,) * system.n,) * system.m,
                          (0.0,) * system.n)
        return still, found.lqr.P, f'then its end is not held but left alone: {error}'
    return held.regulator, held.lqr.P, 'then its end is held'


def _place(system: System, along: Course) -> Plant:
    """Return the plant at the end of a reference, or at the rest that it was solved to end in."""
    x, u, size = along.x[-1], along.u[-1], np.abs(along.x).max(axis=0)
    try:
        return plant(system, x.tolist(), u.tolist())
    except DynamicsError:
        near = nearest(system, x, u)
        if (np.abs(near.x - x) > _AT_REST * np.maximum(size, 1e-2 * size.max())).any():
            raise
        return plant(system, near.x.tolist(), near.u.tolist())


def _gains(along: Course, found: Design, grid: Array, P1: Array) -> list[Array]:
    """Return the gains (m, n) at the times of a grid, backwards from P1 at the last."""
    n, P, gains = found.plant.system.n, P1, []
    step = _sampled_step if found.lqr.period else _step
    for k in range(len(grid) - 1, -1, -1):
        # of an interval its middle, of the end the end
        is_end = k == len(grid) - 1
        time = grid[k] if is_end else 0.5 * (grid[k] + grid[k + 1])
        A, B = found.augmented(*linearize(found.plant.system, *_sample(along, float(time))))
        P, K = step(A, B, found, P, 0.0 if is_end else float(grid[k + 1] - grid[k]))
        gains.append(K[:, :n])
    if not all(np.isfinite(K).all() for K in gains):
        raise DynamicsError('the gain along the reference is not finite')
    return gains[::-1]


def _step(A: Array, B: Array, found: Design, P: Array, time: float) -> tuple[Array, Array]:
    """Return P a time [s] earlier, and the gain there."""
    weights = found.cost
    N = np.zeros_like(B) if weights.cross is None else weights.cross
    right = np.linalg.solve(weights.Qu, np.hstack([B.T, N.T]))
    B_right, N_right = right[:, :len(A)], right[:, len(A):]
    if time:
        M = A - B @ N_right + weights.stability * np.eye(len(A))
        P = stretches.before(stretches.of_plant(
            M, B @ B_right, weights.Qx - N @ N_right, time), P[None])[0]
    return P, B_right @ P + N_right


def _sampled_step(A: Array, B: Array, found: Design, P: Array, time: float
                  ) -> tuple[Array, Array]:
    """Return P a time [s] earlier, in whole periods, and the gain there."""
    period = found.lqr.period
    A, B, cost = discretised(A, B, found.cost, period)
    N = np.zeros_like(B) if cost.cross is None else cost.cross
    growth = np.exp(2.0 * cost.stability * period)
    for _ in range(round(time / period)):
        before, BP = P, growth * B.T @ P
        right = BP @ A + N.T
        P = growth * A.T @ P @ A + cost.Qx - right.T @ np.linalg.solve(cost.Qu + BP @ B, right)
        P = 0.5 * (P + P.T)
        if np.abs(P - before).max() <= 1e-13 * np.abs(P).max():
            break
    BP = growth * B.T @ P
    return P, np.linalg.solve(cost.Qu + BP @ B, BP @ A + N.T)


def _sample(along: Course, t: float) -> tuple[Array, Array]:
    x = np.array([np.interp(t, along.t, column) for column in along.x.T])
    if along.holds:
        return x, along.u[max(0, int(np.searchsorted(along.t, t, 'right')) - 1)]
    return x, np.array([np.interp(t, along.t, column) for column in along.u.T])


def _table(name: str, numbers: Sequence[float], count: int, wanted: tuple[str, ...],
           given: Sequence[str]) -> Array:
    if given and sorted(given) != sorted(wanted):
        raise StatementError(f'{name}: the reference has {", ".join(given)[:200]}; wanted '
                             f'{", ".join(wanted)}')
    values = np.array(numbers, dtype=float)
    if values.size != count * len(wanted):
        raise StatementError(f'{name} has {values.size} numbers; wanted {count} x {len(wanted)}')
    if not np.isfinite(values).all():
        raise StatementError(f'{name}: wanted finite numbers')
    table = values.reshape(count, len(wanted))
    return table[:, [list(given).index(each) for each in wanted]] if given else table
