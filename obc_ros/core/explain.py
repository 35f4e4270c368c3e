# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Why a problem has no answer, in the words of who asked, with numbers.

What `contradictions` and `ill_posed` prove comes first. Then other problems are solved in its
place:

elastic      the terminal constraints become the cost sum of psi_j^2: what is left says how much
             of which constraint is missing; then also with one state bound, path constraint or
             input bound left out at a time: the one without which nothing is missing is to blame;
soft         state bounds and path constraints become a cost as well: which one cannot be held,
             when, and by how much;
least time   L = 1, T free: whether the time is too short;
relaxed      mixtures of two inputs: whether the cost falls while the input switches ever faster;
boxed        |u| <= 10, 100, 1000: whether the cost falls without end.

A problem is called infeasible when that is shown. Where dynamics and constraints are affine and T
is given, the elastic and the soft problem are convex: what is left in them is left by every
input. Others may have minima that are not the least ones; of them it is believed if the least
time, found from several starts and certified, is too long, and else the sentence says what was
found and no more.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.contradictions import contradiction, number, state_bound, terminal
from obc_ros.core.ill_posed import growing, wish, without_minimum
from obc_ros.core.problem import FinalTime, Problem
from obc_ros.core.relaxation import chattering, relaxed
from obc_ros.core.solution import Solution
from obc_ros.core.sweeps import guided, leads_there
from obc_ros.core.undefined import kinked, level, runs_away, steep, undefined
from obc_ros.core.uneven import convex_paths

Array = NDArray[np.float64]
Solver = Callable[[Problem], Solution]

# What a certificate may leave of these conditions for a path to count as one.
_FEASIBLE = {'dynamics': 1e-4, 'start': 1e-5, 'bounds': 1e-4}
_NEARLY = _FEASIBLE | {'start': 1e-3, 'end': 1e-3, 'bounds': 1e-3}   # for it to be all but one
_MISSED = 1e-4      # of a constraint's size: beyond the accuracy of an elastic answer
_PART = 0.1         # of its terms, that Pontryagin's conditions may leave
_EFFORT = 1e-8      # weight of the inputs in problems that would not determine them otherwise
_LATER = 50.0       # times T up to which a least time is looked for
_BOXES = (10.0, 100.0, 1000.0)
_IMPULSE, _INSTANT = 0.1, 1e-4   # parts: of the largest input and its integral; of T
_MORE = 3.0         # times the largest inputs of an answer: where a cheaper one is looked for


@dataclass(frozen=True)
class Reason:
    """A sentence, and whether it says that nothing satisfies the problem's constraints."""

    infeasible: bool
    sentence: str


def explain(problem: Problem, solve: Solver | None = None, *, thorough: Solver | None = None,
            found: Solution | None = None) -> Reason | None:
    """
    Return why a problem has no answer, or None if no reason was found.

    Parameters
    ----------
    problem : Problem
        The one that was not answered.
    solve : callable, optional
        Returns a Solution with its certificate for a problem, whether or not the certificate
        holds; it keeps the time limit. Without it only contradictions are found.
    thorough : callable, optional
        Does the same with more care: its certificate is to hold, for the best of several starts.
    found : Solution, optional
        The best path that was found for the problem.

    """
    sentence = contradiction(problem)
    if sentence:
        return Reason(True, sentence)
    sentence = without_minimum(problem)
    if sentence or solve is None:
        return Reason(False, sentence) if sentence else None
    return _Doubt(problem, solve, thorough or solve).reason(found)


def too_late(problem: Problem, solve: Solver, thorough: Solver) -> str:
    """Return that terminal constraints can be met, but not by T, as a certificate shows, or ''."""
    reason = _Doubt(problem, solve, thorough).too_short(False) if problem.q else None
    return reason.sentence if reason and reason.infeasible else ''


