# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Global optimality of a certified solution where it is proved, otherwise the local minima found.

A certified solution is an extremal. It is globally optimal if the problem is convex (`convexity`).
It is also globally optimal if it is the minimum-time solution of a linear system that can stay at
its target: if the target were met earlier it could be met at every later time, also just before
T, but there the costates separate the target from the reachable set.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import optimize
from obc_ros.core.ocp.least_time_form import find_affine_dynamics, find_target
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Certificate, MOST_MINIMA, Optimality, Solution
from obc_ros.core.solver.proofs.convexity import is_convex_problem
from obc_ros.core.solver.proofs.existence import find_constant_cost
from obc_ros.core.solver.transcription.local_minima import ANOTHER


def add_optimality(problem: Problem, found: Solution) -> Solution:
    """
    Add the `optimality` of a certified solution.

    :param found: `optimality` may describe a search.
    :return: `optimality` is 'global' if that is proved, otherwise 'local'; None without
        certificate.
    """
    if not found.certified:
        return replace(found, optimality=None)
    known = found.optimality
    if known is not None and known.kind == 'global':
        return found
    reason = (
        'every path costs the same' if find_constant_cost(problem) is not None
        else 'convex' if is_convex_problem(problem)
        else 'minimum time of a linear system'
        if found.certificate and _least_time(problem, found, found.certificate) else '')
    if reason:
        return replace(found, optimality=Optimality('global', reason))
    starts, others = (known.starts, known.minima) if known else (1, ())
    return replace(found, optimality=describe_local(starts, found.objective, others))


def describe_local(starts: int, best: float, others: Iterable[float]) -> Optimality:
    """
    Return the result of a search from several initial guesses.

    :param others: costs of other minima. Those that are not higher, or nearly equal to a lower
        one, are duplicates or were not confirmed; they are left out.
    """
    minima = [best]
    for cost in sorted(others):
        if cost - minima[-1] > ANOTHER * abs(minima[-1]):
            minima.append(float(cost))
    many = f'the cheapest of {len(minima)} local minima' if len(minima) > 1 else (
        'the only local minimum')
    guesses = f'{starts} initial guess{"es" * (starts != 1)}'
    return Optimality('local', f'{many} found from {guesses}', starts,
                      tuple(minima[:MOST_MINIMA]))


def _least_time(problem: Problem, found: Solution, certificate: Certificate) -> bool:
    """Return whether a normal extremal reaches a target at which the linear system can stay."""
    aim = find_target(problem) if problem.start is None else None
    plant = find_affine_dynamics(problem) if aim else None
    if aim is None or plant is None:
        return False
    T, final = float(found.t[-1]), problem.final_time
    kept = 1e-9   # relative rate at which a system that stays at its target may leave it
    if not final.lower < T * (1 - kept):   # the lower bound of T is active
        return False
    # On the target C x = d, the rate C A x must be a constant M'd, which inputs can compensate.
    M, _, rank, _ = np.linalg.lstsq(aim.C.T, (aim.C @ plant.A).T, rcond=None)
    left, size = np.abs(M.T @ aim.C - aim.C @ plant.A), np.abs(aim.C) @ np.abs(plant.A)
    if rank < len(aim.d) or (left > kept * size).any():
        return False
    drift, moved = M.T @ aim.d + aim.C @ plant.c, aim.C @ plant.B
    low, high = problem.u_lower, problem.u_upper
    if not (low < high).all():
        return False
    hold = optimize.lsq_linear(moved, -drift, (low, high)).x
    terms = np.abs(M.T) @ np.abs(aim.d) + np.abs(aim.C) @ np.abs(plant.c) + (
        np.abs(moved) @ np.maximum(np.abs(low), np.abs(high)))
    if (np.abs(drift + moved @ hold) > kept * terms).any():
        return False
    rate = found.x @ plant.A.T + found.u @ plant.B.T + plant.c
    H = float((aim.rate + np.sum(np.abs(found.lam * rate), axis=1)).max())
    # The extremal is normal if the residuals of H = L + lam'f are small beside L.
    return max(certificate.residuals.values()) * H <= 0.1 * aim.rate
