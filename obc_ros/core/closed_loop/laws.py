# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The three laws of a loop as values: hold a set point, follow a reference, follow a plan.

Each gives the target, its input and the gain at a stamp [ns].
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from operator import mul
from typing import Protocol

from obc_ros.core.closed_loop.clock import NS
from obc_ros.core.closed_loop.feedback import (
    interpolate_vectors,
    move,
    ReferenceLaw,
    ReferencePoint,
    Rows,
    StateFeedback,
    Vector,
)

MeasureError = Callable[[Sequence[float], Sequence[float]], list[float]]


class FollowedLaw(Protocol):
    """What a loop follows."""

    def at(self, stamp: int) -> ReferencePoint:
        """Return the target at a stamp [ns]."""


@dataclass(frozen=True, eq=False)
class HeldSetPoint:
    """
    A set point, where it is now.

    :ivar x: where it is at `origin`, (n,): a moving one begins at the plant.
    :ivar origin: stamp of t = 0 of the law [ns].
    :ivar is_designed: whether it is that of the parameters and not the end of a reference.
    """

    law: StateFeedback
    x: Vector
    origin: int
    is_designed: bool = True

    def at(self, stamp: int) -> ReferencePoint:
        """Return the target at a stamp [ns]."""
        if self._constant is not None:
            return self._constant
        t = (stamp - self.origin) * NS
        return self.law.at(t)._replace(x=move(self.x, self.law.drift, t))

    @cached_property
    def _constant(self) -> ReferencePoint | None:
        """Return the target at all stamps; None: it moves, or its gains change."""
        if self.law.gains is None and not any(self.law.drift):
            return self.law.at(0.0)._replace(x=tuple(self.x))
        return None

    def place(self, x: Sequence[float], stamp: int, error: MeasureError, origin: int
              ) -> 'HeldSetPoint':
        """
        Return the set point beside a state, with another t = 0.

        The component of the error along the drift is freed and nothing else:
        xe += d (d'(x - xe)) / (d'd).

        :param x: state (n,) at the stamp.
        :param error: returns x - xe (n,), with angles wrapped.
        """
        drift, t = self.law.drift, (stamp - self.origin) * NS
        here = free_drift(x, move(self.x, drift, t), drift, error)
        return replace(self, x=move(here, drift, (origin - stamp) * NS), origin=origin)

    def is_of(self, law: StateFeedback) -> bool:
        """Return whether a law has the set point and the rate of this one, whatever its gains."""
        return (law.x, law.drift) == (self.law.x, self.law.drift)

    def carry(self, law: StateFeedback, stamp: int, restarts: bool) -> 'HeldSetPoint':
        """
        Return another law at the present place of this one.

        If the design has another set point, it is there; otherwise it goes on where it is.

        :param restarts: whether t = 0 is now.
        """
        moved = move(self.x, self.law.drift, (stamp - self.origin) * NS)
        x = moved if self.is_of(law) else law.x
        origin = stamp if restarts else self.origin
        return replace(self, law=law, x=move(x, law.drift, (origin - stamp) * NS), origin=origin)


@dataclass(frozen=True, eq=False)
class Along:
    """A reference law from its beginning, a stamp [ns], on."""

    law: ReferenceLaw
    begin: int

    def at(self, stamp: int) -> ReferencePoint:
        """Return the target at a stamp [ns]."""
        return self.law.at((stamp - self.begin) * NS)


@dataclass(frozen=True, eq=False)
class PlanLaw:
    """
    A plan at equal instants, with a constant gain.

    A stamp selects the nearest sample, so that the jitter of the stamps does not select an input
    one period early or late.

    :ivar begin: stamp half a period before the first sample [ns].
    :ivar period: time between two samples [ns].
    :ivar x, u: N + 1 states (n,), and N inputs (m,), each held over a period.
    """

    begin: int
    period: int
    x: tuple[Vector, ...]
    u: tuple[Vector, ...]
    K: Rows

    def at(self, stamp: int) -> ReferencePoint:
        """Return the target at a stamp [ns]."""
        samples = (stamp - self.begin) * NS / (self.period * NS)
        k = min(max(math.floor(samples + 1e-9), 0), len(self.u) - 1)
        since = samples - 0.5   # of the first sample
        i = min(max(math.floor(since), 0), len(self.x) - 2)
        part = min(since - i, 1.0)
        return ReferencePoint(
            interpolate_vectors(self.x[i], self.x[i + 1], part), self.u[k], self.K)

    def covers(self, stamp: int) -> bool:
        """Return whether the plan has an input for a stamp [ns]."""
        return 0 <= stamp - self.begin < len(self.u) * self.period


def select_plan(plans: Sequence[PlanLaw], stamp: int) -> PlanLaw | None:
    """Return the last of some plans that covers a stamp [ns], or None."""
    return next((each for each in reversed(plans) if each.covers(stamp)), None)


def free_drift(x: Sequence[float], xe: Vector, drift: Vector, error: MeasureError) -> Vector:
    """Return xe + d (d'(x - xe)) / (d'd) for the drift d; xe itself without a drift."""
    if not any(drift):
        return xe
    along = sum(map(mul, drift, error(x, xe))) / sum(map(mul, drift, drift))
    return move(xe, drift, along)
