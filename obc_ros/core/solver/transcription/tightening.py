# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a transcription keeps to besides the bounds of its problem."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem

_AT_ENDS = 0.1   # part of the whole in which a margin grows from nothing
_BESIDE = 9.0    # margins from a bound at which x(0) is on it


@dataclass(frozen=True, eq=False)
class TightenedLimits:
    """
    Bounds besides those of the problem.

    `shortest`, `longest` lengths of the phases; `margin` (n + l,) by which the bounds of x and
    of the path constraints are drawn in; `pinned` (n,) where psi fixes a component of x(T), so
    that its bounds say nothing.
    """

    shortest: Array
    longest: Array
    margin: Array
    pinned: NDArray[np.bool_]

    def of_states(self, problem: Problem, s: Array) -> Array:
        """
        Return by how much to draw in the bounds of x at parts s (K,) of the whole, (K, n).

        Less and less towards an end at which x is given on a bound: to get there within a short
        interval would take large inputs.
        """
        margin, s = self.margin[:problem.n], s[:, None]
        beside = np.minimum(problem.x0 - problem.x_lower, problem.x_upper - problem.x0)
        begins = np.where(beside < _BESIDE * margin, np.minimum(s / _AT_ENDS, 1)**4, 1)
        ends = np.where(self.pinned, np.minimum((1 - s) / _AT_ENDS, 1)**4, 1)
        return np.asarray(margin * begins * ends)
