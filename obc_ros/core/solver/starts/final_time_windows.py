# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Where T is free and time is not all that costs: what paths of other lengths cost.

An oscillation may be met a turn later, or a pendulum pumped up in more swings: each has its own
least cost over T, and Newton's method comes back to the nearest to x(0) from most starts if T may
go anywhere. Held within windows side by side T shows all of them.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import casadi as ca
import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, Path
from obc_ros.core.solver.transcription.program import TranscriptionOutcome

_RATIO = 2**0.5     # from one window to the next
_UP, _DOWN = 6, 4   # windows, at most
_MOST, _ROUGH = 40, 1e-3   # iterations, and relative error of the cost that will do
_SAME = 1e-2        # relative: minima that are one
_KEPT = 4
_WORK = 3000


def find_other_lengths(search: Bench, starts: Iterator[Path], twice: bool) -> list[Path]:
    """
    Return paths near minima over T that may cost less than the path found last, cheapest first.

    `starts`: paths to be stretched, two of them for each window if `twice`.
    """
    if search.last is None or not _weighs(search.problem):
        return []
    outcome, begun = search.last.outcome, search.work
    found: list[TranscriptionOutcome] = []
    for T in [T for T in _lengths(search, outcome) for _ in range(1 + twice)]:
        most = max(_WORK, begun)
        if search.monitor.stopped or search.work - begun > most:
            break
        for start in islice(starts, 1):
            new = _held(search, T, start)
            if new.converged and new.objective < outcome.objective:
                found.append(new)
    kept: list[TranscriptionOutcome] = []
    for each in sorted(found, key=lambda each: each.objective):
        if all(abs(each.objective - other.objective) > _SAME * abs(other.objective)
               for other in kept):
            kept.append(each)
    return [each.path for each in kept[:_KEPT]]


def _weighs(problem: Problem) -> bool:
    """Return whether T is free and something else than time costs."""
    return problem.final_time.free and bool(
        ca.depends_on(problem.L, ca.vertcat(problem.x, problem.u))
        or ca.depends_on(problem.V, problem.x))


def _lengths(search: Bench, outcome: TranscriptionOutcome) -> list[float]:
    """Return the middle of windows beside the one of the path found last, longer ones first."""
    problem, path = search.problem, outcome.path
    final, T = problem.final_time, float(path.t[-1])
    upper = final.upper
    if not ca.depends_on(problem.V, problem.x):
        inputs = path.ua, path.ub, np.clip(0.0 * path.ua, problem.u_lower, problem.u_upper)
        least = min(float(search.kit.integrator.hamiltonian(
            problem, path.x[:-1], u, 0.0 * path.x[:-1])[0].min()) for u in inputs)
        if least > 0:   # time alone costs as much
            upper = min(upper, outcome.objective / least)
    longer = [T * _RATIO**k for k in range(1, _UP + 1)]
    shorter = [T / _RATIO**k for k in range(1, _DOWN + 1)]
    return [each for each in longer + shorter if final.lower <= each <= upper]


def _held(search: Bench, T: float, start: Path) -> TranscriptionOutcome:
    """Return what a coarse mesh gives from a start, stretched, with T in the window around one."""
    free = search.problem
    final, wide = free.final_time, _RATIO**0.5
    stretched = replace(start, t=start.t * (T / start.t[-1]), durations=np.array([T]))
    search.problem = replace(free, final_time=replace(
        final, lower=max(T / wide, final.lower), upper=min(T * wide, final.upper)))
    try:
        return search.collocate(
            build_uniform_mesh(free, search.intervals, search.stages), stretched, most=_MOST,
            rough=_ROUGH,
            once=True)
    finally:
        search.problem = free
