# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The verdict on what a method has found: certificate, status, and the reason in words."""

from collections.abc import Callable, Iterator
from dataclasses import replace
import math

import casadi as ca
import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.method_names import CERTIFIED
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Certificate, Condition, Solution, Status, Verdict
from obc_ros.core.ocp.wording import format_number
from obc_ros.core.solver.bench import Task
from obc_ros.core.solver.diagnosis.explanation import explain, judge_reason
from obc_ros.core.solver.diagnosis.unboundedness import explain_larger_inputs
from obc_ros.core.solver.proofs.contradictions import explain_contradiction
from obc_ros.core.solver.proofs.existence import advise_bounds, find_constant_cost
from obc_ros.core.solver.proofs.optimality import add_optimality
from obc_ros.core.solver.search import search
from obc_ros.core.solver.trace import describe_fault, judge_path


def conclude(task: Task, found: Solution) -> Solution:
    """
    Return what a method has found with its certificate, status and message.

    If the trace shows a search, the cost may fall without end as inputs grow, so that an extremal
    is no minimum; and the reason is looked for if the result is not certified.
    """
    problem, meter = task.problem, task.meter
    if meter.stopped or task.accepts_paths:
        found = _choose_best(task, found)
        meter.resume()
    late = meter.stopped and (meter.stopped == 'cancelled' or not np.isfinite(found.objective))
    if found.status is not Status.INFEASIBLE and (found.certificate or not late):
        found = certify_solution(problem, found)
    sentence = explain_larger_inputs(problem, found, _solver_of_related(task)) if (
        meter.trace.searched and found.certified and find_constant_cost(problem) is None) else ''
    found = _without_least(task, found, sentence) if sentence else _ended(task, found)
    found = add_optimality(problem, found)
    remark = find_remark(problem, found) if found.status is Status.SOLVED else ''
    return replace(found, remark=remark, message=f'{found.message}; {remark}') if remark else found


def certify_solution(problem: Problem, found: Solution) -> Solution:
    """
    Return a solution with its certificate and the status and message that follow from it.

    Without a path it is returned as it is.
    """
    if not found.t.size:
        return found
    certificate = found.certificate or certify(problem, found)
    if not certificate.holds and (L := find_constant_cost(problem)) is not None:
        found = drop_multipliers(found, L)
        certificate = certify(problem, found)
    if certificate.holds:
        message = found.message or 'the certificate passes'
        return replace(found, status=Status.SOLVED, message=message, certificate=certificate)
    found = replace(found, status=Status.NOT_CONVERGED, certificate=certificate)
    return replace(found, message=_uncertified(found))


def _uncertified(found: Solution) -> str:
    """Return the condition that fails in words, of a feasible path with its cost."""
    certificate = found.certificate
    if certificate is None:
        return (f'cost {found.objective:.8g}, not certified because its certificate was not '
                'computed')
    fault = describe_fault(certificate)
    if not certificate.feasible:
        return fault
    return (f'cost {found.objective:.8g}, not certified because {fault}; '
            f'{_describe_path(certificate)}')


def _describe_path(certificate: Certificate) -> str:
    """Return in words how well a feasible path meets the constraints, and the excess cost."""
    words = ('the path meets all constraints (nearest to its tolerance: '
             f'{certificate.largest_violation})')
    if math.isnan(certificate.excess):
        return words
    return (f'{words}; its cost is above that of the nearest local minimum by about '
            f'{certificate.excess:.2g} (estimate)')


def mark_unfinished(path: Solution, accept: str = CERTIFIED) -> Solution:
    """Return an intermediate path as not converged or feasible, with the reason in words."""
    accepted = accept != CERTIFIED and path.feasible
    if path.certified:
        words = (f'cost {path.objective:.8g}, the certificate passes, but the search for a path '
                 'of lower cost was not finished')
        status = Status.FEASIBLE if accepted else Status.NOT_CONVERGED
        return replace(path, status=status, message=words, optimality=None)
    if accepted and path.certificate:
        return _mark_feasible(path, path.certificate)
    return replace(path, status=Status.NOT_CONVERGED, message=_uncertified(path), optimality=None)


def _mark_feasible(path: Solution, certificate: Certificate) -> Solution:
    """Return a path that meets all constraints as such, with what is not shown in words."""
    unmet = certificate.unmet
    verb = 'does' if len(unmet) == 1 else 'do'
    words = (f'cost {path.objective:.8g}, no certificate of optimality: {", ".join(unmet)} {verb} '
             f'not hold; {_describe_path(certificate)}')
    return replace(path, status=Status.FEASIBLE, optimality=None, certificate=certificate,
                   message=words)


def _choose_best(task: Task, found: Solution) -> Solution:
    """Return the best feasible path of a search, or what it has ended with if that is better."""
    best = task.best.path if task.best else None
    if best is None or found.certified or found.status is Status.INFEASIBLE or (
            found.feasible and found.objective <= best.objective):
        return found
    return replace(best, method=found.method, optimality=found.optimality)


