# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Solution of an optimal control problem, with certificate.

A method finds a path and its costates: by default exact methods, then proofs that there is no
path, then a search (`search`). The certificate is computed from the problem and the path alone,
and decides the status. Without one, the reason is looked for (`conclusion`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
import math
import time

import casadi as ca
import numpy as np
from obc_ros.core.ocp.method_names import get_accepted, get_method
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Attempt, MAX_INTERVALS, Report, Solution, Status, Verdict
from obc_ros.core.solver.bench import Bench, BestPath, Candidate, State, Task
from obc_ros.core.solver.conclusion import (
    certify_solution,
    conclude,
    drop_multipliers,
    look_for_proof,
    mark_unfinished,
)
from obc_ros.core.solver.diagnosis.explanation import explain
from obc_ros.core.solver.exact.time_optimal import solve_time_optimal
from obc_ros.core.solver.exact.two_wheeled import solve_two_wheeled
from obc_ros.core.solver.improve.indirect import refine_indirectly
from obc_ros.core.solver.improve.registry import DescentStage, try_improvements
from obc_ros.core.solver.linear_quadratic import solve_lq
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.options import DEFAULTS, Options
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.proofs.existence import find_constant_cost, measure_effort
from obc_ros.core.solver.search import search
from obc_ros.core.solver.trace import judge_path

Method = Callable[[Task], Solution]
Refine = Callable[[Bench, Candidate], Candidate]


@np.errstate(all='ignore')   # the certificate rejects a path with an overflow
def solve(problem: Problem, *, method: str = '', time_limit: float = 60.0,
          report: Report | None = None, cache: Cache | None = None,
          max_intervals: int = MAX_INTERVALS, accept: str = '',
          keep: Callable[[Solution], None] | None = None,
          note: Callable[[tuple[Attempt, ...]], None] | None = None,
          options: Options = DEFAULTS) -> Solution:
    """
    Solve a problem and certify the solution.

    :param problem: a checked statement.
    :param method: one of METHODS; that of the problem if left out.
    :param time_limit: limit of the wall-clock time [s].
    :param report: called as report(phase, iteration, cost, infeasibility); True cancels.
    :param cache: keeps what is built for the structure, for later problems that have it.
    :param max_intervals: maximum number of intervals of a mesh.
    :param accept: one of ACCEPTED; that of the problem if left out. With 'path', the search ends
        at the first path that meets all constraints; with 'best', at the time limit with the best
        one, or earlier with a certified solution.
    :param keep: called with each path that is better than those before, with status
        'not_converged', or 'feasible' if it is accepted. Its message contains the cost and the
        condition that fails. For a caller that must return a path if this process is killed.
    :param note: called with the attempts so far when another one begins, for the same caller.
    :param options: numbers that steer the search.
    :return: 'solved' only if every residual of the certificate is within its tolerance;
        'infeasible' only if infeasibility is proved; 'feasible' only if `accept` allows it and the
        certificate shows that the path meets all constraints; otherwise 'not_converged',
        'timed_out' or 'cancelled', with the reason in `message`, and with the best path if there
        is one.
    :raises StatementError: if the method is unknown, or what to accept.
    """
    name, begun = get_method(method or problem.method), time.monotonic()
    # Time for the certificate, and with state constraints for a path within them.
    kept = options.budget.certificate * time_limit
    if not problem.constrained:
        kept = min(kept, options.budget.least)
    meter = Meter(time_limit - kept, report, max_intervals, kept=kept)
    problem, programs = (cache or Cache(1)).prepared(problem, options)
    accepted = get_accepted(accept or problem.accept)
    best = BestPath(problem, meter, accepted, keep and (lambda path: keep(replace(
        mark_unfinished(path, accepted), attempts=meter.trace.attempts(),
        first_path_time=best.first))))
    if note is not None:
        meter.trace.watch(lambda: note(meter.trace.attempts()))
    task = Task(problem, programs, meter, time_limit, best)
    found = conclude(task, METHODS[name](task))
    built, took = programs.take_build_time(), time.monotonic() - begun
    first = best.first if best.path else took if found.feasible else math.nan
    return replace(found, method=found.method or name, iterations=meter.iterations,
                   attempts=meter.trace.attempts(), build_time=built, solve_time=took - built,
                   first_path_time=first)


def solve_automatically(task: Task) -> Solution:
    """Solve a problem: exact methods, proofs, then a search; its `method` tells which."""
    for exact in EXACT_METHODS:
        found = exact.attempt(task) if exact.affine == task.programs.affine else None
        if found and (found.status in (Status.SOLVED, Status.INFEASIBLE)
                      or exact.decides and not found.t.size):
            return found
        if found and task.best:
            task.best.take(task.problem, found)
    # Proofs take longer than to follow the path of a neighbour.
    if task.programs.neighbour(task.problem) is None:
        with task.meter.trace.attempt('proof', 'from the statement') as attempt:
            reason = explain(task.problem, trace=task.meter.trace)
            attempt.end(Verdict.PROVED if reason else Verdict.NOT_PROVED,
                        reason.sentence if reason else '')
        if reason:
            status = Status.INFEASIBLE if reason.infeasible else Status.NOT_CONVERGED
            return Solution(status, reason.sentence, method='arcs')
    if (L := find_constant_cost(task.problem)) is not None:
        return replace(_find_any_path(task, L), method='arcs')
    return replace(_search(task), method='arcs')


def _find_any_path(task: Task, L: float) -> Solution:
    """Return the path of minimum effort of a problem in which all paths have the same cost."""
    other = replace(task.problem, structure='', V=ca.SX(0), L=1 + measure_effort(task.problem))
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
            or not bench.stated.constrained or bench.programs.twin):
        return found
    meter = task.meter.overtime(options.least) if task.meter.stopped else task.meter.part()
    if meter.remaining() <= 0.0:
        return found
    bench = replace(bench, meter=meter, whole=meter, margin=record.margin)
    state = State(bench, record.outcome, best=bench.certify(record.outcome, record.extremal))
    best = try_improvements(DescentStage.VIOLATED, state).best or found
    return replace(best, solution=replace(
        best.solution, optimality=best.solution.optimality or found.solution.optimality))


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


# In the order in which `auto` tries them. A new one is a function of a problem and a line here.
EXACT_METHODS = (
    ExactMethod('riccati', True, True, (
        'linear quadratic problems with a fixed final time and no active bound'), solve_lq),
    ExactMethod('time_optimal', True, False, (
        'linear minimum-time problems with bounded inputs'), solve_time_optimal),
    ExactMethod('reeds_shepp', False, False, (
        'minimum-time motions of a two-wheeled robot whose shortest path ends at the prescribed '
        'angle'), solve_two_wheeled))
# A new method is a function of a Task and a line here.
METHODS: Mapping[str, Method] = {
    'auto': solve_automatically,
    **{exact.name: exact for exact in EXACT_METHODS},
    'transcription': partial(_search, with_arcs=False),
    'arcs': _search,
    'indirect': partial(_search, refine=refine_indirectly),
}