class _Doubt:
    """A problem without a contradiction, and how others are solved in its place."""

    def __init__(self, problem: Problem, solve: Solver, thorough: Solver) -> None:
        self.problem, self.solve = problem, solve
        self.thorough = thorough
        self.lost = True  # whether no path was found that keeps to the problem
        self.convex = convex_paths(problem)

    def reason(self, found: Solution | None) -> Reason | None:
        """Return why there is no answer, None if that remains unknown."""
        problem = self.problem
        if found is not None and (sentence := undefined(problem, found.t, found.x, found.u)):
            return Reason(False, sentence)
        self.lost = found is None or not _is_path(found)
        if found is not None and _arrives(found) and (
                sentence := kinked(problem, found.t, found.x, found.u)
                or steep(problem, found.t, found.x, found.u)):
            return Reason(False, sentence)
        if found is not None and not self.lost and (
                sentence := level(problem, found.x[-1])):
            return Reason(False, sentence)
        kept = found is not None and not self.lost and not _missed(problem, found)
        if kept or problem.q == 0 and not _bounded(problem):
            return self.mixed(found) or self.without_end(found)
        nearest = self.best(_elastic(problem))
        if not _is_path(nearest):
            sentence = undefined(problem, nearest.t, nearest.x, nearest.u)
            return Reason(False, sentence) if sentence else (
                self.not_held() or problem.q and self.too_short(False)
                or self.without_end(found) or self.leapt(nearest))
        missed = _missed(problem, nearest)
        if not missed:
            return self.mixed(found) or self.without_end(found)
        shown = self.convex and _nearly_optimal(nearest)
        if not shown and found is not None and _almost(problem, found):
            return None   # it came nearer
        return self.too_short(shown) or self.missing(missed, shown)

    def best(self, other: Problem) -> Solution:
        """Return an answer that is a path; of a convex problem the best one but for a little."""
        answer = self.solve(other)
        if not _is_path(answer) or self.convex and not _nearly_optimal(answer):
            answer = self.thorough(other)
        return answer

    def certified(self, other: Problem) -> Solution:
        """Return an answer, with more care where its certificate does not hold at once."""
        answer = self.solve(other)
        return answer if _certified(answer) else self.thorough(other)

    def mixed(self, found: Solution | None) -> Reason | None:
        """Return that the least cost is approached by ever faster switching, if it is."""
        other = relaxed(self.problem, found) if found is not None and found.t.size else None
        # Bounds that a path just misses do not matter where mixtures of an input's bounds do.
        if found is None or other is None or self.lost and other.m > self.problem.m:
            return None
        answer = self.thorough(other)
        sentence = chattering(
            self.problem, other, answer, found) if _certified(answer) else ''
        return Reason(False, sentence) if sentence else None

    def without_end(self, found: Solution | None) -> Reason | None:
        """Return that states, or the cost, grow without end, if they do."""
        sentence = _unbounded(self.problem, self.certified, None if self.lost else found)
        if not sentence and self.lost:
            sentence = runs_away(self.problem, _last(self.problem))
        return Reason(False, sentence) if sentence else None

    def too_short(self, shown: bool) -> Reason | None:
        """Return that the terminal constraints can be met, but only later."""
        problem, last = self.problem, _last(self.problem)
        guess = FinalTime(free=True, lower=1e-3 * last, upper=_LATER * last, guess=2 * last)
        later = replace(problem, L=ca.SX(1), V=ca.SX(0), final_time=guess, structure='')
        answer = self.solve(later)
        if not _is_path(answer) or _missed(problem, answer):
            return None
        early = answer.t[-1] <= last * (1 + 1e-6)
        if not early and not self.convex:
            answer = self.thorough(later)
            early = not _is_path(answer) or answer.t[-1] <= last * (1 + 1e-6)
        if early and not self.convex and not problem.final_time.free and (
                leads_there(problem, answer)):
            return Reason(False, f'no path was found that meets the terminal constraints at T = '
                                 f'{last:.6g}; one meets them at T = {answer.t[-1]:.4g}')
        if early:
            return None
        least = float(answer.t[-1])
        if _certified(answer):
            return Reason(True, f'the terminal constraints cannot be met by T = {last:.6g}: the '
                                f'least time is {number(least)}')
        if shown:
            return Reason(True, f'the terminal constraints cannot be met by T = {last:.6g}: the '
                                f'least time is about {least:.3g}')
        return Reason(False, f'no path was found that meets the terminal constraints by T = '
                             f'{last:.6g}: the quickest takes about {least:.3g}')

    def missing(self, missed: str, shown: bool) -> Reason:
        """Return what of the terminal constraints is out of reach, and for which bound."""
        problem = self.problem
        blamed = _to_blame(problem, self.solve)
        if blamed and shown:
            name, without = blamed
            return Reason(True, (
                f'{name} and the terminal constraints exclude each other {_time(problem)}: with '
                f'it the path ends at best with {missed}; without it {without}'))
        more = f'; without {blamed[0]} {blamed[1]}' if blamed else ''
        return Reason(shown, f'{_time(problem)} no path was found that meets the terminal '
                             f'constraints: the nearest ends with {missed}{more}')

    def not_held(self) -> Reason | None:
        """Return which state bound or path constraint cannot be held."""
        answer = self.best(_soft(self.problem))
        found = _not_held(self.problem, answer)
        if not found:
            return None
        name, how = found
        shown = self.convex and _nearly_optimal(answer)
        return Reason(True, f'{name} cannot be held: {how}') if shown else Reason(
            False, f'no path was found that keeps to {name}: {how}')

    def leapt(self, nearest: Solution) -> Reason | None:
        """Return that a path keeps to bounds at mesh points only, as it leaps over a wall."""
        certificate = nearest.certificate
        if certificate is None or certificate.fault != 'bounds':
            return None
        names = [state_bound(self.problem, i, upper) for upper, bounds in (
            (False, self.problem.x_lower), (True, self.problem.x_upper))
            for i in map(int, np.flatnonzero(np.isfinite(bounds)))]
        names += [f'path_constraints[{row}]' for row in range(self.problem.path.numel())]
        return Reason(False, (
            f'no path was found that meets the terminal constraints and keeps to '
            f'{" and ".join(names)} all the way: the nearest exceeds a bound between mesh points '
            f'by {certificate.residuals["bounds"]:.1g} of its size'))