def _without_least(task: Task, found: Solution, sentence: str) -> Solution:
    """Return a solution without its certificate, since larger inputs may lower the cost."""
    if task.accepts_paths and found.certificate and task.meter.stopped != 'cancelled':
        # How much less another input costs is not known.
        found = _mark_feasible(found, replace(found.certificate, excess=math.nan, residuals={
            **found.certificate.residuals, Condition.MINIMUM: math.inf}))
        return replace(found, message=f'{sentence}; {found.message}')
    none = Solution(Status.NOT_CONVERGED, sentence, method=found.method)
    ended = _ended(task, none)
    if ended.status is Status.INFEASIBLE:
        return ended
    return replace(found, status=ended.status, certificate=None, message=(
        f'{ended.message}; cost {found.objective:.8g}, not certified because larger inputs may '
        'cost less'))


def drop_multipliers(found: Solution, L: float) -> Solution:
    """Return a path with zero costates and multipliers, as if every path has the same cost."""
    return replace(
        found, lam=0.0 * found.lam, nu=0.0 * found.nu, hamiltonian=np.full(len(found.t), L),
        state_multipliers=None, path_multipliers=None)


def _ended(task: Task, found: Solution) -> Solution:
    """Return a solution with its final status, and with the reason if it is not certified."""
    problem, meter, time_limit = task.problem, task.meter, task.time_limit
    path = f'; {_uncertified(found)}' if found.t.size and not found.certified else ''
    if meter.stopped == 'cancelled':
        return replace(found, status=Status.CANCELLED, message=f'cancelled on request{path}')
    if found.status in (Status.SOLVED, Status.INFEASIBLE):
        return found
    if task.accepts_paths and found.certificate and found.feasible:
        known = meter.trace.find_verdict('contradiction')
        if not known and (reason := explain_contradiction(problem)):
            return Solution(Status.INFEASIBLE, reason)
        return _mark_feasible(found, found.certificate)
    if meter.stopped == 'timed_out':
        advice = advise_bounds(problem)
        return replace(found, status=Status.TIMED_OUT, message=(
            '; '.join(filter(None, (f'no certified solution within {time_limit:g} s{path}',
                                    meter.trace.describe_effort(), advice)))))
    if not meter.trace.searched:
        return found
    if meter.trace.mesh_refused:
        found = replace(found, message=(
            f'{found.message}; a mesh with more than max_intervals = {meter.max_intervals} was '
            'needed'))
    return _explained(task, found)


def _explained(task: Task, found: Solution) -> Solution:
    """Return a solution with the reason why none was certified, if one is found."""
    options = task.options.budget
    problem, meter = task.problem, task.meter
    if meter.remaining() < options.least:
        return found
    with meter.trace.attempt('explanation', aside=True) as attempt:
        reason = explain(problem, *_explaining(task), found=found, trace=meter.trace,
                         remaining=meter.remaining)
        attempt.end(*judge_reason(reason))
    if reason is None or meter.stopped == 'cancelled':
        sentence = found.message
        # With a larger residual no mesh is fine enough.
        if found.certificate and (
                1e-2 < found.certificate.residuals[Condition.DYNAMICS] < math.inf):
            sentence = ('no path was found that satisfies all constraints; in the nearest one '
                        f'{sentence}')
        return replace(found, message='; '.join(filter(None, (
            sentence, meter.trace.describe_effort(), advise_bounds(problem)))))
    if reason.solution is not None:
        return certify_solution(problem, replace(reason.solution, method=found.method))
    if not reason.infeasible:
        return replace(found, message='; '.join(
            [reason.sentence, *([_uncertified(found)] if found.feasible else [])]))
    return Solution(Status.INFEASIBLE, reason.sentence)


def look_for_proof(task: Task) -> Callable[[Problem], str]:
    """
    Return the function that a search calls when its first starts lead nowhere.

    It returns a proof of infeasibility in words, or ''. It may take a part of the work of the
    task, and of the time that which descents in vain may not take.
    """
    def why_not(problem: Problem) -> str:
        with task.meter.trace.attempt('proof', 'that no path exists', aside=True) as attempt:
            reason = explain(
                problem, *_explaining(task), trace=task.meter.trace, proofs=True,
                remaining=lambda: (1 - task.options.budget.share) * task.meter.remaining())
            sentence = reason.sentence if reason and reason.infeasible else ''
            attempt.end(Verdict.PROVED if sentence else Verdict.NOT_PROVED, sentence)
        return sentence

    return why_not


def _explaining(task: Task) -> tuple[Callable[[Problem], Solution], ...]:
    """Return the quick and the thorough solver of `explain`, which share one budget of work."""
    options = task.options.budget
    task = replace(task, meter=task.meter.part(options.explanation))
    return _solver_of_related(task), _solver_of_related(task, quick=False)


