# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Saddles: where Newton's method stands still although the cost falls to both sides.

Of a symmetric problem the symmetric path is an extremal, and steps from it stay symmetric: from
straight on through an obstacle none leads around it. First-order conditions hold there. The
Hessian shows a way down, and from a little along it the method finds what lies below.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.solver.nlp.interior_point import Interior, Iterate, solve_program, StoppingRule

_SLIGHT, _LARGEST = 1e-6, 1e6   # of negative curvature
_AWAY = 0.1        # largest step along the way down
_MU, _PUSH = 1e-4, 1e-6
_LESS = 1e-9       # relative cost
_MOST = 3          # saddles in a row


def leave_saddle(work: Interior, end: Iterate, goal: StoppingRule,
                 watch: Callable[[float, float], bool]) -> Iterate:
    """
    Return where a run ended, or what is found below if that is a saddle.

    Parameters
    ----------
    work, end : Interior, Iterate
        The run and its last iterate.
    goal, watch : Goal, callable
        As in `solve_program`.

    """
    for _ in range(_MOST):
        way = _down(work, end) if end.converged else None
        if way is None:
            break
        gone = -float((work.moves(way) / end.gap).min(initial=0.0))
        y = end.y + min(_AWAY, 0.9 / max(gone, 1e-300)) * way
        begun = work.begin(y, max(end.mu, _MU), _PUSH)
        below = solve_program(work, replace(begun), goal, watch)
        if below.status == 'too slow':   # which is no reason to take a saddle for an answer
            begun.iterations = below.iterations
            below = solve_program(work, begun,
                                  replace(goal, most=goal.most + below.iterations, rough=0.0),
                                  watch)
        below.iterations += end.iterations
        if not (below.converged
                and below.values.f < end.values.f - _LESS * abs(end.values.f)):
            end.iterations = below.iterations
            break
        end = below
    return end


def _down(work: Interior, now: Iterate) -> Array | None:
    """Return a way of negative curvature where J d = 0, its largest entry 1; None without one."""
    program, weight, shift = work.program, work.weights(now.z / now.gap), _SLIGHT
    while not program.convex(now.values, work.fixed, weight + shift * work.free + 1 - work.free):
        shift *= 10
        if shift > _LARGEST:
            return None
    if shift == _SLIGHT:
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
