# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What every method of the search may use: the problem, its programs, and operations on one path.

A `Bench` is constant. A method that needs other settings, such as a part of the work or tightened
bounds, uses `dataclasses.replace`. A method returns `Candidate`s; which one is better is decided
in `search`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
import math
import time

import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.ocp.certificate import certificate
from obc_ros.core.ocp.certificate.cost_summands import Summands
from obc_ros.core.ocp.method_names import BEST, CERTIFIED, PATH
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Verdict
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.adjoint.mesh_refinement import (
    compute_tightening,
    Error,
    EXCEEDED,
    HamiltonianLoss,
    measure_loss,
    refine_mesh,
)
from obc_ros.core.solver.arcs.control_discontinuities import find_switching_times
from obc_ros.core.solver.initial_guess import estimate_scales
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.options import DEFAULTS, Options
from obc_ros.core.solver.program_cache import Answered, ProgramCache
from obc_ros.core.solver.trace import COLLOCATION, judge_path, Trace
from obc_ros.core.solver.transcription.mesh import keep_breaks, Mesh, Path
from obc_ros.core.solver.transcription.program import (
    Nearby,
    ProblemScales,
    SolveEffort,
    TightenedLimits,
    TranscriptionOutcome,
    USUAL,
)


class BestPath:
    """
    The best path of a problem so far, and whether it ends the search.

    A certified path is better than a feasible one, and this better than one that is not feasible.
    Among equals the lower cost decides, or the smaller largest residual if none is feasible.

    :param accept: one of `method_names.ACCEPTED`; with PATH the first feasible path stops `meter`.
    :param tell: called with each path that is better than those before, should this process end.
    :ivar path: the best feasible one; None: there is none.
    :ivar first: time after which the first feasible one was found [s]; nan: there is none.
    """

    def __init__(self, problem: Problem, meter: Meter, accept: str = CERTIFIED,
                 tell: Callable[[Solution], None] | None = None) -> None:
        self.accept, self.first = accept, math.nan
        self.path: Solution | None = None
        self._problem, self._meter, self._tell = problem, meter, tell
        self._rank = (False, False, -math.inf)
        self._origin = self._next = time.monotonic()
        self._begun = math.nan

    def is_due(self, problem: Problem) -> bool:
        """Return whether an intermediate path of a problem should be certified and taken now."""
        now = time.monotonic()
        wanted = self.accept == PATH or now >= self._next and (
            self._tell is not None or self.accept == BEST)
        self._begun = now if problem is self._problem and wanted else math.nan
        return not math.isnan(self._begun)

    def take(self, problem: Problem, found: Solution) -> None:
        """Pass a path on if it has a certificate, is of this problem, and the best so far."""
        certificate = found.certificate
        if problem is not self._problem or certificate is None or not found.t.size:
            return
        feasible, worst = certificate.feasible, certificate.residuals[certificate.worst]
        rank = certificate.holds, feasible, -(found.objective if feasible else worst)
        now = time.monotonic()
        if feasible and self.path is None:
            self.first = now - self._origin
        if rank > self._rank:
            self._rank, self.path = rank, found if feasible else None
            if self._tell is not None:
                self._tell(found)
        if feasible and self.accept == PATH:
            self._meter.accept()
        judging = 0.0 if math.isnan(self._begun) else now - self._begun
        # Certifying takes at most a twentieth of the time, twice a second at most.
        self._next = now + max(0.5, judging / 0.05)
        self._begun = math.nan


