# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Further starts, once there is an answer: whether there is a better one elsewhere."""

from collections.abc import Generator, Sequence
from copy import copy
from dataclasses import replace
from itertools import chain
from typing import cast

import numpy as np
from obc_ros.core.ocp.solution import MOST_MINIMA, Solution
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.improve.hamiltonian_wells import move_to_best_branch
from obc_ros.core.solver.program_cache import Answered, collect_numbers
from obc_ros.core.solver.proofs.optimality import describe_local
from obc_ros.core.solver.starts.cross_entropy import (
    interleave_rollouts,
    RolloutEnd,
    search_rollouts_briefly,
)
from obc_ros.core.solver.starts.final_time_windows import find_other_lengths
from obc_ros.core.solver.transcription.local_minima import ANOTHER
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, Path, split
from obc_ros.core.solver.transcription.program import TranscriptionOutcome

_EXPLORING = (0.15, 0.3)   # part of the work for further starts, of easy and of hard problems
_HARD = 3000
_LEAST_HARD = 12      # number of them, of hard problems by collocation, and of rough ones
_LEAST_BENT = 8       # likewise where states do not follow inputs in proportion, or T is free
_BENT, _PARTS = 0.4, 12   # of how far states go, beyond which they do not; steps to find out
_LONG, _LOOKS = 60_000, 3   # work for a path, after which so many starts are looked at
_FEW = 2              # minima, beyond which rough problems are given twice as many
_SLOW = 30            # iterations on a coarse mesh, beyond which a problem is rough
_AFTER = 3            # further starts, once one has led to something better
# Likewise of those by Runge-Kutta steps that are hard, or have uneven costs, and work for them.
_MANY, _MOST, _FOR_MANY = 24, 80, 15_000
_ITERATIONS = 150     # for a lower cost that is not to be believed yet
_MET = 1e-5           # infeasibility of a path
_SPLITS = 2           # of meshes, until a lower cost is believed
_ERRS, _FINER = 1e-2, 4   # relative: such an error of coarse costs; times as many intervals
_TIES, _SAME = 6, 2e-4   # followed up although on the coarse mesh they cost a little more
_CHEAPER = 1e-6       # relative: of two answers that are certified
_SAYS = 0.2           # relative: error of a cost on a coarse mesh that says something
_RIVALS, _RIVAL = 3, 0.3   # other minima that are kept, costs up to so much above the best
# Work without an answer that holds, after which no further start is tried once they have made so
# much; work for further starts of rough problems, where as much has not been made before.
_WEARY, _FOR_ROUGH = (500_000, 50_000), 3000
_LAVISH = 150_000   # work for further starts, once there is an answer that holds


