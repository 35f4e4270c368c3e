# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Multistart: descents from further initial guesses, for a better local minimum."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from obc_ros.core.ocp.solution import MOST_MINIMA, Solution, Verdict
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.bench import Bench, Candidate
from obc_ros.core.solver.coarse_mesh import solve_next_start
from obc_ros.core.solver.descent import descend, Descent, finish
from obc_ros.core.solver.improve.improvement import DescentStage, State
from obc_ros.core.solver.improve.registry import try_improvements
from obc_ros.core.solver.options import MultistartOptions
from obc_ros.core.solver.program_cache import collect_numbers
from obc_ros.core.solver.proofs.optimality import describe_local
from obc_ros.core.solver.starts.registry import try_starts
from obc_ros.core.solver.starts.start import Known, StartStage
from obc_ros.core.solver.starts.start_pool import is_rough, StartPool
from obc_ros.core.solver.starts.stopping_rule import Effort, explain_enough
from obc_ros.core.solver.trace import GUESS
from obc_ros.core.solver.transcription.local_minima import ANOTHER
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, split
from obc_ros.core.solver.transcription.program import TranscriptionOutcome

_MET = 1e-5           # infeasibility of a feasible path
_SAME = 2e-4          # relative difference up to which two coarse costs are of the same minimum
_CHEAPER = 1e-6       # relative difference of the costs of two certified solutions that counts


def descend_from_coarse(bench: Bench, pool: StartPool, first: TranscriptionOutcome
                        ) -> tuple[Candidate, float]:
    """
    Refine a coarse outcome; after much work, try cheaper outcomes of other guesses first.

    A local minimum may need very fine meshes, for example between obstacles, while a better one
    is found easily.

    Parameters
    ----------
    bench : Bench
        With the coarse mesh.
    pool : StartPool
        Other guesses.
    first : TranscriptionOutcome
        The best one on the coarse mesh.

    Returns
    -------
    found : Candidate
    floor : float
        Cost on the coarse mesh of the outcome that led to it.

    """
    options = bench.options.multistart
    first = try_improvements(DescentStage.COARSE, State(bench, first)).outcome
    begun, work = bench.work, Descent(bench, first).follow()
    try:
        while bench.work - begun <= options.long:
            next(work)
    except StopIteration as end:
        return cast('Candidate', end.value), first.objective
    cheapest = first
    for _ in range(options.looks):
        outcome = solve_next_start(bench, pool, once=True, hard=True)
        if is_below(outcome.objective, cheapest.objective, ANOTHER) and bench.is_accurate(outcome):
            cheapest = outcome
    other = None if cheapest is first else descend(bench, cheapest)
    if other is None or not other.certified:
        return finish(work), first.objective
    return other, cheapest.objective


@dataclass(frozen=True)
class Explored:
    """The best candidate of multistart, and the costs of other local minima."""

    best: Candidate
    minima: list[float]
    why: str   # no further start was tried


def explore_starts(bench: Bench, pool: StartPool, first: Candidate, floor: float,
                   others: Sequence[TranscriptionOutcome] = (), *, sound: bool = False
                   ) -> Explored:
    """
    Try further initial guesses, and return the best solution.

    There are none if the problem is convex. Their number grows with the work of the first descent,
    and is larger if costs have several local minima or guesses often fail.

    Parameters
    ----------
    bench : Bench
        With the coarse mesh; a certified solution is kept for neighbours.
    pool : StartPool
        The guesses.
    first : Candidate
        Of the first descent.
    floor : float
        Its cost on the coarse mesh.
    others : sequence of TranscriptionOutcome
        Outcomes on the coarse mesh that were not refined yet.
    sound : bool
        Whether coarse outcomes have a small discretisation error: a convex problem then needs no
        further start, certified or not.

    Returns
    -------
    Explored

    """
    with bench.trace.attempt('multistart') as attempt:
        found = _explore(bench, pool, first, floor, others, sound)
        attempt.end(Verdict.REJECTED if found.best is first else Verdict.ACCEPTED, found.why,
                    cost=found.best.solution.objective)
    return found