@dataclass(frozen=True, eq=False)
class Task:
    """
    A problem to be solved.

    :ivar problem: as stated, in the symbols of `programs`.
    :ivar programs: programs and functions built for the structure of the problem.
    :ivar meter: limits of iterations, work and time.
    :ivar time_limit: as the caller has given it [s], for messages.
    :ivar best: receives the paths that are certified.
    """

    problem: Problem
    programs: ProgramCache
    meter: Meter
    time_limit: float = math.inf
    best: BestPath | None = None

    @property
    def accepts_paths(self) -> bool:
        """Return whether a path without certificate of optimality is an answer."""
        return self.best is not None and self.best.accept != CERTIFIED

    @property
    def options(self) -> Options:
        """Return the options of the search."""
        return self.programs.options

    def restate(self, problem: Problem, meter: Meter | None = None) -> 'Task':
        """Return the task of a related problem, with programs of its own."""
        return replace(self, problem=problem, programs=ProgramCache(problem, self.options),
                       meter=meter or self.meter)


@dataclass(frozen=True)
class Candidate:
    """
    A path with its certificate, and what its neighbours or the indirect method start from.

    :ivar solution: without samples if there is no path.
    :ivar record: None if the path did not come from a transcription.
    :ivar nearby: whether its extremal was found from that of a neighbouring problem.
    """

    solution: Solution
    record: Answered | None = None
    nearby: bool = False

    @property
    def certified(self) -> bool:
        """Return whether the certificate of the path passes."""
        return self.solution.certified

    @property
    def feasible(self) -> bool:
        """Return whether the certificate shows a path, extremal or not."""
        return self.solution.feasible