def _certified(answer: Solution) -> bool:
    return answer.certificate is not None and answer.certificate.holds


def _nearly_optimal(answer: Solution) -> bool:
    """Return whether a convex problem's cost is the least one but for a part of it."""
    certificate = answer.certificate
    return certificate is not None and all(
        certificate.residuals[key] <= _PART
        for key in ('costate', 'minimum', 'transversality', 'hamiltonian'))


def _last(problem: Problem) -> float:
    final = problem.final_time
    return final.upper if final.free else final.value


def _bounded(problem: Problem) -> bool:
    return bool(np.isfinite([problem.x_lower, problem.x_upper]).any() or problem.path.numel())


def _is_path(solution: Solution) -> bool:
    """Return whether an answer, optimal or not, is a path that keeps to the problem."""
    certificate = solution.certificate
    return certificate is not None and all(
        certificate.residuals.get(key, np.inf) <= limit for key, limit in _FEASIBLE.items())


def _arrives(solution: Solution) -> bool:
    """Return whether constraints are met, whatever else an answer lacks."""
    certificate = solution.certificate
    return certificate is not None and all(
        certificate.residuals.get(key, 0.0) <= certificate.tolerances.get(key, 0.0)
        for key in ('start', 'end', 'bounds'))


def _almost(problem: Problem, found: Solution) -> bool:
    """Return whether an answer ends as it has to and nearly keeps to the problem on the way."""
    residuals = found.certificate.residuals if found.certificate else {}
    return not _missed(problem, found) and all(
        residuals.get(key, np.inf) <= limit for key, limit in _NEARLY.items())


def _time(problem: Problem) -> str:
    return f'by T = {_last(problem):.6g}'


def _effort(problem: Problem) -> ca.SX:
    """Return a small cost of inputs away from the middle of their box."""
    boxed = np.isfinite(problem.u_lower) & np.isfinite(problem.u_upper)
    half = np.where(boxed, 0.5*(problem.u_upper - problem.u_lower), 1.0)
    middle = np.where(boxed, problem.u_lower + half, np.clip(
        0.0, problem.u_lower, problem.u_upper))
    return _EFFORT * ca.sumsqr((problem.u - middle) / np.where(half > 0, half, 1.0))


def _sizes(problem: Problem) -> Array:
    """Return what counts as one in each terminal constraint."""
    slope = ca.Function('slope', [problem.x, problem.p],
                        [ca.densify(ca.jacobian(problem.psi, problem.x)), problem.psi])
    psi_x, psi = (value.full() for value in slope(problem.x0, problem.p_value))
    size = np.maximum(np.abs(psi[:, 0]), np.abs(psi_x) @ np.maximum(np.abs(problem.x0), 1e-2))
    return np.where(np.isfinite(size) & (size > 0), size, 1.0)


def _elastic(problem: Problem) -> Problem:
    """Return the problem of coming as near as possible to the terminal constraints."""
    return replace(problem, L=_effort(problem), psi=ca.SX(0, 1), structure='',
                   V=ca.sumsqr(problem.psi / _sizes(problem)))


