# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the methods of `solve` share: the problem, its programs, and the limits of the work."""

from dataclasses import dataclass

from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.nlp.progress import ProgressMonitor
from obc_ros.core.solver.program_cache import Kit


@dataclass(frozen=True, eq=False)
class Task:
    """
    A problem to be solved.

    Attributes
    ----------
    problem : Problem
        In the symbols of `kit`.
    kit : Kit
        Programs and functions built for the structure of the problem.
    monitor : ProgressMonitor
        Limits of iterations, work and time.
    time_limit : float
        As the caller has given it [s], for messages.

    """

    problem: Problem
    kit: Kit
    monitor: ProgressMonitor
    time_limit: float
