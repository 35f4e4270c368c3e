# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Solution of an optimal control problem, with certificate.

A method finds a path and its costates (`methods`): by default exact methods, then proofs that
there is no path, then a search. The certificate is computed from the problem and the path alone,
and decides the status. Without one, the reason is looked for (`conclusion`).
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
import time

import numpy as np
from obc_ros.core.ocp.method_names import get_method
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Attempt, MAX_INTERVALS, Report, Solution
from obc_ros.core.solver.bench import Task
from obc_ros.core.solver.best_path import BestPath
from obc_ros.core.solver.conclusion import conclude, mark_unfinished
from obc_ros.core.solver.methods import METHODS
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.options import DEFAULTS, Options
from obc_ros.core.solver.program_cache import ProgramCache


class Cache:
    """The program caches of the structures solved last, at most `size` of them."""

    def __init__(self, size: int = 32) -> None:
        self._size = size
        self._caches: OrderedDict[str, ProgramCache] = OrderedDict()

    def prepared(self, problem: Problem, options: Options) -> tuple[Problem, ProgramCache]:
        """
        Return a problem in the symbols of the program cache of its structure, and this cache.

        Parameters
        ----------
        problem : Problem
            Without a `structure` its programs are not kept.
        options : Options
            Of the search; programs with other options are built anew.

        Returns
        -------
        problem : Problem
        programs : ProgramCache

        """
        key = problem.structure
        programs = self._caches.pop(key, None) if key else None
        if programs is None or programs.options != options:
            programs = ProgramCache(problem, options)
        if key:
            self._caches[key] = programs
            if len(self._caches) > self._size:
                self._caches.popitem(last=False)
        return programs.restated(problem), programs


@np.errstate(all='ignore')   # the certificate rejects a path with an overflow
def solve(problem: Problem, *, method: str = '', time_limit: float = 60.0,
          report: Report | None = None, cache: Cache | None = None,
          max_intervals: int = MAX_INTERVALS,
          keep: Callable[[Solution], None] | None = None,
          note: Callable[[tuple[Attempt, ...]], None] | None = None,
          options: Options = DEFAULTS) -> Solution:
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
    note : callable, optional
        Called with the attempts so far when another one begins, for the same caller.
    options : Options
        Numbers that steer the search.

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
    name, begun = get_method(method or problem.method), time.monotonic()
    # Time for the certificate, and with state constraints for a path within them.
    kept = options.budget.certificate * time_limit
    if not problem.constrained:
        kept = min(kept, options.budget.least)
    meter = Meter(time_limit - kept, report, max_intervals, kept=kept)
    problem, programs = (cache or Cache(1)).prepared(problem, options)
    best = None if keep is None else BestPath(problem, lambda path: keep(replace(
        mark_unfinished(path), attempts=meter.trace.attempts())))
    if note is not None:
        meter.trace.watch(lambda: note(meter.trace.attempts()))
    task = Task(problem, programs, meter, time_limit, best)
    found = conclude(task, METHODS[name](task))
    built = programs.take_build_time()
    return replace(found, method=found.method or name, iterations=meter.iterations,
                   attempts=meter.trace.attempts(), build_time=built,
                   solve_time=time.monotonic() - begun - built)
