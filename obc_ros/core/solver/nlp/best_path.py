# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The best path that a solver has met so far, passed on while it works."""

from collections.abc import Callable
import math
import time

from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution

PERIOD = 0.5   # [s] between two paths that are judged for this alone
SHARE = 0.05   # of the time, at most, that judging them takes


class BestPath:
    """
    Passes on a path of a problem when it is better than all before.

    A certified path is better than one that only keeps to the problem, that than one that does
    not; then the cost decides, or by how much it does not.
    """

    def __init__(self, problem: Problem, tell: Callable[[Solution], None]) -> None:
        self._problem, self._tell = problem, tell
        self._rank = (False, False, -math.inf)
        self._begun, self._next = math.nan, time.monotonic()

    def is_due(self, problem: Problem) -> bool:
        """Return whether a path of a problem is to be judged and taken, if it is this problem."""
        now = time.monotonic()
        self._begun = now if problem is self._problem and now >= self._next else math.nan
        return not math.isnan(self._begun)

    def take(self, problem: Problem, found: Solution) -> None:
        """Pass a judged path on if it is one of this problem, and the best so far."""
        certificate = found.certificate
        if problem is not self._problem or certificate is None or not found.t.size:
            return
        feasible, worst = certificate.feasible, certificate.residuals[certificate.worst]
        rank = certificate.holds, feasible, -(found.objective if feasible else worst)
        if rank > self._rank:
            self._rank = rank
            self._tell(found)
        now = time.monotonic()
        judging = 0.0 if math.isnan(self._begun) else now - self._begun
        self._next = now + max(PERIOD, judging / SHARE)
        self._begun = math.nan
