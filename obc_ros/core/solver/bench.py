# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The interface through which starts and improvements use the driver of a solve."""

from collections.abc import Generator, Iterator
from typing import Protocol

from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.nlp.progress import ProgressMonitor
from obc_ros.core.solver.program_cache import Answered, Kit
from obc_ros.core.solver.trace import Trace
from obc_ros.core.solver.transcription.local_minima import Familiar
from obc_ros.core.solver.transcription.mesh import Mesh, Path
from obc_ros.core.solver.transcription.program import ProblemScales, TranscriptionOutcome


class Bench(Protocol):
    """
    A problem, its program cache, the results so far, and the operations on a path.

    The docstrings of the operations are those of `descent.Search`, too.

    Attributes
    ----------
    stated, problem : Problem
        The problem as stated, and the one that is solved: its smooth reformulation if |.| occurs.
    kit : Kit
        Programs and functions built for the structure of the problem.
    monitor : ProgressMonitor
        Limits of iterations, work and time.
    bounded : bool
        Whether there are state bounds or path constraints.
    quick : bool
        Whether a feasible path is enough: one start and a few meshes.
    may_hold : bool
        Whether inputs may be held at bounds between switching times.
    switching : tuple of bool, length m
        Inputs that are held so at present.
    stages, intervals : int
        Of the coarse mesh: collocation points in an interval (0: Runge-Kutta), intervals.
    margin : ndarray, shape (n + l,)
        Tightening of the bounds of x and of the path constraints.
    pinned : ndarray of bool, shape (n,)
        Components of x(T) that psi fixes.
    starts : iterator of Path
        Initial guesses that were not used yet.
    tried, looked_from : int
        Initial guesses used so far; those among them that are cross-entropy rollouts.
    familiar : Familiar
        Record of the local minima found on the coarse mesh.
    minima : list of float
        Costs of local minima other than the best.
    typical : int
        Iterations of a solve on the coarse mesh that converged.
    work : int
        Iterations times intervals so far; with collocation times 1 + `stages`.
    last : Answered or None
        Where neighbouring problems and the indirect method start.
    extremal : BoundaryValues or None
        Solution of the boundary value problem that belongs to the present outcome.
    nearby : bool
        Whether `extremal` was found from that of a neighbouring problem.

    """

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

    @property
    def trace(self) -> Trace:
        """Return the record of what is tried."""
        ...

    def collocate(self, mesh: Mesh, start: Path, durations: Array | None = None, *,
                  near: bool = False, sizes: ProblemScales | None = None, most: int = 500,
                  warm: TranscriptionOutcome | None = None,
                  guide: TranscriptionOutcome | None = None,
                  rough: float = 0.0, once: bool = False, known: Familiar | None = None,
                  least: Array | float = 0.0) -> TranscriptionOutcome:
        """
        Solve the transcription on a mesh from a path.

        Parameters
        ----------
        mesh : Mesh
            Phases, their intervals, and the scheme.
        start : Path
            Initial guess.
        durations : ndarray, shape (phases,), optional
            Initial lengths of the phases [s]; those of `start` if left out.
        near : bool
            The guess is close to the solution; phases are kept from vanishing.
        sizes : ProblemScales, optional
            Scales of the unknowns and of the cost; estimated from `start` if left out.
        most : int
            Maximum number of iterations.
        warm : TranscriptionOutcome, optional
            Outcome of a neighbouring problem on this mesh: initial point and multipliers.
        guide : TranscriptionOutcome, optional
            Outcome of this problem on another mesh, from which multipliers are interpolated.
        rough : float
            Relative error of the cost at which the iteration may end; 0: the usual tolerance.
        once : bool
            Try the faster method only.
        known : Familiar, optional
            Local minima; the iteration ends once it is seen to lead to one of them.
        least : ndarray, shape (phases,), or float
            Lower bound of the lengths of the phases [s].

        Returns
        -------
        TranscriptionOutcome
            The last iterate; `converged` tells whether it satisfies the optimality conditions.

        """
        ...

    def believed(self, outcome: TranscriptionOutcome) -> bool:
        """
        Return whether the discretisation error of a coarse outcome is small enough.

        Parameters
        ----------
        outcome : TranscriptionOutcome
            On a coarse mesh.

        Returns
        -------
        bool
            False if it did not converge, or if the local errors or the Hamiltonian loss are so
            large that its cost cannot be compared with other costs.

        """
        ...

    def from_next_start(self, *, once: bool, hard: bool = False) -> TranscriptionOutcome:
        """
        Solve on the coarse mesh from the next initial guess.

        Parameters
        ----------
        once : bool
            Allow few iterations, in proportion to `typical`, of the faster method only.
        hard : bool
            With `once`: allow twice as many.

        Returns
        -------
        TranscriptionOutcome
            Also recorded in `familiar`.

        """
        ...

    def course(self, outcome: TranscriptionOutcome, *, stated: bool = False) -> Extremal:
        """
        Integrate states and costates under the input of an outcome.

        Parameters
        ----------
        outcome : TranscriptionOutcome
            On any mesh.
        stated : bool
            For the problem as stated, not for its smooth reformulation.

        Returns
        -------
        Extremal
            With multipliers of state bounds and path constraints, if there are any.

        """
        ...

    def sizes(self, outcome: TranscriptionOutcome) -> ProblemScales:
        """Return the scales of an outcome's path and cost."""
        ...

    def widen_margin(self, course: Extremal) -> None:
        """Increase `margin` by the amounts by which a path exceeds its bounds between nodes."""
        ...

    def finer(self, outcome: TranscriptionOutcome, course: Extremal) -> Mesh:
        """
        Refine the mesh of an outcome.

        Parameters
        ----------
        outcome : TranscriptionOutcome
            On the mesh to be refined.
        course : Extremal
            Its states and costates, from `course`.

        Returns
        -------
        Mesh
            Finer where the Hamiltonian loss, the local error of the states, the variation of H
            or the violation of constraints exceeds its share; a point at every kink of u*.

        """
        ...

    def solution(self, outcome: TranscriptionOutcome, course: Extremal) -> Solution:
        """Return an outcome as samples with its certificate; without one if work has stopped."""
        ...

    def followed_up(self, start: TranscriptionOutcome, rounds: int = ...) -> Solution:
        """
        Refine the mesh and the arcs of a coarse outcome until its certificate passes.

        Parameters
        ----------
        start : TranscriptionOutcome
            On the coarse mesh.
        rounds : int
            Maximum number of meshes.

        Returns
        -------
        Solution
            The last one that was certified; otherwise the best without a passing certificate.

        """
        ...

    def following(self, start: TranscriptionOutcome, rounds: int = ...) -> Generator[None, None,
                                                                                     Solution]:
        """Do what `followed_up` does step by step: yield after each mesh, return the solution."""
        ...

    def answered(self, outcome: TranscriptionOutcome) -> Answered:
        """Return the record from which a neighbour, or the indirect method, starts."""
        ...

    def reset(self) -> None:
        """Return to the settings of a coarse mesh: no margin, no extremal, no arcs found."""
        ...
