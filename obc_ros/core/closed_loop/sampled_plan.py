# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A plan at equal instants as a reference: the input is held over each period."""

from dataclasses import dataclass
import math

from obc_ros.core.closed_loop.clock import NS
from obc_ros.core.closed_loop.feedback import (
    convert_rows,
    convert_vector,
    interpolate_vectors,
    ReferencePoint,
    Rows,
    Vector,
)
from obc_ros.core.numerics.arrays import Array


@dataclass(frozen=True, eq=False)
class SampledPlan:
    """
    States and inputs of a plan, with a constant gain.

    The time t = 0 is half a period before the first sample: a stamp selects the nearest sample,
    so that the jitter of the stamps does not select an input one period early or late.

    :ivar period: time between two samples [ns].
    :ivar x: N + 1 states (n,).
    :ivar u: N inputs (m,), each held over a period.
    :ivar K: gain (m, n).
    """

    period: int
    x: tuple[Vector, ...]
    u: tuple[Vector, ...]
    K: Rows

    @property
    def duration(self) -> float:
        """Return the time after which no input is left [s]."""
        return len(self.u) * self.period * NS

    def at(self, t: float) -> ReferencePoint:
        """Return the state and the input at time t [s]."""
        samples = t / (self.period * NS)
        k = min(max(math.floor(samples + 1e-9), 0), len(self.u) - 1)
        since = samples - 0.5   # of the first sample
        i = min(max(math.floor(since), 0), len(self.x) - 2)
        part = min(since - i, 1.0)
        return ReferencePoint(
            interpolate_vectors(self.x[i], self.x[i + 1], part), self.u[k], self.K)


def make_sampled_plan(period: int, x: Array, u: Array, K: Rows) -> SampledPlan:
    """
    Return a plan as a reference.

    :param period: time between two samples [ns].
    :param x: (N + 1, n), States.
    :param u: (N, m), Inputs.
    :param K: gain (m, n).
    """
    return SampledPlan(period, tuple(map(convert_vector, x)), convert_rows(u), K)