def _soft(problem: Problem) -> Problem:
    """Return the problem of breaking state bounds and path constraints as little as possible."""
    cost = _effort(problem)
    rows = [*zip(ca.vertsplit(problem.x), problem.x_lower, problem.x_upper, strict=True)]
    if problem.path.numel():
        rows += zip(ca.vertsplit(problem.path), problem.path_lower, problem.path_upper,
                    strict=True)
    for value, lower, upper in rows:
        size = max((abs(bound) for bound in (lower, upper) if np.isfinite(bound)), default=1.0)
        for excess in ((lower - value) if np.isfinite(lower) else None,
                       (value - upper) if np.isfinite(upper) else None):
            if excess is not None:
                cost += ca.fmax(excess / (size or 1.0), 0)**2
    unlimited = np.full(problem.n, np.inf)
    return replace(problem, L=cost, V=ca.SX(0), psi=ca.SX(0, 1), path=ca.SX(0, 1), structure='',
                   path_lower=np.zeros(0), path_upper=np.zeros(0), x_lower=-unlimited,
                   x_upper=unlimited)


def _missed(problem: Problem, nearest: Solution) -> str:
    """Say by how much each terminal constraint is missed at the end of a path; '' if by none."""
    psi = ca.Function('psi', [problem.x, problem.p], [problem.psi])
    values = psi(nearest.x[-1], problem.p_value).full()[:, 0]
    far = np.flatnonzero(np.abs(values) > _MISSED * _sizes(problem))
    parts = []
    for row in map(int, far):
        wanted = terminal(problem, row)
        name, _, value = wanted.partition(' = ')
        if name in problem.states:
            there = nearest.x[-1, problem.states.index(name)]
            parts.append(f'{name} = {number(float(there))} instead of {value}')
        else:
            parts.append(f'{wanted} missed by {number(abs(float(values[row])))}')
    return ', '.join(parts)


def _to_blame(problem: Problem, solve: Solver) -> tuple[str, str] | None:
    """Return the bound that keeps the terminal constraints from being met, and what it is for."""
    for name, freed, seen in _without(problem):
        answer = solve(_elastic(freed))
        if _is_path(answer) and not _missed(freed, answer):
            return name, seen(answer)
    return None


Seen = Callable[[Solution], str]


def _without(problem: Problem) -> Iterator[tuple[str, Problem, Seen]]:
    """Yield the bounds by name, the problem without each, and what a path then does."""
    for index in range(problem.n):
        for upper in (True, False):
            bounds = problem.x_upper if upper else problem.x_lower
            if np.isfinite(bounds[index]):
                key = 'x_upper' if upper else 'x_lower'
                yield (f'state bound {state_bound(problem, index, upper)}',
                       _changed(problem, key, index),
                       _extreme(problem.states[index], index, upper, 'x'))
    for row in range(problem.path.numel()):
        yield (f'path_constraints[{row}]',
               _changed(_changed(problem, 'path_lower', row), 'path_upper', row),
               lambda _: 'they can be met')
    for index in range(problem.m):
        for upper in (True, False):
            bound = (problem.u_upper if upper else problem.u_lower)[index]
            if np.isfinite(bound):
                name = problem.inputs[index]
                yield (f'input bound {name} {"<=" if upper else ">="} {number(bound)}',
                       _changed(problem, 'u_upper' if upper else 'u_lower', index),
                       _extreme(name, index, upper, 'u'))


def _changed(problem: Problem, key: str, index: int) -> Problem:
    """Return a problem without one bound."""
    values = getattr(problem, key).copy()
    values[index] = np.inf if key.endswith('upper') else -np.inf
    changed: dict[str, Array] = {key: values}
    # Where a path constraint has no bound left its row remains and says nothing.
    return replace(problem, structure='', **changed)  # type: ignore[arg-type]  # one of the bounds


def _extreme(name: str, index: int, upper: bool, kind: str) -> Seen:
    def seen(answer: Solution) -> str:
        values = (answer.x if kind == 'x' else answer.u)[:, index]
        k = int(np.argmax(values) if upper else np.argmin(values))
        return f'{name} goes to {values[k]:.4g} at t = {answer.t[k]:.4g}'
    return seen


def _not_held(problem: Problem, answer: Solution) -> tuple[str, str] | None:
    """Return which bound the answer to the soft problem breaks most, and how."""
    if not _is_path(answer):
        return None
    rows, terms = _rows(problem, answer)
    lower = np.concatenate([problem.x_lower, problem.path_lower])
    upper = np.concatenate([problem.x_upper, problem.path_upper])
    size = 1e-2 + np.maximum(np.abs(rows).max(axis=0), terms)
    excess = np.maximum(rows - upper, lower - rows) / size
    k, row = np.unravel_index(int(np.argmax(excess)), excess.shape)
    if excess[k, row] <= _MISSED:
        return None
    over = rows[k, row] > upper[row]
    if row < problem.n:
        name = f'state bound {state_bound(problem, int(row), bool(over))}'
    else:
        bound = upper[row] if over else lower[row]
        name = f'path_constraints[{row - problem.n}] {"<=" if over else ">="} {number(bound)}'
    first = int(np.argmax(excess[:, row] > _MISSED))
    return name, (f'the path that comes nearest to it leaves it at t = {answer.t[first]:.3g} and '
                  f'has {rows[k, row]:.4g} at t = {answer.t[k]:.4g}')