def _explore(bench: Bench, pool: StartPool, best: Candidate, floor: float,
             others: Sequence[TranscriptionOutcome], sound: bool) -> Explored:
    """Do what `explore_starts` does."""
    options = bench.options.multistart
    spent, programs = 0, bench.programs
    alone = (best.certified or sound) and programs.convex(bench.stated)
    before, bent = bench.work, not alone and _disproportion(bench, best) > options.bent
    uneven = programs.uneven_costs(bench.problem, abs(floor))
    wanted = 1 + len(others) + (0 if alone else try_starts(
        StartStage.MULTISTART, bench, pool,
        Known(best=best, floor=floor, begun=before, uneven=uneven, bent=bent)).wanted)
    found, coarse = list[TranscriptionOutcome](), floor   # coarse cost of the best solution
    followed = [floor]   # coarse costs of the outcomes that were refined
    # Costs of the certified solutions that they led to.
    refined = [best.solution.objective] if best.certified else []
    # `wanted`: number of starts, increased by each that leads to a better solution.
    why = 'the problem is convex: there is no other minimum' if alone else (
        f'{options.most} starts were tried')
    for number in range(0 if alone else options.most):
        stop = bench.meter.stopped or explain_enough(Effort(
            starts=number, wanted=wanted, before=before, spent=spent, total=bench.work,
            certified=best.certified, uneven=uneven, bent=bent, rough=is_rough(bench, pool),
            stages=bench.stages, minima=pool.known_minima.minima,
            complete=pool.known_minima.enough()), options)
        if stop:
            why = stop
            break
        started = bench.work
        outcome = others[number] if number < len(others) else _pursued(
            bench, floor, solve_next_start(
                bench, pool, once=best.certified, hard=uneven or before > options.hard))
        lower = is_below(outcome.objective, floor, ANOTHER)
        descends = lower and not outcome.converged and outcome.infeasibility <= _MET
        differs = not best.certified and all(
            abs(outcome.objective - other) > ANOTHER * abs(other) for other in followed)
        if descends or (lower or differs) and bench.is_accurate(outcome) and (
                differs or _may_be_better(bench, outcome, best, coarse, lower=lower)):
            followed.append(outcome.objective)
            floor = min(floor, outcome.objective)
            other = bench.certify(outcome) if descends else descend(bench, outcome)
            refined += [other.solution.objective] if other.certified else []
            if better(best.solution, other.solution) is other.solution:
                best, coarse = other, outcome.objective
                wanted = max(wanted, number + 1 + options.after)
        found.append(outcome)
        spent += bench.work - started
    minima = refined + _others(bench, found, followed, coarse)
    if best.certified and best.record:
        _remember(bench, pool, best, minima, found, coarse)
    return Explored(best, minima, why)


def _remember(bench: Bench, pool: StartPool, best: Candidate, minima: list[float],
              found: list[TranscriptionOutcome], coarse: float) -> None:
    """Keep a solution for neighbouring problems."""
    record, cost = best.record, best.solution.objective
    assert record is not None
    if record.extremal:
        record = replace(record, extremal=bench.programs.indirect.thinned(
            bench.stated, record.extremal, record.sizes))
    bench.programs.remember(replace(
        record, rivals=_rivals(found, coarse, bench.options.multistart),
        refined=cost / coarse if coarse else 1, looked=collect_numbers(bench.stated),
        optimality=describe_local(bench.trace.count(GUESS), cost, minima)))
    bench.programs.note_minima(pool.known_minima.minima)


def better(best: Solution, other: Solution) -> Solution:
    """
    Return the better one of two solutions of a problem.

    A cheaper feasible path replaces a certified solution, since that is not the global minimum.

    Parameters
    ----------
    best : Solution
        Kept if the other one is not clearly better.
    other : Solution
        With its certificate, if there is one.

    """
    def cheaper(one: Solution, than: Solution) -> bool:
        both = one.certified and than.certified
        return is_below(one.objective, than.objective, _CHEAPER if both else ANOTHER)

    def feasible(one: Solution) -> bool:
        return bool(one.certificate and one.certificate.feasible)

    if cheaper(other, best):
        return other if other.certified or feasible(other) else best
    first = other.certified and not best.certified and not (
        feasible(best) and cheaper(best, other))
    return other if first else best


