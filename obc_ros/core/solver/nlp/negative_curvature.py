# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Descent from a saddle point along a direction of negative curvature.

The symmetric path of a symmetric problem satisfies the first-order conditions, and Newton steps
from it stay symmetric: none leads from a path through an obstacle to one around it. At such a
saddle the Hessian has negative curvature on the null space of J. A small step in that direction
gives an initial point from which the method finds a minimum.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.solver.nlp.interior_point import Interior, Iterate, solve_program, StoppingRule


def leave_saddle(work: Interior, end: Iterate, goal: StoppingRule,
                 watch: Callable[[float, float], bool]) -> Iterate:
    """
    Return the last iterate of a run; from a saddle, continue along negative curvature.

    :param work, end: the run and its last iterate.
    :param goal, watch: as in `solve_program`.
    :return: `end`, or a converged iterate of lower cost; `iterations` counts those of all runs.
    """
    for _ in range(3):   # saddles in a row
        way = _down(work, end) if end.converged else None
        if way is None:
            break
        gone = -float((work.moves(way) / end.gap).min(initial=0.0))
        y = end.y + min(0.1, 0.9 / max(gone, 1e-300)) * way
        begun = work.begin(y, max(end.mu, 1e-4), 1e-6)   # least distance from bounds
        below = solve_program(work, begun, goal, watch)
        if below.status == 'too slow':   # repeat without the early end: a saddle is no solution
            below = solve_program(work, replace(begun, iterations=below.iterations),
                                  replace(goal, most=goal.most + below.iterations, rough=0.0),
                                  watch)
        below = replace(below, iterations=below.iterations + end.iterations)
        if not (below.converged
                and below.values.f < end.values.f - 1e-9 * abs(end.values.f)):
            return replace(end, iterations=below.iterations)
        end = below
    return end


def _down(work: Interior, now: Iterate) -> Array | None:
    """Return d with J d = 0, negative curvature and largest entry 1; None if there is none."""
    slight = 1e-6   # scaled curvature that counts as none; 1e6 is the largest one looked for
    program, weight, shift = work.program, work.weights(now.z / now.gap), slight
    while not program.convex(now.values, work.fixed, weight + shift * work.free + 1 - work.free):
        shift *= 10
        if shift > 1e6:
            return None
    if shift == slight:
        return None
    factor = program.pattern.factor(
        now.values.entries, work.place, work.base + weight + shift * work.free)
    if factor is None:
        return None
    way = np.random.default_rng(1).normal(size=len(now.y))
    for _ in range(3):
        way = factor.solve(way * work.free) * work.free
        way /= np.abs(way).max(initial=1e-300)
    return way if np.all(np.isfinite(way)) else None
