# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Constraint tightening (back-off), and bounds of the lengths of phases."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem


@dataclass(frozen=True, eq=False)
class TightenedLimits:
    """
    Bounds of a program besides those of its problem.

    :ivar shortest, longest: (phases,), bounds of the lengths of the phases [s].
    :ivar margin: (n + l,), tightening of the bounds of x and of the path constraints, >= 0.
    :ivar pinned: (n,), components of x(T) that psi fixes, which need no bounds at T.
    :ivar end: (n,), these, and a given time among the states; nan for the other components.
    """

    shortest: Array
    longest: Array
    margin: Array
    pinned: NDArray[np.bool_]
    end: Array

    def of_states(self, problem: Problem, s: Array) -> Array:
        """
        Return the tightening of the bounds of x.

        It vanishes towards an end at which x is given on a bound, since large inputs would be
        needed to reach it within a short interval.

        :param problem: with x(0) and the bounds.
        :param s: (K,), times as parts of the horizon.
        :return: (K, n).
        """
        margin, s = self.margin[:problem.n], s[:, None]
        beside = np.minimum(problem.x0 - problem.x_lower, problem.x_upper - problem.x0)
        beside = problem.given_at_start & (beside < 9.0 * margin)   # x(0) counts as on the bound
        part = 0.1   # of the horizon, in which a margin grows from 0
        begins = np.where(beside, np.minimum(s / part, 1)**4, 1)
        ends = np.where(self.pinned, np.minimum((1 - s) / part, 1)**4, 1)
        return np.asarray(margin * begins * ends)
