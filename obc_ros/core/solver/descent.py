# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The driver of a solve by transcription: initial guesses, arcs, mesh refinement, certificate.

The cost of an outcome is compared with the minimum by the Hamiltonian loss
(adjoint/mesh_refinement.py): the integral of H(x, u, lam) - min H(x, ., lam), which is the excess
of the cost to first order. 'Relative excess' is this loss over |J|.

The module is long because the driver holds the whole course of a solve.
"""

from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from itertools import chain, count

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.least_time_form import get_final_time
from obc_ros.core.ocp.positivity import keep_amounts_positive
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status, Verdict
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.adjoint.mesh_refinement import (
    compute_tightening,
    Error,
    EXCEEDED,
    follow_minimum,
    is_below,
    Judgement,
    measure_loss,
    refine_mesh,
)
from obc_ros.core.solver.arcs.control_discontinuities import find_switching_times
from obc_ros.core.solver.arcs.input_arcs import find_jumping_inputs
from obc_ros.core.solver.improve.arc_iteration import ArcIteration
from obc_ros.core.solver.improve.kink_mesh import solve_on_kinks
from obc_ros.core.solver.improve.state_arcs import solve_along_bounds, solve_at_once
from obc_ros.core.solver.nlp.progress import ProgressMonitor
from obc_ros.core.solver.program_cache import Answered, Kit
from obc_ros.core.solver.proofs.contradictions import explain_contradiction
from obc_ros.core.solver.proofs.optimality import describe_local
from obc_ros.core.solver.starts.cross_entropy import start_from_rollouts
from obc_ros.core.solver.starts.horizon_continuation import lengthen_horizon
from obc_ros.core.solver.starts.initial_guess import estimate_scales, join_whole_turns
from obc_ros.core.solver.starts.multistart import (
    descend_from_coarse,
    explore_starts,
    finish_descent,
)
from obc_ros.core.solver.starts.neighbour import solve_from_neighbour
from obc_ros.core.solver.starts.obstacle_homotopy import start_around
from obc_ros.core.solver.trace import judge_path, Trace
from obc_ros.core.solver.transcription.local_minima import Familiar
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, Mesh, Path, split, STEPPED
from obc_ros.core.solver.transcription.program import ProblemScales, TranscriptionOutcome
from obc_ros.core.solver.transcription.tightening import TightenedLimits

# Work is counted in iterations times intervals, with collocation times 1 + stages, so that the
# result does not depend on the load of the machine. A unit takes about 0.05 ms.
COARSE = 16           # intervals of the coarsest mesh
# Number of initial guesses tried on it, besides those around obstacles: once one had a small
# discretisation error, and while none had.
_STARTS, _STARTS_MOST = 1, 6
_PATIENCE = 10_000    # work, times 1 + stages, after which the first number holds in any case
_COURSES_KEPT = 8     # integrated costates that are cached
_ROUGH = 1e-4         # relative error of the cost at which a coarse solve may end
# Budget of a descent when no coarse outcome had a small discretisation error: times the work so
# far, part of the remaining time. The rest is left for the diagnosis.
_VAIN = 2, 0.6
# Budget of a descent, besides the work so far, if minimising sequences seem to chatter; its part
# of the remaining time is that of _VAIN.
_MIXED = 200_000
# Chattering is assumed if an input stays away from its bounds by more than this part of their
# distance, where H is concave in it, for more than this part of T.
_INSIDE, _LASTING = 1e-2, 0.1
# Discretisation error of a coarse outcome that is small enough: relative local error of a step,
# and excess of the cost over max(|J|, 1).
_BELIEVED, _ABSURD = 1e-2, 1e6
_MESHES = 1, 2, 4, 6  # numbers of refinements after which arcs along state bounds are solved for
_NEAR_BOUNDS = 0.1    # relative excess below which that is tried
_ROUNDS = 10          # maximum number of meshes of a descent
_PLAIN_ROUNDS = 5     # number of refinements after which switching times are sought in any case
_COARSE_ITERATIONS = 150   # maximum number of iterations on a coarse mesh
_FEW_ITERATIONS = 12  # lower limit of the maximum for further initial guesses
_FINER_ITERATIONS = 350    # maximum number of iterations on a finer mesh, from the coarser one
_FINER_WORK = 450_000      # maximum work there, but 50 iterations are always allowed
_WORTH_A_LOOK = 1e-3  # relative excess below which a certificate is computed
_DETOUR = 1e-5        # relative excess from which on inputs may wind around between mesh points
_CLOSE = 1e-6         # relative excess below which it is computed whatever the variation of H is
_LEAST = 1e-6         # floor of |J| as the scale of the loss in the refinement
# Relative excess below which a certified solution is not refined: without, with state bounds.
_CLOSE_ENOUGH = (1e-5, 2e-6)
_FOR_DIGITS = 8000    # work, times 1 + stages, after which it is not refined whatever the excess
_LOST = (3e-7, 1e-7)  # relative loss of all intervals that refinement aims at: without, with them
# Variation of H relative to its terms: that refinement aims at in each interval; on the whole path
# above which no certificate passes.
_DRIFT, _SPREAD = 2e-5, 1.5e-4
_STEP_ERROR = 3e-8    # relative local error, summed over all intervals, that refinement aims at


class Search:
    """
    The driver of one solve; `Bench` documents its attributes and the operations on a path.

    Parameters
    ----------
    problem : Problem
        In the symbols of `kit`.
    kit : Kit
        Programs and functions built for the structure of the problem.
    monitor : ProgressMonitor
        Limits of iterations, work and time.
    with_arcs : bool
        Whether inputs may be held at bounds between switching times.
    quick : bool
        One start and a few meshes, for paths that need not be optimal.
    why_not : callable
        Called when the first starts led to no path. Returns a proof of infeasibility in words, or
        ''.

    """

    def __init__(self, problem: Problem, kit: Kit, monitor: ProgressMonitor, *,
                 with_arcs: bool = True,
                 quick: bool = False,
                 why_not: Callable[[Problem], str] = explain_contradiction) -> None:
        self.stated, self.kit, self.monitor, self.quick = problem, kit, monitor, quick
        self.why_not = why_not
        self.problem = problem if kit.twin is None else kit.twin.problem(problem, 0)
        self.may_hold = with_arcs
        self.switching = tuple(with_arcs and each for each in kit.switching)
        self.reason, self.held_in_vain = '', False
        self.led_somewhere = False   # whether a coarse outcome had a small discretisation error
        self.intervals, self.typical = COARSE, _COARSE_ITERATIONS
        self.work = 0
        self.starts: Iterator[Path] = iter(())
        self.familiar, self.looked_from = Familiar(), 0
        self.tried, self.minima = 0, list[float]()
        self.periods = np.full(problem.m, np.inf)   # of inputs that are angles, else infinite
        self.last: Answered | None = None
        self.extremal: BoundaryValues | None = None
        self.nearby = False
        self._courses: dict[TranscriptionOutcome, tuple[Problem, Extremal]] = {}
        self._judged: tuple[Problem | None, Extremal | None, Judgement | None] = None, None, None
        self.bounded = bool(problem.path.numel() or np.any(
            np.isfinite(problem.x_lower) | np.isfinite(problem.x_upper)))
        self.stages = 3 if self.bounded else 0
        self.margin = np.zeros(problem.n + int(problem.path.numel()))
        self.exceeded = np.zeros(0)   # relative violation of constraints in each interval
        self.pinned = (kit.guesser.final_state(self.problem)[1] if self.bounded
                       else np.zeros(problem.n, dtype=bool))

    @property
    def trace(self) -> Trace:
        """Return the record of what is tried."""
        return self.monitor.trace

    def collocate(self, mesh: Mesh, start: Path, durations: Array | None = None, *,
                  near: bool = False, sizes: ProblemScales | None = None, most: int = 500,
                  warm: TranscriptionOutcome | None = None,
                  guide: TranscriptionOutcome | None = None,
                  rough: float = 0.0, once: bool = False, known: Familiar | None = None,
                  least: Array | float = 0.0) -> TranscriptionOutcome:
        """Solve the transcription on a mesh from a path; see `Bench.collocate`."""
        problem, final = self.problem, self.problem.final_time
        program = self.kit.transcription(problem, mesh.layout)
        if sizes is None:
            sizes = self.kit.guesser.sizes(problem, start)
        if durations is None:
            durations = start.durations
        usual = durations.sum() / mesh.layout.intervals
        shortest = np.maximum(np.where(durations < 2 * usual, 0.0, 0.25 * durations), least)
        longest = np.maximum(4.0 * durations, 4.0 * usual)
        if len(durations) == 1:
            shortest, longest = np.array([final.lower]), np.array([final.upper])
        limits = TightenedLimits(shortest, longest, self.margin, self.pinned)
        w = program.start(mesh, start, durations, sizes) if warm is None else warm.w
        each = mesh.layout.intervals * (1 + mesh.layout.stages)
        with self.trace.attempt('collocation', mesh.layout.describe()) as attempt:
            self.monitor.limit(most, each)
            outcome = program.solve(problem, mesh, w, sizes, limits, self.monitor, near=near,
                                    multipliers=(warm.lam_w, warm.lam_g) if warm else None,
                                    guide=guide, rough=rough, once=once, known=known)
            if near and not outcome.converged and not self.monitor.stopped:
                self.monitor.limit(most, each)
                outcome = program.solve(problem, mesh, w, sizes, limits, self.monitor)
            attempt.end(*outcome.judge(), cost=outcome.objective)
        self.work += outcome.iterations * each
        self.kit.worked(outcome.iterations, mesh.layout)
        return outcome

    def coarse(self) -> list[TranscriptionOutcome]:
        """
        Return the outcomes of several initial guesses on a coarse mesh, the cheapest first.

        Outcomes with a large discretisation error are discarded. If all have one, the mesh is
        made finer, with a stiffly accurate scheme.
        """
        most = self.monitor.max_intervals
        levels = [(min(COARSE, most), self.stages)] + [
            (intervals, 3) for intervals in (2 * COARSE, 4 * COARSE) if intervals <= most]
        found: list[TranscriptionOutcome] = []
        for intervals, stages in levels[:2] if self.quick else levels:
            self.intervals, self.stages = intervals, stages
            self.familiar = Familiar()
            # The solution on the coarser mesh may be close in spite of its discretisation error.
            converged = [outcome for outcome in found if outcome.converged]
            known = [min(converged, key=lambda outcome: outcome.objective).path
                     ] if converged else []
            self.starts = chain(known, self.kit.guesser.starts(
                self.problem, self.kit.integrator, lambda: self.familiar.spans))
            self.periods = self.kit.guesser.periods(self.problem)
            longer = lengthen_horizon(self,
                                      COARSE) if found and intervals == levels[1][0] else None
            found = [longer] if longer else self._from_starts()
            good = [outcome for outcome in found if longer or self.believed(outcome)]
            if good:
                self.led_somewhere = True
                return sorted(good, key=lambda outcome: outcome.objective)
            if self.intervals <= COARSE and not self.quick:
                self.reason = self.why_not(self.stated)
            if self.reason or self.monitor.stopped:
                break
        else:
            good = start_from_rollouts(self, get_final_time(self.problem))
            found, self.led_somewhere = good or found, bool(good)
        return sorted(found, key=lambda outcome: (not outcome.converged, (
            outcome.objective if self.led_somewhere else outcome.infeasibility)))

    def believed(self, outcome: TranscriptionOutcome) -> bool:
        """Return whether the discretisation error of a coarse outcome is small enough."""
        if not outcome.converged:
            return False
        course = self.course(outcome)
        error, loss = course.local.max(), self.judged(course).lost.sum()
        if error < _BELIEVED and loss < _ABSURD * max(abs(outcome.objective), 1.0):
            return True
        with self.trace.attempt('check', 'discretisation error') as attempt:
            attempt.end(Verdict.REJECTED, f'relative error of a step {error:.1e}, allowed '
                        f'{_BELIEVED:.0e}; Hamiltonian loss {loss:.1e}', cost=outcome.objective)
        return False

    def _from_starts(self) -> list[TranscriptionOutcome]:
        """Return the outcomes of the first initial guesses and of paths around obstacles."""
        found: list[TranscriptionOutcome] = []
        begun, good, ways = self.work, False, 0
        for number in count(1):
            outcome = self.from_next_start(once=good)
            found.append(outcome)
            if not good and self.believed(outcome):
                good, self.typical = True, outcome.iterations
                self.keep(outcome)
            if number == 1 and not (self.quick and good):
                ways = start_around(self, outcome)
            patient = self.work - begun < _PATIENCE * (1 + self.stages)
            most = _STARTS if self.quick else _STARTS_MOST
            if (self.monitor.stopped or self.quick and good or number >= ways + (
                    _STARTS if good or not patient else most)):
                break
        return found

    def from_next_start(self, *, once: bool, hard: bool = False) -> TranscriptionOutcome:
        """Solve on the coarse mesh from the next initial guess; see `Bench.from_next_start`."""
        most = _COARSE_ITERATIONS
        self.tried += 1
        if once:
            most = min(most, max(_FEW_ITERATIONS, round((5 if hard else 2.5) * self.typical)))
        start, rough = next(self.starts), _ROUGH
        with self.trace.attempt('initial guess', start.origin) as attempt:
            if np.isfinite(self.periods).any():
                # An input that is an angle and turns by 2 pi within a step interpolates badly:
                # solve with constant inputs first, and remove the whole turns between its steps.
                steps = build_uniform_mesh(self.problem, self.intervals, self.stages, STEPPED)
                stepped = self.collocate(steps, start, most=_COARSE_ITERATIONS)
                start, rough = join_whole_turns(stepped.path, self.periods), 0.0
            # Without terminal constraints a cheap rollout may be near another minimum: allow both
            # methods.
            once = once and not (self.familiar.daring and not self.problem.q)
            outcome = self.collocate(
                build_uniform_mesh(self.problem, self.intervals, self.stages), start, most=most,
                rough=rough, once=once, known=self.familiar)
            self.familiar.ended(outcome.objective, outcome.infeasibility,
                                outcome.path if outcome.converged else None)
            attempt.end(*outcome.judge(), cost=outcome.objective)
        return outcome

    def course(self, outcome: TranscriptionOutcome, *, stated: bool = False) -> Extremal:
        """Integrate states and costates under the input of an outcome; see `Bench.course`."""
        problem = self.stated if stated else self.problem
        kept, course = self._courses.get(outcome, (None, None))
        if course is not None and kept is problem:
            return course
        integrator = self.kit.judge if stated else self.kit.integrator
        course = integrator.extremal(problem, outcome, 4 if self.stages else 2)
        if self.bounded:
            course = self.kit.fitter(problem, stated).fit(problem, outcome, course)
        if len(self._courses) >= _COURSES_KEPT:
            self._courses.clear()
        self._courses[outcome] = problem, course
        return course

    def judged(self, course: Extremal) -> Judgement:
        """Return the Hamiltonian loss of a course; the last one is cached."""
        kept, of, verdict = self._judged
        if verdict is None or kept is not self.problem or of is not course:
            slack = None if course.density_path is None else (
                self.kit.fitter(self.problem).slack(self.problem, course))
            verdict = measure_loss(self.problem, self.kit.integrator, course, slack)
            self._judged = self.problem, course, verdict
        return verdict

    def sizes(self, outcome: TranscriptionOutcome) -> ProblemScales:
        """Return the scales of an outcome's path and cost."""
        cost = abs(outcome.objective)
        return replace(estimate_scales(self.problem, outcome.path), cost=cost if cost > 0 else 1.0)

    def rethought(self, outcome: TranscriptionOutcome, course: Extremal,
                  above: float) -> TranscriptionOutcome:
        """
        Return the outcome, or a better one: with bang arcs if inputs jump, else without detours.

        `above`: relative excess of its cost.
        """
        jumping = find_jumping_inputs(self.problem, outcome.path)
        if self.may_hold and any(jumping) and not self.held_in_vain:
            free, self.switching = self.switching, jumping
            new = ArcIteration(self, COARSE).settled(outcome)
            self.held_in_vain = new.objective > outcome.objective and (
                self.given_away(new, self.course(new)) >= above)
            self.switching = free if self.held_in_vain else jumping
            return outcome if self.held_in_vain else new
        if self.bounded or above < _DETOUR:
            return outcome
        return self.unwound(outcome, course, above)

    def unwound(self, outcome: TranscriptionOutcome, course: Extremal,
                above: float) -> TranscriptionOutcome:
        """
        Return the outcome, or a better one from inputs that follow a minimum of H.

        On a coarse mesh an input in a direction may turn the long way round between two points.
        """
        u = follow_minimum(self.problem, self.kit.integrator, course)
        mesh = split(build_uniform_mesh(self.problem, COARSE, self.stages), np.full(COARSE, 4))
        if not self.monitor.allows(mesh.layout.intervals):
            return outcome
        start = replace(outcome.path, ua=u[:-1], ub=u[1:])
        new = self.collocate(mesh, start, start.t[-1:], sizes=self.sizes(outcome))
        nearby = new.converged and not is_below(
            outcome.objective, new.objective, max(above, _WORTH_A_LOOK))
        better = nearby and self.given_away(new, self.course(new)) < above
        return new if better else outcome

    def improve(self, outcome: TranscriptionOutcome,
                rounds: int) -> Iterator[tuple[TranscriptionOutcome, Extremal]]:
        """Yield outcomes on finer and finer meshes, at most `rounds`, with their costates."""
        if any(self.switching):
            settled = ArcIteration(self, COARSE).settled(outcome)
            self.held_in_vain = self.believed(outcome) and not self.believed(settled)
            if self.held_in_vain:   # the arcs are too long for the number of intervals in them
                self.switching = (False,) * self.problem.m
            else:
                outcome = settled
        above = np.inf
        for turn in range(rounds):
            course = self.course(outcome)
            above, before = self.given_away(outcome, course), above
            stalled = turn and above > _CLOSE and above > 0.3 * before
            if (stalled or turn == _PLAIN_ROUNDS) and not any(self.switching):
                if above < _CLOSE:
                    yield outcome, course
                outcome = self.rethought(outcome, course, above)
                course = self.course(outcome)
            yield outcome, course
            if turn == rounds - 1:
                return
            if self.kit.twin:
                self.problem = self.kit.twin.problem(self.stated, turn + 1)
            if turn and (aligned := solve_on_kinks(self, outcome, course)) is not None:
                outcome = aligned
                continue
            self.widen_margin(course)
            mesh = self.finer(outcome, course)
            if self.monitor.stopped or not self.monitor.allows(mesh.layout.intervals):
                return
            most = _FINER_WORK // (mesh.layout.intervals * (1 + mesh.layout.stages))
            outcome = self.collocate(mesh, outcome.path, near=True, sizes=self.sizes(outcome),
                                     guide=outcome, most=min(_FINER_ITERATIONS, max(50, most)))
            if not outcome.converged:
                return
            if ArcIteration.vanished(outcome):
                outcome = ArcIteration(self, COARSE).without_vanishing(outcome)

    def widen_margin(self, course: Extremal) -> None:
        """Increase `margin` by the amounts by which a path exceeds its bounds between nodes."""
        if not self.bounded:
            return
        value = self.kit.fitter(self.problem).values(self.problem, course)
        self.margin, self.exceeded = compute_tightening(self.problem, value, course, self.margin)

    def finer(self, outcome: TranscriptionOutcome, course: Extremal) -> Mesh:
        """Refine the mesh of an outcome; see `Bench.finer`."""
        verdict, N = self.judged(course), len(course.local)
        share = _LOST[self.bounded] * max(abs(outcome.objective), _LEAST) / N
        errors = [
            Error(verdict.lost - verdict.chords, share, 5.0), Error(verdict.chords, share, 3.0),
            Error(course.local, _STEP_ERROR / N, 7.0), Error(verdict.drift, _DRIFT, 2.0)]
        if self.bounded:
            errors.append(Error(self.exceeded, EXCEEDED[0], 2.0))
        longest = outcome.path.t[-1] / (2 * COARSE)
        return refine_mesh(outcome.mesh, outcome.path, verdict.kinks, errors, longest,
                           self.monitor.max_intervals)

    def solution(self, outcome: TranscriptionOutcome, course: Extremal) -> Solution:
        """Return an outcome as samples with its certificate; see `Bench.solution`."""
        problem = self.stated
        if self.kit.twin:
            outcome = self.kit.twin.back(outcome, problem)
            course = self.course(outcome, stated=True)
        known = self._extremal(outcome)
        times = np.cumsum(known.lengths)[:-1] if known else find_switching_times(outcome)
        found = replace(self.kit.judge.samples(problem, course), switching_times=times,
                        iterations=self.monitor.iterations)
        if self.monitor.stopped:   # to certify a path far from a solution may take long
            return found
        found = replace(found, certificate=certify(problem, found))
        if found.certificate and found.certificate.feasible:
            self.trace.found(found.objective, found.certified)
        if self.monitor.best:
            self.monitor.best.take(problem, found)
        return found

    def keep(self, outcome: TranscriptionOutcome) -> None:
        """Certify an intermediate outcome and pass it on, if the caller wants such paths."""
        best = self.monitor.best
        if best and outcome.converged and best.is_due(self.stated):
            self.solution(outcome, self.course(outcome))

    def given_away(self, outcome: TranscriptionOutcome, course: Extremal) -> float:
        """
        Return the relative excess of the cost, estimated; infinite for a path with large defects.

        It includes the cost of tightened constraints, to first order.
        """
        if not outcome.converged or course.defect > 1e-3 and course.local.max() > 1e-4:
            return np.inf
        lost = self.judged(course).lost.sum()
        if self.margin.any():
            lost += outcome.pressure() @ self.margin
        return float(lost / max(abs(outcome.objective), 1e-3))

    def run(self) -> Solution:
        """
        Solve the problem.

        Returns
        -------
        Solution
            The best one found, with its certificate unless work was stopped; without samples if
            no path was found. The status is that of the descent, see `solve.solve`.

        """
        found = self._run()
        return found if found.optimality else replace(
            found, optimality=describe_local(self.tried, found.objective, self.minima))

    def _run(self) -> Solution:
        if (known := solve_from_neighbour(self)) is not None:
            return known
        with self.trace.attempt('coarse mesh') as attempt:
            starts = self.coarse()
            attempt.end(Verdict.ACCEPTED if self.led_somewhere else Verdict.REJECTED,
                        self.reason or ('' if self.led_somewhere else
                                        'no initial guess led to a path with a small '
                                        'discretisation error'),
                        cost=starts[0].objective if starts and self.led_somewhere else np.nan)
        if self.reason:
            return Solution(Status.INFEASIBLE, self.reason)
        if not starts or not np.all(np.isfinite(starts[0].path.x)):
            return Solution(Status.NOT_CONVERGED, 'no path was found from any initial guess')
        # With a large discretisation error states may have jumped over a pole of f.
        astray = starts[:1] if self.led_somewhere else starts
        if not self.quick and (inside := self.inside(astray)):
            return inside
        if not (self.led_somewhere or self.quick):
            times, share = _VAIN
            self.monitor = self.monitor.part(times * self.work, share * self.monitor.remaining())
        elif not self.quick and self.mixes(starts[0]):
            self.monitor = self.monitor.part(self.work + _MIXED, _VAIN[1]*self.monitor.remaining())
        if self.quick:
            return self.followed_up(starts[0])
        best, floor = descend_from_coarse(self, starts[0])
        if not (best.certified
                or self.monitor.stopped) and (reason := explain_contradiction(self.stated)):
            # The discretised problem may have paths although the stated one has none.
            return Solution(Status.INFEASIBLE, reason)
        return explore_starts(self, best, floor, starts[1:])

    def mixes(self, outcome: TranscriptionOutcome) -> bool:
        """Return whether an input stays between its bounds for long where H is concave in it."""
        problem, course = self.problem, self.course(outcome)
        if self.kit.twin or any(ca.depends_on(problem.path, u) for u in ca.vertsplit(problem.u)):
            return False
        _, _, Huu = self.kit.integrator.hamiltonian(problem, course.x, course.ua, course.lam)
        curvature, span = np.einsum('kii->ki', Huu), problem.u_upper - problem.u_lower
        with np.errstate(invalid='ignore'):
            inside = np.minimum(course.ua - problem.u_lower,
                                problem.u_upper - course.ua) > _INSIDE * span
        concave = curvature < -_INSIDE * np.abs(curvature).max(axis=0, initial=0.0)
        share = np.diff(course.t) @ (inside & concave & np.isfinite(span)) / course.t[-1]
        return bool(np.any(share > _LASTING))

    def inside(self, astray: list[TranscriptionOutcome]) -> Solution | None:
        """
        Return a solution found with bounds >= 0 on states that are amounts, or None.

        `astray`: outcomes whose states show for which amounts the bound is missing. A solution
        without a certificate that passes is returned only if it is feasible and a coarse outcome
        had a small discretisation error.
        """
        problem = keep_amounts_positive(self.stated, [outcome.path.x for outcome in astray])
        if problem is self.stated:
            return None
        answer = Search(problem, Kit(problem), self.monitor, with_arcs=self.may_hold).run()
        if answer.certificate:
            answer = replace(answer, certificate=certify(self.stated, answer))
        fits = answer.certificate.feasible if answer.certificate else self.monitor.stopped
        return answer if answer.certified or self.led_somewhere and fits else None

    def followed_up(self, start: TranscriptionOutcome, rounds: int = _ROUNDS) -> Solution:
        """Refine a coarse outcome until its certificate passes; see `Bench.followed_up`."""
        return finish_descent(self.following(start, rounds))

    def following(self, start: TranscriptionOutcome,
                  rounds: int = _ROUNDS) -> Generator[None, None, Solution]:
        """Do what `followed_up` does step by step: yield after each mesh, return the solution."""
        descent = self.trace.begin('descent', f'from cost {start.objective:.6g} on '
                                   f'{start.mesh.layout.describe()}')
        with self.trace.under(descent):
            found = solve_at_once(self, start)
        if found is not None:
            descent.end(*judge_path(found), cost=found.objective)
            return found
        best: Solution | None = None
        nearest = tried = start
        begun, steps = self.work, enumerate(self.improve(start, rounds))
        while True:
            with self.trace.under(descent), self.trace.attempt('mesh') as attempt:
                if (step := next(steps, None)) is None:
                    attempt.end(Verdict.STOPPED, 'no finer mesh is tried or leads to a path')
                    break
                number, (outcome, course) = step
                above = self.given_away(outcome, course)
                attempt.end(Verdict.ACCEPTED, cost=outcome.objective, loss=above,
                            what=outcome.mesh.layout.describe())
                # At such an excess the certificate may pass although the next mesh would reduce
                # it.
                worth = number and above < _WORTH_A_LOOK and (
                    self.kit.twin or self.judged(course).spread < _SPREAD)
                if above < _CLOSE or worth or self.monitor.stopped:
                    answer = self.solution(outcome, self.course(outcome))
                    attempt.end(*judge_path(answer), cost=outcome.objective, loss=above)
                    if best is None or answer.certified or not best.certified:
                        best, self.last = answer, self.answered(outcome)
                else:
                    self.keep(outcome)
                nearest, held = outcome, best is not None and best.certified
                chorded = above > _CLOSE_ENOUGH[1] and self.judged(course).chorded
                if number in _MESHES and above < _NEAR_BOUNDS and (chorded or not held):
                    tried = outcome
                    if (found := solve_along_bounds(self, outcome, best)) is not None:
                        descent.end(*judge_path(found), cost=found.objective)
                        return found
                late = self.work - begun > _FOR_DIGITS * (1 + self.stages)
                close = above < _CLOSE_ENOUGH[self.bounded]
                if best is not None and best.certified and (close or late):
                    break
                if self.quick and number >= 2:
                    break
            yield
        with self.trace.under(descent):
            if best is None:
                best = self.solution(outcome, self.course(outcome))
                self.last = self.answered(outcome)
            if not best.certified and nearest is not tried:
                best = solve_along_bounds(self, nearest) or best
        descent.end(*judge_path(best), cost=best.objective)
        return best

    def answered(self, outcome: TranscriptionOutcome) -> Answered:
        """Return the record from which a neighbour, or the indirect method, starts."""
        return Answered(
            problem=self.stated, outcome=outcome, sizes=outcome.scales or self.sizes(outcome),
            margin=self.margin, extremal=self._extremal(outcome))

    def _extremal(self, outcome: TranscriptionOutcome) -> BoundaryValues | None:
        """Return the extremal whose kinks are mesh points of an outcome, if it is known."""
        return self.extremal if len(outcome.path.durations) == 1 else None

    def reset(self) -> None:
        """Return to the settings of a coarse mesh: no margin, no extremal, no arcs found."""
        self.extremal = None
        self.margin, self.held_in_vain = np.zeros_like(self.margin), False
        self.switching = tuple(self.may_hold and each for each in self.kit.switching)
        if self.kit.twin:
            self.problem = self.kit.twin.problem(self.stated, 0)
