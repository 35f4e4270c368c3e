# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""An improvement of a path: what it is called, when it is tried, and what it changes."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from obc_ros.core.ocp.solution import Verdict
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.bench import Bench, Candidate
from obc_ros.core.solver.trace import judge_path
from obc_ros.core.solver.transcription.program import TranscriptionOutcome


class DescentStage(StrEnum):
    """When in a search an improvement is tried."""

    COARSE = 'on the best coarse outcome'
    START = 'before a descent'
    FIRST_MESH = 'on the first mesh of a descent'
    STALLED = 'on a mesh that gained little'
    NEXT_MESH = 'before a finer mesh'
    VIOLATED = 'at the end of a descent'
    CERTIFIED = 'on a finer mesh without a certificate'


@dataclass(frozen=True, eq=False)
class State:
    """
    A path on the way to a certificate, and what is known about it.

    :ivar bench: of the search, with the tightening found so far.
    :ivar outcome: the path.
    :ivar switching: length m, inputs that may be held at bounds.
    :ivar in_vain: whether holding inputs at bounds did not help.
    :ivar extremal: solution of the boundary value problem whose kinks are the mesh points.
    :ivar best: the best candidate so far.
    """

    bench: Bench
    outcome: TranscriptionOutcome
    switching: tuple[bool, ...] = ()
    in_vain: bool = False
    extremal: BoundaryValues | None = None
    best: Candidate | None = None

    def judge(self, before: 'State') -> tuple[Verdict, str, float]:
        """Return the verdict on the step from another state to this one, why, and the cost."""
        if self.best is not None and self.best is not before.best:
            return *judge_path(self.best.solution), self.best.solution.objective
        helped = self.outcome is not before.outcome
        return Verdict.ACCEPTED if helped else Verdict.REJECTED, '', self.outcome.objective


@dataclass(frozen=True)
class Improvement:
    """
    A change of a path that may lower its cost or lead to its certificate.

    :ivar name: as users see it in the trace, unique.
    :ivar stage: when it is tried.
    :ivar when: when it applies, in one sentence.
    :ivar applies: whether it applies.
    :ivar run: returns the new state, or the reason why there is none.
    """

    name: str
    stage: DescentStage
    when: str
    applies: Callable[[State], bool]
    run: Callable[[State], State | str]
