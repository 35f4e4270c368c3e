# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Explanation of why a problem has no solution, with numbers, in the names of its statement.

The checks are records in CHECKS; a new one is a function and a line. They are tried in turn, each
in the situations for which it is meant, until one finds a reason. Those that examine the statement
come first, unless the trace shows that they were tried. Then related problems are solved:

elastic       Minimise the violation of the terminal constraints; then again without one state
              bound, path constraint or input bound at a time, to find the bound that is to blame.
soft          Minimise the violation of state bounds and path constraints: which one is violated,
              when, and by how much.
minimum time  L = 1, T free: whether the available time is too short.
sparing       Maximise the final value of a state that never increases: whether enough is left.
relaxed       Mixtures of two inputs: whether minimising sequences chatter.
boxed         |u| <= 10, 100, 1000: whether the cost decreases without limit.

A problem is called infeasible only if that is proved: by `contradictions`, or, if dynamics and
constraints are affine, T is given and inputs are bounded, by weak duality (`weak_duality`). The
sentences about searches say that nothing was proved, because a search may end at a local minimum.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
import math

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import FinalTime, Problem
from obc_ros.core.ocp.solution import Condition, Solution, Status, Verdict
from obc_ros.core.ocp.structure import has_convex_paths
from obc_ros.core.ocp.wording import format_number, state_bound
from obc_ros.core.solver.diagnosis.feasibility import (
    describe_broken_bound,
    describe_shortfall,
    FEASIBLE,
    find_blocking_bound,
    is_path,
    reaches_end,
    relax_path_constraints,
    relax_terminal,
    Solver,
)
from obc_ros.core.solver.diagnosis.finite_arcs import attain_by_arcs
from obc_ros.core.solver.diagnosis.monotone_resources import explain_shortage
from obc_ros.core.solver.diagnosis.relaxed_controls import (
    explain_chattering,
    relax_controls,
    split_mixture,
)
from obc_ros.core.solver.diagnosis.unboundedness import explain_unbounded
from obc_ros.core.solver.exact.weak_duality import is_excluded
from obc_ros.core.solver.proofs.contradictions import explain_contradiction
from obc_ros.core.solver.proofs.existence import explain_no_minimum
from obc_ros.core.solver.proofs.singular_expressions import (
    explain_escape,
    explain_kink,
    explain_level_terminal,
    explain_steep_root,
    explain_undefined,
)
from obc_ros.core.solver.trace import Trace

# Residuals of a certificate up to which a path nearly satisfies the constraints; with rough steps.
_NEARLY = FEASIBLE | {Condition.START: 1e-3, Condition.END: 1e-3, Condition.BOUNDS: 1e-3}
_ROUGHLY = _NEARLY | {Condition.DYNAMICS: 1e-2}
# Residuals of Pontryagin's conditions up to which a path of a convex problem is nearly optimal.
_OPTIMAL = dict.fromkeys((Condition.COSTATE, Condition.MINIMUM, Condition.TRANSVERSALITY,
                          Condition.HAMILTONIAN), 0.1)
_CONSTRAINTS = {Condition.START, Condition.END, Condition.BOUNDS}
_UNPROVED = 'infeasibility has not been proved'
_WEAK_DUALITY = 'weak duality'
_EXCLUDED = ('the bounds and constraints exclude each other: a combination of them is negative on '
             'every path (weak duality)')


@dataclass(frozen=True)
class Reason:
    """A sentence, whether infeasibility is proved, and a certified path if one was found."""

    infeasible: bool
    sentence: str
    solution: Solution | None = None


class Situation(StrEnum):
    """When a check is tried."""

    STATED = 'before a search'
    FOUND = 'a search has found samples'
    ARRIVED = 'the samples meet the constraints'
    PATH = 'the samples are a path'
    KEPT = 'the path meets all constraints, or there are none'
    UNHELD = 'no path within the state constraints was found'
    REACHED = 'a related problem has a path that meets all constraints'
    MISSED = 'all paths miss the terminal constraints'


