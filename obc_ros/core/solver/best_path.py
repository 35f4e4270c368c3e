# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The best intermediate path, for a caller that must return one if the solver is killed."""

from collections.abc import Callable
import math
import time

from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution


class BestPath:
    """
    Passes on each path of a problem that is better than those before.

    A certified path is better than a feasible one, and this better than one that is not feasible.
    Among equals the lower cost decides, or the smaller largest residual if none is feasible.

    :param problem: paths of other problems are ignored.
    :param tell: called with each better path.
    """

    def __init__(self, problem: Problem, tell: Callable[[Solution], None]) -> None:
        self._problem, self._tell = problem, tell
        self._rank = (False, False, -math.inf)
        self._begun, self._next = math.nan, time.monotonic()

    def is_due(self, problem: Problem) -> bool:
        """Return whether an intermediate path of a problem should be certified and taken now."""
        now = time.monotonic()
        self._begun = now if problem is self._problem and now >= self._next else math.nan
        return not math.isnan(self._begun)

    def take(self, problem: Problem, found: Solution) -> None:
        """
        Pass a path on if it belongs to this problem and is the best so far.

        :param problem: of the path.
        :param found: with its certificate; without one it is ignored.
        """
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
        # Certifying takes at most a twentieth of the time, twice a second at most.
        self._next = now + max(0.5, judging / 0.05)
        self._begun = math.nan
