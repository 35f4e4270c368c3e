# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Multistart: descents from further guesses, until no better local minimum is expected."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from obc_ros.core.ocp.solution import MOST_MINIMA, Solution, Verdict
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.bench import Bench, Candidate
from obc_ros.core.solver.descent import descend
from obc_ros.core.solver.multistart.coarse_mesh import solve_next_start
from obc_ros.core.solver.options import MultistartOptions
from obc_ros.core.solver.program_cache import Answered, collect_numbers
from obc_ros.core.solver.proofs.optimality import describe_local
from obc_ros.core.solver.starts.registry import try_starts
from obc_ros.core.solver.starts.start import Known, StartPool, StartStage
from obc_ros.core.solver.trace import GUESS
from obc_ros.core.solver.transcription.local_minima import ANOTHER, CHEAPER, MET, SAME
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, split
from obc_ros.core.solver.transcription.program import Nearby, SolveEffort, TranscriptionOutcome


@dataclass(frozen=True, kw_only=True)
class Effort:
    """
    What multistart has done so far, and what it knows of the problem.

    :ivar starts, wanted: initial guesses so far, and those that are worth a try because of earlier
        ones.
    :ivar before, spent, total: work before multistart, work of its starts, and work of the whole
        search.
    :ivar certified: whether the best solution is certified.
    :ivar uneven, bent, rough: whether the cost may have several local minima in the states;
        whether the dynamics are strongly nonlinear; whether coarse solves fail, end at very
        different costs, or are slow.
    :ivar stages: collocation points in an interval; 0: Runge-Kutta steps.
    :ivar complete: whether no further minimum is expected (Boender, Rinnooy Kan 1987).
    """

    starts: int
    wanted: int
    before: int
    spent: int
    total: int
    certified: bool
    uneven: bool = False
    bent: bool = False
    rough: bool = False
    stages: int = 0
    complete: bool = False


def explain_enough(effort: Effort, options: MultistartOptions) -> str:
    """Return in words why multistart may stop; '' if another start is worth its work."""
    number, spent, hard = effort.starts, effort.spent, effort.before > options.hard
    if spent > options.lavish:
        return f'{_count(number)} used up the work that further starts may take'
    if (effort.rough or effort.bent) and effort.certified and not (hard or effort.uneven) and (
            spent > options.hard):
        return f'{_count(number)} took more work than the solution'
    if effort.uneven or hard and not effort.stages:
        many = number >= 2 * options.least_hard and spent >= options.many_work
    else:
        least = options.least_bent if effort.bent else 1
        least = options.least_hard if hard or effort.rough else least
        many = number >= max(least, effort.wanted)
    if many and spent > (2 if hard else 1) * options.share * effort.total:
        return f'{_count(number)} used up their part of the work'
    if many and effort.complete:
        return f'{_count(number)} led to known minima only'
    return ''


