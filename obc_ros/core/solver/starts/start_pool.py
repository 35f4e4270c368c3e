# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The initial guesses of a search, and the local minima that those used so far have led to."""

from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.transcription.local_minima import LocalMinima
from obc_ros.core.solver.transcription.mesh import label_paths, Path


class StartPool:
    """
    Initial guesses in the order in which they are used, without end.

    :param problem: in the symbols of `programs`.
    :param programs: programs and functions built for the structure of the problem.
    :ivar known_minima: record of the local minima found on the coarse mesh.
    :ivar periods: (m,), periods of inputs that are angles, else infinite.
    """

    def __init__(self, problem: Problem, programs: ProgramCache) -> None:
        self._problem, self._programs = problem, programs
        self.known_minima = LocalMinima(programs.options.coarse)
        self.periods: Array = np.full(problem.m, np.inf)
        self._first: Iterator[Path] = iter(())
        self._rest: Iterator[Path] = iter(())

    def fill(self, first: Iterable[Path] = ()) -> None:
        """Begin with the given paths, then the usual guesses; forget the minima."""
        self.forget()
        self.periods = self._programs.guesser.periods(self._problem)
        self._first = label_paths(first, 'solution on the coarser mesh')
        self._rest = self._programs.guesser.starts(
            self._problem, self._programs.integrator, lambda: self.known_minima.spans)

    def forget(self) -> None:
        """Forget the minima."""
        self.known_minima = LocalMinima(self._programs.options.coarse)

    def put_first(self, paths: Iterator[Path]) -> None:
        """Use these paths before those that are left."""
        self._first = chain(paths, self._first)

    def replace_rest(self, paths: Iterator[Path]) -> None:
        """Use these paths in place of `rest`, which they may contain."""
        self._rest = paths

    @property
    def rest(self) -> Iterator[Path]:
        """Return the guesses that are left, without those that were put first."""
        return self._rest

    def take(self) -> Path:
        """Return the next guess."""
        return next(chain(self._first, self._rest))


def is_rough(bench: Bench, pool: StartPool) -> bool:
    """Return whether coarse solves fail, end at very different costs, or are slow."""
    slow = bench.typical > 30   # iterations
    return slow or pool.known_minima.rough