class Unsolved:
    """A problem without a solution, and what was found; the parameters are those of `explain`."""

    def __init__(self, problem: Problem, solve: Solver, thorough: Solver, found: Solution | None,
                 trace: Trace, remaining: Callable[[], float]) -> None:
        self.problem, self.solve, self.thorough = problem, solve, thorough
        self.found, self._trace, self._remaining = found, trace, remaining
        self.lost = found is None or not is_path(found)   # no path within the bounds
        self.convex = has_convex_paths(problem)

    @cached_property
    def excluded(self) -> bool:
        """Whether weak duality proves that no path satisfies all constraints."""
        if not self.convex:
            return False
        verdict = self._trace.find_verdict(_WEAK_DUALITY)
        if verdict is None:
            with self._trace.attempt(_WEAK_DUALITY) as attempt:
                proved = is_excluded(self.problem, self._remaining())
                verdict = Verdict.PROVED if proved else Verdict.NOT_PROVED
                attempt.end(verdict)
        return verdict is Verdict.PROVED

    @cached_property
    def nearest(self) -> Solution:
        """The path within the state constraints that ends nearest to the terminal ones."""
        return self.best(relax_terminal(self.problem))

    @cached_property
    def missed(self) -> str:
        """By how much the nearest path misses the terminal constraints, '' if it meets them."""
        return describe_shortfall(self.problem, self.nearest)

    @cached_property
    def outcome(self) -> Situation | None:
        """How the searches ended; None if the path found is nearer than `nearest`."""
        problem, found = self.problem, self.found
        kept = found is not None and not self.lost and not describe_shortfall(problem, found)
        if kept or problem.q == 0 and not problem.constrained:
            return Situation.KEPT
        if not self.keeps(self.nearest):
            return Situation.UNHELD
        if not self.missed:
            return Situation.REACHED
        nearer = found is not None and found.meets(_NEARLY) and not (
            describe_shortfall(problem, found) or self.excluded)
        return None if nearer else Situation.MISSED

    def is_in(self, situation: Situation) -> bool:
        """Return whether a situation is given; to decide that, related problems may be solved."""
        if situation is Situation.STATED:
            return True
        if situation is Situation.FOUND:
            return self.found is not None
        if situation is Situation.ARRIVED:
            certificate = None if self.found is None else self.found.certificate
            return certificate is not None and not _CONSTRAINTS & set(certificate.faults)
        if situation is Situation.PATH:
            return not self.lost
        return situation is self.outcome

    def contradicts(self) -> Reason | None:
        """Return which parts of the statement provably exclude each other."""
        sentence = explain_contradiction(self.problem)
        return Reason(True, sentence) if sentence else None

    def look(self, explain_path: Callable[[Problem, Array, Array, Array], str]) -> str:
        """Return what the samples of the path found show."""
        found = self.found
        return '' if found is None else explain_path(self.problem, found.t, found.x, found.u)

    def best(self, other: Problem) -> Solution:
        """Return a path of another problem; of a convex problem a nearly optimal one."""
        answer = self.solve(other)
        if not self.keeps(answer) or self.convex and not answer.meets(_OPTIMAL):
            answer = self.thorough(other)
        return answer

    def keeps(self, answer: Solution) -> bool:
        """
        Return whether a solution is a path; in a convex problem bounds may be violated slightly.

        What is infeasible within wider bounds is infeasible within narrower ones.
        """
        return is_path(answer, wide=1e-2) if self.convex else is_path(answer)

    def certified(self, other: Problem) -> Solution:
        """Return a solution; if it is not certified, the one of the thorough solver."""
        answer = self.solve(other)
        return answer if answer.certified else self.thorough(other)

    def mixed(self) -> Reason | None:
        """Return that minimising sequences chatter, or a path of few arcs that attains as much."""
        found = self.found
        other = relax_controls(self.problem, found) if found is not None and found.t.size else None
        # A path that slightly violates bounds is good enough for mixtures of an input's bounds.
        if found is None or other is None or self.lost and other.m > self.problem.m:
            return None
        answer = self.thorough(other)
        sentence = answer.certified and explain_chattering(self.problem, other, answer, found)
        mixture = split_mixture(self.problem, other, answer) if sentence else None
        if not sentence or mixture is None:
            return None
        with self._trace.attempt('arcs of a mixture') as attempt:
            path = attain_by_arcs(self.problem, answer, mixture)
            attempt.end(Verdict.CERTIFIED if path else Verdict.REJECTED,
                        '' if path else 'no number of arcs attains the relaxed minimum',
                        cost=path.objective if path else np.nan)
        return Reason(False, sentence, path)

    def without_end(self) -> str:
        """Return that the cost decreases without limit or that states diverge, if they do."""
        found = None if self.lost else self.found
        sentence = explain_unbounded(self.problem, self.certified, found)
        if not sentence and self.lost and self.problem.start is None:
            sentence = explain_escape(self.problem, self.problem.final_time.latest)
        return sentence

    def too_short(self) -> Reason | str:
        """Return that the terminal constraints can be met at a later T, if they can."""
        problem, last = self.problem, self.problem.final_time.latest
        guess = FinalTime(free=True, lower=1e-3 * last, upper=50 * last, guess=2 * last)
        later = replace(problem, L=ca.SX(1), V=ca.SX(0), final_time=guess, structure='')
        answer = self.solve(later)
        if not is_path(answer) and answer.meets(_ROUGHLY):
            answer = self.thorough(later)
        if not is_path(answer) or describe_shortfall(problem, answer):
            return ''
        early = answer.t[-1] <= last * (1 + 1e-6)
        if not early and not self.convex:
            answer = self.thorough(later)
            early = not is_path(answer) or answer.t[-1] <= last * (1 + 1e-6)
        if early and not self.convex and not problem.final_time.free and (
                reaches_end(problem, answer)):
            return (f'no path was found that meets the terminal constraints at T = {last:.6g}; '
                    f'a path meets them at T = {answer.t[-1]:.4g}')
        if early:
            return ''
        least = float(answer.t[-1])
        found = format_number(least) if answer.certified else f'about {least:.3g}'
        if self.excluded:
            return Reason(True, f'the terminal constraints cannot be met by T = {last:.6g}: the '
                                f'minimum time is {found}')
        return (f'no path was found that meets the terminal constraints by T = {last:.6g}: the '
                f'fastest path found takes {found}; {_UNPROVED}')

    def too_little(self) -> Reason | str:
        """Return that the terminal constraints use up more of a monotone state than is allowed."""
        sentence = explain_shortage(self.problem, self.thorough) if self.problem.q else ''
        if sentence and self.excluded:
            return Reason(True, sentence)
        return sentence and (
            f'no path was found that satisfies all constraints: {sentence}; {_UNPROVED}')

    def missing(self) -> Reason:
        """Return by how much the terminal constraints are missed, and because of which bound."""
        by, missed = f'by T = {self.problem.final_time.latest:.6g}', self.missed
        blamed = find_blocking_bound(self.problem, self.solve)
        if blamed and self.excluded:
            name, without = blamed
            return Reason(True, (
                f'{name} and the terminal constraints exclude each other {by}: with '
                f'this bound the closest path found ends with {missed}; without it {without}'))
        more = f'; without {blamed[0]} {blamed[1]}' if blamed else ''
        what = 'no path meets' if self.excluded else 'no path was found that meets'
        doubt = '' if self.excluded else f'; {_UNPROVED}'
        return Reason(self.excluded, (
            f'{by} {what} the terminal constraints: the closest path found ends with '
            f'{missed}{more}{doubt}'))

    def not_held(self) -> Reason | str:
        """Return which state bound or path constraint cannot be satisfied."""
        answer = self.best(relax_path_constraints(self.problem))
        found = describe_broken_bound(self.problem, answer)
        if not found:
            return ''
        name, how = found
        return Reason(True, f'{name} cannot be satisfied: {how}') if self.excluded else (
            f'no path was found that satisfies {name}: {how}; {_UNPROVED}')

    def leapt(self) -> str:
        """Return that a path satisfies bounds at mesh points only: it jumps over an obstacle."""
        certificate = self.nearest.certificate
        if certificate is None or certificate.fault != Condition.BOUNDS:
            return ''
        names = [state_bound(self.problem, i, upper) for upper, bounds in (
            (False, self.problem.x_lower), (True, self.problem.x_upper))
            for i in map(int, np.flatnonzero(np.isfinite(bounds)))]
        names += [f'path_constraints[{row}]' for row in range(self.problem.path.numel())]
        return ('no path was found that meets the terminal constraints and satisfies '
                f'{" and ".join(names)} at all times: the closest path found violates a bound '
                f'between mesh points by {certificate.residuals[Condition.BOUNDS]:.1g} of its '
                'size')


