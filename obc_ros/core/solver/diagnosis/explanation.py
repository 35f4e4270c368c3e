# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Explanation of why a problem has no solution, with numbers, in the names of its statement.

The proofs of `contradictions` and `existence` come first. Then related problems are solved:

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

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from obc_ros.core.ocp.nonconvexity import has_convex_paths
from obc_ros.core.ocp.problem import FinalTime, Problem
from obc_ros.core.ocp.solution import Condition, Solution
from obc_ros.core.ocp.wording import format_number, state_bound
from obc_ros.core.solver.diagnosis.feasibility import (
    describe_broken_bound,
    describe_shortfall,
    FEASIBLE,
    find_blocking_bound,
    is_path,
    relax_path_constraints,
    relax_terminal,
    Solver,
)
from obc_ros.core.solver.diagnosis.forward_check import reaches_end
from obc_ros.core.solver.diagnosis.monotone_resources import explain_shortage
from obc_ros.core.solver.diagnosis.relaxed_controls import explain_chattering, relax_controls
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

# Residuals of a certificate up to which a path nearly satisfies the constraints; with rough steps.
_NEARLY = FEASIBLE | {Condition.START: 1e-3, Condition.END: 1e-3, Condition.BOUNDS: 1e-3}
_ROUGHLY = _NEARLY | {Condition.DYNAMICS: 1e-2}
_WIDE = 1e-2        # violation of bounds allowed for a path of a convex problem
# Residuals of Pontryagin's conditions up to which a path of a convex problem is nearly optimal.
_OPTIMAL = dict.fromkeys((Condition.COSTATE, Condition.MINIMUM, Condition.TRANSVERSALITY,
                          Condition.HAMILTONIAN), 0.1)
_LATER = 50.0       # times T up to which a minimum time is looked for
_UNPROVED = 'infeasibility has not been proved'
_EXCLUDED = ('the bounds and constraints exclude each other: a combination of them is negative on '
             'every path (weak duality)')


@dataclass(frozen=True)
class Reason:
    """A sentence, and whether infeasibility is proved."""

    infeasible: bool
    sentence: str


def explain(problem: Problem, solve: Solver | None = None, thorough: Solver | None = None, *,
            found: Solution | None = None, proved: bool | None = None) -> Reason | None:
    """
    Return why a problem has no solution.

    Parameters
    ----------
    problem : Problem
        The problem that was not solved.
    solve : callable, optional
        Returns a Solution of a problem with its certificate, whether or not the certificate
        passes; observes the time limit. Without it only the proofs are tried.
    thorough : callable, optional
        Does the same with more work: several initial guesses, until the certificate passes.
    found : Solution, optional
        The best path found for the problem.
    proved : bool, optional
        Result of `is_proved_infeasible`, if it is known.

    Returns
    -------
    Reason or None
        None if no reason was found.

    """
    sentence = explain_contradiction(problem)
    if sentence:
        return Reason(True, sentence)
    sentence = explain_no_minimum(problem)
    if sentence or solve is None:
        return Reason(False, sentence) if sentence else None
    doubt = _Doubt(problem, solve, thorough or solve, proved)
    reason = doubt.reason(found)
    if (reason is None or not reason.infeasible) and doubt.shown:
        return Reason(True, _EXCLUDED)   # no related problem shows which constraint is to blame
    return reason


def is_proved_infeasible(problem: Problem) -> bool:
    """
    Return whether weak duality proves that no path satisfies all constraints.

    Parameters
    ----------
    problem : Problem
        Any problem; proofs exist only for affine dynamics and constraints, given T and bounded
        inputs.

    Returns
    -------
    bool
        False if nothing is proved.

    """
    return has_convex_paths(problem) and is_excluded(problem)


