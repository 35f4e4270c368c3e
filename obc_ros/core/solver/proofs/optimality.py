# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
How good a certified answer is: proved to be the best, or the best of the local minima met.

A certificate shows an extremal. It is the best path where the problem is convex (`convexity`), and
where the least time of a linear system is asked for and its target can be kept: if the target were
met sooner it could be met at each later time too, also just before T; there the costates separate
it from what is reached.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from obc_ros.core.ocp.convexity import is_convex_problem
from obc_ros.core.ocp.least_time_form import find_affine_dynamics, find_target
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Certificate, MOST_MINIMA, Optimality, Solution
from obc_ros.core.solver.proofs.existence import find_constant_cost
from obc_ros.core.solver.transcription.local_minima import ANOTHER
from scipy.optimize import lsq_linear

_KEPT = 1e-9    # relative: by how much a target that is kept may move
_NORMAL = 0.1   # of L: what the residuals of H may be for L to count in H = L + lam'f


def add_optimality(problem: Problem, found: Solution) -> Solution:
    """Return a solution that says how good it is, if it is certified."""
    if not found.certified:
        return replace(found, optimality=None)
    known = found.optimality
    if known is not None and known.kind == 'global':
        return found
    reason = _proof(problem, found)
    if reason:
        return replace(found, optimality=Optimality('global', reason))
    starts, others = (known.starts, known.minima) if known else (1, ())
    return replace(found, optimality=describe_local(starts, found.objective, others))


def describe_local(starts: int, best: float, others: Iterable[float]) -> Optimality:
    """
    Return what a search has shown.

    Parameters
    ----------
    starts : int
        From so many it began.
    best : float
        Cost of the answer.
    others : iterable of float
        Costs of other minima; those that are no higher, or nearly equal to a lower one, are the
        same or were not confirmed, and are left out.

    """
    minima = [best]
    for cost in sorted(others):
        if cost - minima[-1] > ANOTHER * abs(minima[-1]):
            minima.append(float(cost))
    many = f'the cheapest of {len(minima)} local minima' if len(minima) > 1 else (
        'the only local minimum')
    return Optimality('local', f'{many} met from {starts} start{"s" * (starts != 1)}', starts,
                      tuple(minima[:MOST_MINIMA]))


def _proof(problem: Problem, found: Solution) -> str:
    """Return why no path costs less than a certified one; '' where that is not shown."""
    if find_constant_cost(problem) is not None:
        return 'every path costs the same'
    if is_convex_problem(problem):
        return 'convex'
    if found.certificate and _least_time(problem, found, found.certificate):
        return 'least time of a linear system'
    return ''


def _least_time(problem: Problem, found: Solution, certificate: Certificate) -> bool:
    """Return whether a normal extremal meets a target of a linear system that can be kept."""
    aim = find_target(problem)
    plant = find_affine_dynamics(problem) if aim else None
    if aim is None or plant is None:
        return False
    T, final = float(found.t[-1]), problem.final_time
    if not final.lower < T * (1 - _KEPT):   # T is held up: sooner is not allowed
        return False
    # On the target C x = d its own rate must be a constant, M d, that inputs can undo.
    M, _, rank, _ = np.linalg.lstsq(aim.C.T, (aim.C @ plant.A).T, rcond=None)
    left, size = np.abs(M.T @ aim.C - aim.C @ plant.A), np.abs(aim.C) @ np.abs(plant.A)
    if rank < len(aim.d) or (left > _KEPT * size).any():
        return False
    drift, moved = M.T @ aim.d + aim.C @ plant.c, aim.C @ plant.B
    low, high = problem.u_lower, problem.u_upper
    if not (low < high).all():
        return False
    hold = lsq_linear(moved, -drift, (low, high)).x
    terms = np.abs(M.T) @ np.abs(aim.d) + np.abs(aim.C) @ np.abs(plant.c) + (
        np.abs(moved) @ np.maximum(np.abs(low), np.abs(high)))
    if (np.abs(drift + moved @ hold) > _KEPT * terms).any():
        return False
    rate = found.x @ plant.A.T + found.u @ plant.B.T + plant.c
    H = float((aim.rate + np.sum(np.abs(found.lam * rate), axis=1)).max())
    return max(certificate.residuals.values()) * H <= _NORMAL * aim.rate
