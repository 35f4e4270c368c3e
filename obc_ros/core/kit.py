# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is built for the structure of a problem, and kept for the next one that has it."""

from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
import time

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.arcs import switching_inputs
from obc_ros.core.extremal import Integrator
from obc_ros.core.guesses import Guesser
from obc_ros.core.indirect import Indirect
from obc_ros.core.mesh import Layout
from obc_ros.core.multipliers import Fitter
from obc_ros.core.nonsmooth import twin
from obc_ros.core.problem import Problem
from obc_ros.core.transcription import Outcome, Pieces, Scales, Transcription

Array = NDArray[np.float64]

_LAYOUTS_KEPT = 24
_NEIGHBOUR = 0.2   # relative change of its numbers up to which a problem is a neighbour
_ELSEWHERE = 2.0   # likewise of x0, of the largest values of x on the path
_NUMBERS = ('x0', 'p_value', 'x_lower', 'x_upper', 'u_lower', 'u_upper', 'path_lower',
            'path_upper')


class Kit:
    """What was built for one structure, kept for the next problem that has it."""

    def __init__(self, problem: Problem) -> None:
        begun = time.monotonic()
        self.twin = twin(problem)
        self.judge = Integrator(problem)
        smooth = self.twin.problem(problem, 0) if self.twin else problem
        self.integrator = Integrator(smooth) if self.twin else self.judge
        self.guesser = Guesser(smooth)
        self.switching = switching_inputs(smooth)
        self.affine = not ca.depends_on(
            ca.jacobian(problem.f, ca.vertcat(problem.x, problem.u)),
            ca.vertcat(problem.x, problem.u))
        self.last: Answered | None = None
        self.touched_up = False   # whether answers were polished
        self._problem = problem
        self._pieces: dict[tuple[int, bool], Pieces] = {}
        self._fitters: dict[bool, Fitter] = {}
        self._transcriptions: OrderedDict[Layout, Transcription] = OrderedDict()
        self.build_time = time.monotonic() - begun

    def transcription(self, problem: Problem, layout: Layout) -> Transcription:
        """Return the program of a layout, built at most once."""
        found = self._transcriptions.pop(layout, None)
        if found is None:
            begun = time.monotonic()
            kind = layout.stages, layout.free_durations
            if kind not in self._pieces:
                self._pieces[kind] = Pieces(problem, *kind)
            found = Transcription(problem, layout, self._pieces[kind])
            self.build_time += time.monotonic() - begun
        self._transcriptions[layout] = found
        if len(self._transcriptions) > _LAYOUTS_KEPT:
            self._transcriptions.popitem(last=False)
        return found

    @cached_property
    def indirect(self) -> Indirect:
        """Return the boundary value problem."""
        return Indirect(self._problem)

    def fitter(self, problem: Problem, stated: bool = False) -> Fitter:
        """Return what fits multipliers, built at most once."""
        if stated not in self._fitters:
            self._fitters[stated] = Fitter(problem)
        return self._fitters[stated]


@dataclass(frozen=True, eq=False)
class Answered:
    """A problem that was answered, and with what: where its neighbours start."""

    problem: Problem
    outcome: Outcome
    sizes: Scales
    margin: Array


def neighbours(problem: Problem, last: Answered) -> bool:
    """Return whether the numbers of a problem are near those of one answered before."""
    for name in _NUMBERS:
        a, b = np.asarray(getattr(problem, name)), np.asarray(getattr(last.problem, name))
        with np.errstate(invalid='ignore'):
            apart = np.where(a == b, 0.0, np.abs(a - b))
        size = _NEIGHBOUR * np.maximum(np.where(np.isfinite(b), np.abs(b), 0.0), 1e-3)
        if name == 'x0':
            size = np.maximum(_ELSEWHERE * np.abs(last.outcome.path.x).max(axis=0), size)
        if np.any(apart > size):
            return False
    a, b = (np.nan_to_num([p.final_time.value, p.final_time.lower, p.final_time.upper])
            for p in (problem, last.problem))
    return bool(np.all(np.abs(a - b) <= _NEIGHBOUR * np.abs(b)))