@dataclass(frozen=True)
class Check:
    """
    A reason why a problem may have no solution.

    :ivar name: as users see it in the trace, unique.
    :ivar when: when it is tried.
    :ivar run: returns the reason, a sentence if it is not proved; None or '' if it is another one.
    """

    name: str
    when: tuple[Situation, ...]
    run: Callable[[Unsolved], Reason | str | None]


CHECKS = (
    Check('contradiction', (Situation.STATED,), Unsolved.contradicts),
    Check('no minimum', (Situation.STATED,), lambda case: explain_no_minimum(case.problem)),
    Check('undefined expression', (Situation.FOUND,), lambda case: case.look(explain_undefined)),
    Check('kink of an expression', (Situation.ARRIVED,),
          lambda case: case.look(explain_kink) or case.look(explain_steep_root)),
    Check('level terminal constraint', (Situation.PATH,), lambda case: case.look(
        lambda problem, t, x, u: explain_level_terminal(problem, x[-1]))),
    Check('state constraint', (Situation.UNHELD,), Unsolved.not_held),
    Check('minimum time', (Situation.UNHELD, Situation.MISSED), Unsolved.too_short),
    Check('monotone resource', (Situation.UNHELD, Situation.MISSED), Unsolved.too_little),
    Check('chattering', (Situation.KEPT, Situation.REACHED), Unsolved.mixed),
    Check('unbounded cost', (Situation.KEPT, Situation.REACHED, Situation.UNHELD),
          Unsolved.without_end),
    Check('obstacle between mesh points', (Situation.UNHELD,), Unsolved.leapt),
    Check('blocking bound', (Situation.MISSED,), Unsolved.missing))


