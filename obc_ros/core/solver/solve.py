# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solution of an optimal control problem by the method for its structure, with certificate."""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import replace
import time

import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.method_names import AUTO, get_method
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Condition, MAX_INTERVALS, Report, Solution, Status, Verdict
from obc_ros.core.solver.descent import Search
from obc_ros.core.solver.diagnosis.explanation import explain, is_proved_infeasible
from obc_ros.core.solver.diagnosis.unboundedness import explain_larger_inputs
from obc_ros.core.solver.exact.time_optimal import solve_time_optimal
from obc_ros.core.solver.exact.two_wheeled import solve_two_wheeled
from obc_ros.core.solver.improve.indirect import refine_after_search, refine_indirectly
from obc_ros.core.solver.linear_quadratic import solve_lq
from obc_ros.core.solver.nlp.progress import BestPath, ProgressMonitor
from obc_ros.core.solver.program_cache import Kit
from obc_ros.core.solver.proofs.existence import (
    advise_bounds,
    explain_no_minimum,
    find_constant_cost,
    state_least_effort,
)
from obc_ros.core.solver.proofs.optimality import add_optimality
from obc_ros.core.solver.trace import judge_path

Method = Callable[[Problem, Kit, ProgressMonitor], Solution]

_FAULTS: Mapping[str, str] = {
    Condition.DYNAMICS: 'the states do not satisfy the dynamics',
    Condition.START: 'the path does not start at x(0)',
    Condition.END: 'the terminal constraints are not met',
    Condition.BOUNDS: 'a bound is violated',
    Condition.COSTATE: 'the costates do not satisfy the adjoint equation',
    Condition.MINIMUM: 'the input does not minimise the Hamiltonian',
    Condition.TRANSVERSALITY: 'the costates at T do not satisfy the transversality '
                              'condition',
    Condition.HAMILTONIAN: 'the Hamiltonian is not constant',
    Condition.FINAL_TIME: 'the Hamiltonian is not zero, as an optimal free final time requires',
    Condition.COST: 'the reported cost differs from that of the path',
}
_EXPLAINING = 400_000   # work (see `descent`) that a diagnosis may take
_ATTEMPT = 150_000      # work for each of the problems that it solves
_NO_PATH = 1e-2         # residual of the dynamics above which no mesh is fine enough
_LEAST = 0.5            # [s] of the time limit that must be left for a diagnosis
_JUDGING = 0.05, 0.5    # part of the time limit, at most [s], reserved for the certificate


class Cache:
    """The kits of the structures solved last, at most `size` of them."""

    def __init__(self, size: int = 32) -> None:
        self._size = size
        self._kits: OrderedDict[str, Kit] = OrderedDict()

    def prepared(self, problem: Problem) -> tuple[Problem, Kit]:
        """
        Return a problem in the symbols of the kit of its structure, and this kit.

        Parameters
        ----------
        problem : Problem
            Without a `structure` its kit is not kept.

        Returns
        -------
        problem : Problem
        kit : Kit

        """
        key = problem.structure
        kit = self._kits.pop(key, None) if key else None
        if kit is None:
            kit = Kit(problem)
        if key:
            self._kits[key] = kit
            if len(self._kits) > self._size:
                self._kits.popitem(last=False)
        return kit.restated(problem), kit


def _special(answer: Callable[[Problem], Solution | None], what: str) -> Method:
    """Return a method for special problems; `what` tells which ones, for the message."""
    def method(problem: Problem, kit: Kit, monitor: ProgressMonitor) -> Solution:
        return answer(problem) or Solution(Status.NOT_CONVERGED, (
            f'{what}; this problem is not one of them'))

    return method


def _transcription(problem: Problem, kit: Kit, monitor: ProgressMonitor) -> Solution:
    return Search(problem, kit, monitor, with_arcs=False).run()


def _arcs(problem: Problem, kit: Kit, monitor: ProgressMonitor) -> Solution:
    search = Search(problem, kit, monitor)
    answer = search.run()
    return answer if search.monitor.stopped else refine_after_search(search, answer)


def _indirect(problem: Problem, kit: Kit, monitor: ProgressMonitor) -> Solution:
    search = Search(problem, kit, monitor)
    answer = search.run()
    return answer if search.monitor.stopped else refine_indirectly(search, answer)


def _auto(problem: Problem, kit: Kit, monitor: ProgressMonitor) -> Solution:
    specials = ({'riccati': solve_lq, 'time_optimal': solve_time_optimal} if kit.affine else
                {'reeds_shepp': solve_two_wheeled})
    for name, special in specials.items():
        with monitor.trace.attempt('exact method', name) as attempt:
            found = special(problem)
            if found is None:
                attempt.end(Verdict.REJECTED, 'it does not apply')
                continue
            found = found if not found.t.size else _judged(problem, found)
            attempt.end(*judge_path(found), cost=found.objective)
        if found.status is Status.INFEASIBLE or name == 'riccati' and not found.t.size:
            return replace(found, method=name)
        if found.status is Status.SOLVED:
            return replace(found, method=name)
        if monitor.best:
            monitor.best.take(problem, found)
    if not kit.answers and explain_no_minimum(problem):
        return Solution(Status.NOT_CONVERGED, 'the cost has no minimum', method='arcs')
    if (L := find_constant_cost(problem)) is not None:
        return replace(_any_path(problem, L, monitor), method='arcs')
    search = _asking(problem, kit, monitor)
    answer = search.run()
    if not search.monitor.stopped:
        answer = refine_after_search(search, answer)
    return replace(answer, method='arcs')


