# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What starts and improvements use of the driver of a solve."""

from collections.abc import Generator, Iterator
from typing import Protocol

from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.nlp.progress import ProgressMonitor
from obc_ros.core.solver.program_cache import Answered, Kit
from obc_ros.core.solver.transcription.local_minima import Familiar
from obc_ros.core.solver.transcription.mesh import Mesh, Path
from obc_ros.core.solver.transcription.program import ProblemScales, TranscriptionOutcome


class Bench(Protocol):
    """The problem, what was built for it and found so far, and the operations on a path."""

    bounded: bool
    extremal: BoundaryValues | None
    familiar: Familiar
    intervals: int
    kit: Kit
    last: Answered | None
    looked_from: int
    margin: Array
    may_hold: bool
    minima: list[float]
    monitor: ProgressMonitor
    nearby: bool
    pinned: Mask
    problem: Problem
    quick: bool
    stages: int
    starts: Iterator[Path]
    stated: Problem
    switching: tuple[bool, ...]
    tried: int
    typical: int
    work: int

    def collocate(self, mesh: Mesh, start: Path, durations: Array | None = None, *,
                  near: bool = False, sizes: ProblemScales | None = None, most: int = 500,
                  warm: TranscriptionOutcome | None = None,
                  guide: TranscriptionOutcome | None = None,
                  rough: float = 0.0, once: bool = False, known: Familiar | None = None,
                  least: Array | float = 0.0) -> TranscriptionOutcome:
        """
        Solve the transcription on a mesh from a path, in at most `most` iterations.

        `rough`: relative error of the cost that will do. `once`: try the faster method only.
        `known`: what need not be found again.
        `near`: the path is nearly an answer; phases are then kept from vanishing. `warm`: the
        outcome of a neighbour on this mesh. `guide`: one nearby on another mesh.
        """
        ...

    def believed(self, outcome: TranscriptionOutcome) -> bool:
        """Return whether the cost of a coarse outcome says something."""
        ...

    def from_next_start(self, *, once: bool, hard: bool = False) -> TranscriptionOutcome:
        """Return what the coarse mesh gives from the next start; with `once` in few iterations."""
        ...

    def course(self, outcome: TranscriptionOutcome, *, stated: bool = False) -> Extremal:
        """Return states and costates under the input of an outcome."""
        ...

    def sizes(self, outcome: TranscriptionOutcome) -> ProblemScales:
        """Return the scales of a path that was found, its cost among them."""
        ...

    def widen_margin(self, course: Extremal) -> None:
        """Draw bounds of x and of the path in by what the path exceeds them between nodes."""
        ...

    def finer(self, outcome: TranscriptionOutcome, course: Extremal) -> Mesh:
        """Return a mesh that is finer where the path gives cost away."""
        ...

    def solution(self, outcome: TranscriptionOutcome, course: Extremal) -> Solution:
        """Return an outcome as samples, with its certificate."""
        ...

    def followed_up(self, start: TranscriptionOutcome, rounds: int = ...) -> Solution:
        """Return the best answer that improving a coarse outcome gives."""
        ...

    def following(self, start: TranscriptionOutcome, rounds: int = ...) -> Generator[None, None,
                                                                                     Solution]:
        """Return what `followed_up` does, at leisure: yield after each mesh."""
        ...

    def answered(self, outcome: TranscriptionOutcome) -> Answered:
        """Return what a neighbour, or the indirect method, starts from."""
        ...

    def reset(self) -> None:
        """Go back to what holds for a coarse mesh."""
        ...
