# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Descent: mesh refinement and arcs, from an outcome on a coarse mesh to a passing certificate.

The cost of an outcome is compared with the minimum by the Hamiltonian loss
(adjoint/mesh_refinement.py): the integral of H(x, u, lam) - min H(x, ., lam), which is the excess
of the cost to first order. 'Relative excess' is this loss over |J|.
"""

from collections.abc import Generator, Iterator
from dataclasses import replace
from typing import cast

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Verdict
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.arcs.input_arcs import find_jumping_inputs
from obc_ros.core.solver.bench import Bench, Candidate
from obc_ros.core.solver.improve.arc_iteration import ArcIteration
from obc_ros.core.solver.improve.kink_mesh import solve_on_kinks
from obc_ros.core.solver.improve.state_arcs import solve_along_bounds, solve_at_once
from obc_ros.core.solver.trace import judge_path
from obc_ros.core.solver.transcription.program import TranscriptionOutcome


class Descent:
    """
    A descent from one outcome. It holds the arcs and the tightening found so far.

    Parameters
    ----------
    bench : Bench
        Of the search.

    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._switching = bench.switching
        self._held_in_vain = False    # whether holding inputs at bounds did not help
        self._exceeded: Array = np.zeros(0)
        # Solution of the boundary value problem whose kinks are the present mesh points.
        self._extremal: BoundaryValues | None = None

    def follow(self, start: TranscriptionOutcome,
               rounds: int = 0) -> Generator[None, None, Candidate]:
        """
        Refine mesh and arcs until the certificate passes; yield after each mesh.

        Parameters
        ----------
        start : TranscriptionOutcome
            On the coarse mesh.
        rounds : int, optional
            Maximum number of meshes; that of the options if left out.

        Returns
        -------
        Candidate
            The last one that was certified; otherwise the best without a passing certificate.

        """
        options = self._bench.options.descent
        trace = self._bench.trace
        descent = trace.begin('descent', f'from cost {start.objective:.6g}')
        with trace.under(descent):
            best = solve_at_once(self._bench, any(self._switching), start)
        if best is not None:
            descent.end(*judge_path(best.solution), cost=best.solution.objective)
            return best
        nearest = tried = start
        begun = self._bench.work
        meshes = enumerate(self._meshes(start, rounds or options.meshes))
        while True:
            with trace.under(descent), trace.attempt('mesh') as attempt:
                if (step := next(meshes, None)) is None:
                    attempt.end(Verdict.STOPPED, 'no finer mesh is tried or leads to a path')
                    break
                number, (outcome, course) = step
                above = self._bench.excess(outcome, course)
                attempt.end(Verdict.ACCEPTED, cost=outcome.objective, loss=above,
                            what=outcome.mesh.layout.describe())
                if self._is_worth_a_certificate(number, course, above):
                    found = self._bench.certify(outcome, self._extremal)
                    attempt.end(*judge_path(found.solution), cost=outcome.objective, loss=above)
                    if best is None or found.certified or not best.certified:
                        best = found
                else:
                    self._bench.keep(outcome, self._extremal)
                nearest, held = outcome, best is not None and best.certified
                chorded = above > options.enough_bounded and self._bench.judged(course).chorded
                due = number in options.boundary_arcs and above < options.boundary_excess
                if due and (chorded or not held):
                    tried = outcome
                    if (found_ := solve_along_bounds(self._bench, outcome, best)) is not None:
                        descent.end(*judge_path(found_.solution), cost=found_.solution.objective)
                        return found_
                late = self._bench.work - begun > options.digits * (1 + self._bench.stages)
                close = above < (
                    options.enough_bounded if self._bench.bounded else options.enough)
                if held and (close or late) or self._bench.quick and number >= 2:
                    break
            yield
        with trace.under(descent):
            best = best or self._bench.certify(outcome, self._extremal)
            if not best.certified and nearest is not tried:
                best = solve_along_bounds(self._bench, nearest) or best
        descent.end(*judge_path(best.solution), cost=best.solution.objective)
        return best

    def _is_worth_a_certificate(self, number: int, course: Extremal, above: float) -> bool:
        """Return whether a certificate may pass, or whether this is the last chance for one."""
        options = self._bench.options.descent
        # At such an excess the certificate may pass although the next mesh would reduce it.
        bench = self._bench
        worth = number and above < options.look and (
            bench.programs.twin or bench.judged(course).spread < options.spread)
        return bool(above < options.close or worth or bench.meter.stopped)

    def _meshes(self, outcome: TranscriptionOutcome,
                rounds: int) -> Iterator[tuple[TranscriptionOutcome, Extremal]]:
        """Yield outcomes on finer and finer meshes, at most `rounds`, with their costates."""
        options = self._bench.options.descent
        outcome, above = self._with_arcs(outcome), np.inf
        for turn in range(rounds):
            course = self._bench.course(outcome)
            above, before = self._bench.excess(outcome, course), above
            stalled = turn and above > options.close and above > 0.3 * before
            if (stalled or turn == options.plain) and not any(self._switching):
                if above < options.close:
                    yield outcome, course
                outcome = self._rethought(outcome, above)
                course = self._bench.course(outcome)
            yield outcome, course
            if turn == rounds - 1:
                return
            if twin := self._bench.programs.twin:
                self._state(twin.problem(self._bench.stated, turn + 1))
            if turn and (aligned := self._on_kinks(outcome, course)) is not None:
                outcome = aligned
                continue
            self._bench, self._exceeded = self._bench.tighten(course)
            finer = self._on_finer_mesh(outcome, course)
            if finer is None:
                return
            outcome = finer

    def _state(self, problem: Problem) -> None:
        """Solve another smooth reformulation of the problem from now on."""
        self._bench = replace(self._bench, problem=problem)

    def _iteration(self) -> ArcIteration:
        return ArcIteration(self._bench, self._switching, self._bench.options.coarse.intervals)

    def _with_arcs(self, outcome: TranscriptionOutcome) -> TranscriptionOutcome:
        """Return a coarse outcome with the arcs of the inputs that switch."""
        if not any(self._switching):
            return outcome
        settled = self._iteration().settle(outcome)
        self._held_in_vain = (
            self._bench.is_accurate(outcome) and not self._bench.is_accurate(settled))
        if not self._held_in_vain:
            return settled
        # The arcs are too long for the number of intervals in them.
        self._switching = (False,) * self._bench.problem.m
        return outcome

    def _on_kinks(self, outcome: TranscriptionOutcome,
                  course: Extremal) -> TranscriptionOutcome | None:
        """Return an outcome with mesh points at the kinks of the inputs, once in a descent."""
        if self._extremal is not None or any(self._switching):
            return None
        found = solve_on_kinks(self._bench, outcome, course)
        if found is None:
            return None
        aligned, self._extremal = found
        return aligned

    def _on_finer_mesh(self, outcome: TranscriptionOutcome,
                       course: Extremal) -> TranscriptionOutcome | None:
        """Return the outcome on a finer mesh, without arcs that have vanished; None without."""
        options = self._bench.options.descent
        bench = self._bench
        mesh = bench.finer(outcome, course, self._exceeded)
        if bench.meter.stopped or not bench.meter.allows(mesh.layout.intervals):
            return None
        most = options.work // (mesh.layout.intervals * (1 + mesh.layout.stages))
        new = bench.collocate(mesh, outcome.path, near=True, sizes=bench.sizes(outcome),
                              guide=outcome, most=min(options.iterations, max(50, most)))
        if not new.converged:
            return None
        return self._iteration().without_vanishing(new) if ArcIteration.vanished(new) else new

    def _rethought(self, outcome: TranscriptionOutcome, above: float) -> TranscriptionOutcome:
        """Return the outcome, or a better one with bang arcs; `above`: its relative excess."""
        bench = self._bench
        jumping = find_jumping_inputs(bench.problem, outcome.path)
        if bench.may_hold and any(jumping) and not self._held_in_vain:
            free, self._switching = self._switching, jumping
            new = self._iteration().settle(outcome)
            self._held_in_vain = new.objective > outcome.objective and (
                bench.excess(new, bench.course(new)) >= above)
            self._switching = free if self._held_in_vain else jumping
            return outcome if self._held_in_vain else new
        return outcome


def descend(bench: Bench, start: TranscriptionOutcome, rounds: int = 0) -> Candidate:
    """
    Refine mesh and arcs of a coarse outcome until its certificate passes; see `Descent.follow`.

    Parameters
    ----------
    bench : Bench
        Of the search.
    start : TranscriptionOutcome
        On the coarse mesh.
    rounds : int, optional
        Maximum number of meshes; that of the options if left out.

    """
    return finish(Descent(bench).follow(start, rounds))


def finish(work: Generator[None, None, Candidate]) -> Candidate:
    """
    Run a descent to its end.

    Parameters
    ----------
    work : generator
        From `Descent.follow`.

    Returns
    -------
    Candidate

    """
    while True:
        try:
            next(work)
        except StopIteration as end:
            return cast('Candidate', end.value)