class _Doubt:
    """A problem without a known contradiction, and the solvers for related problems."""

    def __init__(self, problem: Problem, solve: Solver, thorough: Solver,
                 proved: bool | None) -> None:
        self.problem, self.solve = problem, solve
        self.thorough = thorough
        self.lost = True  # whether no path was found within the bounds
        self.convex = has_convex_paths(problem)
        self._shown = proved

    @property
    def shown(self) -> bool:
        """Whether it is proved that no path satisfies all constraints."""
        if self._shown is None:
            self._shown = is_proved_infeasible(self.problem)
        return self._shown

    def reason(self, found: Solution | None) -> Reason | None:
        """Return why there is no solution, None if no reason was found."""
        problem = self.problem
        if found is not None and (sentence := explain_undefined(problem, found.t, found.x,
                                                                found.u)):
            return Reason(False, sentence)
        self.lost = found is None or not is_path(found)
        if found is not None and _arrives(found) and (
                sentence := explain_kink(problem, found.t, found.x, found.u)
                or explain_steep_root(problem, found.t, found.x, found.u)):
            return Reason(False, sentence)
        if found is not None and not self.lost and (
                sentence := explain_level_terminal(problem, found.x[-1])):
            return Reason(False, sentence)
        kept = found is not None and not self.lost and not describe_shortfall(problem, found)
        if kept or problem.q == 0 and not problem.constrained:
            return self.mixed(found) or self.without_end(found)
        nearest = self.best(relax_terminal(problem))
        if not self.keeps(nearest):
            sentence = explain_undefined(problem, nearest.t, nearest.x, nearest.u)
            return Reason(False, sentence) if sentence else (
                self.not_held() or problem.q and (self.too_short() or self.too_little())
                or self.without_end(found) or self.leapt(nearest))
        missed = describe_shortfall(problem, nearest)
        if not missed:
            return self.mixed(found) or self.without_end(found)
        if found is not None and found.meets(_NEARLY) and not (
                describe_shortfall(problem, found) or self.shown):
            return None   # the path found before is closer
        return self.too_short() or self.too_little() or self.missing(missed)

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
        return is_path(answer, _WIDE) if self.convex else is_path(answer)

    def certified(self, other: Problem) -> Solution:
        """Return a solution; if it is not certified, the one of the thorough solver."""
        answer = self.solve(other)
        return answer if answer.certified else self.thorough(other)

    def mixed(self, found: Solution | None) -> Reason | None:
        """Return that minimising sequences chatter, if they do."""
        other = relax_controls(self.problem, found) if found is not None and found.t.size else None
        # A path that slightly violates bounds is good enough for mixtures of an input's bounds.
        if found is None or other is None or self.lost and other.m > self.problem.m:
            return None
        answer = self.thorough(other)
        sentence = explain_chattering(
            self.problem, other, answer, found) if answer.certified else ''
        return Reason(False, sentence) if sentence else None

    def without_end(self, found: Solution | None) -> Reason | None:
        """Return that the cost decreases without limit or that states diverge, if they do."""
        sentence = explain_unbounded(self.problem, self.certified, None if self.lost else found)
        if not sentence and self.lost:
            sentence = explain_escape(self.problem, self.problem.final_time.latest)
        return Reason(False, sentence) if sentence else None

    def too_short(self) -> Reason | None:
        """Return that the terminal constraints can be met at a later T, if they can."""
        problem, last = self.problem, self.problem.final_time.latest
        guess = FinalTime(free=True, lower=1e-3 * last, upper=_LATER * last, guess=2 * last)
        later = replace(problem, L=ca.SX(1), V=ca.SX(0), final_time=guess, structure='')
        answer = self.solve(later)
        if not is_path(answer) and answer.meets(_ROUGHLY):
            answer = self.thorough(later)
        if not is_path(answer) or describe_shortfall(problem, answer):
            return None
        early = answer.t[-1] <= last * (1 + 1e-6)
        if not early and not self.convex:
            answer = self.thorough(later)
            early = not is_path(answer) or answer.t[-1] <= last * (1 + 1e-6)
        if early and not self.convex and not problem.final_time.free and (
                reaches_end(problem, answer)):
            return Reason(False, f'no path was found that meets the terminal constraints at T = '
                                 f'{last:.6g}; a path meets them at T = {answer.t[-1]:.4g}')
        if early:
            return None
        least = float(answer.t[-1])
        found = format_number(least) if answer.certified else f'about {least:.3g}'
        if self.shown:
            return Reason(True, f'the terminal constraints cannot be met by T = {last:.6g}: the '
                                f'minimum time is {found}')
        return Reason(False, f'no path was found that meets the terminal constraints by T = '
                             f'{last:.6g}: the fastest path found takes {found}; {_UNPROVED}')

    def too_little(self) -> Reason | None:
        """Return that the terminal constraints use up more of a monotone state than is allowed."""
        sentence = explain_shortage(self.problem, self.thorough)
        if not sentence:
            return None
        return Reason(True, sentence) if self.shown else Reason(
            False, f'no path was found that satisfies all constraints: {sentence}; {_UNPROVED}')

    def missing(self, missed: str) -> Reason:
        """Return by how much the terminal constraints are missed, and because of which bound."""
        problem = self.problem
        blamed = find_blocking_bound(problem, self.solve)
        if blamed and self.shown:
            name, without = blamed
            return Reason(True, (
                f'{name} and the terminal constraints exclude each other {_time(problem)}: with '
                f'this bound the closest path found ends with {missed}; without it {without}'))
        more = f'; without {blamed[0]} {blamed[1]}' if blamed else ''
        what = 'no path meets' if self.shown else 'no path was found that meets'
        doubt = '' if self.shown else f'; {_UNPROVED}'
        return Reason(self.shown, (
            f'{_time(problem)} {what} the terminal constraints: the closest path found ends with '
            f'{missed}{more}{doubt}'))

    def not_held(self) -> Reason | None:
        """Return which state bound or path constraint cannot be satisfied."""
        answer = self.best(relax_path_constraints(self.problem))
        found = describe_broken_bound(self.problem, answer)
        if not found:
            return None
        name, how = found
        return Reason(True, f'{name} cannot be satisfied: {how}') if self.shown else Reason(
            False, f'no path was found that satisfies {name}: {how}; {_UNPROVED}')

    def leapt(self, nearest: Solution) -> Reason | None:
        """Return that a path satisfies bounds at mesh points only: it jumps over an obstacle."""
        certificate = nearest.certificate
        if certificate is None or certificate.fault != Condition.BOUNDS:
            return None
        names = [state_bound(self.problem, i, upper) for upper, bounds in (
            (False, self.problem.x_lower), (True, self.problem.x_upper))
            for i in map(int, np.flatnonzero(np.isfinite(bounds)))]
        names += [f'path_constraints[{row}]' for row in range(self.problem.path.numel())]
        return Reason(False, (
            f'no path was found that meets the terminal constraints and satisfies '
            f'{" and ".join(names)} at all times: the closest path found violates a bound '
            f'between mesh points by {certificate.residuals[Condition.BOUNDS]:.1g} of its size'))


def _arrives(solution: Solution) -> bool:
    """Return whether the constraints are met; dynamics and optimality are not examined."""
    certificate = solution.certificate
    return certificate is not None and all(
        certificate.residuals.get(key, 0.0) <= certificate.tolerances.get(key, 0.0)
        for key in (Condition.START, Condition.END, Condition.BOUNDS))


def _time(problem: Problem) -> str:
    return f'by T = {problem.final_time.latest:.6g}'
