# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A plan of the receding horizon: states and held inputs on the samples of a period."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import StatementError


@dataclass(frozen=True, eq=False)
class Plan:
    """
    A motion of the model over the horizon, whose input is held over each period.

    :ivar stamp: time of the first state [s].
    :ivar period: time between two samples [s].
    :ivar x, u: (N + 1, n) and (N, m), states, which follow from x[0] and the inputs in the model;
        inputs, within their bounds. An angle is continuous along the plan, within half a turn of
        the set point at its start.
    :ivar cost: cost of the horizon, without the penalty.
    :ivar slack: the largest excess of each softened limit that is exceeded, in the unit of the
        limit.
    :ivar residual: relative residual of the optimality conditions; inf if it was not computed.
    :ivar terminal_value: e'P e at the end.
    """

    stamp: float
    period: float
    x: Array
    u: Array
    cost: float
    slack: Mapping[str, float] = field(default_factory=dict)
    residual: float = math.inf
    terminal_value: float = math.inf

    @property
    def end(self) -> float:
        """Return the time of the last state [s]."""
        return self.stamp + len(self.u) * self.period

    def at(self, t: float) -> tuple[Array, Array]:
        """
        Return the state, linear between the samples, and the held input at a time.

        :param t: time [s]; before the plan its first sample is returned, after it the last one.
        :return: x, u: (n,) and (m,).
        """
        # A sample that is reached up to rounding has the input that begins there.
        place = min(max((t - self.stamp) / self.period, 0.0), float(len(self.u)))
        if abs(place - round(place)) < 1e-9 * max(1.0, place):
            place = float(round(place))
        k = min(int(place), len(self.u) - 1)
        part = place - k
        return (1.0 - part) * self.x[k] + part * self.x[k + 1], self.u[k].copy()

    def shift(self, k: int) -> 'Plan':
        """
        Return the rest of the plan from sample k on.

        :param k: at least 0 and below N.
        :raises StatementError: if nothing is left.
        """
        if not 0 <= k < len(self.u):
            raise StatementError(f'shift of {k} periods: the plan has {len(self.u)}')
        return replace(self, stamp=self.stamp + k * self.period, x=self.x[k:], u=self.u[k:],
                       cost=math.nan, residual=math.inf)

    @property
    def excess(self) -> float:
        """Return the largest excess of a softened limit; 0 if all are kept."""
        return max(self.slack.values(), default=0.0)

    @property
    def is_finite(self) -> bool:
        """Return whether all states and inputs are finite numbers."""
        return bool(np.isfinite(self.x).all() and np.isfinite(self.u).all())
