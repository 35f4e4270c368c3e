# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Whether costs have hollows and hills, between which a path that is best nearby need not be best.

Where L and V are quadratic, or curved upwards all over, minima that are not the least one come of
dynamics and bounds alone. Where their curvature changes sign each hollow may have one.
"""

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.batch import Batch
from obc_ros.core.problem import Problem

Array = NDArray[np.float64]

_POINTS = 64
_DOWN = 1e-6        # of the largest curvature, what counts as downwards


class Uneven:
    """The curvature of L and V of all problems of one structure; `curved`: where it varies."""

    def __init__(self, problem: Problem) -> None:
        both = ca.vertcat(problem.x, problem.u)
        self.curved = []
        for cost, z in ((problem.L, both), (problem.V, problem.x)):
            curvature = ca.hessian(cost, z)[0]
            if ca.depends_on(curvature, z):
                self.curved.append(Batch([problem.x, problem.u, problem.p], [curvature], 1))

    def __call__(self, problem: Problem, x_room: Array, u_room: Array) -> bool:
        """Return whether L or V is curved downwards somewhere so near to x(0) and to u = 0."""
        chance = np.random.default_rng(3)
        x = problem.x0 + x_room * chance.uniform(-1, 1, (_POINTS, problem.n))
        u = u_room * chance.uniform(-1, 1, (_POINTS, problem.m))
        x = np.clip(x, problem.x_lower, problem.x_upper)
        u = np.clip(u, problem.u_lower, problem.u_upper)
        for curved in self.curved:
            values, = curved(x, u, problem.p_value)
            good = values[np.isfinite(values).all(axis=1)]
            if len(good):
                n = round(np.sqrt(good.shape[1]))
                size = np.append(x_room, u_room)[:n]
                curvature = good.reshape(-1, n, n) * size[:, None] * size
                least = np.linalg.eigvalsh(curvature)[:, 0]
                if least.min() < -_DOWN * np.abs(curvature).max():
                    return True
        return False
