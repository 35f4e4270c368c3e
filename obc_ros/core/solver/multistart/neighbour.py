# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Warm start from a neighbour: the same problem with slightly different numbers, solved before."""

from dataclasses import replace

import numpy as np
from obc_ros.core.ocp.solution import Solution, Status, Verdict
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.bench import Bench, Candidate
from obc_ros.core.solver.descent import descend
from obc_ros.core.solver.improve.indirect import start_from_neighbour
from obc_ros.core.solver.program_cache import Answered, collect_numbers
from obc_ros.core.solver.proofs.contradictions import explain_contradiction
from obc_ros.core.solver.proofs.optimality import describe_local
from obc_ros.core.solver.trace import judge_path, NEIGHBOUR
from obc_ros.core.solver.transcription.local_minima import ANOTHER
from obc_ros.core.solver.transcription.program import Nearby, SolveEffort


def solve_from_neighbour(bench: Bench, last: Answered) -> Candidate | None:
    """
    Solve from the solution of a problem of the same structure with nearly the same numbers.

    :return: certified, and of lower cost than its rivals; or infeasible, with a proof. None
        without convergence, if its mesh is too fine, or if a rival has become better.
    """
    if last.outcome.mesh.layout.intervals > bench.meter.max_intervals:
        return None
    with bench.trace.attempt(NEIGHBOUR, 'from a solution with other numbers') as attempt:
        found = _follow(bench, last)
        if found is None:
            attempt.end(Verdict.REJECTED, 'it does not converge, or another minimum is lower')
        else:
            attempt.end(*judge_path(found.solution), cost=found.solution.objective)
    return found


def _follow(bench: Bench, last: Answered) -> Candidate | None:
    """Do what `solve_from_neighbour` does, from the solution of one neighbour."""
    few = SolveEffort(12)   # a neighbour needs fewer, or another minimum may be better
    programs, stated, start = bench.programs, bench.stated, last.outcome
    bench = replace(
        bench, margin=last.margin, stages=start.mesh.layout.stages,
        problem=programs.twin.problem(stated) if programs.twin else bench.problem)   # the sharpest
    extremal, near = None, start_from_neighbour(programs, stated, last)
    if near is None:
        outcome = bench.collocate(start.mesh, start.path, near=Nearby(last.sizes, warm=start),
                                  effort=few)
    else:
        extremal, guide = near
        outcome = bench.collocate(guide.mesh, guide.path, near=Nearby(last.sizes, guide=guide),
                                  effort=few)
    found = bench.certify(outcome, extremal) if outcome.converged else None
    if found is not None and found.certified:
        found = Candidate(found.solution, nearby=near is not None, record=replace(
            last, problem=stated, outcome=outcome, extremal=extremal))
    elif reason := explain_contradiction(stated):  # although the neighbour has a solution
        return Candidate(Solution(Status.INFEASIBLE, reason))
    else:
        programs.answers.remove(last)   # it does not serve the next problem either
        if found is not None and not bench.meter.stopped:   # kinks have left the mesh points
            found = descend(bench, outcome)
            found = replace(found, record=found.record and replace(
                found.record, rivals=last.rivals, refined=last.refined, looked=last.looked))
    if found is None or not found.certified or found.record is None:
        return None
    # Costs of the rivals here, scaled from coarse to fine meshes.
    outcomes = [bench.collocate(rival.mesh, rival.path, near=Nearby(),
                                effort=SolveEffort(bench.options.coarse.iterations))
                for rival in last.rivals]
    costs = [last.refined * outcome.objective for outcome in outcomes if outcome.converged]
    if any(is_below(cost, found.solution.objective, ANOTHER) for cost in costs):
        return None
    known = last.optimality
    if known is None or not np.array_equal(last.rows[0], collect_numbers(stated)):
        known = describe_local(1 + len(costs), found.solution.objective, costs)
        known = replace(known, reason=f'{known.reason}, each a local minimum of the same problem '
                                      'with other numbers')
    programs.remember(replace(found.record, optimality=known))
    return replace(found, solution=replace(found.solution, optimality=known))