@dataclass(frozen=True, eq=False)
class Bench:
    """
    A problem, its programs, the settings of a search, and the operations on a path.

    :ivar stated, problem: that of the task, and the one that is solved: its smooth reformulation
        if |.| occurs.
    :ivar programs: as in `Task`.
    :ivar whole, meter: of this search, a part of that of the task; and of what is tried now, a
        part of `whole`.
    :ivar pinned: (n,), components of x(T) that psi fixes.
    :ivar end: (n,), these, and a given time among the states; nan for the other components.
    :ivar margin: (n + l,), tightening of the bounds of x and of the path constraints.
    :ivar quick: whether a feasible path is enough: one start and a few meshes.
    :ivar may_hold: whether inputs may be held at bounds between switching times.
    :ivar intervals, stages: of the coarse mesh: intervals, collocation points in an interval (0:
        Runge-Kutta).
    :ivar typical: iterations of a solve on the coarse mesh that converged.
    :ivar best: as in `Task`.
    """

    stated: Problem
    problem: Problem
    programs: ProgramCache
    whole: Meter
    meter: Meter
    pinned: Mask
    end: Array
    margin: Array
    quick: bool = False
    may_hold: bool = True
    intervals: int = DEFAULTS.coarse.intervals
    stages: int = 0
    typical: int = DEFAULTS.coarse.iterations
    best: BestPath | None = None
    _courses: dict[tuple[Problem, TranscriptionOutcome], Extremal] = field(
        default_factory=dict, repr=False)
    _losses: dict[tuple[Problem, Extremal], HamiltonianLoss] = field(
        default_factory=dict, repr=False)
    _accurate: dict[tuple[Problem, TranscriptionOutcome], bool] = field(
        default_factory=dict, repr=False)

    @property
    def options(self) -> Options:
        """Return the options of the search."""
        return self.programs.options

    @property
    def trace(self) -> Trace:
        """Return the record of what is tried."""
        return self.meter.trace

    @property
    def switching(self) -> tuple[bool, ...]:
        """Return the inputs that may be held at bounds between switching times."""
        return tuple(self.may_hold and each for each in self.programs.switching)

    def collocate(self, mesh: Mesh, start: Path, *, near: Nearby | None = None,
                  effort: SolveEffort = USUAL) -> TranscriptionOutcome:
        """
        Solve the transcription on a mesh from a path.

        :param start: initial guess, with the initial lengths of the phases of the mesh.
        :param near: if the guess is close to the solution; phases are kept from vanishing then.
        :return: the last iterate; `converged` tells whether it satisfies the optimality
            conditions.
        """
        problem, final = self.problem, self.problem.final_time
        mesh = keep_breaks(problem, mesh, start.durations.sum())
        program = self.programs.transcription(problem, mesh.layout)
        known, durations = near or Nearby(), start.durations
        sizes = known.scales or self.programs.guesser.sizes(problem, start)
        usual = durations.sum() / mesh.layout.intervals
        shortest = np.maximum(
            np.where(durations < 2 * usual, 0.0, 0.25 * durations), known.shortest)
        longest = np.maximum(4.0 * durations, 4.0 * usual)
        if len(durations) == 1:
            shortest, longest = np.array([final.lower]), np.array([final.upper])
        limits = TightenedLimits(shortest, longest, self.margin, self.pinned, self.end)
        w = known.warm.w if known.warm else program.start(mesh, start, durations, sizes)
        each = mesh.layout.intervals * (1 + mesh.layout.stages)
        with self.trace.attempt(COLLOCATION, mesh.layout.describe()) as attempt:
            self.meter.limit(effort.most, each)
            outcome = program.solve(
                problem, mesh, w, sizes, limits, self.meter, near=near, effort=effort)
            if near and not outcome.converged and not self.meter.stopped:
                self.meter.limit(effort.most, each)
                outcome = program.solve(problem, mesh, w, sizes, limits, self.meter)
            attempt.end(*outcome.judge(), cost=outcome.objective)
        self.whole.credit(outcome.iterations * each)
        return outcome

    def is_accurate(self, outcome: TranscriptionOutcome) -> bool:
        """
        Return whether a coarse outcome converged, and its cost can be compared with other costs.

        It cannot if the local errors or the Hamiltonian loss are large. An outcome is checked
        once, so that the trace shows the check once.
        """
        key = self.problem, outcome
        if not outcome.converged or key in self._accurate:
            return outcome.converged and self._accurate[key]
        options, course = self.options.coarse, self.course(outcome)
        error, loss = course.local.max(), self.measure_loss(course).lost.sum()
        good = error < options.error and loss < options.wild * max(abs(outcome.objective), 1.0)
        self._accurate[key] = bool(good)
        if not good:
            with self.trace.attempt('check', 'discretisation error') as attempt:
                attempt.end(Verdict.REJECTED, f'relative error of a step {error:.1e}, allowed '
                            f'{options.error:.0e}; Hamiltonian loss {loss:.1e}',
                            cost=outcome.objective)
        return self._accurate[key]

    def course(self, outcome: TranscriptionOutcome, *, stated: bool = False) -> Extremal:
        """
        Integrate states and costates under the input of an outcome, with multipliers of bounds.

        `stated`: for the problem as stated, not for its smooth reformulation.
        """
        problem = self.stated if stated else self.problem
        if (course := self._courses.get((problem, outcome))) is not None:
            return course
        integrator = self.programs.stated_integrator if stated else self.programs.integrator
        course = integrator.extremal(problem, outcome, 4 if self.stages else 2)
        if self.stated.constrained:
            course = self._fit(outcome, course, stated)
        if len(self._courses) >= 8:   # of the last outcomes
            self._courses.clear()
        self._courses[problem, outcome] = course
        return course

    def _fit(self, outcome: TranscriptionOutcome, course: Extremal, stated: bool) -> Extremal:
        """
        Return a course with fitted costates and multipliers.

        At a kink of |u| H has no derivative. There the parts of u are at bounds.
        """
        problem, twin = self.problem, self.programs.twin
        if not (stated and twin):
            return self.programs.fitter(problem).fit(problem, outcome, course)
        parts = twin.problem(self.stated)   # the sharpest
        fitted = self.programs.fitter(parts).fit(parts, outcome, replace(
            course, ua=twin.part(self.stated, course.ua), ub=twin.part(self.stated, course.ub)))
        return replace(fitted, ua=course.ua, ub=course.ub)

    def measure_loss(self, course: Extremal) -> HamiltonianLoss:
        """Return the Hamiltonian loss of a course; the last one is cached."""
        if (loss := self._losses.get((self.problem, course))) is None:
            slack = None if course.density_path is None else (
                self.programs.fitter(self.problem).slack(self.problem, course))
            loss = measure_loss(self.problem, self.programs.integrator, course, slack)
            self._losses.clear()
            self._losses[self.problem, course] = loss
        return loss

    def excess(self, outcome: TranscriptionOutcome, course: Extremal) -> float:
        """
        Return the relative excess of the cost, estimated; infinite for a path with large defects.

        It includes the cost of tightened constraints, to first order.
        """
        if not outcome.converged or course.defect > 1e-3 and course.local.max() > 1e-4:
            return np.inf
        lost = self.measure_loss(course).lost.sum()
        if self.margin.any():
            lost += outcome.tightening_costs() @ self.margin
        return float(lost / max(self.cost_size(outcome), 1e-3))

    def sizes(self, outcome: TranscriptionOutcome) -> ProblemScales:
        """Return the scales of an outcome's path and cost."""
        return replace(estimate_scales(self.problem, outcome.path),
                       cost=self.cost_size(outcome) or 1.0)

    def cost_size(self, outcome: TranscriptionOutcome) -> float:
        """Return |J|, or a part of what cancels if every summand of the cost nearly vanishes."""
        summands, cost = self._summands(outcome), abs(outcome.objective)
        part = 1e-4   # of its size up to which a summand nearly vanishes
        return max(cost, part * float(summands.sizes.sum()) if summands.vanish(part) else 0.0)

    def _summands(self, outcome: TranscriptionOutcome) -> Summands:
        path = outcome.path
        return self.programs.summands.measure(
            path.t, path.x, np.vstack([path.ua, path.ub[-1:]]), self.problem.p_value)

    def tighten(self, course: Extremal, most: float = EXCEEDED[1]) -> tuple['Bench', Array]:
        """
        Tighten the bounds by the amounts by which a path exceeds them between nodes.

        :param most: relative violation above which a bound is not tightened.
        :return: with the larger margin; exceeded: (intervals,), relative violation of the
            constraints in each interval; empty without any.
        """
        if not self.stated.constrained:
            return self, np.zeros(0)
        fitter = self.programs.fitter(self.problem)
        value = fitter.at(self.problem, *course.points[:2])
        size = fitter.sizes(self.problem, course, value)
        margin, exceeded = compute_tightening(self.problem, value, size, course, self.margin, most)
        return replace(self, margin=margin), exceeded

    def finer(self, outcome: TranscriptionOutcome, course: Extremal, exceeded: Array) -> Mesh:
        """
        Refine the mesh of an outcome, given its `course`, and `exceeded` from `tighten`.

        It becomes finer where the Hamiltonian loss, the local error of the states, the variation
        of H or the violation of constraints exceeds its share, and has a point at every kink of
        u*.
        """
        options = self.options.refinement
        verdict, N = self.measure_loss(course), len(course.local)
        aim = options.loss_bounded if self.stated.constrained else options.loss
        # |J| is the scale of the loss, with a floor if it vanishes.
        share = aim * max(abs(outcome.objective), 1e-6 * self._summands(outcome).unit) / N
        errors = [
            Error(verdict.lost - verdict.chords, share, 5.0), Error(verdict.chords, share, 3.0),
            Error(course.local, options.step_error / N, 7.0),
            Error(verdict.drift, options.drift, 2.0)]
        if self.stated.constrained:
            errors.append(Error(exceeded, EXCEEDED[0], 2.0))
        longest = outcome.path.t[-1] / (2 * self.options.coarse.intervals)
        return refine_mesh(outcome.mesh, outcome.path, verdict.kinks, errors, longest,
                           self.meter.max_intervals)

    def certify(self, outcome: TranscriptionOutcome, extremal: BoundaryValues | None = None
                ) -> Candidate:
        """
        Return an outcome as samples with its certificate; without one if work has stopped.

        `extremal`: solution of the boundary value problem whose kinks are its mesh points.
        """
        problem, record = self.stated, self.record(outcome, extremal)
        course = self.course(outcome)
        if self.programs.twin:
            outcome = self.programs.twin.back(outcome, problem)
            course = self.course(outcome, stated=True)
        times = (np.cumsum(record.extremal.lengths)[:-1] if record.extremal else
                 find_switching_times(outcome))
        found = replace(self.programs.stated_integrator.samples(problem, course),
                        switching_times=times, iterations=self.meter.iterations)
        if self.meter.stopped:   # to certify a path far from a solution may take long
            return Candidate(found, record)
        found = replace(found, certificate=certificate.certify(problem, found))
        self.take(found)
        return Candidate(found, record)

    def take(self, found: Solution) -> None:
        """Note a path of the stated problem that has a certificate."""
        if found.feasible:
            self.trace.found(found.objective, found.certified)
        if self.best:
            self.best.take(self.stated, found)

    def record(self, outcome: TranscriptionOutcome,
               extremal: BoundaryValues | None = None) -> Answered:
        """Return what a neighbouring problem, or the indirect method, starts from."""
        return Answered(
            problem=self.stated, outcome=outcome, sizes=outcome.scales or self.sizes(outcome),
            margin=self.margin, options=self.options.neighbour,
            extremal=extremal if len(outcome.path.durations) == 1 else None)

    def keep(self, outcome: TranscriptionOutcome, extremal: BoundaryValues | None = None
             ) -> Candidate | None:
        """Certify an intermediate outcome and pass it on, if the caller wants such paths."""
        if self.best and outcome.converged and self.best.is_due(self.stated):
            return self.certify(outcome, extremal)
        return None


