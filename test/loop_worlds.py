# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Control loops of one planar mass in several worlds, which have to command the same.

In one world all stamps are later, in one the plane is turned, in one every message arrives twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
import math
from typing import NamedTuple

from loop_bench import MS
import numpy as np
from obc_ros.core.closed_loop.control import Control, Leg, Prediction, Reference, Rules
from obc_ros.core.closed_loop.feedback import (
    InputLimits,
    ReferencePoint,
    Region,
    StateFeedback,
    Vector,
)
from obc_ros.core.closed_loop.laws import PlanLaw
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.closed_loop.modes import Mode

NAMES = 'px', 'py', 'vx', 'vy'
PERIOD = 100 * MS            # of plans and predictions
ALLOWED = ((-1.0, 1.0),) * 4
GAIN = np.array([[1.0, 0.3, 2.0, 0.1], [-0.2, 1.5, 0.4, 1.8]])
TARGETS = ((0.0, 0.0), (3.1, -1.7), (-20.3, 8.9))
DRIFTS = ((0.0, 0.0), (2.0, 0.0), (1.3, -0.7))


class Setup(NamedTuple):
    """The parameters of a loop, in the coordinates of the first world."""

    rules: Rules = Rules()
    gain: float = 1.0
    target: Vector = TARGETS[0]
    drift: Vector = DRIFTS[0]
    limit: float = math.inf
    delay: int = 0            # periods
    has_integral: bool = False
    has_region: bool = False
    longest: float = math.inf
    legs: tuple[int, ...] = ()


class Route(NamedTuple):
    """A straight reference: its beginning [ns] or None, duration [s], start and velocity."""

    begin: int | None
    duration: float
    start: Vector
    velocity: Vector
    is_judged: bool

    def place(self, t: float) -> list[float]:
        """Return the state (4,) at a time [s], at rest after the end."""
        moves = t < self.duration
        s = min(t, self.duration)
        return [*(a + v * s for a, v in zip(self.start, self.velocity, strict=True)),
                *(v * moves for v in self.velocity)]


@dataclass(frozen=True)
class Line:
    """A reference that moves at a constant velocity."""

    x: Vector
    rate: Vector
    u: Vector
    K: tuple[Vector, ...]

    def at(self, t: float) -> ReferencePoint:
        """Return its point at a time [s]."""
        return ReferencePoint(tuple(a + v * t for a, v in zip(self.x, self.rate, strict=True)),
                              self.u, self.K)


@dataclass
class World:
    """A loop whose stamps are shifted [ns] and whose plane is turned by (cos, sin)."""

    shift: int = 0
    turn: tuple[float, float] = (1.0, 0.0)
    repeats: bool = False
    legs: dict[int, Leg] = field(default_factory=dict)
    loop: ControlLoop = None  # type: ignore[assignment] # it begins with the first setup

    def begin(self, setup: Setup) -> None:
        """Create the loop of an inactive node."""
        self.loop = ControlLoop(self.make(setup), Mode.INACTIVE)

    def rotate(self, values: Sequence[float]) -> Vector:
        """Return vectors of the plane, one after the other, in this world."""
        c, s = self.turn
        return tuple(each for a, b in zip(values[::2], values[1::2], strict=True)
                     for each in (c * a - s * b, s * a + c * b))

    def rotate_gain(self, gain: float) -> tuple[Vector, ...]:
        """Return the gain (2, 4) in this world."""
        c, s = self.turn
        R = np.array([[c, -s], [s, c]])
        return tuple(map(tuple, (gain * R @ GAIN @ np.kron(np.eye(2), R).T).tolist()))

    def make(self, setup: Setup) -> Control:
        """Return the control of a setup."""
        c, s = self.turn
        K, drift = self.rotate_gain(setup.gain), self.rotate(setup.drift) + (0.0, 0.0)
        prediction = None
        if setup.delay:
            prediction = predict(setup.delay, setup.has_integral, self.turn)
        integral = {'C': ((c, s, 0.0, 0.0), (-s, c, 0.0, 0.0)),
                    } if setup.has_integral else {}
        region = Region(tuple(tuple(float(i == j) for j in range(4)) for i in range(4)), 4.0)
        return Control(
            regulator=StateFeedback(
                self.rotate(setup.target) + self.rotate(setup.drift), self.rotate((0.3, -0.2)), K,
                drift, ((0.4 * c, -0.4 * s), (0.4 * s, 0.4 * c)) if setup.has_integral else (),
                region if setup.has_region else None),
            limits=InputLimits((-setup.limit,) * 2, (setup.limit,) * 2),
            rest=self.rotate((0.3, -0.2)), names=NAMES, rules=setup.rules,
            legs=tuple(self.legs[each] for each in setup.legs), prediction=prediction,
            longest_period=setup.longest, **integral)

    def add_leg(self, number: int, route: Route, gain: float) -> None:
        """Make a reference known."""
        K, u = self.rotate_gain(gain), self.rotate((0.1, 0.2))
        start = self.rotate(route.start) + self.rotate(route.velocity)
        begin = None if route.begin is None else route.begin + self.shift
        end = StateFeedback(self.rotate(route.place(math.inf)), u, K, (0.0,) * 4)
        self.legs[number] = Leg(
            Reference(begin, route.duration),
            Line(start, self.rotate(route.velocity) + (0.0, 0.0), u, K), end,
            ALLOWED if route.is_judged else (), ('m', 'm', 'm/s', 'm/s'))

    def make_plan(self, stamp: int, x: Sequence[float], samples: int) -> PlanLaw:
        """Return a plan of constant velocity whose first sample is at a stamp [ns]."""
        states = [[x[0] + x[2] * 0.1 * k, x[1] + x[3] * 0.1 * k, *x[2:]]
                  for k in range(samples + 1)]
        return PlanLaw(
            stamp + self.shift - PERIOD // 2, PERIOD, tuple(map(self.rotate, states)),
            tuple(self.rotate((0.2 * k, 0.5)) for k in range(samples)), self.rotate_gain(1.0))

    def find_number(self) -> int | None:
        """Return the number of the reference that is followed or whose end is held."""
        reference = self.loop.reference
        return next((number for number, leg in self.legs.items()
                     if leg.reference is reference), None)

    def get_begin(self, number: int) -> int:
        """Return the stamp [ns] at which a reference has begun."""
        return self.loop._itinerary.get_begin(self.legs[number].reference)


def predict(delay: int, has_integral: bool, turn: tuple[float, float]) -> Prediction:
    """Return the exact prediction of a mass over some periods; the outputs are px and py."""
    h, n = PERIOD * 1e-9, 6 if has_integral else 4
    M = np.zeros((n, n))
    M[0, 2] = M[1, 3] = 1.0
    c, s = turn
    if has_integral:
        M[4:, :2] = [[c, s], [-s, c]]
    B = np.zeros((n, 2))
    B[2:4] = np.eye(2)
    # M^3 = 0: the series ends.
    move = np.eye(n) + M * h + M @ M * h**2 / 2
    push = (np.eye(n) * h + M * h**2 / 2 + M @ M * h**3 / 6) @ B
    powers = [np.linalg.matrix_power(move, k) for k in range(delay + 1)]
    rows = [tuple(map(tuple, (each @ push).tolist())) for each in powers[:delay]]
    return Prediction(tuple(map(tuple, powers[delay].tolist())), tuple(rows), PERIOD,
                      delay * PERIOD)
