# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A start of the search: what it is called, when it is tried, and what it proposes.

The initial guesses of a search are in a pool, with the local minima that they have led to.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import chain

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Verdict
from obc_ros.core.solver.bench import Bench, Candidate
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.transcription.local_minima import LocalMinima
from obc_ros.core.solver.transcription.mesh import label_paths, Path
from obc_ros.core.solver.transcription.program import TranscriptionOutcome


class StartPool:
    """
    Initial guesses in the order in which they are used, without end, and what they have led to.

    :ivar known_minima: record of the local minima found on the coarse mesh.
    :ivar periods: (m,), periods of inputs that are angles, else infinite.
    :ivar rest: guesses that are left, without those that were put first.
    """

    def __init__(self, problem: Problem, programs: ProgramCache) -> None:
        self._problem, self._programs = problem, programs
        self.known_minima = LocalMinima(programs.options.coarse)
        self.periods: Array = np.full(problem.m, np.inf)
        self._first: Iterator[Path] = iter(())
        self.rest: Iterator[Path] = iter(())

    def fill(self, first: Iterable[Path] = ()) -> None:
        """Begin with the given paths, then the usual guesses; forget the minima."""
        self.forget()
        self.periods = self._programs.guesser.periods(self._problem)
        self._first = label_paths(first, 'solution on the coarser mesh')
        self.rest = self._programs.guesser.starts(
            self._problem, self._programs.integrator, lambda: self.known_minima.spans)

    def forget(self) -> None:
        """Forget the minima."""
        self.known_minima = LocalMinima(self._programs.options.coarse)

    def put_first(self, paths: Iterator[Path]) -> None:
        """Use these paths before those that are left."""
        self._first = chain(paths, self._first)

    def replace_rest(self, paths: Iterator[Path]) -> None:
        """Use these paths in place of `rest`, which they may contain."""
        self.rest = paths

    def take(self) -> Path:
        """Return the next guess."""
        return next(chain(self._first, self.rest))

    def is_rough(self, bench: Bench) -> bool:
        """Return whether coarse solves fail, end at very different costs, or are slow."""
        return bench.typical > 30 or self.known_minima.rough   # iterations


class StartStage(StrEnum):
    """When in a search a start is tried."""

    FIRST_OUTCOME = 'after the first initial guess'
    SECOND_MESH = 'on the second coarse mesh'
    LAST_RESORT = 'after the last coarse mesh'
    MULTISTART = 'before multistart'


@dataclass(frozen=True)
class Known:
    """
    What is known when a start is tried.

    :ivar outcome: that of the first initial guess.
    :ivar best: that of the first descent, in multistart.
    :ivar floor: its cost on the coarse mesh.
    :ivar begun: work of the search before multistart.
    :ivar uneven: whether the cost may have several local minima in the states.
    :ivar bent: whether the dynamics are so nonlinear that they may cause other local minima.
    """

    outcome: TranscriptionOutcome | None = None
    best: Candidate | None = None
    floor: float = np.nan
    begun: int = 0
    uneven: bool = False
    bent: bool = False


@dataclass(frozen=True)
class Proposal:
    """
    What a start proposes.

    :ivar outcomes: already solved, with a small discretisation error; the stage ends with them.
    :ivar first: initial guesses that are used before all others.
    :ivar rest: initial guesses in place of those of the pool, which it may contain.
    :ivar wanted: number of further initial guesses that are worth a try because of this.
    :ivar why: for the trace.
    """

    outcomes: tuple[TranscriptionOutcome, ...] = ()
    first: Iterator[Path] | None = None
    rest: Iterator[Path] | None = None
    wanted: int = 0
    why: str = ''

    def judge(self) -> tuple[Verdict, str]:
        """Return the verdict on the start, and the reason."""
        idle = not self.outcomes and self.first is None and self.rest is None
        return Verdict.REJECTED if idle else Verdict.ACCEPTED, self.why


@dataclass(frozen=True)
class Start:
    """
    A source of initial guesses, besides those that every search uses.

    :ivar name: as users see it in the trace, unique. Its initial guesses have it, too.
    :ivar stage: when it is tried.
    :ivar when: when it applies, in one sentence.
    :ivar applies: whether it applies.
    :ivar run: makes the proposal.
    """

    name: str
    stage: StartStage
    when: str
    applies: Callable[[Bench, Known], bool]
    run: Callable[[Bench, StartPool, Known], Proposal]
