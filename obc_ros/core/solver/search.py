# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Search by transcription: initial guesses, descents from them, and the best candidate.

The order is: a neighbouring problem that was solved before; initial guesses on a coarse mesh; a
descent from the best outcome; further guesses (multistart), until no better minimum is expected.
"""

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status, Verdict
from obc_ros.core.solver.bench import Bench, build_bench, Candidate, Task
from obc_ros.core.solver.descent import descend
from obc_ros.core.solver.multistart.coarse_mesh import CoarseResult, solve_coarse
from obc_ros.core.solver.multistart.multistart import explore_starts
from obc_ros.core.solver.multistart.neighbour import solve_from_neighbour
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.proofs.contradictions import explain_contradiction
from obc_ros.core.solver.proofs.optimality import describe_local
from obc_ros.core.solver.starts.start import StartPool
from obc_ros.core.solver.trace import GUESS
from obc_ros.core.solver.transcription.program import TranscriptionOutcome


def search(task: Task, *, with_arcs: bool = True, quick: bool = False,
           why_not: Callable[[Problem], str] = explain_contradiction) -> tuple[Candidate, Bench]:
    """
    Search for a solution.

    :param task: the problem, its programs, and the limits of the work.
    :param with_arcs: whether inputs may be held at bounds between switching times.
    :param quick: one start and a few meshes, for paths that need not be optimal.
    :param why_not: called when the first starts led to no path. Returns a proof of infeasibility
        in words, or ''.
    :return: found: the best one, with its certificate unless work was stopped; without samples if
        no path was found. The status is that of the descent, see `solve.solve`; bench: with the
        part of the work that the search was allowed.
    """
    bench = build_bench(task, with_arcs=with_arcs, quick=quick)
    last = None if quick or task.problem.starts else bench.programs.neighbour(bench.stated)
    if last and (known := solve_from_neighbour(bench, last)):
        return known, bench
    pool = StartPool(bench.problem, bench.programs)
    with bench.trace.attempt('coarse mesh') as attempt:
        coarse = solve_coarse(bench, pool, why_not)
        attempt.end(
            Verdict.ACCEPTED if coarse.sound else Verdict.REJECTED, '' if coarse.sound else (
                coarse.reason or 'no initial guess led to a path with a small discretisation '
                                 'error'),
            cost=coarse.outcomes[0].objective if coarse.outcomes and coarse.sound else np.nan)
    found, bench, minima = _descend(coarse, pool)
    if not found.solution.optimality:
        found = replace(found, solution=replace(found.solution, optimality=describe_local(
            bench.trace.count(GUESS), found.solution.objective, minima)))
    return found, bench


def _descend(coarse: CoarseResult, pool: StartPool) -> tuple[Candidate, Bench, list[float]]:
    """Return the best candidate from coarse outcomes, the bench, and the costs of minima."""
    bench, outcomes = coarse.bench, coarse.outcomes
    if coarse.reason:
        return Candidate(Solution(Status.INFEASIBLE, coarse.reason)), bench, []
    if not outcomes or not np.all(np.isfinite(outcomes[0].path.x)):
        return Candidate(Solution(Status.NOT_CONVERGED, (
            'no path was found from any initial guess'))), bench, []
    if bench.best and bench.best.path and bench.meter.stopped == 'accepted':
        return Candidate(bench.best.path), bench, []
    bench = replace(bench, meter=_budget(coarse))
    if bench.quick:
        return descend(bench, outcomes[0]), bench, []
    first = descend(bench, outcomes[0])
    if not (first.certified or bench.meter.stopped) and (
            reason := explain_contradiction(bench.stated)):
        # The discretised problem may have paths although the stated one has none.
        return Candidate(Solution(Status.INFEASIBLE, reason)), bench, []
    if bench.meter.stopped and (bench.meter.stopped == 'accepted' or not first.certified):
        return first, bench, []
    explored = explore_starts(
        bench, pool, first, outcomes[0].objective, outcomes[1:], sound=coarse.sound)
    return explored.best, bench, explored.minima


def _budget(coarse: CoarseResult) -> Meter:
    """Return the work that the descents may take."""
    options = coarse.bench.options.budget
    bench = coarse.bench
    if bench.quick:
        return bench.meter
    left = options.share * bench.meter.remaining()
    if not coarse.sound:
        return bench.meter.part(2 * bench.whole.effort, left)   # twice that of the coarse solves
    if _mixes(bench, coarse.outcomes[0]):   # chattering inputs: most work is left to explain them
        return bench.meter.part(bench.whole.effort + options.related, left)
    return bench.meter


def _mixes(bench: Bench, outcome: TranscriptionOutcome) -> bool:
    """Return whether an input stays between its bounds where H is concave in it."""
    error = bench.options.coarse.error
    problem, course = bench.problem, bench.course(outcome)
    if bench.programs.twin or any(ca.depends_on(problem.path, u) for u in ca.vertsplit(problem.u)):
        return False
    _, _, Huu = bench.programs.integrator.hamiltonian(problem, course.x, course.ua, course.lam)
    curvature, span = np.einsum('kii->ki', Huu), problem.u_upper - problem.u_lower
    with np.errstate(invalid='ignore'):
        inside = np.minimum(course.ua - problem.u_lower,
                            problem.u_upper - course.ua) > error * span
    concave = curvature < -error * np.abs(curvature).max(axis=0, initial=0.0)
    share = np.diff(course.t) @ (inside & concave & np.isfinite(span)) / course.t[-1]
    return bool(np.any(share > error))
