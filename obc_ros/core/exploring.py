# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Further starts, once there is an answer: whether there is a better one elsewhere."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from obc_ros.core.familiar import ANOTHER
from obc_ros.core.mesh import split
from obc_ros.core.refine import below
from obc_ros.core.rollouts import interleaved
from obc_ros.core.solution import Solution

if TYPE_CHECKING:
    from obc_ros.core.search import Search

_EXPLORING = (0.15, 0.3)   # part of the work for further starts, of easy and of hard problems
_HARD = 3000
_LEAST = 2, 6         # number of them, of easy problems, and of hard ones by collocation
# Likewise of those by Runge-Kutta steps that are hard, or have uneven costs, and work for them.
_MANY, _MOST, _FOR_MANY = 24, 80, 15_000
_ITERATIONS = 150     # on a mesh on which a lower cost may be believed
_WEARY = 500_000      # work without an answer that holds, after which no further start is tried


def explored(search: 'Search', best: Solution, floor: float) -> Solution:
    """
    Return the best answer after some more starts.

    Their number grows with the work that the problem has made so far: what is solved at once
    is not held up; what is hard, or has uneven costs, is looked at from many sides.
    """
    kept, spent, uneven = search.last, 0, search.kit.uneven_costs(search.problem, abs(floor))
    if uneven:
        search.starts = search.kit.guesser.scattered(
            search.problem, search.kit.integrator, search.starts, abs(floor))
    elif search.work > _HARD:
        search.starts = interleaved(search, search.starts)
    for number in range(_MOST):
        hard = search.work > _HARD
        many = uneven or hard and not search.stages
        enough = (number >= _MANY and spent >= _FOR_MANY) if many else number >= _LEAST[hard]
        weary = search.work > _WEARY and not best.certified
        if search.monitor.stopped or weary or enough and (
                spent > _EXPLORING[hard] * search.work or search.familiar.enough()):
            break
        started = search.work
        search.reset()
        outcome = search.from_next_start(once=best.certified, hard=hard or uneven)
        lower = below(outcome.objective, floor, ANOTHER)
        if lower and outcome.converged and not search.believed(outcome):
            mesh = split(outcome.mesh, np.full(search.intervals, 2))
            outcome = search.collocate(mesh, outcome.path, near=True, most=_ITERATIONS)
            lower = below(outcome.objective, floor, ANOTHER)
        if (lower or not best.certified
                and abs(outcome.objective - floor) > ANOTHER * abs(floor)
                ) and search.believed(outcome):
            floor = outcome.objective
            other = search.followed_up(outcome)
            # What is cheaper and feasible shows that the other is not the best, proved or not.
            cheaper = below(other.objective, best.objective, ANOTHER)
            if (other.certified and (cheaper or not best.certified)
                    or cheaper and other.certificate and other.certificate.feasible):
                best, kept = other, search.last
        spent += search.work - started
    search.last = kept
    if best.certified and kept:
        search.kit.remember(kept if kept.extremal is None else replace(
            kept, extremal=search.kit.indirect.thinned(search.stated, kept.extremal, kept.sizes)))
    return best

