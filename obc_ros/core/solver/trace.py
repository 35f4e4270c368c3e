# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The record of a solve: what was tried, in which order, at what cost, and why it ended."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
import math

from obc_ros.core.ocp.solution import (
    Attempt,
    Certificate,
    Condition,
    MOST_ATTEMPTS,
    Solution,
    Status,
    Verdict,
)

# The methods of attempts from an initial guess, and from the solution of a neighbour.
GUESS, NEIGHBOUR = 'initial guess', 'neighbour'
# Those of a descent from a start, of one mesh of it, and of the solve on it.
DESCENT, MESH, COLLOCATION = 'descent', 'mesh', 'collocation'
_OUTER = 2   # levels of attempts that are named when the time is up, and told when they begin

# What the failure of a condition means.
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


class Entry:
    """
    An attempt so far.

    :ivar aside: whether it solves another problem, whose costs say nothing about this one.
    """

    def __init__(self, attempt: Attempt, *, aside: bool) -> None:
        self.attempt, self.aside = attempt, aside

    def end(self, verdict: Verdict, why: str = '', *, cost: float = math.nan,
            loss: float = math.nan, what: str = '') -> None:
        """Set the result; see `Attempt`. A later call replaces it; `what` if it is given."""
        self.attempt = replace(self.attempt, what=what or self.attempt.what, verdict=verdict,
                               why=why, cost=float(cost), loss=float(loss))

    def spend(self, work: int) -> None:
        """Set the work, in iterations times intervals."""
        self.attempt = replace(self.attempt, work=work)


class Trace:
    """
    The attempts of a solve, as a tree. Entries are added and never removed.

    :ivar work: iterations times intervals so far.
    :ivar mesh_refused: whether a mesh with more than the maximum number of intervals was needed.
    """

    def __init__(self) -> None:
        self._tell: Callable[[], None] = lambda: None
        self.work, self.mesh_refused = 0, False
        self._entries: list[Entry] = []
        self._open: list[Entry] = []   # the innermost last
        self._best, self._certified = math.inf, False
        self._late = ''   # what was tried when the time was up
        self._description: str | None = None

    def spend(self, work: int) -> None:
        """Add work, in iterations times intervals."""
        self.work += work

    def watch(self, tell: Callable[[], None]) -> None:
        """Call `tell` whenever an attempt at one of the outer levels begins."""
        self._tell = tell

    @contextmanager
    def attempt(self, method: str, what: str = '', *, aside: bool = False) -> Iterator[Entry]:
        """
        Add an attempt, make it the innermost one under way, and count its work.

        :param method, what: as in `Attempt`.
        :param aside: as in `Entry`.
        """
        parent = self._open[-1].attempt.number if self._open else 0
        entry = Entry(Attempt(
            number=len(self._entries) + 1, parent=parent, method=method, what=what,
            begun=self.work, work=0, cost=math.nan, loss=math.nan, verdict=Verdict.STOPPED,
            why=''), aside=aside or self._aside)
        self._entries.append(entry)
        self._open.append(entry)
        self._description = None
        if len(self._open) <= _OUTER:
            self._tell()
        try:
            yield entry
        finally:
            self._open.pop()
            self._description = None
            entry.spend(self.work - entry.attempt.begun)

    def found(self, cost: float, certified: bool) -> None:
        """Note the cost of a feasible path, for `describe`; a certified one replaces others."""
        if not self._aside and (certified, -cost) > (self._certified, -self._best):
            self._best, self._certified = cost, certified
            self._description = None

    def note_refused_mesh(self) -> None:
        """Note that a mesh with more than the maximum number of intervals was needed."""
        self.mesh_refused |= not self._aside

    def note_time_up(self) -> None:
        """Note that the time is up, and what is tried now."""
        self._late = self._late or ', '.join(
            entry.attempt.method for entry in self._open[:_OUTER])

    @property
    def _aside(self) -> bool:
        return bool(self._open) and self._open[-1].aside

    def describe(self) -> str:
        """Return start, mesh and method now, and the best cost so far, in words."""
        if self._description is None:
            best = '' if math.isinf(self._best) else (
                f': best {self._best:.6g} '
                f'{"(certified)" if self._certified else "(not certified)"}')
            self._description = (', '.join(self._describe_place()) or 'solving') + best
        return self._description

    def _describe_place(self) -> Iterator[str]:
        """Yield the number of the start, that of the mesh of a descent, and the method."""
        if starts := self.count(GUESS):
            yield f'start {starts}'
        now = [entry.attempt for entry in self._open]
        descent = next((each.number for each in reversed(now) if each.method == DESCENT), None)
        if meshes := sum((entry.attempt.parent, entry.attempt.method) == (descent, MESH)
                         for entry in self._entries):
            yield f'mesh {meshes}'
        if now and now[-1].method not in (GUESS, DESCENT, MESH, COLLOCATION):
            yield now[-1].method

    def count(self, method: str, verdict: Verdict | None = None) -> int:
        """Return the number of attempts for the problem itself, all or with one verdict."""
        return sum(entry.attempt.method == method and not entry.aside
                   and verdict in (None, entry.attempt.verdict) for entry in self._entries)

    def find_verdict(self, method: str) -> Verdict | None:
        """Return the verdict of the last attempt by a method, None if it was not tried."""
        return next((entry.attempt.verdict for entry in reversed(self._entries)
                     if entry.attempt.method == method), None)

    @property
    def searched(self) -> bool:
        """Return whether a path was searched for, not only an exact method or a proof."""
        return self.count(GUESS) + self.count(NEIGHBOUR) > 0

    def describe_effort(self) -> str:
        """Return in words how hard a path was searched for; '' without a search."""
        guesses = self.count(GUESS)
        if not guesses:
            return ''
        led = self.count(GUESS, Verdict.CONVERGED)
        tried = 'guess was' if guesses == 1 else 'guesses were'
        late = f'; the time was up during {self._late}' if self._late else ''
        return f'{guesses} initial {tried} tried, {led} led to a path on a coarse mesh{late}'

    def attempts(self, most: int = MOST_ATTEMPTS) -> tuple[Attempt, ...]:
        """Return the attempts, at most `most`; the most detailed are left out first."""
        depth = [0]
        for entry in self._entries:
            depth.append(depth[entry.attempt.parent] + 1)
        level = max(depth)
        while level > 1 and sum(each <= level for each in depth[1:]) > most:
            level -= 1
        return tuple(entry.attempt for entry in self._entries
                     if depth[entry.attempt.number] <= level)[:most]


def judge_path(found: Solution) -> tuple[Verdict, str]:
    """Return the verdict on a solution, and why: the condition with the largest residual."""
    if not found.t.size:
        return (Verdict.PROVED if found.status is Status.INFEASIBLE else Verdict.REJECTED,
                found.message)
    if found.certified:
        return Verdict.CERTIFIED, ''
    if found.certificate is None:
        return Verdict.STOPPED, 'before the certificate'
    return Verdict.NOT_CERTIFIED, describe_fault(found.certificate)


def describe_fault(certificate: Certificate) -> str:
    """Return in words which condition fails most, with residual and tolerance."""
    worst = certificate.worst
    residual = certificate.residuals[worst]
    if not math.isfinite(residual):
        return (f'the residual of {worst} could not be computed: a number is not finite, or '
                'rounding errors are too large')
    return (f'{_FAULTS[worst]}: residual {residual:.1e}, allowed '
            f'{certificate.tolerances[worst]:.0e}')
