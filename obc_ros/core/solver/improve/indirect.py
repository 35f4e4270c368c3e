# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Pontryagin's boundary value problem from a path of the transcription, for two purposes.

Indirect refinement: its states, costates and switching times are accurate to rounding errors. The
input of a solution is linear between samples, u* is not. The samples are moved so that the
piecewise linear input has the integral of u* in each interval, and are so dense that it differs
from u* by at most a given part of its size.

Meshes with points at the kinks of the inputs, where they meet or leave a bound: a kink inside an
interval causes a loss that grows with its length, so that many short intervals are needed if the
kink is not a mesh point. The kinks are found from a path nearby or from the solution of a
neighbouring problem.
"""

from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, Mask
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Condition, Solution, Status
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues, cut_evenly
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.arcs.input_arcs import find_arcs, insert_free_arcs
from obc_ros.core.solver.bench import Bench, Candidate, State
from obc_ros.core.solver.program_cache import Answered, ProgramCache
from obc_ros.core.solver.transcription.mesh import build_path, build_uniform_mesh
from obc_ros.core.solver.transcription.program import Nearby, TranscriptionOutcome


def refine_indirectly(bench: Bench, found: Candidate) -> Candidate:
    """
    Refine a solution by the indirect method.

    :return: with a certified solution from the boundary value problem; otherwise with that of
        `found`, and the reason in its message if the method does not apply or did not converge.
    """
    if found.record is None:
        return found
    outcome, known = found.record.outcome, found.record.extremal
    if bench.programs.twin or bench.course(outcome).density_x is not None:
        reason = ('the indirect method does not treat active state bounds, path constraints or '
                  'absolute values')
    else:
        values = (solve_boundary_values(bench, outcome) if known is None
                  else bench.programs.indirect.refined(bench.stated, known, outcome.path.t,
                                                       bench.sizes(outcome)))
        if values is not None:
            return _better(bench, found, values, bench.options.indirect.precise)
        reason = ('the indirect method found no extremal on which every input is at a bound or '
                  'has dH/du = 0')
    return replace(found, solution=replace(
        found.solution, message=f'solved by transcription: {reason}'))


def _better(bench: Bench, known: Candidate, found: BoundaryValues, wanted: float) -> Candidate:
    """Return the solution sampled from boundary values if it is certified, else `known`."""
    new, answer = _sampled(bench, found, wanted), known.solution
    judged = answer.certificate
    if judged is not None and judged.feasible:
        # An extremal costs no more than a path near it, up to the errors of that path.
        error = 1e-8 + judged.residuals[Condition.DYNAMICS] + judged.residuals[Condition.END]
        if new.objective > answer.objective + error * abs(answer.objective):
            return known
    new = replace(new, certificate=certify(bench.stated, new), optimality=answer.optimality)
    assert new.certificate is not None
    return replace(known, solution=new) if new.certificate.holds else known


def _sampled(bench: Bench, found: BoundaryValues, wanted: float) -> Solution:
    """Return boundary values as samples, including both ends of each arc."""
    problem = bench.stated
    longest = found.lengths.sum() / (2 * bench.options.coarse.intervals)   # as of other meshes
    points_, of = build_points(found, wanted, longest, most=4000)
    # Places of the start of each interval, and of the end of each arc, among the samples.
    starts, last = np.arange(len(of)) + of, np.flatnonzero(np.diff(of, append=-1))
    t, arc = np.empty(len(of) + len(last)), np.empty(len(of) + len(last), dtype=np.int64)
    t[starts], arc[starts] = points_[:-1], of
    t[starts[last] + 1], arc[starts[last] + 1] = points_[last + 1], of[last]
    k, part = found.where(t, arc)
    z, u = found.at(k, part)
    x, lam = z[:, :problem.n], z[:, problem.n:]
    free = found.free[k]
    for _ in range(2):
        _, Hu, Huu = bench.programs.stated_integrator.hamiltonian(problem, x, u, lam)
        whole = np.where(free[:, :, None], Huu, np.eye(problem.m))
        u = u - np.linalg.solve(whole, np.where(free, Hu, 0.0)[:, :, None])[:, :, 0]
    off, drift = _in_the_mean(found, t, arc)
    u = u + off
    by_u = (1 - part)[:, None, None] * found.by_u[k, 0] + part[:, None, None] * found.by_u[k, 1]
    z = z + np.einsum('kzj,kj->kz', by_u, drift)
    x, lam = z[:, :problem.n], z[:, problem.n:]
    u = np.clip(u, problem.u_lower, problem.u_upper)
    new = _joined(found, k, u)
    t, x, u, lam = problem.final_time.place_end(t[new]), x[new], u[new], lam[new]
    H, _, _ = bench.programs.stated_integrator.hamiltonian(problem, x, u, lam)
    return Solution(
        status=Status.NOT_CONVERGED, message='', objective=found.cost, t=t, x=x, u=u, lam=lam,
        hamiltonian=H, nu=found.nu, switching_times=np.cumsum(found.lengths)[:-1],
        iterations=bench.meter.iterations)


def _in_the_mean(found: BoundaryValues, t: Array, arc: Index) -> tuple[Array, Array]:
    """
    Return the shifts of the samples from u*, and the integral of the error of the interpolation.

    The interpolation of u* itself has a mean error of h^2/12 times its second derivative. In each
    arc the samples are shifted so that the interpolation has the integral of u*.
    """
    off, drift = np.zeros((len(t), found.u.shape[2])), np.zeros((len(t), found.u.shape[2]))
    free = np.isnan(found.levels)
    for number, of in enumerate(free):
        rows = np.flatnonzero(arc == number)
        times = t[rows]
        length = np.diff(times)[:, None]
        k, part = found.where((times[:-1] + times[1:]) / 2, arc[rows[:-1]])
        lost = found.bend(k, part) * length**3 / 24
        share = np.vstack([lost, np.zeros(off.shape[1])])
        share[1:] += lost
        # An input that meets a bound at the end of an arc stays there: its neighbour is shifted.
        for end, beside, meets in ((0, 1, number - 1), (-1, -2, number + 1)):
            if 0 <= meets < len(free) and len(rows) > 2:
                share[beside] += np.where(free[meets], 0.0, share[end])
                share[end] = np.where(free[meets], share[end], 0.0)
        mass = np.append(length, 0.0) / 2
        mass[1:] += length[:, 0] / 2
        # After rounding, two times may coincide.
        move = np.divide(-share, mass[:, None], out=np.zeros_like(share),
                         where=of & (mass > 0)[:, None])
        off[rows] = move
        drift[rows[1:]] = np.where(of, np.cumsum(
            length * (move[1:] + move[:-1]) / 2 + 2 * lost, axis=0), 0.0)
    return off, drift


def _joined(found: BoundaryValues, k: Index, u: Array) -> Mask:
    """Make inputs that do not jump between arcs equal, in place; return which samples to keep."""
    new = np.ones(len(k), dtype=bool)
    size = np.abs(found.u).max(axis=(0, 1))
    for row in np.flatnonzero(np.diff(found.arc_of[k]) > 0):
        a, b = k[row], k[row + 1]
        same = np.abs(found.u[a, 1] - found.u[b, 0]) <= 1e-9 * size   # rounding
        held = np.where(found.free[a], u[row + 1], u[row])
        both = found.free[a] & found.free[b]
        value = np.where(both, (u[row] + u[row + 1]) / 2, held)
        u[row] = np.where(same, value, u[row])
        u[row + 1] = np.where(same, value, u[row + 1])
        new[row + 1] = not np.all(same)
    return new


def solve_boundary_values(bench: Bench, outcome: TranscriptionOutcome, *, rough: bool = False
                          ) -> BoundaryValues | None:
    """
    Solve Pontryagin's boundary value problem from an outcome, whose inputs give the arcs.

    Free arcs are inserted in which an input crosses from bound to bound within a mesh interval.

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
    """
    Return boundary values as the outcome of a transcription on mesh points `t` (N + 1,).

    A problem that has an extremal with kinks has no path constraints.
    """
    n, N, none = problem.n, len(arc), np.zeros(0)
    za, ua = found.at(*found.where(t[:-1], arc))
    zb, ub = found.at(*found.where(t[1:], arc))
    ua, ub = (np.clip(np.where(np.isnan(found.levels[arc]), u, found.levels[arc]),
                      problem.u_lower, problem.u_upper) for u in (ua, ub))
    z = np.vstack([za, zb[-1:]])
    return TranscriptionOutcome(
        mesh=replace(build_uniform_mesh(problem, N, 0), fractions=np.diff(t) / t[-1]),
        path=build_path(t, z[:, :n], ua, ub), converged=True, status='extremal',
        objective=found.cost, infeasibility=0.0, iterations=0, nu=found.nu, costates=z[:, n:],
        node_bounds=np.zeros((N + 1, n)), inner_bounds=np.zeros((N, 0, n)),
        node_path=np.zeros((N + 1, 0)), inner_path=np.zeros((N, 0, 0)),
        sides_path=np.zeros((N, 2, 0)), w=none, lam_w=none, lam_g=none, mu=0.0)


def may_have_kinks(state: State) -> bool:
    """Return whether the kinks of free inputs are looked for, once in a descent."""
    bench, layout = state.bench, state.outcome.mesh.layout
    return state.extremal is None and not any(state.switching) and not (
        bench.stated.constrained or bench.stated.breaks.size or bench.programs.twin
        or len(layout.phases) > 1 or layout.stages)


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
