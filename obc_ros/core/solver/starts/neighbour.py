# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Warm start from a neighbour: the same problem with slightly different numbers, solved before."""

from dataclasses import replace

import numpy as np
from obc_ros.core.ocp.solution import Optimality, Solution, Status, Verdict
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.improve.kink_mesh import start_from_neighbour
from obc_ros.core.solver.program_cache import Answered, collect_numbers
from obc_ros.core.solver.proofs.contradictions import explain_contradiction
from obc_ros.core.solver.proofs.optimality import describe_local
from obc_ros.core.solver.trace import judge_path
from obc_ros.core.solver.transcription.local_minima import ANOTHER

_ITERATIONS = 15    # maximum number of iterations: with more, another minimum may be better
_ROUNDS = 3         # maximum number of meshes if the certificate does not pass at once
_RIVAL_ITERATIONS = 150   # maximum number of iterations for a rival


def solve_from_neighbour(search: Bench) -> Solution | None:
    """
    Solve from the solution of a neighbouring problem.

    Parameters
    ----------
    search : Bench
        Driver; its state is reset if None is returned.

    Returns
    -------
    Solution or None
        Certified, and of lower cost than its rivals; or infeasible, with a proof. None without a
        neighbour, without convergence, or if a rival has become better.

    """
    last = None if search.quick else search.kit.neighbour(search.stated)
    if last is None or last.outcome.mesh.layout.intervals > search.monitor.max_intervals:
        return None
    with search.trace.attempt('neighbour', 'from a solution with other numbers') as attempt:
        answer = _follow(search, last)
        if answer is None:
            attempt.end(Verdict.REJECTED, 'it does not converge, or another minimum is lower')
        else:
            attempt.end(*judge_path(answer), cost=answer.objective)
    return answer


def _follow(search: Bench, last: Answered) -> Solution | None:
    """Do what `solve_from_neighbour` does, from the solution of one neighbour."""
    if search.kit.twin:
        search.problem = search.kit.twin.problem(search.stated)   # the sharpest
    start, search.margin = last.outcome, last.margin
    search.stages = start.mesh.layout.stages
    near = start_from_neighbour(search.kit, search.stated, last)
    if near is None:
        outcome = search.collocate(start.mesh, start.path, near=True, sizes=last.sizes,
                                   most=_ITERATIONS, warm=start)
    else:
        (search.extremal, guide), search.nearby = near, True
        outcome = search.collocate(guide.mesh, guide.path, near=True, sizes=last.sizes,
                                   most=_ITERATIONS, guide=guide)
    answer = search.solution(outcome, search.course(outcome)) if outcome.converged else None
    if answer is not None and answer.certified:
        search.last = replace(last, problem=search.stated, outcome=outcome,
                              extremal=search.extremal)
    elif reason := explain_contradiction(search.stated):  # although the neighbour has a solution
        return Solution(Status.INFEASIBLE, reason)
    else:
        search.kit.answers.remove(last)   # it does not serve the next problem either
        search.extremal, search.nearby = None, False
        if answer is not None and not search.monitor.stopped:   # kinks have left the mesh points
            answer = search.followed_up(outcome, _ROUNDS)
            search.last = search.last and replace(
                search.last, rivals=last.rivals, refined=last.refined, looked=last.looked)
    costs = follow_rivals(search, last) if answer and answer.certified and search.last else None
    if answer and search.last and costs is not None and not is_beaten(answer, costs):
        known = last.optimality
        if known is None or not np.array_equal(last.numbers, collect_numbers(search.stated)):
            known = compare_with_rivals(answer, costs)
        search.kit.remember(replace(search.last, optimality=known))
        return replace(answer, optimality=known)
    search.extremal, search.nearby = None, False
    search.stages = 3 if search.bounded else 0
    search.reset()
    return None


def follow_rivals(search: Bench, last: Answered) -> list[float]:
    """Return the costs of the rivals of a neighbour here, scaled from coarse to fine meshes."""
    outcomes = [search.collocate(rival.mesh, rival.path, near=True, most=_RIVAL_ITERATIONS)
                for rival in last.rivals]
    return [last.refined * outcome.objective for outcome in outcomes if outcome.converged]


def is_beaten(answer: Solution, costs: list[float]) -> bool:
    """Return whether a rival has become cheaper than the solution."""
    return any(is_below(cost, answer.objective, ANOTHER) for cost in costs)


def compare_with_rivals(answer: Solution, costs: list[float]) -> Optimality:
    """Return the optimality shown by following a solution and its rivals from a neighbour."""
    found = describe_local(1 + len(costs), answer.objective, costs)
    return replace(found, reason=f'{found.reason}, each a local minimum of the same problem with '
                                 'other numbers')