def finish_descent(work: Generator[None, None, Solution]) -> Solution:
    """Return what work at leisure leads to."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return cast('Solution', end.value)


def descend_from_coarse(search: Bench, first: TranscriptionOutcome) -> tuple[Solution, float]:
    """
    Return the answer that a coarse outcome leads to, or one that costs less, and its coarse cost.

    A path that winds between obstacles may need meshes that take a minute where another one is
    found at once: after some work a few starts are looked at, before finer meshes.
    """
    first = move_to_best_branch(search, first)
    begun, work = search.work, search.following(first)
    try:
        while search.work - begun <= _LONG:
            next(work)
    except StopIteration as end:
        return cast('Solution', end.value), first.objective
    beside, cheapest = copy(search), first
    for _ in range(_LOOKS):
        beside.reset()
        outcome = beside.from_next_start(once=True, hard=True)
        if is_below(outcome.objective, cheapest.objective, ANOTHER) and beside.believed(outcome):
            cheapest = outcome
    other = None if cheapest is first else beside.followed_up(cheapest)
    search.work, search.tried = beside.work, beside.tried
    if other is None or not other.certified:
        return finish_descent(work), first.objective
    search.last = beside.last
    return other, cheapest.objective


def explore_starts(search: Bench, best: Solution, floor: float,
                   others: Sequence[TranscriptionOutcome] = ()) -> Solution:
    """
    Return the best answer after some more starts, and after what others have led to.

    There are none where no path can be better. Their number grows with the work that the problem
    has made so far: what is solved at once is not held up; what is hard, has uneven costs or leads
    starts astray is looked at from many sides.
    """
    kept, spent = search.last, 0
    alone = best.certified and search.kit.convex(search.stated)
    before, bent = search.work, not alone and _disproportion(search) > _BENT
    uneven = search.kit.uneven_costs(search.problem, abs(floor))
    promising, lengths = ([], []) if alone else _lined_up(
        search, floor, uneven=uneven, bent=bent)
    # `ground`: of the best, on the coarse mesh.
    found, ground = list[TranscriptionOutcome](), floor
    ties = [floor]   # coarse costs of what was followed up
    refined = [best.objective] if best.certified else []   # and those that it led to
    # Starts, more after each that has led to something better.
    wanted = 1 + len(others) + len(lengths) + bool(promising)
    for number in range(0 if alone else _MOST):
        if search.monitor.stopped or _enough(search, number, (before, spent), wanted,
                                             best.certified, uneven=uneven, bent=bent):
            break
        started = search.work
        search.reset()
        outcome = others[number] if number < len(others) else _pursued(
            search, floor, search.from_next_start(
                once=best.certified, hard=uneven or before > _HARD))
        lower = is_below(outcome.objective, floor, ANOTHER)
        falls = lower and not outcome.converged and outcome.infeasibility <= _MET
        tied = (outcome.converged and len(ties) < _TIES and outcome.objective < _tie(best, ground)
                and all(abs(outcome.objective - other) > _SAME * abs(other) for other in ties))
        differs = not best.certified and all(
            abs(outcome.objective - other) > ANOTHER * abs(other) for other in ties)
        if falls or (lower or tied or differs) and search.believed(outcome) and (
                differs or _may_be_better(search, outcome, best, kept, ground, lower=lower)):
            ties.append(outcome.objective)
            floor = min(floor, outcome.objective)
            if falls:
                other = search.solution(outcome, search.course(outcome))
                search.last = search.answered(outcome)
            else:
                other = search.followed_up(outcome)
            refined += [other.objective] if other.certified else []
            if _to_be_told(other, best):
                best, kept, ground = other, search.last, outcome.objective
                wanted = max(wanted, number + 1 + _AFTER)
        found.append(outcome)
        spent += search.work - started
    search.last, search.minima = kept, refined + _others(search, found, ties, ground)
    if best.certified and kept:
        if kept.extremal:
            kept = replace(kept, extremal=search.kit.indirect.thinned(
                search.stated, kept.extremal, kept.sizes))
        search.kit.remember(replace(
            kept, rivals=_rivals(found, ground), refined=best.objective / ground if ground else 1,
            looked=collect_numbers(search.stated),
            optimality=describe_local(search.tried, best.objective, search.minima)))
        search.kit.several |= search.familiar.minima > 1
    return best


def _lined_up(search: Bench, floor: float, *, uneven: bool,
              bent: bool) -> tuple[list[RolloutEnd], list[Path]]:
    """Line up further starts; return the promising ones, and those of other lengths."""
    problem, begun, lengths = search.problem, search.work, list[Path]()
    if uneven:
        search.starts = search.kit.guesser.scattered(
            problem, search.kit.integrator, search.starts, abs(floor))
        if problem.q:
            return [], lengths
    promising = search_rollouts_briefly(search, bent or uneven)
    if not uneven:
        lengths = find_other_lengths(search, search.starts, bent)
    aside = search.work - begun
    search.starts = chain(lengths, interleave_rollouts(
        search, search.starts, promising,
        lambda: search.work - aside > _HARD or _rough(search), bent))
    return promising, lengths


def _to_be_told(other: Solution, best: Solution) -> bool:
    """
    Return whether another answer is to be told instead of the best one so far.

    What is cheaper and feasible shows that the other is not the best, proved or not.
    """
    def cheaper(one: Solution, than: Solution) -> bool:
        both = one.certified and than.certified
        return is_below(one.objective, than.objective, _CHEAPER if both else ANOTHER)

    def feasible(one: Solution) -> bool:
        return bool(one.certificate and one.certificate.feasible)

    if cheaper(other, best):
        return other.certified or feasible(other)
    return other.certified and not best.certified and not (
        feasible(best) and cheaper(best, other))


def _enough(search: Bench, number: int, work: tuple[int, int], wanted: int, certified: bool, *,
            uneven: bool, bent: bool) -> bool:
    """Return whether so many further starts will do; `work`: before them, and for them."""
    (before, spent), rough = work, _rough(search)
    hard = before > _HARD
    if spent > _LAVISH if certified else search.work > _WEARY[0] and spent > _WEARY[1]:
        return True
    if (rough or bent) and certified and not (hard or uneven) and spent > max(_FOR_ROUGH, before):
        return True
    if uneven or hard and not search.stages:
        many = number >= _MANY and spent >= _FOR_MANY
    else:
        times = 1 + (search.familiar.minima > _FEW and not hard)
        least = _LEAST_HARD if hard or rough else _LEAST_BENT if bent else 1
        many = number >= max(times * least if least > 1 else 1, wanted)
    return many and (spent > _EXPLORING[hard] * search.work or search.familiar.enough())


def _disproportion(search: Bench) -> float:
    """
    Return by how much states are off half of their way where inputs go half of theirs.

    From their means to those of the path found last; relative to how far the states go on it.
    Where it is small, dynamics bring about no other minima.
    """
    if search.last is None:
        return 0.0
    path, parts = search.last.outcome.path, np.array([0.0, 0.5, 1.0])
    first = np.unique(np.linspace(0, len(path.ua), _PARTS + 1).astype(np.int64))
    t, h = path.t[first], np.diff(path.t)[:, None]
    u = np.add.reduceat(h * (path.ua + path.ub) / 2, first[:-1])
    mean, u = u.sum(axis=0) / t[-1], u / np.maximum(np.diff(t), 1e-300)[:, None]
    (none, half, all_), _ = search.kit.integrator.forward_each(
        search.problem, np.tile(t, (3, 1)), mean + parts[:, None, None] * (u - mean))
    with np.errstate(invalid='ignore', over='ignore'):
        off = np.abs(2 * half - none - all_).max(axis=0)
        off /= np.maximum(np.ptp(path.x, axis=0), 1e-300)
    return float(np.nan_to_num(off, nan=np.inf).max(initial=0.0))


def _rough(search: Bench) -> bool:
    """Return whether starts have led far or nowhere, or slowly."""
    return search.typical > _SLOW or search.familiar.rough


def _pursued(search: Bench, floor: float, outcome: TranscriptionOutcome) -> TranscriptionOutcome:
    """Return an outcome, or what it leads to where a lower cost is not to be believed yet."""
    if is_below(outcome.objective, floor, ANOTHER):
        if not outcome.converged and outcome.infeasibility <= _MET:   # ended too soon
            later = search.collocate(outcome.mesh, outcome.path, near=True, most=_ITERATIONS)
            outcome = later if later.converged else outcome
        for _ in range(_SPLITS):
            if not outcome.converged or search.believed(outcome):
                break
            mesh = split(outcome.mesh, np.full(outcome.mesh.layout.intervals, 2))
            outcome = search.collocate(mesh, outcome.path, near=True, most=_ITERATIONS)
    return outcome


def _tie(best: Solution, ground: float) -> float:
    """Return the coarse cost below which finer meshes may lead to less than the best answer."""
    error = abs(best.objective - ground)
    return ground + 2 * error if best.certified and error < _SAYS * abs(ground) else -np.inf


def _may_be_better(search: Bench, outcome: TranscriptionOutcome, best: Solution,
                   kept: Answered | None,
                   ground: float, *, lower: bool) -> bool:
    """
    Return whether an outcome may be better on a finer mesh, too, where coarse costs err.

    `lower`: whether it is on the coarse one.
    """
    if kept is None or abs(best.objective - ground) <= _ERRS * abs(ground) or (
            outcome.mesh.layout.intervals > search.intervals):
        return True
    mesh = build_uniform_mesh(search.problem, _FINER * search.intervals, search.stages)
    if not search.monitor.allows(mesh.layout.intervals):
        return True
    known, new = (search.collocate(mesh, path, path.t[-1:], near=True, most=_ITERATIONS)
                  for path in (kept.outcome.path, outcome.path))
    if not (known.converged and new.converged):
        return lower
    apart, error = new.objective - known.objective, abs(best.objective - known.objective)
    return _SAME * abs(known.objective) < abs(apart) and apart < 2 * error


def _others(search: Bench, found: list[TranscriptionOutcome], followed: list[float],
            ground: float) -> list[float]:
    """
    Return the costs of minima that were not followed up, on the mesh on which they were met.

    `followed`: coarse costs of those that were; `ground`: that of the best of them.
    """
    costs: list[float] = []
    for outcome in sorted(found, key=lambda outcome: outcome.objective):
        cost, known = outcome.objective, [*followed, *costs]
        if len(costs) == MOST_MINIMA or search.monitor.stopped:
            break
        if cost > ground and all(abs(cost - other) > ANOTHER * abs(other) for other in known) and (
                search.believed(outcome)):
            costs.append(cost)
    return costs


def _rivals(found: list[TranscriptionOutcome], ground: float) -> tuple[TranscriptionOutcome, ...]:
    """Return outcomes of other minima whose costs are not much more than the best one's."""
    rivals: list[TranscriptionOutcome] = []
    for outcome in sorted(found, key=lambda outcome: outcome.objective):
        above = outcome.objective - (rivals[-1].objective if rivals else ground)
        if (outcome.converged and above > ANOTHER * abs(ground)
                and outcome.objective <= ground + _RIVAL * abs(ground)):
            rivals.append(outcome)
    return tuple(rivals[:_RIVALS])
