# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Scales of states, inputs, time and cost: powers of 2, so that scaling adds no rounding error."""

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.transcription.mesh import Path
from obc_ros.core.solver.transcription.program import ProblemScales


def round_to_power(size: Array | float) -> Array:
    """Return the power of 2 nearest to a size."""
    return np.asarray(np.exp2(np.round(np.log2(np.clip(size, 1e-8, 1e12)))))


def estimate_scales(problem: Problem, path: Path) -> ProblemScales:
    """
    Estimate the scales of states, inputs and time.

    :param problem: its bounds give the scales of what is 0 on the path.
    :param path: its largest values give the others.
    :return: powers of 2; the scale of the cost is 1.
    """
    def size(values: Array, lower: Array, upper: Array) -> Array:
        seen = np.max(np.abs(values), axis=0, initial=0.0)
        span = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
        largest = np.where(seen > 0, seen, np.where(span > 0, span, 1.0))
        return round_to_power(largest)

    return ProblemScales(size(path.x, problem.x_lower, problem.x_upper),
                         size(np.vstack([path.ua, path.ub]), problem.u_lower, problem.u_upper),
                         float(np.exp2(np.round(np.log2(path.t[-1])))), 1.0)
