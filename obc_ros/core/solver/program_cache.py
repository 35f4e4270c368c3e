# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is built for the structure of a problem, and kept for the next one that has it."""

from collections import OrderedDict
from dataclasses import dataclass, replace
from functools import cached_property
import time

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.nonconvexity import has_convex_paths, Uneven
from obc_ros.core.ocp.problem import Problem, SYMBOLIC
from obc_ros.core.ocp.solution import Optimality
from obc_ros.core.ocp.structure import (
    find_branching_inputs,
    find_deciding_inputs,
    find_switching_inputs,
)
from obc_ros.core.solver.adjoint.bvp import Indirect
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.adjoint.costates import CostateIntegrator
from obc_ros.core.solver.adjoint.multipliers import Fitter
from obc_ros.core.solver.arcs.phase_program import PhasedProgram
from obc_ros.core.solver.starts.initial_guess import Guesser
from obc_ros.core.solver.transcription.absolute_values import build_smooth_twin
from obc_ros.core.solver.transcription.intervals import Pieces
from obc_ros.core.solver.transcription.mesh import Layout
from obc_ros.core.solver.transcription.program import (
    ProblemScales,
    Transcription,
    TranscriptionOutcome,
)

_LAYOUTS_KEPT, _ANSWERS_KEPT = 24, 16
_NEIGHBOUR = 0.2   # relative change of its numbers up to which a problem is a neighbour
_ELSEWHERE = 2.0   # likewise of x0, of the largest values of x on the path
# Of both, from where the best of all minima was looked for: where only one is known, or several.
_ALONE, _SEVERAL = 1.0, 0.05
# Iterations times intervals after which the quicker derivatives have paid; usual iterations.
_WORTH_DERIVING, _USUAL = 1000, 10
_AGAIN = 4   # times the work for a structure's later answers: what is asked twice is asked on
_NUMBERS = ('x0', 'p_value', 'x_lower', 'x_upper', 'u_lower', 'u_upper', 'path_lower',
            'path_upper')


@dataclass(frozen=True, eq=False)
class Answered:
    """
    A problem that was answered, and with what: where its neighbours start.

    `rivals`: other minima of about the same cost, on a coarse mesh; `refined`: what the cost of
    the best one is there times that finer meshes bring it to. `looked`: the numbers for which the
    best of all minima was looked for last: far from there another may be the best. `optimality`:
    what that search has shown.
    """

    problem: Problem
    outcome: TranscriptionOutcome
    sizes: ProblemScales
    margin: Array
    extremal: BoundaryValues | None = None   # where its kinks are known
    rivals: tuple[TranscriptionOutcome, ...] = ()
    refined: float = 1.0
    looked: Array | None = None
    optimality: Optimality | None = None

    @cached_property
    def numbers(self) -> Array:
        """Return all numbers of the problem."""
        return collect_numbers(self.problem)

    @cached_property
    def reach(self) -> Array:
        """Return by how much the numbers of neighbours may differ."""
        size = np.where(np.isfinite(self.numbers), np.abs(self.numbers), 0.0)
        size[:-3] = np.maximum(size[:-3], 1e-3)
        found = _NEIGHBOUR * size
        n = self.problem.n
        found[:n] = np.maximum(found[:n], _ELSEWHERE * np.abs(self.outcome.path.x).max(axis=0))
        return found

    @cached_property
    def rows(self) -> Array:
        """Return its numbers, its reach, and from where the best of all was looked for, or nan."""
        nowhere = np.full(len(self.numbers), np.nan)
        return np.stack([self.numbers, self.reach,
                         nowhere if self.looked is None else self.looked])


