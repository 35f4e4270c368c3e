# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The hypothesis that a filter has lost the plant, against the one that outliers are wrong.

A row of outliers alone decides nothing: a receiver that is wrong for a while sends one too. Wrong
measurements need not agree with each other, with the other sensors, or for long; those of a lost
plant do. A rival is a second estimate that begins at an outlier with a wide covariance and takes
all measurements. It is given up when

- a measurement passes the test of the filter but not its own,
- the sensor that began it passes the test of the filter again,
- of the outliers since then it has refused more than it has explained.

It wins when it has explained `ENOUGH` outliers, and for the time that the caller wants.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from obc_ros.core.estimation.filter import Belief, KalmanFilter, Update
from obc_ros.core.numerics.arrays import Array

ENOUGH = 20   # outliers that agree with each other


@dataclass(eq=False)
class Rival:
    """
    A rival, and the votes on it.

    :ivar origin: the event of the outlier at which it begins.
    :ivar stamp: of that event [ns].
    :ivar sensor: the outputs of the outlier.
    :ivar start: before the outlier.
    :ivar explained, refused: how many outliers of the filter since then pass its test, and do not.
    """

    origin: Any
    stamp: int
    sensor: tuple[int, ...]
    start: Belief
    explained: int = 0
    refused: int = 0

    def vote(self, sensor: tuple[int, ...], of_filter: Update, own: Update) -> bool:
        """Count a measurement after the first one; return whether the rival is kept."""
        if not of_filter.is_outlier:
            return not own.is_outlier and sensor != self.sensor
        self.refused += own.is_outlier
        self.explained += not own.is_outlier
        return self.refused <= self.explained


def widen(kalman: KalmanFilter, mean: Array, u: Array, at: tuple[int, ...], innovation: Array,
          P0: Array) -> Belief | None:
    """
    Return an estimate whose covariance explains an innovation.

    :param kalman: with the outputs.
    :param mean, u: (n,) and (m,), mean of the estimate, and the input.
    :param at: indices of the measured outputs.
    :param innovation: y - h(mean, u) of these.
    :param P0: (n, n), the least covariance.
    :return: with P0, multiplied until no entry of the innovation is above its standard deviation.
        None: that exceeds the range of double precision.
    """
    C = kalman.system.measure(mean, u)[1][list(at)]
    variances = np.einsum('ij,jk,ik->i', C, P0, C)
    seen = variances > 0.0   # the others are functions of the input alone
    with np.errstate(over='ignore'):
        ratio = float((innovation[seen]**2 / variances[seen]).max(initial=1.0))
        P = P0 * ratio
    return Belief(mean, P) if np.isfinite(P).all() else None