def explain(problem: Problem, solve: Solver | None = None, thorough: Solver | None = None, *,
            found: Solution | None = None, trace: Trace | None = None,
            remaining: Callable[[], float] = lambda: math.inf,
            proofs: bool = False) -> Reason | None:
    """
    Return why a problem has no solution.

    :param solve: returns a Solution of a problem with its certificate, whether or not the
        certificate passes; observes the time limit. Without it only the statement is examined.
    :param thorough: does the same with more work: several initial guesses, until the certificate
        passes.
    :param found: the best path found for the problem.
    :param trace: what was tried for the problem; the checks are added.
    :param remaining: returns the time left [s].
    :param proofs: solve related problems only if infeasibility is proved.
    :return: None if no reason was found.
    """
    trace = trace or Trace()
    solve_ = solve or (lambda _: Solution(Status.NOT_CONVERGED, 'no related problem is solved'))
    case = Unsolved(problem, solve_, thorough or solve_, found, trace, remaining)
    stated = [check for check in CHECKS if Situation.STATED in check.when]
    reason = _try(case, trace, (
        check for check in stated if trace.find_verdict(check.name) is None))
    if reason or solve is None or proofs and not case.excluded:
        return reason
    reason = _try(case, trace, (check for check in CHECKS if check not in stated))
    if (reason is None or not reason.infeasible) and case.excluded:
        return Reason(True, _EXCLUDED)   # no related problem shows which constraint is to blame
    return reason


def _try(case: Unsolved, trace: Trace, checks: Iterable[Check]) -> Reason | None:
    """Return the first reason that a check finds."""
    for check in checks:
        if any(case.is_in(situation) for situation in check.when):
            with trace.attempt(check.name) as attempt:
                found = check.run(case) or None
                reason = Reason(False, found) if isinstance(found, str) else found
                attempt.end(*judge_reason(reason))
            if reason:
                return reason
    return None


def judge_reason(reason: Reason | None) -> tuple[Verdict, str]:
    """Return the verdict on the search for a reason, and the reason in words."""
    proved = reason is not None and reason.infeasible
    return Verdict.PROVED if proved else Verdict.NOT_PROVED, reason.sentence if reason else ''