@dataclass(frozen=True, eq=False)
class State:
    """
    A path on the way to a certificate, and what is known about it.

    :ivar bench: of the search, with the tightening found so far.
    :ivar outcome: the path.
    :ivar switching: length m, inputs that may be held at bounds.
    :ivar in_vain: whether holding inputs at bounds did not help.
    :ivar extremal: solution of the boundary value problem whose kinks are the mesh points.
    :ivar best: the best candidate so far.
    """

    bench: Bench
    outcome: TranscriptionOutcome
    switching: tuple[bool, ...] = ()
    in_vain: bool = False
    extremal: BoundaryValues | None = None
    best: Candidate | None = None

    def judge(self, before: 'State') -> tuple[Verdict, str, float]:
        """Return the verdict on the step from another state to this one, why, and the cost."""
        if self.best is not None and self.best is not before.best:
            return *judge_path(self.best.solution), self.best.solution.objective
        helped = self.outcome is not before.outcome
        return Verdict.ACCEPTED if helped else Verdict.REJECTED, '', self.outcome.objective


def build_bench(task: Task, *, with_arcs: bool = True, quick: bool = False) -> Bench:
    """Return the bench of a search; inputs may be held at bounds if `with_arcs` is set."""
    problem, programs, bounded = task.problem, task.programs, task.problem.constrained
    smooth = programs.twin.problem(problem, 0) if programs.twin else problem
    whole = task.meter.part()
    x, pinned = (programs.guesser.final_state(smooth) if bounded
                 else (smooth.x0, np.zeros(problem.n, dtype=bool)))
    known = pinned.copy()
    if problem.has_clock and not problem.final_time.free:
        known[problem.stated] = True
    return Bench(
        stated=problem, problem=smooth, programs=programs, whole=whole, meter=whole, quick=quick,
        may_hold=with_arcs and not problem.breaks.size,   # it moves mesh points
        intervals=programs.options.coarse.intervals,
        typical=programs.options.coarse.iterations, stages=3 if bounded else 0,
        margin=np.zeros(problem.n + int(problem.path.numel())),
        pinned=pinned, end=np.where(known, x, np.nan), best=task.best)
