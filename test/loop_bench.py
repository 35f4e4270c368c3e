# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Controls and states for tests of the loop without ROS."""

import math

from obc_ros.core.closed_loop.control import Control, Leg, Reference, Rules
from obc_ros.core.closed_loop.feedback import InputLimits, ReferencePoint, StateFeedback
from obc_ros.core.closed_loop.loop import ControlLoop

MS = 1_000_000
S = 1_000_000_000
FREE = (-math.inf,), (math.inf,)
K = ((1.0, 2.0),)


def control(x: tuple[float, ...] = (0.0, 0.0), u: float = 0.0, drift: tuple[float, ...] = (0, 0),
            gain: tuple[tuple[float, ...], ...] = K, limits: tuple[tuple[float], ...] = FREE,
            Ki: tuple[tuple[float, ...], ...] = (), **options: object) -> Control:
    """Return a control of a plant with two states and an input."""
    rules = options.pop('rules', Rules())
    return Control(
        regulator=StateFeedback(x, (u,), gain, drift, Ki), limits=InputLimits(*limits),
        rest=options.pop('rest', (u,)), names=('px', 'vx'), rules=rules, **options)  # type: ignore[arg-type]


def answers(loop: ControlLoop, *states: tuple[float, list[float]]) -> list[list[float] | None]:
    """Return the commands for states at stamps [s]; each state arrives at its stamp."""
    return [loop.answer(round(t * S), x, t) for t, x in states]


class Ramp:
    """The reference px = t."""

    def at(self, t: float) -> ReferencePoint:
        """Return its point at time t."""
        return ReferencePoint((t, 1.0), (0.0,), K)


def leg(begin: int | None, end: float = 2.0) -> Leg:
    """Return a ramp with a law that holds its end."""
    return Leg(Reference(begin, end), Ramp(), StateFeedback((end, 0.0), (0.5,), K, (0.0, 0.0)))