class Kit:
    """
    What was built for one structure, kept for the next problem that has it.

    All of it is made of the symbols of the problem it was built for: `restated` puts another
    problem of the structure in these symbols before anything here is used with it.
    """

    def __init__(self, problem: Problem) -> None:
        begun = time.monotonic()
        self.twin = build_smooth_twin(problem)
        self.judge = CostateIntegrator(problem)
        smooth = self.twin.problem(problem, 0) if self.twin else problem
        self.integrator = CostateIntegrator(smooth) if self.twin else self.judge
        self.guesser = Guesser(smooth)
        self.switching = find_switching_inputs(smooth)
        self.affine = not ca.depends_on(
            ca.jacobian(problem.f, ca.vertcat(problem.x, problem.u)),
            ca.vertcat(problem.x, problem.u))
        self.answers: list[Answered] = []   # the latest last
        self.touched_up = False   # whether answers were polished
        self.several = False   # whether several minima were found for some numbers
        self._problem, self._smooth = problem, smooth
        self._pieces: dict[tuple[int, bool, bool], Pieces] = {}
        self._fitters: dict[bool, Fitter] = {}
        self._transcriptions: OrderedDict[tuple[Layout, bool], Transcription] = OrderedDict()
        self._work = 0   # iterations times intervals of Runge-Kutta steps
        self.build_time = time.monotonic() - begun

    def restated(self, problem: Problem) -> Problem:
        """Return a problem of the structure with its own numbers and the symbols of this kit."""
        return replace(problem, **{name: getattr(self._problem, name) for name in SYMBOLIC})

    def transcription(self, problem: Problem, layout: Layout) -> Transcription:
        """Return the program of a layout, built at most once, or twice where that soon pays."""
        ahead = 0 if (layout, False) in self._transcriptions else _USUAL * layout.intervals
        swift = not layout.stages and self._work + ahead > _WORTH_DERIVING
        found = self._transcriptions.pop((layout, swift), None)
        if found is None:
            begun = time.monotonic()
            kind = layout.stages, layout.free_durations, swift
            if kind not in self._pieces:
                self._pieces[kind] = Pieces(problem, *kind)
            found = Transcription(problem, layout, self._pieces[kind])
            self.build_time += time.monotonic() - begun
        self._transcriptions[layout, swift] = found
        if len(self._transcriptions) > _LAYOUTS_KEPT:
            self._transcriptions.popitem(last=False)
        return found

    def worked(self, iterations: int, layout: Layout) -> None:
        """Take note of iterations of a program."""
        weight = _AGAIN if self.answers else 1
        self._work += 0 if layout.stages else weight * iterations * layout.intervals

    def remember(self, answer: Answered) -> None:
        """Keep an answer for its neighbours."""
        self.answers = [*self.answers[1 - _ANSWERS_KEPT:], answer]

    def neighbour(self, problem: Problem) -> Answered | None:
        """Return the nearest answer to a problem whose numbers are near, if there is one."""
        if not self.answers:
            return None
        mine = collect_numbers(problem)
        theirs, reach, looked = np.stack([answer.rows for answer in self.answers], axis=1)
        with np.errstate(invalid='ignore', divide='ignore'):
            apart = np.where(mine == theirs, 0.0, np.abs(mine - theirs) / reach).max(axis=1)
            # Further from where it was looked for another of several minima may be the best.
            allowed = (_SEVERAL if self.several else _ALONE) * reach
            serves = ~np.any(np.abs(mine - looked) > allowed, axis=1)
        most = np.where(serves, apart, np.inf)
        # Of equal ones the latest.
        k = len(most) - 1 - int(np.argmin(most[::-1]))
        return self.answers[k] if most[k] <= 1.0 else None

    @cached_property
    def deciding(self) -> NDArray[np.bool_]:
        """Return which inputs enter the rate of each row of (x, c)."""
        return find_deciding_inputs(self._smooth)

    @cached_property
    def branching(self) -> NDArray[np.bool_]:
        """Return in which inputs H may have several least points."""
        return find_branching_inputs(self._smooth)

    @cached_property
    def _uneven(self) -> Uneven:
        return Uneven(self._smooth)

    def uneven_costs(self, problem: Problem, cost: float) -> bool:
        """Return whether L or V may have hollows, each with a minimum, for paths of a cost."""
        return bool(self._uneven.curved) and self._uneven(
            problem, *self.guesser.room(problem, self.integrator, cost))

    def convex(self, problem: Problem) -> bool:
        """Return whether no path is better than one that satisfies Pontryagin's conditions."""
        return self._convex_paths and self._uneven.upwards(problem)

    @cached_property
    def _convex_paths(self) -> bool:
        return self.affine and not self.twin and has_convex_paths(self._problem)

    @cached_property
    def indirect(self) -> Indirect:
        """Return the boundary value problem."""
        return Indirect(self._problem)

    @cached_property
    def phased(self) -> PhasedProgram:
        """Return what solves for arcs along bounds of the state."""
        return PhasedProgram(self._smooth, self.switching)

    def fitter(self, problem: Problem, stated: bool = False) -> Fitter:
        """Return what fits multipliers, built at most once."""
        if stated not in self._fitters:
            self._fitters[stated] = Fitter(problem)
        return self._fitters[stated]


def collect_numbers(problem: Problem) -> Array:
    """Return all numbers of a problem in a row."""
    final = problem.final_time
    return np.concatenate([*(getattr(problem, name) for name in _NUMBERS),
                           np.nan_to_num([final.value, final.lower, final.upper])])
