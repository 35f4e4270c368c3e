# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Global minimisation of H where it has several local minima in an input, such as gears or modes.

A descent follows the local minimum of H at which it starts, although another one may be lower.
Here inputs are moved to the global minimum (needle variations, as in the proof of Pontryagin's
principle) and the problem is solved from there. Phases begin where inputs then jump from one
minimum to another.
"""

from dataclasses import replace
from functools import partial
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.numerics.collocation import compute_gauss_points
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.arcs.control_discontinuities import APART, find_jumps, SLIGHT_JUMP
from obc_ros.core.solver.arcs.input_arcs import Arc, have_moved
from obc_ros.core.solver.bench import Bench, State
from obc_ros.core.solver.improve.arc_iteration import solve_on_arcs
from obc_ros.core.solver.transcription.local_minima import ANOTHER, CHEAPER
from obc_ros.core.solver.transcription.mesh import Path
from obc_ros.core.solver.transcription.program import Nearby, SolveEffort, TranscriptionOutcome

_VALUES = 17   # of an input, at which H is evaluated


def has_branches(state: State) -> bool:
    """Return whether H may have several local minima in an input."""
    programs = state.bench.programs
    return not (state.bench.quick or programs.twin) and bool(programs.branching.any())


def move_to_best_branch(state: State) -> State | str:
    """Move inputs to the global minimum of H and solve from there, while the cost decreases."""
    bench = state.bench
    best = outcome = state.outcome
    for _ in range(bench.options.bangs.solves):
        paths = _moved(bench, best)
        if not paths and best is outcome:
            best = _with_jumps(bench, best) if _leaps(bench, best) else best
            break
        found = [new for path in paths if (new := _from_inputs(bench, best, path)) is not None]
        new = min(found, key=lambda each: each.objective, default=best)
        if bench.meter.stopped or not is_below(new.objective, best.objective, CHEAPER):
            break
        best = _with_jumps(bench, new)
    return 'H has no lower minimum' if best is outcome else replace(state, outcome=best)


def _moved(bench: Bench, outcome: TranscriptionOutcome) -> list[Path]:
    """Return paths with inputs at the minimum of H, in all intervals that gain and in fewer."""
    path, every = outcome.path, np.arange(len(outcome.path.ua))
    for rows in (every[::max(1, len(every) // 8)], every):   # a glance at 8 intervals first
        least, gap = _least(bench, outcome, rows)
        if not gap.any():
            return []
    if not np.diff(path.t) @ gap > ANOTHER * abs(outcome.objective):
        return []
    # All inputs that gain move, or those that gain most.
    chosen = [(gap > share * gap.max())[:, None] for share in (0.0, 0.3, 0.7)]
    return [replace(path, ua=np.where(moved, least, path.ua), ub=np.where(moved, least, path.ub))
            for moved in chosen]


def _least(bench: Bench, outcome: TranscriptionOutcome, rows: Index) -> tuple[Array, Array]:
    """Return the minimiser of H in some intervals, (N, m), and the decrease of H, (N,)."""
    problem, path = bench.problem, outcome.path
    H = partial(_mean_H, bench, bench.course(outcome), rows)
    now = H(path.ua[rows], path.ub[rows])
    value, least = now.copy(), (path.ua[rows] + path.ub[rows]) / 2
    for j in np.flatnonzero(bench.programs.branching):
        levels = np.linspace(problem.u_lower[j], problem.u_upper[j], _VALUES)
        tried = np.repeat(least[None], _VALUES, axis=0)
        tried[:, :, j] = levels[:, None]
        there = H(tried, tried)
        k = np.argmin(np.where(np.isfinite(there), there, np.inf), axis=0)
        lowest = there[k, np.arange(len(k))]
        # If H only decreases on the way, the present input is no local minimum but inaccurate.
        between = (levels[:, None] - least[:, j]) * (levels[:, None] - levels[k]) < 0
        lower = (lowest < value) & np.any(between & (there > value), axis=0)
        least[lower, j], value[lower] = levels[k[lower]], lowest[lower]
    return least, np.where(value < now, now - value, 0.0)


def _mean_H(bench: Bench, course: Extremal, rows: Index, ua: Array, ub: Array) -> Array:
    """Return the mean of H (..., N) at the ends of intervals, with inputs (..., N, m) there."""
    first = rows * course.parts
    last = first + course.parts - 1
    x, lam = (np.stack([one[first], other[last]]) for one, other in (
        (course.x, course.x_end), (course.lam, course.lam_end)))
    u = np.stack([ua, ub], axis=-3)
    points = (np.broadcast_to(each, (*u.shape[:-1], each.shape[-1])).reshape(-1, each.shape[-1])
              for each in (x, u, lam))
    H = bench.programs.integrator.hamiltonian(bench.problem, *points)[0].reshape(u.shape[:-1])
    return np.asarray(H.mean(axis=-2))


def _from_inputs(bench: Bench, outcome: TranscriptionOutcome,
                 path: Path) -> TranscriptionOutcome | None:
    problem, h = bench.problem, np.diff(path.t)
    steps = np.maximum(1, np.ceil(40 * h / h.max())).astype(np.int64)   # of the integration
    t = np.append(0.0, np.cumsum(np.repeat(h / steps, steps)))
    held = np.repeat((path.ua + path.ub) / 2, steps, axis=0)
    with np.errstate(all='ignore'):
        (x,), _ = bench.programs.integrator.forward_each(
            problem.pin_start(path.x[0]), t[None], held[None])
    # With terminal constraints the states of the path stay: those of the new inputs violate them.
    if np.isfinite(x).all() and not problem.q:
        inner = path.t[:-1, None] + h[:, None] * compute_gauss_points(path.inner.shape[1])
        path = replace(path, x=x[np.append(0, np.cumsum(steps))],
                       inner=interpolate_columns(inner, t, x))
    new = bench.collocate(outcome.mesh, path, near=Nearby(),
                          effort=SolveEffort(bench.options.coarse.iterations))
    return new if new.converged else None


def _leaps(bench: Bench, outcome: TranscriptionOutcome) -> bool:
    """Return whether an input jumps between local minima of H that are not both at bounds."""
    problem, path, here = bench.problem, outcome.path, bench.programs.branching
    jumps = find_jumps(path, here.tolist(), bench.options.bangs.jump)
    at = np.clip(np.searchsorted(path.t, jumps) - 1, 0, len(path.ua) - 1)
    if not at.size:
        return False
    before, after = path.ua[np.maximum(at - 1, 0)], path.ub[np.minimum(at + 1, len(path.ub) - 1)]
    part = np.linspace(0.0, 1.0, _VALUES)[:, None, None]
    along = before + part * (after - before)
    H = _mean_H(bench, bench.course(outcome), at, along, along)
    wall = H.max(axis=0) > np.maximum(H[0], H[-1])
    ends = np.stack([before, after])[:, :, here]
    room = SLIGHT_JUMP * (problem.u_upper - problem.u_lower)[here]
    free = (ends > problem.u_lower[here] + room) & (ends < problem.u_upper[here] - room)
    return bool(np.any(wall & free.any(axis=(0, 2))))


def _with_jumps(bench: Bench, outcome: TranscriptionOutcome) -> TranscriptionOutcome:
    """
    Solve with phases that begin where inputs jump, until these times do not change.

    The input next to the end of a phase may stay at the minimum of H of the other side, which is a
    slope over an interval. The end of the phase is then moved to that interval.
    """
    for _ in range(bench.options.bangs.solves):
        path, arcs = outcome.path, _apart(bench, outcome)
        if len(arcs) == len(path.durations) and not have_moved(
                arcs, path.durations, bench.options.bangs.vanishing):
            break
        new = solve_on_arcs(bench, arcs, outcome, len(path.ua))
        if new is None or is_below(outcome.objective, new.objective, CHEAPER):
            break
        outcome = new
    return outcome


def _apart(bench: Bench, outcome: TranscriptionOutcome) -> list[Arc]:
    """Return arcs that begin where inputs jump, at the ends of phases or in steep intervals."""
    problem, path, here = bench.problem, outcome.path, bench.programs.branching
    first = np.flatnonzero(np.diff(outcome.mesh.layout.phase_of)) + 1
    ends, least = path.t[first], bench.options.bangs.vanishing * path.t[-1]
    span = (problem.u_upper - problem.u_lower)[here]
    found = find_jumps(path, here.tolist(), bench.options.bangs.jump)
    times = found.tolist()
    for group in filter(len, np.split(first, np.flatnonzero(np.diff(ends) > least) + 1)):
        jump = path.ua[group[-1], here] - path.ub[group[0] - 1, here]
        end = float(path.t[group].mean())
        near = APART * max(path.t[group[-1] + 1] - end, end - path.t[group[0] - 1])
        if np.any(np.abs(jump) > SLIGHT_JUMP * span) and np.all(np.abs(found - end) > near):
            times.append(end)
    arcs, start, free = list[Arc](), 0.0, (math.nan,) * problem.m
    for end in sorted(times):
        if start + least < end < path.t[-1] - least:
            arcs.append(Arc(start, end, free, jump=start > 0))
            start = end
    return [*arcs, Arc(start, float(path.t[-1]), free, jump=start > 0)]