def _disproportion(bench: Bench, best: Candidate) -> float:
    """
    Return the nonlinearity index: max |2 x(u_half) - x(u_mean) - x(u)| over the range of x.

    u is the input of the last path, u_mean its mean, u_half the mean of both. If the index is
    small, the dynamics cause no other local minima.
    """
    options = bench.options.multistart
    if best.record is None:
        return 0.0
    path, parts = best.record.outcome.path, np.array([0.0, 0.5, 1.0])
    first = np.unique(np.linspace(0, len(path.ua), options.parts + 1).astype(np.int64))
    t, h = path.t[first], np.diff(path.t)[:, None]
    u = np.add.reduceat(h * (path.ua + path.ub) / 2, first[:-1])
    mean, u = u.sum(axis=0) / t[-1], u / np.maximum(np.diff(t), 1e-300)[:, None]
    (none, half, all_), _ = bench.programs.integrator.forward_each(
        bench.problem, np.tile(t, (3, 1)), mean + parts[:, None, None] * (u - mean))
    with np.errstate(invalid='ignore', over='ignore'):
        off = np.abs(2 * half - none - all_).max(axis=0)
        off /= np.maximum(np.ptp(path.x, axis=0), 1e-300)
    return float(np.nan_to_num(off, nan=np.inf).max(initial=0.0))


def _pursued(bench: Bench, floor: float, outcome: TranscriptionOutcome) -> TranscriptionOutcome:
    """Return an outcome; of lower cost than `floor`, converged on meshes with small errors."""
    options = bench.options.multistart
    if is_below(outcome.objective, floor, ANOTHER):
        if not outcome.converged and outcome.infeasibility <= _MET:   # it needs more iterations
            later = bench.collocate(outcome.mesh, outcome.path, near=True, most=options.iterations)
            outcome = later if later.converged else outcome
        for _ in range(options.splits):
            if not outcome.converged or bench.is_accurate(outcome):
                break
            mesh = split(outcome.mesh, np.full(outcome.mesh.layout.intervals, 2))
            outcome = bench.collocate(mesh, outcome.path, near=True, most=options.iterations)
    return outcome


def _may_be_better(bench: Bench, outcome: TranscriptionOutcome, best: Candidate, coarse: float, *,
                   lower: bool) -> bool:
    """
    Return whether an outcome may be better than the best, by costs on a finer mesh if these err.

    `lower`: whether it is on the coarse mesh.
    """
    options = bench.options.multistart
    cost, kept = best.solution.objective, best.record
    if kept is None or abs(cost - coarse) <= options.errs * abs(coarse) or (
            outcome.mesh.layout.intervals > bench.intervals):
        return True
    mesh = build_uniform_mesh(bench.problem, options.finer * bench.intervals, bench.stages)
    if not bench.meter.allows(mesh.layout.intervals):
        return True
    known, new = (bench.collocate(mesh, path, path.t[-1:], near=True, most=options.iterations)
                  for path in (kept.outcome.path, outcome.path))
    if not (known.converged and new.converged):
        return lower
    apart, error = new.objective - known.objective, abs(cost - known.objective)
    return _SAME * abs(known.objective) < abs(apart) and apart < 2 * error


def _others(bench: Bench, found: list[TranscriptionOutcome], followed: list[float],
            coarse: float) -> list[float]:
    """
    Return the costs of local minima that were not refined, on the mesh on which they were found.

    `followed`: coarse costs of those that were refined; `coarse`: that of the best.
    """
    costs: list[float] = []
    for outcome in sorted(found, key=lambda outcome: outcome.objective):
        cost, known = outcome.objective, [*followed, *costs]
        if len(costs) == MOST_MINIMA or bench.meter.stopped:
            break
        if cost > coarse and all(abs(cost - other) > ANOTHER * abs(other) for other in known) and (
                bench.is_accurate(outcome)):
            costs.append(cost)
    return costs


def _rivals(found: list[TranscriptionOutcome], coarse: float,
            options: MultistartOptions) -> tuple[TranscriptionOutcome, ...]:
    """Return outcomes of other local minima whose coarse cost is not much above the best."""
    rivals: list[TranscriptionOutcome] = []
    for outcome in sorted(found, key=lambda outcome: outcome.objective):
        above = outcome.objective - (rivals[-1].objective if rivals else coarse)
        if (outcome.converged and above > ANOTHER * abs(coarse)
                and outcome.objective <= coarse + options.rival * abs(coarse)):
            rivals.append(outcome)
    return tuple(rivals[:options.rivals])
