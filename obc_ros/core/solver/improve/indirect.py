# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Indirect refinement: Pontryagin's boundary value problem from a solution of the transcription.

Its states, costates and switching times are accurate to rounding errors. The input of a solution
is linear between samples, u* is not. The samples are moved so that the piecewise linear input has
the integral of u* in each interval, and are so dense that it differs from u* by at most a given
part of its size.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.solution import Condition, Solution, Status
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.bench import Bench, Candidate
from obc_ros.core.solver.improve.kink_mesh import build_points, solve_boundary_values


def refine_indirectly(bench: Bench, found: Candidate) -> Candidate:
    """
    Refine a solution by the indirect method.

    :param found: result of the search.
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


def _joined(found: BoundaryValues, k: Index, u: Array) -> NDArray[np.bool_]:
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
