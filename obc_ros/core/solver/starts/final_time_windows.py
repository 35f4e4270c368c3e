# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Initial guesses with other final times: local minima of the cost over a free T.

A target that oscillates may be met a period later, and a pendulum may be swung up in more swings.
Each has its own local minimum over T. With T free a descent leads to the same one from most
guesses; with T limited to adjacent windows it leads to each.
"""

from dataclasses import replace
from itertools import islice

import casadi as ca
import numpy as np
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.starts.start import Known, Proposal, StartPool
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, Path
from obc_ros.core.solver.transcription.program import SolveEffort, TranscriptionOutcome


def has_other_lengths(bench: Bench, known: Known) -> bool:
    """Return whether T is free, and the cost depends on more than T and has one minimum in x."""
    problem = bench.problem
    return not known.uneven and known.best is not None and known.best.record is not None and (
        problem.final_time.free and bool(
            ca.depends_on(problem.L, ca.vertcat(problem.x, problem.u))
            or ca.depends_on(problem.V, problem.x)))


def find_other_lengths(bench: Bench, pool: StartPool, known: Known) -> Proposal:
    """
    Propose paths with other final times that cost less than the last outcome, cheapest first.

    The guesses of the pool are stretched in time: one for each window, two if the dynamics are
    bent.
    """
    same = bench.options.coarse.error
    assert known.best is not None and known.best.record is not None
    outcome, begun = known.best.record.outcome, bench.whole.effort
    found: list[TranscriptionOutcome] = []
    for T in [T for T in _lengths(bench, outcome) for _ in range(1 + known.bent)]:
        most = max(bench.options.multistart.hard, begun)
        if bench.meter.stopped or bench.whole.effort - begun > most:
            break
        for start in islice(pool.rest, 1):
            new = _held(bench, T, start)
            if new.converged and new.objective < outcome.objective:
                found.append(new)
    kept: list[TranscriptionOutcome] = []
    for each in sorted(found, key=lambda each: each.objective):
        if all(abs(each.objective - other.objective) > same * abs(other.objective)
               for other in kept):
            kept.append(each)
    paths = [each.path for each in kept]
    return Proposal(first=iter(paths), wanted=len(paths)) if paths else Proposal(
        why='none of them costs less')


def _lengths(bench: Bench, outcome: TranscriptionOutcome) -> list[float]:
    """Return final times at the centres of windows next to that of an outcome, longer first."""
    options = bench.options.windows
    problem, path = bench.problem, outcome.path
    final, T = problem.final_time, float(path.t[-1])
    upper = final.upper
    if not ca.depends_on(problem.V, problem.x):
        inputs = path.ua, path.ub, np.clip(0.0 * path.ua, problem.u_lower, problem.u_upper)
        least = min(float(bench.programs.integrator.hamiltonian(
            problem, path.x[:-1], u, 0.0 * path.x[:-1])[0].min()) for u in inputs)
        if least > 0:   # a lower bound of L on the path: the cost grows with T
            upper = min(upper, outcome.objective / least)
    powers = range(1, options.most + 1)
    times = [*(T * options.ratio**k for k in powers), *(T / options.ratio**k for k in powers)]
    return [each for each in times if final.lower <= each <= upper]


def _held(bench: Bench, T: float, start: Path) -> TranscriptionOutcome:
    """Solve on the coarse mesh from a guess stretched to T, with T limited to its window."""
    options = bench.options.coarse
    final, wide = bench.problem.final_time, bench.options.windows.ratio**0.5
    stretched = replace(start, t=start.t * (T / start.t[-1]), durations=np.array([T]))
    problem = replace(bench.problem, final_time=replace(
        final, lower=max(T / wide, final.lower), upper=min(T * wide, final.upper)))
    return replace(bench, problem=problem).collocate(
        build_uniform_mesh(problem, bench.intervals, bench.stages), stretched,
        effort=SolveEffort(options.iterations, options.rough, once=True))