def _rows(problem: Problem, answer: Solution) -> tuple[Array, Array]:
    """Return x and c at the samples of an answer, and the largest size of their terms."""
    c, z = problem.path, ca.vertcat(problem.x, problem.u)
    terms = ca.mtimes(ca.fabs(ca.jacobian(c, z)), ca.fabs(z))
    path = ca.Function('path', [problem.x, problem.u, problem.p], [c, terms]).map(len(answer.t))
    values, sizes = (np.array(value).T for value in path(
        answer.x.T, answer.u.T, ca.repmat(problem.p_value, 1, len(answer.t))))
    return np.hstack([answer.x, values]), np.append(
        np.abs(answer.x).max(axis=0), sizes.max(axis=0))


def _unbounded(problem: Problem, solve: Solver, found: Solution | None) -> str:
    """
    Return a sentence if the cost goes on falling as the inputs are given more room.

    Where a path was found its inputs are where the search starts, as far as there is room.
    """
    free = ~(np.isfinite(problem.u_lower) & np.isfinite(problem.u_upper))
    if not free.any():
        return ''
    size = np.maximum(1.0, np.abs(np.where(np.isfinite(problem.u_lower), problem.u_lower, 0.0)))
    costs, full = [], True
    for room in _BOXES:
        boxed = _boxed(problem, room * size)
        answer = solve(boxed if found is None else guided(boxed, found))
        if not _is_path(answer) or (problem.q and _missed(problem, answer)):
            return ''
        costs.append(float(answer.objective))
        full &= bool((np.abs(answer.u).max(axis=0) >= 0.99 * room * size)[free].any())
    first, second = costs[0] - costs[1], costs[1] - costs[2]
    names = ', '.join(f'|{name}|' for name, yes in zip(problem.inputs, free, strict=True) if yes)
    listed = ', '.join(f'{cost:.4g} with {names} <= {room:g}'
                       for cost, room in zip(costs, _BOXES, strict=True))
    if costs[2] < 0 and first > 0 and second > 3*first:
        return f'the cost has no lower bound: {listed}'
    if full and first > 0 and second > _PART * abs(costs[1]):
        return f'no least cost was found: it goes on falling as inputs may be larger, {listed}'
    return ''


def _boxed(problem: Problem, room: Array) -> Problem:
    """Return a problem with inputs of at most this magnitude."""
    return replace(problem, structure='', u_lower=np.maximum(problem.u_lower, -room),
                   u_upper=np.minimum(problem.u_upper, room))


def outgrown(problem: Problem, found: Solution, solve: Solver) -> str:
    """
    Return a sentence if larger inputs cost much less than those of a certified answer; else ''.

    Where H is linear in an input without bounds, an answer that runs off to infinity has
    residuals that are small beside its own size.
    """
    if not wish(problem):
        return ''
    if name := _impulsive(problem, found):
        return f'no least cost was found: {name} has an impulse, larger and shorter without end'
    largest = np.abs(found.u).max(axis=0)
    room = _MORE * np.maximum(largest, 1e-6 * largest.max())
    other = solve(_boxed(problem, room if largest.any() else np.ones(problem.m)))
    if not _is_path(other):
        return _unbounded(problem, solve, None)
    if problem.q and _missed(problem, other) or (
            found.objective - other.objective <= _PART * abs(found.objective)):
        return ''
    return (f'no least cost was found: {found.objective:.4g} with inputs up to '
            f'{largest.max():.4g}, {other.objective:.4g} with larger ones; {wish(problem)}')


def _impulsive(problem: Problem, found: Solution) -> str:
    """Return an input without bounds that does part of its work in next to no time, or ''."""
    h = np.diff(found.t)
    for name in growing(problem):
        size = np.abs(found.u[:, problem.inputs.index(name)])
        high = np.maximum(size[:-1], size[1:])
        short = high > _IMPULSE * size.max()
        work = h * (size[:-1] + size[1:])
        if (size.max() * found.t[-1] > 0 and h[short].sum() < _INSTANT * found.t[-1]
                and work[short].sum() > _IMPULSE * work.sum()):
            return name
    return ''