def _any_path(problem: Problem, L: float, monitor: ProgressMonitor) -> Solution:
    """Return the path of minimum effort of a problem in which all paths have the same cost."""
    other = state_least_effort(problem)
    found = _asking(other, Kit(other), monitor).run()
    if not found.t.size:
        return found
    found = _without_multipliers(found, L)
    return replace(found, objective=L * found.t[-1] + float(problem.V), certificate=None)


def _asking(problem: Problem, kit: Kit, monitor: ProgressMonitor) -> Search:
    """Return a search that looks for a proof of infeasibility if its first starts lead nowhere."""
    def why_not(problem: Problem) -> str:
        with monitor.trace.attempt('proof', 'that no path exists', aside=True) as attempt:
            solvers = _explaining(monitor) if is_proved_infeasible(problem) else ()
            reason = explain(problem, *solvers)
            sentence = reason.sentence if reason and reason.infeasible else ''
            attempt.end(Verdict.PROVED if sentence else Verdict.NOT_PROVED, sentence)
        return sentence

    return Search(problem, kit, monitor, why_not=why_not)


def _explaining(monitor: ProgressMonitor) -> tuple[Callable[[Problem], Solution], ...]:
    """Return the quick and the thorough solver of `explain`, which share one budget of work."""
    part = monitor.part(_EXPLAINING)
    return _attempt(part), _attempt(part, quick=False)


def _attempt(monitor: ProgressMonitor, quick: bool = True) -> Callable[[Problem], Solution]:
    """
    Return a solver for the problems of a diagnosis.

    It also certifies the path at which its own budget of work ends.
    """
    def attempt(other: Problem) -> Solution:
        part = monitor.part(_ATTEMPT)
        begun = not part.stopped
        with monitor.trace.attempt('related problem', 'quick' if quick else 'thorough',
                                   aside=True) as entry:
            found = Search(other, Kit(other), part, quick=quick).run()
            entry.end(*judge_path(found), cost=found.objective)
        unjudged = begun and part.stopped == 'spent' and found.t.size and not found.certificate
        return replace(found, certificate=certify(other, found)) if unjudged else found

    return attempt


METHODS: dict[str, Method] = {
    'auto': _auto,
    'riccati': _special(solve_lq, (
        'riccati solves linear quadratic problems with a fixed final time and no active bound')),
    'time_optimal': _special(solve_time_optimal, (
        'time_optimal solves linear minimum-time problems with bounded inputs')),
    'reeds_shepp': _special(solve_two_wheeled, (
        'reeds_shepp solves minimum-time motions of a two-wheeled robot whose shortest path '
        'ends at the prescribed angle')),
    'transcription': _transcription,
    'arcs': _arcs,
    'indirect': _indirect,
}


def solve(problem: Problem, *, method: str = '', time_limit: float = 60.0,
          report: Report | None = None, cache: Cache | None = None,
          max_intervals: int = MAX_INTERVALS,
          keep: Callable[[Solution], None] | None = None) -> Solution:
    """
    Solve a problem and certify the solution.

    Parameters
    ----------
    problem : Problem
        A checked statement.
    method : str
        One of METHODS; that of the problem if left out.
    time_limit : float
        Limit of the wall-clock time [s].
    report : callable, optional
        Called as report(phase, iteration, cost, infeasibility); True cancels.
    cache : Cache, optional
        Keeps what is built for the structure, for later problems that have it.
    max_intervals : int, optional
        Maximum number of intervals of a mesh.
    keep : callable, optional
        Called with each path that is better than those before, with status 'not_converged'. Its
        message contains the cost and the condition that fails. For a caller that must return a
        path if this process is killed.

    Returns
    -------
    Solution
        'solved' only if every residual of the certificate is within its tolerance; 'infeasible'
        only if infeasibility is proved; otherwise 'not_converged', 'timed_out' or 'cancelled',
        with the reason in `message`, and with the best path if there is one.

    Raises
    ------
    StatementError
        If the method is unknown.

    """
    method = get_method(method or problem.method)
    begun = time.monotonic()
    part, most = _JUDGING
    monitor = ProgressMonitor(time_limit - min(part * time_limit, most), report, max_intervals)
    problem, kit = (cache or Cache(1)).prepared(problem)
    if keep is not None:
        monitor.best = BestPath(problem, lambda path: keep(_half_way(path)))
    found = METHODS[method](problem, kit, monitor)
    late = monitor.stopped and (monitor.stopped == 'cancelled' or not np.isfinite(found.objective))
    if found.status is not Status.INFEASIBLE and (found.certificate or not late):
        found = _judged(problem, found)
    sentence = explain_larger_inputs(problem, found, _attempt(monitor)) if (
        method == AUTO and found.method == 'arcs' and found.certified
        and find_constant_cost(problem) is None) else ''
    if sentence:
        found = _without_least(problem, found, sentence, monitor, time_limit)
    else:
        found = _ended(problem, found, monitor, time_limit, method)
    built, kit.build_time = kit.build_time, 0.0
    found = add_optimality(problem, found)
    return replace(found, method=found.method or method, iterations=monitor.iterations,
                   attempts=monitor.trace.attempts(), build_time=built,
                   solve_time=time.monotonic() - begun - built)


