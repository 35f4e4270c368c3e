# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Correctness of verdicts and reasons, on random problems with known properties.

All proofs of infeasibility are tried on feasible problems without a search before, since a
solution would hide a false proof; a sample of these problems is solved in full. Infeasible
problems must not be solved, and no cost but a known minimum may be certified. Half of the problems
of `--edges` touch a constraint at a given end, the other half have a least cost of 0. `_truths.py`
and `_edges.py` generate the problems.
"""

import sys

import timing  # isort: skip - before numpy

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
import time

import _edges
import _truths
import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.exact.time_optimal import solve_time_optimal
from obc_ros.core.solver.exact.two_wheeled import solve_two_wheeled
from obc_ros.core.solver.linear_quadratic import solve_lq
from obc_ros.core.solver.proofs.contradictions import CONTRADICTIONS
from obc_ros.core.solver.proofs.existence import explain_no_minimum
from obc_ros.core.solver.proofs.singular_expressions import explain_undefined
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import StatementError

ABOVE = 1e-5      # largest relative difference of a certified cost from the minimum
LIMIT = 2.0       # [s] time limit of one problem
EVERY = 200       # one of so many feasible problems is solved
TOUCHED = 10      # one of so many problems of the edges: each second one touches a constraint
LOOSE = 0.25      # share of feasible problems whose initial values are found within ranges
TOLD = 5          # false findings of a kind that are printed in full
Special = Callable[[Problem], Solution | None]
SPECIAL: tuple[Special, ...] = (solve_lq, solve_time_optimal, solve_two_wheeled)
# Parts of messages that are false for a problem with a finite minimum cost.
FALSE = ('no lower bound', 'undefined', 'divides by zero', 'cannot be', 'not attained')


@dataclass
class Tally:
    """Numbers of problems and of results, and the false ones."""

    asked: Counter[str] = field(default_factory=Counter)
    found: Counter[str] = field(default_factory=Counter)
    false: list[str] = field(default_factory=list)

    def accuse(self, kind: str, what: str, mapping: _truths.Mapping) -> None:
        """Count a false finding, and print the first ones."""
        self.false.append(f'{kind}: {what}')
        if len(self.false) <= TOLD:
            print(f'FALSE: {what}\n{mapping}', flush=True)


def findings(truth: _truths.Truth, problem: Problem) -> Iterator[tuple[str, str]]:
    """Yield the findings on a problem, each with the name of its check."""
    for check in CONTRADICTIONS:
        for sentence in check(problem):
            yield check.__name__.strip('_'), sentence
            break
    if sentence := explain_no_minimum(problem):
        yield 'without_minimum', sentence
    x = truth.x
    if problem.has_clock:   # time is a state
        x = np.column_stack([x, truth.t])
    if sentence := explain_undefined(problem, truth.t, x, truth.u):
        yield 'undefined', sentence
    for special in SPECIAL:
        answer = special(problem)
        if answer is not None and answer.status is Status.INFEASIBLE:
            yield special.__name__, answer.message


def ask_feasible(count: int, rng: np.random.Generator, until: float) -> Tally:
    """Try all checks on feasible problems, and solve a sample of them."""
    tally = Tally()
    for number in _counted('feasible', count, until, tally):
        truth = _truths.feasible(rng)
        if rng.random() < LOOSE:
            truth = _truths.loosened(truth, rng)
        _ask_admissible(truth, tally, is_solved=number % EVERY == 0)
    return tally


def _ask_admissible(truth: _truths.Truth, tally: Tally, is_solved: bool) -> None:
    """Try all checks on a problem with an admissible path; solve it if asked to."""
    try:
        problem = build_problem(truth.mapping)
    except StatementError as error:   # a constraint that depends on no state
        tally.found[f'refused: {str(error)[:40]}'] += 1
        return
    tally.asked[truth.kind] += 1
    try:
        for name, sentence in findings(truth, problem):
            tally.accuse(truth.kind, f'{name}: {sentence}', truth.mapping)
    except Exception as error:   # an exception in a check would end a worker
        tally.accuse(truth.kind, f'{type(error).__name__}: {error}', truth.mapping)
    if not is_solved:
        return
    try:
        answer = solve(problem, time_limit=LIMIT)
    except Exception as error:
        tally.accuse(truth.kind, f'solve: {type(error).__name__}: {error}', truth.mapping)
        return
    tally.found[answer.status.value] += 1
    if answer.status is Status.INFEASIBLE or any(word in answer.message for word in FALSE):
        tally.accuse(truth.kind, f'solve: {answer.message}', truth.mapping)


def ask_infeasible(count: int, rng: np.random.Generator, until: float) -> Tally:
    """Solve infeasible problems."""
    tally = Tally()
    for _ in _counted('infeasible', count, until, tally):
        kind, mapping = _truths.infeasible(rng)
        answer = solve(build_problem(mapping), time_limit=LIMIT)
        tally.asked[kind] += 1
        tally.found[answer.status.value] += 1
        if answer.status is Status.SOLVED or answer.certified:
            tally.accuse(kind, f'solved at {answer.objective:.6g}', mapping)
    return tally


def ask_convex(count: int, rng: np.random.Generator, until: float) -> Tally:
    """Solve problems whose minimum cost is known."""
    tally = Tally()
    for _ in _counted('convex', count, until, tally):
        kind, mapping, least = _truths.convex(rng)
        _ask_least(kind, mapping, least, ABOVE * max(abs(least), 1e-6), tally)
    return tally


def ask_edges(count: int, rng: np.random.Generator, until: float) -> Tally:
    """Try and solve problems that touch a constraint at an end, or have a least cost of 0."""
    tally = Tally()
    for number in _counted('edges', count, until, tally):
        if number % 2:
            _ask_least(*_edges.reachable(rng), tally)
        else:
            _ask_admissible(_edges.touching(rng), tally, is_solved=number % TOUCHED == 0)
    return tally


def _ask_least(kind: str, mapping: _truths.Mapping, least: float, above: float, tally: Tally
               ) -> None:
    """Solve a problem whose minimum cost is known; a certified cost may be `above` it."""
    answer = solve(build_problem(mapping), time_limit=LIMIT)
    tally.asked[kind] += 1
    tally.found[answer.status.value] += 1
    if answer.status is Status.INFEASIBLE or any(word in answer.message for word in FALSE):
        tally.accuse(kind, answer.message, mapping)
    elif answer.certified and abs(answer.objective - least) > above:
        tally.accuse(kind, f'{answer.objective:.9g}, least {least:.9g}', mapping)


def _counted(what: str, count: int, until: float, tally: Tally) -> Iterator[int]:
    """Yield numbers until the time limit, and print the progress every 10 s."""
    said = time.monotonic()
    for number in range(count):
        if time.monotonic() > until:
            return
        if time.monotonic() > said + 10:
            said = time.monotonic()
            print(f'  {what}: {number} of {count}, {len(tally.false)} false', flush=True)
        yield number


def report(what: str, tally: Tally) -> None:
    """Print a tally."""
    timing.table(f'{what}: {sum(tally.asked.values())} problems', ('kind', 'problems', 'false'), [
        (kind, number, sum(each.startswith(f'{kind}:') for each in tally.false))
        for kind, number in sorted(tally.asked.items())])
    if tally.found:
        print('  answers: ' + ', '.join(f'{number} {status}' for status, number in sorted(
            tally.found.items())))
    timing.require(f'{what}: false', len(tally.false), 0)


def main() -> int:
    """Solve, print and return the exit status."""
    args = timing.arguments('random problems with known properties',
                            feasible=2000, infeasible=200, convex=200, edges=200, seed=1,
                            seconds=0)
    parts = {'feasible': (ask_feasible, args.feasible),
             'infeasible': (ask_infeasible, args.infeasible),
             'convex': (ask_convex, args.convex),
             'edges': (ask_edges, args.edges)}
    for number, (what, (ask, count)) in enumerate(parts.items()):
        until = time.monotonic() + args.seconds / len(parts) if args.seconds else np.inf
        report(what, ask(count, np.random.default_rng([args.seed, number]), until))
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())
