# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where the search for an optimal path may start."""

from dataclasses import dataclass, field

from obc_ros.core.numerics.arrays import Array


@dataclass(frozen=True, eq=False)
class Guess:
    """
    Where the search may start.

    `x` and `u` map a name to its values equally spaced over [0, T]; names left out are guessed.
    """

    x: dict[str, Array] = field(default_factory=dict)
    u: dict[str, Array] = field(default_factory=dict)
    final_time: float | None = None
