# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solution from the first initial guesses on a coarse mesh, finer if its error is large."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.initial_guess import join_whole_turns
from obc_ros.core.solver.starts.registry import try_starts
from obc_ros.core.solver.starts.start import Known, StartPool, StartStage
from obc_ros.core.solver.trace import GUESS
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, STEPPED
from obc_ros.core.solver.transcription.program import SolveEffort, TranscriptionOutcome


@dataclass(frozen=True)
class CoarseResult:
    """
    The outcomes of the first initial guesses.

    :ivar bench: with the coarse mesh on which they were found.
    :ivar outcomes: the cheapest first if `sound`, else the one with the smallest infeasibility.
    :ivar sound: whether they have a small discretisation error.
    :ivar reason: a proof that there is no path, '' without one.
    """

    bench: Bench
    outcomes: list[TranscriptionOutcome]
    sound: bool
    reason: str = ''


def solve_coarse(bench: Bench, pool: StartPool, why_not: Callable[[Problem], str]) -> CoarseResult:
    """
    Solve from several initial guesses on a coarse mesh.

    Outcomes with a large discretisation error are discarded. If all have one, the mesh is made
    finer, with a stiffly accurate scheme. An outcome with boundary layers keeps a large error on
    any coarse mesh; it is accepted if its cost is that of the coarser mesh, or if the problem is
    convex, so that there is no other minimum. The pool is filled anew for each mesh.

    `why_not` is called when the first mesh led to no path. It returns a proof of infeasibility in
    words, or ''.
    """
    options = bench.options.coarse
    most, convex = bench.meter.max_intervals, bench.programs.convex(bench.problem)
    if not bench.stages and bench.programs.guesser.is_stiff(bench.problem, options.intervals):
        bench = replace(bench, stages=3)
    levels = [(min(options.intervals, most), bench.stages)] + [
        (finer * options.intervals, 3) for finer in (2, 4) if finer * options.intervals <= most]
    found: list[TranscriptionOutcome] = []
    reason = ''
    for intervals, stages in levels[:2] if bench.quick else levels:
        bench = replace(bench, intervals=intervals, stages=stages)
        # The solution on the coarser mesh may be close in spite of its discretisation error.
        converged = [outcome for outcome in found if outcome.converged]
        pool.fill([min(converged, key=lambda outcome: outcome.objective).path]
                  if converged else ())
        if found and intervals == levels[1][0] and (
                longer := try_starts(StartStage.SECOND_MESH, bench, pool, Known()).outcomes):
            return CoarseResult(bench, list(longer), True)
        bench, found = _solve_first(bench, pool)
        good = [outcome for outcome in found
                if convex and outcome.converged or bench.is_accurate(outcome)
                or _agrees(outcome, converged, options.error)]
        if good:
            return CoarseResult(bench, _by_cost(good), True)
        if intervals <= options.intervals and not bench.quick:
            reason = why_not(bench.stated)
        if reason or bench.meter.stopped:
            break
    else:
        if last := try_starts(StartStage.LAST_RESORT, bench, pool, Known()).outcomes:
            bench = replace(bench, intervals=last[0].mesh.layout.intervals)
            return CoarseResult(bench, _by_cost(list(last)), True)
    return CoarseResult(bench, sorted(found, key=lambda outcome: (
        not outcome.converged, outcome.infeasibility)), False, reason)


def _agrees(outcome: TranscriptionOutcome, coarser: list[TranscriptionOutcome],
            apart: float) -> bool:
    """Return whether an outcome costs as much as one on a coarser mesh with the same scheme."""
    return outcome.converged and any(
        each.mesh.layout.stages == outcome.mesh.layout.stages
        and abs(each.objective - outcome.objective) <= apart * abs(outcome.objective)
        for each in coarser)


def _by_cost(outcomes: list[TranscriptionOutcome]) -> list[TranscriptionOutcome]:
    return sorted(outcomes, key=lambda outcome: (not outcome.converged, outcome.objective))


def _solve_first(bench: Bench, pool: StartPool) -> tuple[Bench, list[TranscriptionOutcome]]:
    """Return the outcomes of the first guesses, the given starts, and paths around obstacles."""
    options = bench.options.coarse
    found: list[TranscriptionOutcome] = []
    begun, good, others = bench.whole.effort, False, len(bench.problem.starts)
    for number in count(1):
        outcome = solve_next_start(bench, pool, once=good)
        found.append(outcome)
        if not good and bench.is_accurate(outcome):
            good, bench = True, replace(bench, typical=outcome.iterations)
            bench.keep(outcome)
        if outcome.converged and bench.programs.convex(bench.problem):
            return bench, found   # a convex program has no other minimum
        if number == 1 and not (bench.quick and good or bench.meter.stopped):
            others += try_starts(
                StartStage.FIRST_OUTCOME, bench, pool, Known(outcome=outcome)).wanted
        # After half a second `starts` guesses are enough, with and without a path.
        patient = bench.whole.effort - begun < 10_000 * (1 + bench.stages)
        most = options.starts if bench.quick else bench.options.rollouts.tried
        if (bench.meter.stopped or bench.quick and good or number >= others + (
                options.starts if good or not patient else most)):
            return bench, found
    raise AssertionError('the loop has no end of its own')


def solve_next_start(bench: Bench, pool: StartPool, *, once: bool,
                     hard: bool = False) -> TranscriptionOutcome:
    """
    Solve on the coarse mesh from the next initial guess.

    :param pool: the outcome is recorded in its `known_minima`.
    :param once: allow few iterations, in proportion to `bench.typical`, of the faster method only.
    :param hard: with `once`: allow twice as many.
    """
    options = bench.options.coarse
    most = options.iterations
    if once:
        most = min(most, max(12, round((5 if hard else 2.5) * bench.typical)))
    guess = start = pool.take()
    rough = options.rough
    with bench.trace.attempt(GUESS, guess.origin) as attempt:
        if np.isfinite(pool.periods).any():
            # An input that is an angle and turns by 2 pi within a step interpolates badly: solve
            # with constant inputs first, and remove the whole turns between its steps.
            steps = build_uniform_mesh(bench.problem, bench.intervals, bench.stages, STEPPED)
            stepped = bench.collocate(steps, start, effort=SolveEffort(options.iterations))
            start, rough = join_whole_turns(stepped.path, pool.periods), 0.0
        # Without terminal constraints a cheap rollout may be near another minimum: allow both
        # methods.
        once = once and not (guess.rollout and not bench.problem.q)
        outcome = bench.collocate(
            build_uniform_mesh(bench.problem, bench.intervals, bench.stages), start,
            effort=SolveEffort(most, rough, once, pool.known_minima))
        pool.known_minima.record_end(
            outcome.objective, outcome.infeasibility,
            outcome.path if outcome.converged else None, rollout=guess.rollout)
        attempt.end(*outcome.judge(), cost=outcome.objective)
    return outcome
