# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The control law u = ur - K (x - xr) about a reference, clipped to the limits.

It is evaluated at every state. Plain floats are used because they are several times faster than
arrays for the few states of a plant.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from operator import mul, sub
from typing import Any, NamedTuple, Protocol

Vector = tuple[float, ...]
Rows = tuple[Vector, ...]


class ReferencePoint(NamedTuple):
    """
    A point of a reference: state xr (n,), input ur (m,), and gain K (m, n).

    Ki (m, p) is the gain of the integrals; empty without integral action.
    """

    x: Vector
    u: Vector
    K: Rows
    Ki: Rows = ()


class ReferenceLaw(Protocol):
    """A reference and a gain over time."""

    def at(self, t: float) -> ReferencePoint:
        """Return the reference at time t [s]."""


@dataclass(frozen=True)
class Region:
    """The errors e with e'P e <= level: an ellipsoid about a set point."""

    P: Rows
    level: float

    def measure(self, e: Sequence[float]) -> float:
        """Return e'P e of an error e (n,)."""
        return sum([float(value * sum(map(mul, row, e)))
                    for value, row in zip(e, self.P, strict=True)])


@dataclass(frozen=True, eq=False)
class Gains:
    """
    Gains over time or another variable, interpolated linearly.

    :ivar grid: increasing values of the variable.
    :ivar K: an (m, n) gain for each value; outside the grid the nearest one is used.
    :ivar Ki: an (m, p) gain of the integrals for each value.
    """

    grid: Vector
    K: tuple[Rows, ...]
    Ki: tuple[Rows, ...]

    def at(self, value: float) -> tuple[Rows, Rows]:
        """Return K and Ki at a value of the variable."""
        k = bisect_right(self.grid, value) - 1
        if k < 0 or value != value:
            return self.K[0], self.Ki[0]
        if k + 1 >= len(self.grid):
            return self.K[-1], self.Ki[-1]
        part = (value - self.grid[k]) / (self.grid[k + 1] - self.grid[k])
        K, Ki = (tuple([interpolate_vectors(a, b, part) for a, b in zip(*rows, strict=True)])
                 for rows in ((self.K[k], self.K[k + 1]), (self.Ki[k], self.Ki[k + 1])))
        return K, Ki


@dataclass(frozen=True)
class StateFeedback:
    """
    State feedback about a set point that is constant or moves at a constant rate.

    :ivar x, u: set point xe (n,) at t = 0, and its input ue (m,).
    :ivar K: gain (m, n).
    :ivar drift: dxe/dt (n,).
    :ivar Ki: gain (m, p) of the integrals; empty without integral action.
    :ivar region: the errors for which the feedback is used; None: for all.
    :ivar gains: gains over time in place of K and Ki; None: they are constant.
    """

    x: Vector
    u: Vector
    K: Rows
    drift: Vector
    Ki: Rows = ()
    region: Region | None = None
    gains: Gains | None = None

    def at(self, t: float) -> ReferencePoint:
        """Return the set point at time t [s]."""
        point = self._start
        if any(self.drift):
            point = point._replace(x=move(self.x, self.drift, t))
        if self.gains is not None:
            K, Ki = self.gains.at(t)
            point = point._replace(K=K, Ki=Ki)
        return point

    @cached_property
    def _start(self) -> ReferencePoint:
        return ReferencePoint(self.x, self.u, self.K, self.Ki)


@dataclass(frozen=True)
class InputLimits:
    """
    Limits of the inputs, and the states that are angles.

    :ivar lower, upper: (m,) limits of the inputs.
    :ivar angles: indices of the states whose error is wrapped to [-pi, pi].
    """

    lower: Vector
    upper: Vector
    angles: tuple[int, ...] = ()

    def error(self, x: Sequence[float], xr: Sequence[float]) -> list[float]:
        """Return x - xr, shape (n,); angles in [-pi, pi]."""
        e = list(map(sub, x, xr))
        for i in self.angles:
            if not -math.pi <= e[i] <= math.pi:
                e[i] = math.remainder(e[i], math.tau)
        return e

    def clip(self, u: list[float]) -> None:
        """Clip u (m,) to the limits, in place."""
        for j, value in enumerate(u):
            if value < self.lower[j]:
                u[j] = self.lower[j]
            elif value > self.upper[j]:
                u[j] = self.upper[j]


def compute_feedback(point: ReferencePoint, e: Sequence[float]) -> list[float]:
    """Return ur - K e, shape (m,), without limits."""
    return [u - sum(map(mul, row, e)) for u, row in zip(point.u, point.K, strict=True)]


def move(x: Sequence[float], drift: Vector, t: float) -> Vector:
    """Return x + drift t."""
    return tuple([a + v * t for a, v in zip(x, drift, strict=True)]) if any(drift) else tuple(x)


def interpolate_vectors(a: Vector, b: Vector, part: float) -> Vector:
    """Return a + part (b - a)."""
    return tuple([p + part * (q - p) for p, q in zip(a, b, strict=True)])


def convert_rows(matrix: Sequence[Sequence[float]] | Any) -> Rows:
    """Return a matrix as a tuple of rows of floats."""
    return tuple(convert_vector(row) for row in matrix)


def convert_vector(values: Sequence[float] | Any) -> Vector:
    """Return numbers as a tuple of floats."""
    return tuple(map(float, values))
