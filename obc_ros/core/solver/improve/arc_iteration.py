# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Arc iteration: detection of arcs on a path, and solution on phases, until the arcs do not change.

The arcs on which inputs or states are at bounds become phases of unknown lengths. The arcs of the
solution on these phases are detected again and compared.
"""

from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.structure import find_mixed_equalities, find_shared_inputs
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.arcs.bang_arcs import close_ends
from obc_ros.core.solver.arcs.control_discontinuities import cut_at_jumps, sharpen_steps
from obc_ros.core.solver.arcs.input_arcs import (
    Arc,
    build_arc_mesh,
    close_gaps,
    find_arcs,
    find_jumping_inputs,
    free_shared_inputs,
    get_signature,
    have_moved,
    open_arcs,
    Signature,
)
from obc_ros.core.solver.arcs.state_contacts import add_contacts, find_contacts
from obc_ros.core.solver.bench import Bench, State
from obc_ros.core.solver.transcription.local_minima import CHEAPER
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
from obc_ros.core.solver.transcription.program import Nearby, SolveEffort, TranscriptionOutcome

_PERHAPS, _NEVER = 1, 2   # `touch`: boundary arcs also at near contacts; no boundary arcs


class ArcIteration:
    """
    The arc iteration for one problem.

    :param switching: length m, inputs that may be held at bounds.
    :ivar free, seen: the signature of one free arc, and those that were tried.
    :ivar density: intervals of the whole horizon, about.
    """

    def __init__(self, bench: Bench, switching: tuple[bool, ...]) -> None:
        self.bench, self.problem, self.programs = bench, bench.problem, bench.programs
        self.switching, self.touch = switching, 0
        self.free: Signature = ((None,) * self.problem.m,)
        self.seen: set[Signature] = {self.free}
        self.density = 2.0 * bench.options.coarse.intervals

    def settle(self, outcome: TranscriptionOutcome) -> TranscriptionOutcome:
        """
        Iterate from an outcome on any mesh until the arcs do not change.

        The last outcome that converged at no higher cost is returned; its arcs may still change.
        """
        bench, options, now = self.bench, self.bench.options.bangs, self.free
        for _ in range(options.solves):
            arcs = found = self.shown(outcome)
            if get_signature(arcs) == now:
                arcs = self.checked(found, outcome)
            shown = get_signature(arcs)
            elsewhere = have_moved(arcs, outcome.path.durations, options.vanishing)
            if bench.meter.stopped:
                break
            if shown == now:
                # Where ends move no arc at a bound shrinks by more than 2 %.
                new = self.with_arcs(arcs, outcome, kept=0.98) if elsewhere else None
                if new is None or not is_below(new.objective, outcome.objective, CHEAPER):
                    new, now = (self.freed if elsewhere else self.closed)(found, outcome)
                if new is None:
                    break
                outcome = new
                continue
            if shown in self.seen:
                self.density *= 1.5
                if self.density > bench.meter.max_intervals / 4:
                    break
            self.seen.add(shown)
            new = self.with_arcs(arcs, outcome)
            if new is None and get_signature(found) == now:
                new, shown = self.freed(found, outcome)
            if new is not None:
                outcome, now = new, shown
                continue
            if self.touches_otherwise(outcome):
                continue
            self.density *= 2
            if not bench.meter.allows(int(self.density)):
                break
            new = bench.collocate(
                build_uniform_mesh(self.problem, int(self.density), bench.stages),
                outcome.path.in_one_phase(), near=Nearby(bench.sizes(outcome)))
            if not new.converged:
                break
            outcome, now = new, self.free
        return self.without_vanishing(outcome)

    def freed(self, found: list[Arc], outcome: TranscriptionOutcome
              ) -> tuple[TranscriptionOutcome | None, Signature]:
        """
        Solve with inputs free where dH/du has the wrong sign; return the outcome and its arcs.

        On a coarse mesh a short singular arc looks like several bang arcs.
        """
        return self.solve_unseen(self.checked(found, outcome, moving=False), outcome)

    def closed(self, found: list[Arc], outcome: TranscriptionOutcome
               ) -> tuple[TranscriptionOutcome | None, Signature]:
        """
        Solve with short bang arcs at the ends of singular ones; return the outcome and its arcs.

        A bang that is much shorter than an interval does not show in the inputs of a coarse path,
        but dH/du does not vanish there, and the discretisation error is large.
        """
        if self.bench.is_accurate(outcome):
            return None, ()
        course = self.bench.course(outcome)
        arcs = close_ends(
            self.problem, found, np.logical_and(self.switching, self.programs.switching),
            self.programs.deciding, ((course.t[:-1] + course.t[1:]) / 2,
                                     (course.ua + course.ub) / 2, self.slopes(course)))
        return self.solve_unseen(arcs, outcome)

    def solve_unseen(self, arcs: list[Arc], outcome: TranscriptionOutcome
                     ) -> tuple[TranscriptionOutcome | None, Signature]:
        """Solve with arcs and return the outcome, None if they were seen; and their signature."""
        shown = get_signature(arcs)
        if shown in self.seen or self.bench.meter.stopped:
            return None, shown
        self.seen.add(shown)
        return self.with_arcs(arcs, outcome), shown

    def shown(self, outcome: TranscriptionOutcome) -> list[Arc]:
        """Return the arcs detected on an outcome."""
        found = find_arcs(self.problem, outcome.path, self.switching,
                          [not each for each in self.programs.switching])
        return self.broken(self.touching(found, outcome), outcome)

    def broken(self, arcs: list[Arc], outcome: TranscriptionOutcome) -> list[Arc]:
        """Return arcs with a free input in each equality, cut where inputs jump inside bounds."""
        arcs = free_shared_inputs(arcs, find_mixed_equalities(self.problem))
        loose = ~(np.isfinite(self.problem.u_lower) | np.isfinite(self.problem.u_upper))
        of = (loose | find_shared_inputs(self.problem)) & np.array(self.switching)
        return cut_at_jumps(
            arcs, outcome.path, of, (), self.bench.options.bangs.jump) if of.any() else arcs

    def touching(self, arcs: list[Arc], outcome: TranscriptionOutcome) -> list[Arc]:
        """Return arcs with boundary arcs inserted, for state bounds that switching inputs hold."""
        free = self.programs.deciding & np.array(self.switching)
        if not (self.bench.stated.constrained and free.any()) or self.touch == _NEVER:
            return arcs
        path, problem = outcome.path, self.problem
        value = self.programs.fitter(problem).at(problem, path.x, path.u)
        found = find_contacts(problem, outcome, value, self.bench.margin, free.any(axis=1),
                              perhaps=self.touch == _PERHAPS)
        return add_contacts(arcs, found, free) if found else arcs

    def touches_otherwise(self, outcome: TranscriptionOutcome) -> bool:
        """Change `touch` until other boundary arcs are detected; return whether there are any."""
        while self.touch < _NEVER:
            self.touch += 1
            if get_signature(self.shown(outcome)) not in self.seen:
                return True
        self.touch = 0
        return False

    def with_arcs(self, arcs: list[Arc], outcome: TranscriptionOutcome, *, kept: float = 0.0,
                  density: float = 0.0) -> TranscriptionOutcome | None:
        """
        Solve with a phase for each arc, from an outcome; return None if that costs more or fails.

        Costs are compared as they are, then corrected for gaps. `kept`: least length of arcs at
        bounds, as part of the given one.
        """
        bench, problem = self.bench, self.problem
        mesh, durations = build_arc_mesh(
            problem, arcs, bench.stages, (density or self.density) / outcome.path.t[-1])
        if not bench.meter.allows(mesh.layout.intervals) or not self.programs.transcription(
                problem, mesh.layout).solvable(problem, mesh):
            return None
        held = [not np.isnan(arc.levels).any() for arc in arcs]
        new = bench.collocate(
            mesh, replace(sharpen_steps(outcome.path, arcs), durations=durations),
            near=Nearby(bench.sizes(outcome), shortest=kept * durations * held),
            effort=SolveEffort(bench.options.coarse.iterations))
        bench.keep(new)
        room, closed = bench.options.bangs.room * abs(outcome.objective), (
            self.programs.integrator.closed)
        cheap = new.converged and (new.objective <= outcome.objective + room or (
            closed(problem, new) <= closed(problem, outcome) + room))
        return new if cheap else None

    def without_vanishing(self, outcome: TranscriptionOutcome) -> TranscriptionOutcome:
        """Remove the shortest arcs of an outcome on phases if the cost does not increase."""
        options = self.bench.options.bangs
        durations, T = outcome.path.durations, outcome.path.t[-1]
        if np.all(durations > options.vanishing * T):
            return outcome
        arcs = [arc for arc in self.shown(outcome) if arc.end - arc.start > options.vanishing * T]
        density = max(2.0 * self.bench.options.coarse.intervals, outcome.mesh.layout.intervals)
        new = self.with_arcs(close_gaps(arcs, T), outcome, density=density)
        room = options.room * abs(outcome.objective)
        return outcome if new is None or new.objective > outcome.objective + room else new

    def checked(self, arcs: list[Arc], outcome: TranscriptionOutcome, *,
                moving: bool = True) -> list[Arc]:
        """
        Return arcs corrected where dH/du has the wrong sign for the bound of an input.

        The input moves to its other bound there; without `moving` it becomes free.
        """
        course = self.bench.course(outcome)
        Hu = self.slopes(course)
        moves = self.programs.switching if moving else (False,) * self.problem.m
        arcs = open_arcs(arcs, course.t, Hu, self.problem, self.programs.switching, moves)
        return self.broken(self.touching(arcs, outcome), outcome)

    def slopes(self, course: Extremal) -> Array:
        """Return dH/du in the middle of each part of a course, shape (K, m)."""
        x, u = (course.x + course.x_end) / 2, (course.ua + course.ub) / 2
        mu = None if course.density_path is None else course.density_path.mean(axis=1)
        return self.programs.integrator.hamiltonian(
            self.problem, x, u, (course.lam + course.lam_end) / 2, mu)[1]


def hold_switching_inputs(state: State) -> State | str:
    """
    Solve with bang arcs of the inputs in which H is linear.

    Inputs are no longer held if the arcs are too long for the intervals in them.
    """
    bench, outcome = state.bench, state.outcome
    settled = ArcIteration(bench, state.switching).settle(outcome)
    if bench.is_accurate(outcome) and not bench.is_accurate(settled):
        return replace(state, switching=(False,) * bench.problem.m, in_vain=True)
    return replace(state, outcome=settled)


def has_jumping_inputs(state: State) -> bool:
    """Return whether inputs jump from bound to bound, and none is held."""
    bench = state.bench
    return bench.may_hold and not (any(state.switching) or state.in_vain) and any(
        find_jumping_inputs(bench.problem, state.outcome.path))


def hold_jumping_inputs(state: State) -> State | str:
    """Solve with bang arcs of the inputs that jump, unless they help neither cost nor loss."""
    bench, outcome = state.bench, state.outcome
    above = bench.excess(outcome, bench.course(outcome))
    held = replace(state, switching=find_jumping_inputs(bench.problem, outcome.path))
    new = ArcIteration(bench, held.switching).settle(outcome)
    if new.objective > outcome.objective and bench.excess(new, bench.course(new)) >= above:
        return replace(state, in_vain=True)
    return replace(held, outcome=new)


def remove_vanished_arcs(state: State) -> State:
    """Remove the arcs that have vanished on a finer mesh of a descent."""
    durations = state.outcome.path.durations
    if not durations.min() < 1e-6 * durations.sum():
        return state
    iteration = ArcIteration(state.bench, state.switching)
    return replace(state, outcome=iteration.without_vanishing(state.outcome))
