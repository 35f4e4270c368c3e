# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Consistency of an estimator: normalised errors and innovations against their 95 % band.

If model and noise are right, the normalised estimation error squared e'P^-1 e (NEES) and the
normalised innovation squared v'S^-1 v (NIS) are chi-square with as many degrees of freedom as e
and v have entries. A sum of N independent ones is chi-square with the sum of the degrees.

Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation,
2001, section 5.4.
"""

from collections import deque
from dataclasses import dataclass
from functools import lru_cache

from obc_ros.core.numerics.arrays import Array, linalg, special


def compute_chi_square_quantile(probability: float, degrees: float) -> float:
    """Return the value below which a chi-square variable is with a probability."""
    return float(2.0 * special.gammaincinv(0.5 * degrees, probability))


def compute_normalized_error(error: Array, P: Array) -> float:
    """
    Return e'P^-1 e.

    :param error: (n,), estimate minus state.
    :param P: (n, n), covariance of the estimate; positive definite.
    """
    return float(error @ linalg.solve(P, error, assume_a='pos'))


@lru_cache
def compute_band(degrees: float, count: int = 1, probability: float = 0.95
                 ) -> tuple[float, float]:
    """
    Return the interval that holds the mean of normalised squares with a probability.

    :param degrees: degrees of freedom of each.
    :param count: number of independent ones.
    :param probability: of the interval, with equal tails.
    """
    tail = 0.5 * (1.0 - probability)
    low, high = (compute_chi_square_quantile(p, degrees * count) for p in (tail, 1.0 - tail))
    return low / count, high / count


@dataclass(frozen=True)
class Consistency:
    """
    The mean of the last normalised squares, relative to their degrees of freedom.

    `ratio` is near 1 for a consistent estimator, above `upper` if the estimator trusts itself too
    much, below `lower` if too little; `count` is the number of measurements in the mean.
    """

    ratio: float
    lower: float
    upper: float
    count: int

    def __str__(self) -> str:
        """Return the verdict in words."""
        if not self.count:
            return 'no innovation yet'
        band = f'{self.ratio:.2f}, 95 % band {self.lower:.2f} to {self.upper:.2f}'
        if self.ratio > self.upper:
            return f'inconsistent: innovations are larger than Qw and Rv say ({band})'
        if self.ratio < self.lower:
            return f'cautious: innovations are smaller than Qw and Rv say ({band})'
        return f'consistent ({band})'


class InnovationMonitor:
    """
    The consistency of the last innovations.

    :param window: number of innovations that are kept.
    """

    def __init__(self, window: int = 200) -> None:
        self._kept: deque[tuple[float, int]] = deque(maxlen=window)

    def add(self, nis: float, degrees: int) -> None:
        """Add a normalised innovation squared and its degrees of freedom."""
        self._kept.append((nis, degrees))

    def assess(self) -> Consistency:
        """Return the consistency of what is kept."""
        if not self._kept:
            return Consistency(1.0, 1.0, 1.0, 0)
        degrees = sum([each for _, each in self._kept])
        lower, upper = compute_band(degrees)
        ratio = sum([nis for nis, _ in self._kept]) / degrees
        return Consistency(ratio, lower / degrees, upper / degrees, len(self._kept))
