# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Descent: mesh refinement and arcs, from an outcome on a coarse mesh to a passing certificate.

The cost of an outcome is compared with the minimum by the Hamiltonian loss
(adjoint/mesh_refinement.py): the integral of H(x, u, lam) - min H(x, ., lam), which is the excess
of the cost to first order. 'Relative excess' is this loss over |J|.
"""

from dataclasses import replace

import numpy as np
from obc_ros.core.ocp.method_names import PATH
from obc_ros.core.ocp.solution import Verdict
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.bench import Bench, Candidate, State
from obc_ros.core.solver.improve.arc_iteration import remove_vanished_arcs
from obc_ros.core.solver.improve.registry import DescentStage, try_improvements
from obc_ros.core.solver.trace import DESCENT, Entry, judge_path, MESH
from obc_ros.core.solver.transcription.program import Nearby, SolveEffort, TranscriptionOutcome


class _Descent:
    """
    A descent from one outcome.

    :param bench: of the search.
    :param start: on the coarse mesh.
    """

    def __init__(self, bench: Bench, start: TranscriptionOutcome) -> None:
        self._state, self._tried = State(bench, start, bench.switching), start
        self._judged = 0   # paths so far

    def run(self) -> Candidate:
        """Do what `descend` does."""
        if not self._try(DescentStage.START):
            self._refine_until_enough()
        state = self._state
        best = state.best or state.bench.certify(state.outcome, state.extremal)
        if not (best.certified or self._state.outcome is self._tried):
            self._try(DescentStage.CERTIFIED)
            best = self._state.best or best
        if not best.feasible:
            self._state = replace(self._state, best=best)
            self._try(DescentStage.VIOLATED)
            best = self._state.best or best
        return best

    def _refine_until_enough(self) -> None:
        """Measure, improve and judge the path on each mesh, and solve on a finer one."""
        course, above = None, np.inf
        for turn in range(self._state.bench.options.descent.meshes + 1):
            with self._state.bench.trace.attempt(MESH) as attempt:
                if not self._next_mesh(turn, course):
                    attempt.end(Verdict.STOPPED, 'no finer mesh is tried or leads to a path')
                    return
                course, before = self._state.bench.course(self._state.outcome), above
                above = self._state.bench.excess(self._state.outcome, course)
                # Jumping inputs are to be held at bounds, since a mesh gained little; after five
                # meshes without arcs switching times are sought in any case.
                enough = self._state.bench.options.descent.enough_bounded
                stalled = (turn == 5 or turn and above > enough and above > 0.3 * before
                           ) and not any(self._state.switching)
                # A path that may be certified is judged before it is changed.
                close = above < enough
                if stalled and not close:
                    course = self._try_jumps()
                if self._judge_and_improve(attempt, course):
                    return
            if stalled and close:
                with self._state.bench.trace.attempt(MESH) as attempt:
                    course = self._try_jumps()
                    if self._judge_and_improve(attempt, course):
                        return

    def _next_mesh(self, turn: int, course: Extremal | None) -> bool:
        """Go to the next mesh; return whether there is one, with a path."""
        if course is None:
            self._try(DescentStage.FIRST_MESH)
            return True
        bench, coarse = self._state.bench, self._state.outcome
        if turn == bench.options.descent.meshes:
            return False
        if twin := bench.programs.twin:
            self._state = replace(self._state, bench=replace(
                bench, problem=twin.problem(bench.stated, turn)))
        if turn > 1:
            self._try(DescentStage.NEXT_MESH)
        return self._state.outcome is not coarse or self._solve_finer(course)

    def _try_jumps(self) -> Extremal:
        self._try(DescentStage.STALLED)
        return self._state.bench.course(self._state.outcome)

    def _judge_and_improve(self, attempt: Entry, course: Extremal) -> bool:
        """Judge the path and try arcs; return whether the descent has ended."""
        number, self._judged = self._judged, self._judged + 1
        above = self._judge(attempt, number, course)
        bench, best = self._state.bench, self._state.best
        options, certified = bench.options.descent, best is not None and best.certified
        chorded = above > options.enough_bounded and bench.measure_loss(course).chorded
        # Farther above the minimum no arcs along state bounds are sought.
        if number > 0 and above < 0.1 and (chorded or not certified):
            self._tried = self._state.outcome
            if self._try(DescentStage.CERTIFIED):
                return True
        close = above < (options.enough_bounded if bench.stated.constrained else options.enough)
        return certified and close or bench.quick and number >= 2

    def _try(self, stage: DescentStage) -> bool:
        """Try the improvements of a stage; return whether one led to a candidate."""
        before = self._state.best
        self._state = try_improvements(stage, self._state)
        return self._state.best is not before

    def _judge(self, attempt: Entry, number: int, course: Extremal) -> float:
        """Return the relative excess of the present outcome; certify it if that may pass."""
        bench, outcome = self._state.bench, self._state.outcome
        above = bench.excess(outcome, course)
        attempt.end(Verdict.ACCEPTED, cost=outcome.objective, loss=above,
                    what=outcome.mesh.layout.describe())
        if not self._is_worth_a_certificate(number, course, above):
            kept = bench.keep(outcome, self._state.extremal)
            if kept and bench.best and bench.best.accept == PATH:   # a path, not an optimum
                try_improvements(DescentStage.VIOLATED, replace(self._state, best=kept))
            return above
        found, best = bench.certify(outcome, self._state.extremal), self._state.best
        attempt.end(*judge_path(found.solution), cost=outcome.objective, loss=above)
        # Of two that are equal in this respect the later one is kept, on the finer mesh.
        if best is None or (found.certified, found.feasible) >= (best.certified, best.feasible):
            self._state = replace(self._state, best=found)
        return above

    def _is_worth_a_certificate(self, number: int, course: Extremal, above: float) -> bool:
        """Return whether a certificate may pass, or whether this is the last chance for one."""
        bench, options = self._state.bench, self._state.bench.options.descent
        # The certificate may pass although the next mesh would reduce the excess, but not if H
        # varies by more than 1.5e-4.
        worth = number and above < bench.options.coarse.error and (
            bench.programs.twin or bench.measure_loss(course).spread < 1.5e-4)
        return bool(above < options.enough_bounded or worth or bench.meter.stopped)

    def _solve_finer(self, course: Extremal) -> bool:
        """Solve on a finer mesh, within tightened bounds; return whether that converged."""
        outcome, options = self._state.outcome, self._state.bench.options.descent
        bench, exceeded = self._state.bench.tighten(course)
        self._state = replace(self._state, bench=bench)
        mesh = bench.finer(outcome, course, exceeded)
        if bench.meter.stopped or not bench.meter.allows(mesh.layout.intervals):
            return False
        most = options.work // (mesh.layout.intervals * (1 + mesh.layout.stages))
        new = bench.collocate(
            mesh, outcome.path, near=Nearby(bench.sizes(outcome), guide=outcome),
            effort=SolveEffort(min(options.iterations, max(50, most))))
        if new.converged:
            self._state = remove_vanished_arcs(replace(self._state, outcome=new))
        return new.converged


def descend(bench: Bench, start: TranscriptionOutcome) -> Candidate:
    """
    Refine mesh and arcs of a coarse outcome until its certificate passes.

    The last candidate that was certified is returned; otherwise the best without a certificate
    that passes.
    """
    with bench.trace.attempt(DESCENT, f'from cost {start.objective:.6g}') as attempt:
        best = _Descent(bench, start).run()
        attempt.end(*judge_path(best.solution), cost=best.solution.objective)
    return best
