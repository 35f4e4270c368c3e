# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The exact methods, in the order in which `auto` tries them.

A new one is a function of a problem and a line in EXACT_METHODS.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status, Verdict
from obc_ros.core.solver.bench import Task
from obc_ros.core.solver.conclusion import certify_solution
from obc_ros.core.solver.exact.time_optimal import solve_time_optimal
from obc_ros.core.solver.exact.two_wheeled import solve_two_wheeled
from obc_ros.core.solver.linear_quadratic import solve_lq
from obc_ros.core.solver.trace import judge_path


@dataclass(frozen=True)
class ExactMethod:
    """
    A method for special problems, which needs no initial guess.

    :ivar name: as users write it.
    :ivar affine: whether the dynamics must be affine.
    :ivar decides: whether a result without a path is final, not only a proof of infeasibility.
    :ivar what: which problems it solves, for the message.
    :ivar solve: returns None for other problems.
    """

    name: str
    affine: bool
    decides: bool
    what: str
    solve: Callable[[Problem], Solution | None]

    def attempt(self, task: Task) -> Solution | None:
        """Return the result with its certificate, None for other problems; the trace notes it."""
        with task.meter.trace.attempt('exact method', self.name) as attempt:
            found = self.solve(task.problem)
            if found is None:
                attempt.end(Verdict.REJECTED, 'it does not apply')
                return None
            found = replace(certify_solution(task.problem, found), method=self.name)
            attempt.end(*judge_path(found), cost=found.objective)
        return found

    def __call__(self, task: Task) -> Solution:
        """Solve the problem if it is of this kind; otherwise say which kind that is."""
        return self.attempt(task) or Solution(Status.NOT_CONVERGED, (
            f'{self.name} solves {self.what}; this problem is not one of them'))


EXACT_METHODS = (
    ExactMethod('riccati', True, True, (
        'linear quadratic problems with a fixed final time and no active bound'), solve_lq),
    ExactMethod('time_optimal', True, False, (
        'linear minimum-time problems with bounded inputs'), solve_time_optimal),
    ExactMethod('reeds_shepp', False, False, (
        'minimum-time motions of a two-wheeled robot whose shortest path ends at the prescribed '
        'angle'), solve_two_wheeled))
