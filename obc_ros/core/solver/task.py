# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A problem with its programs and the limits of the work: what a method of `solve` gets."""

from dataclasses import dataclass, replace
import math

from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.nlp.progress import ProgressMonitor
from obc_ros.core.solver.program_cache import ProgramCache


@dataclass(frozen=True, eq=False)
class Task:
    """
    A problem to be solved.

    Attributes
    ----------
    problem : Problem
        As stated, in the symbols of `programs`.
    programs : ProgramCache
        Programs and functions built for the structure of the problem.
    monitor : ProgressMonitor
        Limits of iterations, work and time.
    time_limit : float, optional
        As the caller has given it [s], for messages.

    """

    problem: Problem
    programs: ProgramCache
    monitor: ProgressMonitor
    time_limit: float = math.inf

    def restate(self, problem: Problem, monitor: ProgressMonitor | None = None) -> 'Task':
        """Return the task of a related problem, with programs of its own."""
        return replace(self, problem=problem, programs=ProgramCache(problem),
                       monitor=monitor or self.monitor)
