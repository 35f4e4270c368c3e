# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Initial guess of an optimal path."""

from dataclasses import dataclass, field

from obc_ros.core.numerics.arrays import Array


@dataclass(frozen=True, eq=False)
class Guess:
    """
    Initial guess of states, inputs and final time.

    `x` and `u` map a name to its values at equally spaced times in [0, T]. The solver chooses
    what is left out.
    """

    x: dict[str, Array] = field(default_factory=dict)
    u: dict[str, Array] = field(default_factory=dict)
    final_time: float | None = None