def _judged(problem: Problem, found: Solution) -> Solution:
    """Return a solution with its certificate and the status and message that follow from it."""
    if not found.t.size:
        return found
    certificate = found.certificate or certify(problem, found)
    if not certificate.holds and (L := find_constant_cost(problem)) is not None:
        found = _without_multipliers(found, L)
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
    worst = certificate.worst
    fault = (f'{_FAULTS[worst]}: residual {certificate.residuals[worst]:.1e}, '
             f'allowed {certificate.tolerances[worst]:.0e}')
    if not certificate.feasible:
        return fault
    return f'cost {found.objective:.8g}, not certified because {fault}'


def _half_way(path: Solution) -> Solution:
    """Return an intermediate path as not converged, with the reason in words."""
    words = (f'cost {path.objective:.8g}, the certificate passes, but the search for a path of '
             'lower cost was not finished' if path.certified else _uncertified(path))
    return replace(path, status=Status.NOT_CONVERGED, message=words, optimality=None)


def _without_least(problem: Problem, found: Solution, sentence: str, monitor: ProgressMonitor,
                   time_limit: float) -> Solution:
    """Return a solution without its certificate, since larger inputs may lower the cost."""
    none = Solution(Status.NOT_CONVERGED, sentence, method=found.method)
    ended = _ended(problem, none, monitor, time_limit, AUTO)
    if ended.status is Status.INFEASIBLE:
        return ended
    return replace(found, status=ended.status, certificate=None, message=(
        f'{ended.message}; cost {found.objective:.8g}, not certified because larger inputs may '
        'cost less'))


def _without_multipliers(found: Solution, L: float) -> Solution:
    """Return a path with zero costates and multipliers, as if every path has the same cost."""
    return replace(
        found, lam=0.0 * found.lam, nu=0.0 * found.nu, hamiltonian=np.full(len(found.t), L),
        state_multipliers=None, path_multipliers=None)


def _ended(problem: Problem, found: Solution, monitor: ProgressMonitor, time_limit: float,
           method: str) -> Solution:
    """Return a solution with its final status, and with the reason if it is not certified."""
    path = f'; {_uncertified(found)}' if found.t.size and not found.certified else ''
    if monitor.stopped == 'cancelled':
        return replace(found, status=Status.CANCELLED, message=f'cancelled on request{path}')
    if found.status in (Status.SOLVED, Status.INFEASIBLE):
        return found
    if monitor.stopped == 'timed_out':
        advice = advise_bounds(problem)
        return replace(found, status=Status.TIMED_OUT, message=(
            f'no certified solution within {time_limit:g} s{path}{advice and "; "}{advice}'))
    if method in ('riccati', 'time_optimal') or found.method == 'riccati':
        return found
    if monitor.short:
        found = replace(found, message=(
            f'{found.message}; a mesh with more than max_intervals = {monitor.max_intervals} was '
            'needed'))
    return _explained(problem, found, monitor)


def _explained(problem: Problem, found: Solution, monitor: ProgressMonitor) -> Solution:
    """Return a solution with the reason why none was certified, if one is found."""
    if monitor.remaining() < _LEAST:
        return found
    with monitor.trace.attempt('explanation', aside=True) as attempt:
        reason = explain(problem, *_explaining(monitor), found=found)
        proved = reason is not None and reason.infeasible
        attempt.end(Verdict.PROVED if proved else Verdict.NOT_PROVED,
                    reason.sentence if reason else '')
    if reason is None or monitor.stopped == 'cancelled':
        sentence = found.message
        if found.certificate and found.certificate.residuals[Condition.DYNAMICS] > _NO_PATH:
            sentence = ('no path was found that satisfies all constraints; in the nearest one '
                        f'{sentence}')
        return replace(found, message='; '.join(filter(None, (sentence, advise_bounds(problem)))))
    if not reason.infeasible:
        is_path = found.certificate is not None and found.certificate.feasible
        return replace(found, message='; '.join(
            [reason.sentence, *([_uncertified(found)] if is_path else [])]))
    return Solution(Status.INFEASIBLE, reason.sentence)
