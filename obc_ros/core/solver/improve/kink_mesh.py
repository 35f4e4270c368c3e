# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Meshes with points at the kinks of the inputs, where they meet or leave a bound.

The inputs of a transcription are linear between mesh points. A kink inside an interval causes a
loss that grows with its length, so that many short intervals are needed if the kink is not a mesh
point. Pontryagin's boundary value problem gives the kinks, from a path nearby or from the solution
of a neighbouring problem.
"""

from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues, cut_evenly
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.arcs.input_arcs import find_arcs, insert_free_arcs
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.improve.improvement import State
from obc_ros.core.solver.program_cache import Answered, ProgramCache
from obc_ros.core.solver.transcription.mesh import build_path, build_uniform_mesh, Mesh
from obc_ros.core.solver.transcription.program import Nearby, TranscriptionOutcome


def solve_boundary_values(bench: Bench, outcome: TranscriptionOutcome, *, rough: bool = False
                          ) -> BoundaryValues | None:
    """
    Solve Pontryagin's boundary value problem from an outcome, whose inputs give the arcs.

    Free arcs are inserted in which an input crosses from bound to bound within a mesh interval.

    :param rough: accept a rough solution.
    :return: None on singular arcs, for a problem that is too large, or without convergence.
    """
    problem, programs = bench.stated, bench.programs
    arcs = find_arcs(problem, outcome.path, (True,) * problem.m)
    singular = any(linear and np.isnan(level) for arc in arcs
                   for linear, level in zip(programs.switching, arc.levels, strict=True))
    if singular or outcome.mesh.layout.intervals * (6 * problem.n)**2 > 3e7:   # 240 MB
        return None
    course = bench.course(outcome)
    x, u, lam = course.points
    slopes = np.zeros((2, len(x), problem.m))
    for side, bound in enumerate((problem.u_lower, problem.u_upper)):
        for i in np.flatnonzero(np.isfinite(bound)):
            held = u.copy()
            held[:, i] = bound[i]
            slopes[side, :, i] = programs.stated_integrator.hamiltonian(
                problem, x, held, lam)[1][:, i]
    arcs = insert_free_arcs(arcs, course.t, (slopes[0], slopes[1]),
                            [not each for each in programs.switching])
    return programs.indirect.solve(problem, arcs, course, outcome.path.t, bench.sizes(outcome),
                                   rough=rough)


def build_points(found: BoundaryValues, error: float, longest: float, most: int
                 ) -> tuple[Array, Index]:
    """
    Choose mesh points for piecewise linear inputs.

    :param found: the solution; its slopes may have any size if it is not a path.
    :param error: deviation of an input from linear in an interval, relative to its size.
    :param longest: maximum length of an interval [s].
    :param most: number of intervals, besides one for each arc, above which all become longer.
    :return: t: (N + 1,), mesh points [s], the ends of the arcs among them; arc: (N,), arc of each
        interval.
    """
    size = np.maximum(np.abs(found.u).max(axis=(0, 1)), 1e-300)
    bend = np.abs(np.diff(found.du, axis=1)[:, 0]) * found.h[:, None] / size
    parts = np.maximum(np.sqrt(bend.max(axis=1) / (12 * error)), found.h / longest)
    parts = np.minimum(np.nan_to_num(parts, nan=most), most)
    parts *= min(1.0, most / parts.sum())
    return cut_evenly(parts, found.arc_of, found.h)


def start_from_neighbour(programs: ProgramCache, problem: Problem, last: Answered
                         ) -> tuple[BoundaryValues, TranscriptionOutcome] | None:
    """
    Solve the boundary value problem from that of a neighbouring problem.

    :param problem: as stated, in the symbols of `programs`.
    :param last: the neighbour.
    :return: the solution, and the same on the mesh of the neighbour stretched in time. None if the
        neighbour has no extremal, or without convergence; or where x(0) is free.
    """
    known = last.extremal
    if known is None or problem.start is not None:
        return None
    levels = np.where(known.levels == last.problem.u_lower, problem.u_lower,
                      np.where(known.levels == last.problem.u_upper, problem.u_upper, np.nan))
    found = programs.indirect.follow(problem, known, levels, last.sizes)
    if found is None:
        return None
    before, after = (np.append(0.0, np.cumsum(each.lengths)) for each in (known, found))
    t = np.interp(last.outcome.path.t, before, after)
    return found, transcribe_on_points(problem, found, t, np.searchsorted(
        after[1:-1], (t[:-1] + t[1:]) / 2))


def transcribe_on_points(problem: Problem, found: BoundaryValues, t: Array,
                         arc: Index) -> TranscriptionOutcome:
    """Return boundary values as the outcome of a transcription on mesh points `t` (N + 1,)."""
    n, T = problem.n, t[-1]
    za, ua = found.at(*found.where(t[:-1], arc))
    zb, ub = found.at(*found.where(t[1:], arc))
    ua, ub = (np.clip(np.where(np.isnan(found.levels[arc]), u, found.levels[arc]),
                      problem.u_lower, problem.u_upper) for u in (ua, ub))
    z = np.vstack([za, zb[-1:]])
    mesh = Mesh(build_uniform_mesh(problem, len(arc), 0).layout, np.diff(t) / T,
                np.zeros((1, problem.m)))
    l = int(problem.path.numel())  # noqa: E741  # as in Outcome
    path = build_path(t, z[:, :n], ua, ub)
    return TranscriptionOutcome(
        mesh=mesh, path=path, converged=True, status='extremal', objective=found.cost,
        infeasibility=0.0, iterations=0, nu=found.nu, costates=z[:, n:],
        node_bounds=np.zeros((len(t), n)), inner_bounds=np.zeros((len(arc), 0, n)),
        node_path=np.zeros((len(t), l)), inner_path=np.zeros((len(arc), 0, l)),
        sides_path=np.zeros((len(arc), 2, l)), w=np.zeros(0), lam_w=np.zeros(0),
        lam_g=np.zeros(0), mu=0.0)


def may_have_kinks(state: State) -> bool:
    """Return whether the kinks of free inputs are looked for, once in a descent."""
    bench, layout = state.bench, state.outcome.mesh.layout
    return state.extremal is None and not any(state.switching) and not (
        bench.bounded or bench.programs.twin or len(layout.phases) > 1 or layout.stages)


def solve_on_kinks(state: State) -> State | str:
    """
    Solve on a mesh with a point at each kink of the inputs.

    The outcome must cost about the same. Its state has the extremal whose kinks are mesh points.
    """
    bench, outcome = state.bench, state.outcome
    found = solve_boundary_values(bench, outcome, rough=True)
    if found is None or len(found.lengths) == 1:
        return 'no extremal with kinks was found'
    longest = outcome.path.t[-1] / (2 * bench.options.coarse.intervals)
    # In an interval an input may deviate from linear by 0.4 % of its size.
    guide = transcribe_on_points(bench.stated, found, *build_points(
        found, 4e-3, longest, 2 * bench.meter.max_intervals))
    if not bench.meter.allows(guide.mesh.layout.intervals):
        return 'it would have too many intervals'
    new = bench.collocate(guide.mesh, guide.path, near=Nearby(bench.sizes(outcome), guide=guide))
    if not new.converged or is_below(outcome.objective, new.objective, bench.options.bangs.room):
        return 'its cost is higher' if new.converged else new.status
    return replace(state, outcome=new, extremal=found)