def _solver_of_related(task: Task, quick: bool = True) -> Callable[[Problem], Solution]:
    """
    Return a solver for the problems of a diagnosis.

    It also certifies the path at which its own budget of work ends.
    """
    options = task.options.budget
    def solve_related(other: Problem) -> Solution:
        part = task.meter.part(options.related)
        begun = not part.stopped
        with part.trace.attempt('related problem', 'quick' if quick else 'thorough',
                                aside=True) as entry:
            found = search(task.restate(other, part), quick=quick)[0].solution
            entry.end(*judge_path(found), cost=found.objective)
        unjudged = begun and part.stopped == 'spent' and found.t.size and not found.certificate
        return replace(found, certificate=certify(other, found)) if unjudged else found

    return solve_related


def find_remark(problem: Problem, found: Solution) -> str:
    """
    Return what decided a certified answer, if that was a bound of the search or a missing part.

    A bound of T, of a duration or of a free parameter often only limits the search, and a part of
    the statement may be missing. The certificate holds all the same: the answer is that of the
    statement.
    """
    return '; '.join([*_remark_decision(problem, found), *_remark_unused(problem)])


def _remark_decision(problem: Problem, found: Solution) -> Iterator[str]:
    """Yield what decided an answer in place of the cost, at most one sentence."""
    if find_constant_cost(problem) is not None:
        yield (f'all paths cost {format_number(found.objective)}: the cost depends on neither '
               'states nor inputs, so that this path is one of many')
        return
    bounds = [*_list_bounds(problem, found), *_list_starts(problem, found)]
    if bounds:
        decides = 'this bound decides' if len(bounds) == 1 else 'these bounds decide'
        yield ', and '.join([f'{" and ".join(bounds)}: {decides} the answer',
                             *_list_missing(problem)])
    elif not (problem.q or problem.constrained or ca.depends_on(
            ca.vertcat(problem.L, problem.V), problem.x)):
        yield ('nothing is asked of the states: none is in the cost or in a constraint, so that '
               'the inputs only minimise the running cost')


def _remark_unused(problem: Problem) -> Iterator[str]:
    """Yield which inputs change nothing."""
    names = [name for name, u in zip(problem.inputs, ca.vertsplit(problem.u), strict=True)
             if not ca.depends_on(ca.vertcat(problem.f, problem.L, problem.path), u)]
    if names and problem.phases is None and not problem.held:
        inputs, has = (f'the input {names[0]} occurs', 'its values are') if len(names) == 1 else (
            f'the inputs {", ".join(names)} occur', 'their values are')
        yield f'{inputs} in neither dynamics, cost nor constraints: {has} arbitrary'


def _list_bounds(problem: Problem, found: Solution) -> Iterator[str]:
    """Yield the bounds at which T and the free parameters are."""
    final, T = problem.final_time, float(found.t[-1])
    for side, bound in (('lower', final.lower), ('upper', final.upper)):
        # As in the certificate.
        if final.free and final.lower < final.upper and abs(T - bound) <= 1e-9 * bound:
            yield f'T = {format_number(bound)} s is the {side} bound of final_time'
    lower, upper = problem.start_box
    for name in problem.free_parameters:
        k = problem.states.index(name)
        for side, bound in (('lower', lower[k]), ('upper', upper[k])):
            if lower[k] < upper[k] and _is_at(found.x[0, k], bound, lower[k], upper[k]):
                yield f'{name} = {format_number(bound)} is its {side} bound'


def _list_starts(problem: Problem, found: Solution) -> Iterator[str]:
    """Yield bounds of x(0) that a path begins at, and beyond which it would cost less."""
    if problem.start is None or problem.phases is not None or not found.lam.size:
        return
    slope = found.lam[0].copy()   # of the cost by x(0)
    for k, other in problem.start.linked:
        slope[k] += found.lam[0, other]
    lower, upper = problem.start_box
    for k, name in enumerate(problem.states[:problem.stated]):
        for side, bound, sign in (('lower', lower[k], 1.0), ('upper', upper[k], -1.0)):
            if lower[k] < upper[k] and _is_at(found.x[0, k], bound, lower[k], upper[k]) and (
                    sign * slope[k] > 1e-6 * np.abs(found.lam).max()):
                yield f'{name}(0) = {format_number(bound)} is the {side} bound of initial_state'


def _is_at(value: float, bound: float, lower: float, upper: float) -> bool:
    return math.isfinite(bound) and abs(value - bound) <= 1e-6 * min(
        upper - lower, max(1.0, abs(bound)))


def _list_missing(problem: Problem) -> Iterator[str]:
    """Yield the parts of a statement without which only a bound ends the search."""
    if not problem.q and not ca.depends_on(problem.V, problem.x):
        yield 'there is neither a terminal constraint nor a terminal cost'
    names = [name for name, u, boxed in zip(
        problem.inputs, ca.vertsplit(problem.u), problem.boxed, strict=True)
        if not (boxed or ca.depends_on(ca.vertcat(problem.L, problem.path), u))]
    if names:
        yield f'neither input_bounds nor the cost limit {", ".join(names)}'