def _count(number: int) -> str:
    return f'{number} start{"" if number == 1 else "s"}'


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

    :param bench: with the coarse mesh; a certified solution is kept for neighbours.
    :param first, floor: of the first descent, and its cost on the coarse mesh.
    :param others: outcomes on the coarse mesh that were not refined yet.
    :param sound: whether coarse outcomes have a small discretisation error: a convex problem then
        needs no further start, certified or not.
    """
    with bench.trace.attempt('multistart') as attempt:
        found = _Multistart(bench, pool, first, floor).run(others, sound)
        vain = found.best is first
        attempt.end(Verdict.REJECTED if vain else Verdict.ACCEPTED,
                    f'no lower cost; {found.why}' if vain else found.why,
                    cost=found.best.solution.objective)
    return found


class _Multistart:
    """The best candidate of a search, and what further starts led to."""

    def __init__(self, bench: Bench, pool: StartPool, first: Candidate, floor: float) -> None:
        self._bench, self._pool, self._options = bench, pool, bench.options.multistart
        self._before, self._spent, self._wanted = bench.whole.effort, 0, 1
        self._bent = self._uneven = False
        self._best, self._coarse = first, floor   # and its cost on the coarse mesh
        self._found: list[TranscriptionOutcome] = []
        # Coarse costs of the outcomes that were refined, costs of certified solutions from them.
        self._followed = [floor]
        self._refined = [first.solution.objective] if first.certified else []

    def run(self, others: Sequence[TranscriptionOutcome], sound: bool) -> Explored:
        """Try starts until no better minimum is expected."""
        if (self._best.certified or sound) and self._bench.programs.convex(self._bench.stated):
            why = 'the problem is convex: there is no other minimum'
        else:
            why = self._try_starts(others)
        minima = self._refined + self._find_others()
        if self._best.certified and self._best.record:
            self._remember(self._best.record, minima)
        return Explored(self._best, minima, why)

    def _try_starts(self, others: Sequence[TranscriptionOutcome]) -> str:
        """Refine outcomes of lower cost; return why no further start is tried."""
        bench, floor = self._bench, self._coarse
        self._bent = _disproportion(bench, self._best) > self._options.bent
        self._uneven = bench.programs.uneven_costs(bench.problem, abs(floor))
        known = Known(best=self._best, floor=floor, begun=self._before, uneven=self._uneven,
                      bent=self._bent)
        self._wanted = 1 + len(others) + try_starts(
            StartStage.MULTISTART, bench, self._pool, known).wanted
        for number in range(self._options.most):
            begun = bench.whole.effort
            if stop := bench.meter.stopped or explain_enough(Effort(
                    starts=number, wanted=self._wanted, before=self._before, spent=self._spent,
                    total=begun, certified=self._best.certified, uneven=self._uneven,
                    bent=self._bent, rough=self._pool.is_rough(bench),
                    stages=bench.stages, complete=self._pool.known_minima.enough()),
                    self._options):
                return stop
            outcome = others[number] if number < len(others) else self._solve_next()
            if (other := self._refine(outcome)) is not None:
                self._refined += [other.solution.objective] if other.certified else []
                if better(self._best.solution, other.solution) is other.solution:
                    self._best, self._coarse = other, outcome.objective
                    self._wanted = max(self._wanted, number + 1 + self._options.after)
            self._found.append(outcome)
            self._spent += bench.whole.effort - begun
        return f'{self._options.most} starts were tried'

    def _solve_next(self) -> TranscriptionOutcome:
        """Solve from the next guess; if the cost is lower, on meshes with small errors."""
        bench, effort = self._bench, SolveEffort(self._bench.options.coarse.iterations)
        outcome = solve_next_start(bench, self._pool, once=self._best.certified,
                                   hard=self._uneven or self._before > self._options.hard)
        if not self._is_lowest(outcome):
            return outcome
        if not outcome.converged and outcome.infeasibility <= MET:   # it needs more iterations
            later = bench.collocate(outcome.mesh, outcome.path, near=Nearby(), effort=effort)
            outcome = later if later.converged else outcome
        for _ in range(2):   # two halvings of the mesh confirm a lower cost
            if not outcome.converged or bench.is_accurate(outcome):
                break
            mesh = split(outcome.mesh, np.full(outcome.mesh.layout.intervals, 2))
            outcome = bench.collocate(mesh, outcome.path, near=Nearby(), effort=effort)
        return outcome

    def _is_lowest(self, outcome: TranscriptionOutcome) -> bool:
        """Return whether an outcome costs less than those that were refined."""
        return is_below(outcome.objective, min(self._followed), ANOTHER)

    def _refine(self, outcome: TranscriptionOutcome) -> Candidate | None:
        """Return the candidate that an outcome leads to, None if it cannot be the best."""
        lower = self._is_lowest(outcome)
        descends = lower and not outcome.converged and outcome.infeasibility <= MET
        differs = not self._best.certified and all(
            abs(outcome.objective - other) > ANOTHER * abs(other) for other in self._followed)
        if not (descends or (lower or differs) and self._bench.is_accurate(outcome) and (
                differs or self._may_be_better(outcome, lower=lower))):
            return None
        self._followed.append(outcome.objective)
        return self._bench.certify(outcome) if descends else descend(self._bench, outcome)

    def _may_be_better(self, outcome: TranscriptionOutcome, *, lower: bool) -> bool:
        """
        Return whether an outcome may be the best, by costs on a finer mesh if these err.

        `lower`: whether it is on the coarse mesh.
        """
        bench, effort = self._bench, SolveEffort(self._bench.options.coarse.iterations)
        cost, kept, coarse = self._best.solution.objective, self._best.record, self._coarse
        if kept is None or abs(cost - coarse) <= bench.options.coarse.error * abs(coarse) or (
                outcome.mesh.layout.intervals > bench.intervals):
            return True
        mesh = build_uniform_mesh(bench.problem, 4 * bench.intervals, bench.stages)
        if not bench.meter.allows(mesh.layout.intervals):
            return True
        known, new = (bench.collocate(mesh, path.in_one_phase(), near=Nearby(), effort=effort)
                      for path in (kept.outcome.path, outcome.path))
        if not (known.converged and new.converged):
            return lower
        apart, error = new.objective - known.objective, abs(cost - known.objective)
        return SAME * abs(known.objective) < abs(apart) and apart < 2 * error

    def _find_others(self) -> list[float]:
        """Return the coarse costs of local minima above the best that were not refined."""
        costs: list[float] = []
        for outcome in sorted(self._found, key=lambda outcome: outcome.objective):
            cost, known = outcome.objective, [*self._followed, *costs]
            if len(costs) == MOST_MINIMA or self._bench.meter.stopped:
                break
            if cost > self._coarse and all(
                    abs(cost - other) > ANOTHER * abs(other) for other in known) and (
                        self._bench.is_accurate(outcome)):
                costs.append(cost)
        return costs

    def _remember(self, record: Answered, minima: list[float]) -> None:
        """Keep the best solution, and rivals that may be the best of neighbouring problems."""
        bench, cost, coarse = self._bench, self._best.solution.objective, self._coarse
        if record.extremal:
            record = replace(record, extremal=bench.programs.indirect.thinned(
                bench.stated, record.extremal, record.sizes))
        rivals: list[TranscriptionOutcome] = []
        for outcome in sorted(self._found, key=lambda outcome: outcome.objective):
            above = outcome.objective - (rivals[-1].objective if rivals else coarse)
            if (outcome.converged and above > ANOTHER * abs(coarse) and outcome.objective
                    <= coarse + bench.options.neighbour.near * abs(coarse)):
                rivals.append(outcome)
        bench.programs.remember(replace(
            record, rivals=tuple(rivals[:MOST_MINIMA]), refined=cost / coarse if coarse else 1,
            looked=collect_numbers(bench.stated),
            optimality=describe_local(bench.trace.count(GUESS), cost, minima)),
            self._pool.known_minima.minima)


def better(best: Solution, other: Solution) -> Solution:
    """
    Return the better one of two solutions of a problem.

    A cheaper feasible path replaces a certified solution, since that is not the global minimum. A
    feasible path replaces one that is not.

    :param best: kept if the other one is not clearly better.
    :param other: with its certificate, if there is one.
    """
    def cheaper(one: Solution, than: Solution) -> bool:
        both = one.certified and than.certified
        return is_below(one.objective, than.objective, CHEAPER if both else ANOTHER)

    if other.feasible and (cheaper(other, best) or not best.feasible):
        return other
    first = other.certified and not best.certified and not cheaper(best, other)
    return other if first else best


def _disproportion(bench: Bench, best: Candidate) -> float:
    """
    Return the nonlinearity index: max |2 x(half) - x(none) - x(all)| over the range of x.

    'none', 'half' and 'all' are the mean of the input of the last path, that input, and what is
    between them; and the lower bound of each free initial value or parameter, its upper bound, and
    the middle. If the index is small, the dynamics cause no other local minima.
    """
    if best.record is None:
        return 0.0
    problem, path = bench.problem, best.record.outcome.path
    pieces = 2 * bench.options.rollouts.pieces
    first = np.unique(np.linspace(0, len(path.ua), pieces + 1).astype(np.int64))
    t, h = path.t[first], np.diff(path.t)[:, None]
    u = np.add.reduceat(h * (path.ua + path.ub) / 2, first[:-1])
    mean, u = u.sum(axis=0) / t[-1], u / np.maximum(np.diff(t), 1e-300)[:, None]
    lower, upper = problem.start_box
    width = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    base = np.where(width > 0, lower, path.x[0])
    none, half, all_ = (bench.programs.integrator.forward(
        problem.pin_start(base + part * width), t, inputs, inputs)[0]
        for part in (0.0, 0.5, 1.0) for inputs in [mean + part * (u - mean)])
    size = np.maximum(np.ptp(path.x, axis=0), 1e-9 * np.abs(path.x).max() + 1e-300)
    with np.errstate(invalid='ignore', over='ignore'):
        off = np.abs(2 * half - none - all_).max(axis=0) / size
    return float(np.nan_to_num(off, nan=np.inf).max(initial=0.0))
