# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Programs and functions built for the structure of a problem, and solutions of neighbours."""

from collections import OrderedDict
from dataclasses import dataclass, replace
from functools import cached_property
import time

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.certificate.cost_summands import CostSummands
from obc_ros.core.ocp.problem import Problem, SYMBOLIC
from obc_ros.core.ocp.solution import Optimality
from obc_ros.core.ocp.structure import (
    find_deciding_inputs,
    find_switching_inputs,
    has_convex_paths,
    make_differentiable,
    Uneven,
)
from obc_ros.core.solver.adjoint.bvp import Indirect
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.adjoint.costates import CostateIntegrator
from obc_ros.core.solver.adjoint.multipliers import Fitter
from obc_ros.core.solver.arcs.phase_program import PhasedProgram
from obc_ros.core.solver.initial_guess import Guesser
from obc_ros.core.solver.options import DEFAULTS, NeighbourOptions, Options
from obc_ros.core.solver.proofs.convexity import is_convex_problem
from obc_ros.core.solver.transcription.absolute_values import build_smooth_twin
from obc_ros.core.solver.transcription.intervals import Pieces
from obc_ros.core.solver.transcription.mesh import Layout
from obc_ros.core.solver.transcription.program import (
    ProblemScales,
    Transcription,
    TranscriptionOutcome,
)

# All numbers of a problem but those of its final time.
_NUMBERS = ('x0', 'p_value', 'x_lower', 'x_upper', 'u_lower', 'u_upper', 'path_lower',
            'path_upper')


@dataclass(frozen=True, eq=False)
class Answered:
    """
    A solved problem, with what its neighbours start from.

    :ivar outcome: of the last mesh.
    :ivar margin: (n + l,), tightening of the bounds of x and of the path constraints.
    :ivar extremal: solution of the boundary value problem, if its kinks are mesh points of the
        outcome.
    :ivar rivals: other local minima of about the same cost, on the coarse mesh.
    :ivar refined: cost of the best minimum over its cost on the coarse mesh.
    :ivar looked: numbers of the problem for which multistart looked for the best minimum last. Far
        from there another one may be the best.
    :ivar optimality: result of that search.
    :ivar options: give the reach.
    """

    problem: Problem
    outcome: TranscriptionOutcome
    sizes: ProblemScales
    margin: Array
    extremal: BoundaryValues | None = None
    rivals: tuple[TranscriptionOutcome, ...] = ()
    refined: float = 1.0
    looked: Array | None = None
    optimality: Optimality | None = None
    options: NeighbourOptions = DEFAULTS.neighbour

    @cached_property
    def rows(self) -> Array:
        """
        Return three rows about the numbers of the problem, (3, numbers).

        They are the numbers, the changes up to which a problem is a neighbour, and `looked`, nan
        without it.
        """
        numbers, n = collect_numbers(self.problem), self.problem.n
        reach = np.where(np.isfinite(numbers), np.abs(numbers), 0.0)
        reach[:-3] = np.maximum(reach[:-3], 1e-3)
        reach *= self.options.near
        reach[:n] = np.maximum(reach[:n], 2.0 * np.abs(self.outcome.path.x).max(axis=0))
        return np.stack([numbers, reach, np.full(len(numbers), np.nan) if self.looked is None
                         else self.looked])


