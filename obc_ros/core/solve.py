# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Answer an optimal control problem by the method its structure asks for, and certify the answer.
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
import time

import numpy as np
from numpy.typing import NDArray

from obc_ros.core.errors import StatementError
from obc_ros.core.extremal import Integrator
from obc_ros.core.guesses import Guesser, scales
from obc_ros.core.problem import Problem
from obc_ros.core.solution import Report, Solution, Status
from obc_ros.core.transcription import (
    Layout, Mesh, Monitor, Outcome, Path, Scales, Transcription, uniform)

Array = NDArray[np.float64]


@dataclass
class Kit:
    """What was built for one structure, kept for the next problem that has it."""

    integrator: Integrator
    guesser: Guesser
    transcriptions: dict[Layout, Transcription] = field(default_factory=dict)
    last: Outcome | None = None

    def transcription(self, problem: Problem, layout: Layout) -> Transcription:
        """Return the program of a layout, built at most once."""
        if layout not in self.transcriptions:
            self.transcriptions[layout] = Transcription(problem, layout)
        return self.transcriptions[layout]


class Cache:
    """The kits of the structures met last, at most `size` of them."""

    def __init__(self, size: int = 32) -> None:
        self._size = size
        self._kits: OrderedDict[str, Kit] = OrderedDict()

    def kit(self, problem: Problem) -> Kit:
        """Return the kit of a problem's structure."""
        key = problem.structure
        kit = self._kits.pop(key, None) if key else None
        if kit is None:
            kit = Kit(Integrator(problem), Guesser(problem))
        if key:
            self._kits[key] = kit
            if len(self._kits) > self._size:
                self._kits.popitem(last=False)
        return kit


def _transcription(problem: Problem, kit: Kit, monitor: Monitor) -> Solution:
    best: Outcome | None = None
    outcome: Outcome | None = None
    for _, (_, start) in zip(range(3), kit.guesser.starts(problem, kit.integrator)):
        outcome = _collocate(problem, kit, uniform(problem, 16), start, monitor)
        if outcome.converged and (best is None or outcome.objective < best.objective):
            best = outcome
        if monitor.stopped:
            break
    best = best or outcome
    assert best is not None
    for intervals in (32, 64):
        if monitor.stopped or not best.converged:
            break
        best = _collocate(problem, kit, uniform(problem, intervals), best.path, monitor)
    return _solution(problem, kit, best, monitor)


def _collocate(problem: Problem, kit: Kit, mesh: Mesh, start: Path, monitor: Monitor) -> Outcome:
    program = kit.transcription(problem, mesh.layout)
    sizes: Scales = scales(problem, start)
    w = program.start(mesh, start, start.durations, sizes)
    return program.solve(problem, mesh, w, sizes, monitor)


def _solution(problem: Problem, kit: Kit, outcome: Outcome, monitor: Monitor) -> Solution:
    path = outcome.path
    parts = 4
    jumps = np.zeros((len(path.ua) * parts + 1, problem.n))
    jumps[::parts] = outcome.node_bounds
    jumps[parts // 2::parts] += outcome.inner_bounds.sum(axis=1)
    e = kit.integrator.extremal(problem, path.t, path.ua, path.ub, outcome.nu, parts=parts,
                                jumps=jumps)
    t = np.repeat(e.t, 2)[1:-1]
    x = np.repeat(e.x, 2, axis=0)[1:-1]
    u = np.stack([e.ua, e.ub], axis=1).reshape(-1, problem.m)
    lam = np.stack([e.lam[:-1], e.lam_before[1:]], axis=1).reshape(-1, problem.n)
    same = np.append(False, (np.diff(t) == 0) & np.all(np.diff(u, axis=0) == 0, axis=1)
                     & np.all(np.diff(lam, axis=0) == 0, axis=1))
    t, x, u, lam = t[~same], x[~same], u[~same], lam[~same]
    H, _ = kit.integrator.hamiltonian(problem, x, u, lam)
    status = Status.SOLVED if outcome.converged else Status.NOT_CONVERGED
    if monitor.stopped:
        status = Status(monitor.stopped)
    return Solution(status, outcome.status, e.cost, t, x, u, lam, H, outcome.nu,
                    iterations=monitor.iterations)


METHODS: dict[str, Callable[[Problem, Kit, Monitor], Solution]] = {
    'transcription': _transcription,
}


def solve(problem: Problem, *, method: str = 'auto', time_limit: float = 60.0,
          report: Report | None = None, cache: Cache | None = None) -> Solution:
    """
    Answer a problem; the answer is called solved only if its certificate holds.

    Parameters
    ----------
    problem : Problem
    method : str
        'auto' or one of METHODS.
    time_limit : float
        [s]
    report : callable, optional
        Called as report(phase, iteration, cost, infeasibility); True cancels.
    cache : Cache, optional
        Keeps what was built, for problems of the same structure.

    Raises
    ------
    StatementError
        If the method is unknown.

    """
    if method != 'auto' and method not in METHODS:
        raise StatementError(
            f"method '{method}' is unknown; there are auto, {', '.join(METHODS)}")
    begun = time.monotonic()
    monitor = Monitor(time_limit, report)
    kit = (cache or Cache(1)).kit(problem)
    built = time.monotonic()
    name = 'transcription' if method == 'auto' else method
    solution = METHODS[name](problem, kit, monitor)
    ended = time.monotonic()
    return replace(solution, method=name, build_time=built - begun, solve_time=ended - built)
