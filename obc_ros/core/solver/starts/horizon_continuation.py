# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Horizon continuation: the problem is solved over a short horizon, then over horizons twice as long.

A coarse mesh does not resolve many periods of an oscillation. Without terminal constraints the
solution over half of the horizon, continued with its last samples, is close to that over the whole
horizon if the state has come to rest.
"""

from dataclasses import replace

import numpy as np
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.starts.start import Known, Proposal, StartPool
from obc_ros.core.solver.transcription.mesh import (
    build_path,
    build_uniform_mesh,
    Layout,
    Mesh,
    Path,
    Phase,
)
from obc_ros.core.solver.transcription.program import SolveEffort, TranscriptionOutcome


def has_open_end(bench: Bench, _: Known) -> bool:
    """Return whether T is fixed and the end free; a convex problem needs no other outcome."""
    problem = bench.problem
    return not (bench.quick or problem.q or problem.final_time.free or bench.programs.twin
                or bench.programs.convex(problem))


def continue_horizon(bench: Bench, _: StartPool, __: Known) -> Proposal:
    """Propose the outcome of horizon continuation."""
    outcome = lengthen_horizon(bench, bench.options.coarse.intervals)
    return Proposal(outcomes=() if outcome is None else (outcome,))


def lengthen_horizon(bench: Bench, intervals: int) -> TranscriptionOutcome | None:
    """
    Solve over longer and longer horizons up to [0, T], each longer by at least `intervals`.

    None is returned if no outcome with a small discretisation error was reached.
    """
    whole, final = bench.problem, bench.problem.final_time
    start = bench.programs.guesser.line(whole, final.value)
    outcome: TranscriptionOutcome | None = None
    bench = replace(bench, meter=bench.meter.part(bench.options.horizon.work))
    most = 6   # halvings: 1/64 of T at first
    for halvings in range(most, -1, -1):
        length = final.value / 2**halvings
        bench = replace(bench, problem=replace(whole, final_time=replace(final, value=length)))
        if outcome is None:
            mesh = build_uniform_mesh(bench.problem, intervals, bench.stages)
            path = replace(start, t=start.t / 2**halvings, durations=np.array([length]))
        else:
            mesh, path = _longer(bench, outcome, intervals, length)
        bench, outcome = _solve_finely(bench, mesh, path)
        if outcome is None and halvings < most:
            break
    return outcome


def _solve_finely(bench: Bench, mesh: Mesh,
                  path: Path) -> tuple[Bench, TranscriptionOutcome | None]:
    """
    Solve on finer and finer meshes until the discretisation error is small.

    Return the bench with its bounds tightened, and the outcome, None if the error is not small.
    """
    most = bench.options.descent.meshes
    for number in range(most):
        if bench.meter.stopped or not bench.meter.allows(mesh.layout.intervals):
            break
        outcome = bench.collocate(
            mesh, path, effort=SolveEffort(bench.options.coarse.iterations))
        if not outcome.converged:
            break
        if bench.is_accurate(outcome):
            return bench, outcome
        if number < most - 1:
            course = bench.course(outcome)
            bench, exceeded = bench.tighten(course)
            mesh, path = bench.finer(outcome, course, exceeded), outcome.path
    return bench, None


def _longer(bench: Bench, outcome: TranscriptionOutcome, intervals: int,
            length: float) -> tuple[Mesh, Path]:
    """Return a mesh and a path over a longer horizon, continued with the last samples."""
    problem, known = bench.problem, outcome.path
    intervals = max(intervals, int(np.count_nonzero(known.t > length / 4)))   # no coarser
    t = np.linspace(known.t[-1], length, intervals + 1)
    points = np.append(known.t, t[1:])
    x, held = (np.tile(last, (intervals, 1)) for last in (known.x[-1], known.ub[-1]))
    path = build_path(points, np.vstack([known.x, x]), np.vstack([known.ua, held]),
                      np.vstack([known.ub, held]), np.array([length]))
    before = outcome.mesh.layout
    phase = Phase(len(points) - 1, before.phases[0].modes)
    layout = Layout((phase,), before.stages, before.free_time)
    return Mesh(layout, np.diff(points) / length, np.zeros((1, problem.m))), path
