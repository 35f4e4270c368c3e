# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The methods by name, and the exact methods in the order in which `auto` tries them.

A new method is a function of a `Task` and a line here; a new exact method is a function of a
problem and a line in EXACT_METHODS.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status, Verdict
from obc_ros.core.solver.bench import Bench, Candidate, Task
from obc_ros.core.solver.conclusion import certify_solution, drop_multipliers, look_for_proof
from obc_ros.core.solver.diagnosis.explanation import explain, Reason
from obc_ros.core.solver.exact.time_optimal import solve_time_optimal
from obc_ros.core.solver.exact.two_wheeled import solve_two_wheeled
from obc_ros.core.solver.improve.improvement import DescentStage, State
from obc_ros.core.solver.improve.indirect import refine_indirectly
from obc_ros.core.solver.improve.registry import try_improvements
from obc_ros.core.solver.linear_quadratic import solve_lq
from obc_ros.core.solver.proofs.existence import find_constant_cost, state_least_effort
from obc_ros.core.solver.search import search
from obc_ros.core.solver.trace import judge_path

Method = Callable[[Task], Solution]
Refine = Callable[[Bench, Candidate], Candidate]


@dataclass(frozen=True)
class ExactMethod:
    """
    A method for special problems, which needs no initial guess.

    Attributes
    ----------
    name : str
        As users write it.
    affine : bool
        Whether the dynamics must be affine.
    decides : bool
        Whether a result without a path is final, not only a proof of infeasibility.
    what : str
        Which problems it solves, for the message.
    solve : callable
        Returns None for other problems.

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


def solve_automatically(task: Task) -> Solution:
    """Solve a problem: exact methods, proofs, then a search; its `method` tells which."""
    for exact in EXACT_METHODS:
        if exact.affine == task.programs.affine and (found := _try_exact(task, exact)) is not None:
            return found
    # Proofs take longer than to follow the path of a neighbour.
    is_near = task.programs.neighbour(task.problem) is not None
    if not is_near and (reason := _examine_statement(task)):
        status = Status.INFEASIBLE if reason.infeasible else Status.NOT_CONVERGED
        return Solution(status, reason.sentence, method='arcs')
    if (L := find_constant_cost(task.problem)) is not None:
        return replace(_find_any_path(task, L), method='arcs')
    return replace(_search(task), method='arcs')


def _try_exact(task: Task, exact: ExactMethod) -> Solution | None:
    """Return the final result of an exact method, None if there is none."""
    found = exact.attempt(task)
    if found is None:
        return None
    if found.status in (Status.SOLVED, Status.INFEASIBLE) or exact.decides and not found.t.size:
        return found
    if task.best:
        task.best.take(task.problem, found)
    return None


def _examine_statement(task: Task) -> Reason | None:
    """Return a proof that no path satisfies the constraints, or that the cost has no minimum."""
    with task.meter.trace.attempt('proof', 'from the statement') as attempt:
        reason = explain(task.problem, trace=task.meter.trace)
        attempt.end(Verdict.PROVED if reason else Verdict.NOT_PROVED,
                    reason.sentence if reason else '')
    return reason


def _find_any_path(task: Task, L: float) -> Solution:
    """Return the path of minimum effort of a problem in which all paths have the same cost."""
    other = state_least_effort(task.problem)
    found = search(task.restate(other), why_not=look_for_proof(task))[0].solution
    if not found.t.size:
        return found
    found = drop_multipliers(found, L)
    return replace(found, objective=L * found.t[-1] + float(task.problem.V), certificate=None)


def _search(task: Task, *, with_arcs: bool = True, refine: Refine | None = None) -> Solution:
    """Return the result of a search, refined unless its work was stopped."""
    found, bench = search(task, with_arcs=with_arcs, why_not=look_for_proof(task))
    if bench.meter.stopped:
        found = _keep_bounds(task, bench, found)
    elif refine is not None:
        found = refine(bench, found)
    return found.solution


def _keep_bounds(task: Task, bench: Bench, found: Candidate) -> Candidate:
    """Return the result of a search that was stopped, within its bounds if that is possible."""
    options, record = task.options.budget, found.record
    if (record is None or found.feasible or task.meter.stopped == 'cancelled'
            or not bench.bounded or bench.programs.twin):
        return found
    meter = task.meter.overtime(options.least) if task.meter.stopped else task.meter.part()
    if meter.remaining() <= 0.0:
        return found
    bench = replace(bench, meter=meter, whole=meter, margin=record.margin)
    state = State(bench, record.outcome, best=bench.certify(record.outcome, record.extremal))
    best = try_improvements(DescentStage.VIOLATED, state).best or found
    return replace(best, solution=replace(
        best.solution, optimality=best.solution.optimality or found.solution.optimality))


METHODS: Mapping[str, Method] = {
    'auto': solve_automatically,
    **{exact.name: exact for exact in EXACT_METHODS},
    'transcription': partial(_search, with_arcs=False),
    'arcs': _search,
    'indirect': partial(_search, refine=refine_indirectly),
}
