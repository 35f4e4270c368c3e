# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Answer an optimal control problem by the method its structure asks for, and certify the answer.
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
import time

from obc_ros.core.errors import StatementError
from obc_ros.core.monitor import Monitor
from obc_ros.core.problem import Problem
from obc_ros.core.search import Kit, Search
from obc_ros.core.solution import Report, Solution


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
            kit = Kit.of(problem)
        if key:
            self._kits[key] = kit
            if len(self._kits) > self._size:
                self._kits.popitem(last=False)
        return kit


def _transcription(problem: Problem, kit: Kit, monitor: Monitor) -> Solution:
    return Search(problem, kit, monitor).run()


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