class ProgramCache:
    """
    Programs and functions built for one structure, and solutions of its problems.

    All of it is built from the symbols of `problem`. Another problem of the structure must be
    restated in these symbols by `restated` first.

    :ivar answers: solved problems, the latest last.
    :ivar several: whether several minima were found for one of the problems.
    """

    def __init__(self, problem: Problem, options: Options = DEFAULTS) -> None:
        self.options = options
        begun = time.monotonic()
        differentiable = make_differentiable(problem)
        self.twin = build_smooth_twin(differentiable)
        self.stated_integrator = CostateIntegrator(differentiable)
        smooth = self.twin.problem(problem, 0) if self.twin else problem
        self.integrator = CostateIntegrator(smooth) if self.twin else self.stated_integrator
        self.guesser = Guesser(smooth if self.twin else differentiable, options.guesses)
        self.switching = find_switching_inputs(smooth)
        self.affine = not ca.depends_on(
            ca.jacobian(problem.f, ca.vertcat(problem.x, problem.u)),
            ca.vertcat(problem.x, problem.u))
        self.answers: list[Answered] = []
        self.several = False
        self._problem, self._smooth = problem, smooth
        self._convex: tuple[Problem | None, bool] = None, False
        self._pieces: dict[tuple[int, bool], Pieces] = {}
        self._fitter: Fitter | None = None
        self._transcriptions: OrderedDict[Layout, Transcription] = OrderedDict()
        self.build_time = time.monotonic() - begun

    def restated(self, problem: Problem) -> Problem:
        """Return a problem of the structure with its own numbers and the symbols of this cache."""
        return replace(problem, **{name: getattr(self._problem, name) for name in SYMBOLIC})

    def _differentiable(self, problem: Problem) -> Problem:
        """Return a problem with differentiable norms; the smooth reformulation has them."""
        smooth = self.twin is not None and problem.p is self.twin.p
        return problem if smooth else make_differentiable(problem)

    def transcription(self, problem: Problem, layout: Layout) -> Transcription:
        """Return the program of a layout, which is built once."""
        found = self._transcriptions.pop(layout, None)
        if found is None:
            begun = time.monotonic()
            kind = layout.stages, layout.free_durations
            if kind not in self._pieces:
                self._pieces[kind] = Pieces(self._differentiable(problem), *kind)
            found = Transcription(problem, layout, self._pieces[kind])
            self.build_time += time.monotonic() - begun
        self._transcriptions[layout] = found
        if len(self._transcriptions) > self.options.neighbour.kept:
            self._transcriptions.popitem(last=False)
        return found

    def remember(self, answer: Answered, minima: int = 1) -> None:
        """Keep a solved problem, with this number of local minima, for its neighbours."""
        self.answers = [*self.answers, answer][-self.options.neighbour.kept:]
        self.several |= minima > 1

    def take_build_time(self) -> float:
        """Return the time spent on building programs since the last call [s]."""
        built, self.build_time = self.build_time, 0.0
        return built

    def neighbour(self, problem: Problem) -> Answered | None:
        """Return the solved problem whose numbers are nearest, None if none is a neighbour."""
        if not self.answers:
            return None
        mine = collect_numbers(problem)
        theirs, reach, looked = np.stack([answer.rows for answer in self.answers], axis=1)
        with np.errstate(invalid='ignore', divide='ignore'):
            apart = np.where(mine == theirs, 0.0, np.abs(mine - theirs) / reach).max(axis=1)
            # Further from where multistart looked another minimum may be the best; with several
            # known ones by a twentieth of the reach already.
            allowed = (0.05 if self.several else 1.0) * reach
            serves = ~np.any(np.abs(mine - looked) > allowed, axis=1)
        most = np.where(serves, apart, np.inf)
        # The latest of equal ones.
        k = len(most) - 1 - int(np.argmin(most[::-1]))
        return self.answers[k] if most[k] <= 1.0 else None

    @cached_property
    def deciding(self) -> NDArray[np.bool_]:
        """Return which inputs occur in the time derivatives of (x, c), (n + l, m)."""
        return find_deciding_inputs(self._smooth)

    @cached_property
    def summands(self) -> CostSummands:
        """Return the summands of the cost."""
        return CostSummands(self._smooth)

    @cached_property
    def _uneven(self) -> Uneven:
        return Uneven(self._smooth)

    def uneven_costs(self, problem: Problem, cost: float) -> bool:
        """Return whether L or V may have several local minima in states of paths up to a cost."""
        return bool(self._uneven.curved) and self._uneven(
            problem, *self.guesser.room(problem, self.integrator, cost))

    def convex(self, problem: Problem) -> bool:
        """Return whether Pontryagin's conditions are sufficient; kept for the last problem."""
        if self._convex[0] is not problem:
            self._convex = problem, self._convex_paths and (
                self._uneven.upwards(problem) or is_convex_problem(problem))
        return self._convex[1]

    @cached_property
    def _convex_paths(self) -> bool:
        return not self.twin and has_convex_paths(self._problem)

    @cached_property
    def indirect(self) -> Indirect:
        """Return the boundary value problem of the indirect method."""
        return Indirect(make_differentiable(self._problem))

    @cached_property
    def phased(self) -> PhasedProgram:
        """Return the multi-phase program for arcs along state bounds."""
        return PhasedProgram(self._differentiable(self._smooth), self.switching)

    def fitter(self, problem: Problem) -> Fitter:
        """Return the fitter of constraint multipliers; with |.| that of the smooth problem."""
        if self._fitter is None:
            self._fitter = Fitter(self._differentiable(problem))
        return self._fitter


def collect_numbers(problem: Problem) -> Array:
    """
    Return all numbers of a problem.

    They are x(0), parameters, bounds, those of x(0) if it is free; value, lower and upper bound of
    the final time (nan: 0).
    """
    final = problem.final_time
    start = () if problem.start is None else problem.start_box
    return np.concatenate([*(getattr(problem, name) for name in _NUMBERS), *start,
                           np.nan_to_num([final.value, final.lower, final.upper])])


class Cache:
    """
    Programs and solutions of the problems solved last, for others that differ only in numbers.

    Parameters
    ----------
    size : int
        Largest number of structures of problems; 0: nothing is kept.

    """

    def __init__(self, size: int = 32) -> None:
        self._size = size
        self._caches: OrderedDict[str, ProgramCache] = OrderedDict()

    def prepared(self, problem: Problem, options: Options) -> tuple[Problem, ProgramCache]:
        """
        Return a problem in the symbols of the program cache of its structure, and this cache.

        Programs with other options are built anew; without a `structure` they are not kept.
        """
        key = problem.structure
        programs = self._caches.pop(key, None) if key else None
        if programs is None or programs.options != options:
            programs = ProgramCache(problem, options)
        if key:
            self._caches[key] = programs
            if len(self._caches) > self._size:
                self._caches.popitem(last=False)
        return programs.restated(problem), programs
