# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The indirect method: Pontryagin's boundary value problem from an answer of the transcription.

Its states, costates and switching times are exact to rounding. The input between the samples of
an answer is linear, which u* is not: returned is the linear one nearest to u* in the mean, which
moves the states as u* does, on samples so dense that it is off u* by at most a given part of its
size.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.solution import Condition, Solution, Status
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.improve.kink_mesh import build_points, solve_boundary_values
from obc_ros.core.solver.program_cache import Answered

_PRECISE, _QUICK = 2e-7, 1e-5   # of its size: how far u may be off u*, alone and after a search
_FEWEST_SAMPLES, _MOST_SAMPLES = 64, 4000
_WORTH_IT = 800   # iterations times intervals
_LEAST = 0.5       # [s] without which an answer is left as it is
_SAME = 1e-9       # of its size: inputs on both sides of a switch that does not jump
_DEARER = 1e-8     # relative: by how much an answer may seem to cost more


def refine_indirectly(search: Bench, answer: Solution) -> Solution:
    """Return the indirect answer near one found by a search, or that one with the reason."""
    if search.last is None:
        return answer
    if not _smooth(search, search.last):
        return replace(answer, message='answered by transcription: indirect does without active '
                                       'state bounds, path constraints and absolute values')
    found = _boundary_values(search)
    if found is None:
        return replace(answer, message='answered by transcription: no extremal was found from it '
                                       'on which the inputs are at bounds or make dH/du zero')
    return _better(search, answer, found, _PRECISE)


def refine_after_search(search: Bench, answer: Solution) -> Solution:
    """
    Return the indirect answer near one found by a search, or that one.

    Where an answer is found so soon that this would take longer it is left as it is.
    """
    kit = search.kit
    if (search.last is None or search.nearby or search.work < _WORTH_IT and not kit.touched_up
            or search.monitor.remaining() < _LEAST or not _smooth(search, search.last)):
        return answer
    found = _boundary_values(search)
    if found is None:
        return answer
    for wanted in (_QUICK, _PRECISE):
        new = _better(search, answer, found, wanted)
        if new is not answer:
            kit.touched_up = True
            break
    return new


def _smooth(search: Bench, last: Answered) -> bool:
    """Return whether neither bounds of the state nor kinks say what the extremal is."""
    return not search.kit.twin and search.course(last.outcome).density_x is None


def _boundary_values(search: Bench) -> BoundaryValues | None:
    """Return the solution of the boundary value problem near what a search found last."""
    assert search.last is not None
    outcome, known = search.last.outcome, search.last.extremal
    if known is not None:
        return search.kit.indirect.refined(
            search.stated, known, outcome.path.t, search.sizes(outcome))
    return solve_boundary_values(search.kit, search.stated, outcome, search.course(outcome),
                                 search.sizes(outcome))


def _better(search: Bench, answer: Solution, found: BoundaryValues, wanted: float) -> Solution:
    """Return the answer made of boundary values if its certificate holds, else the other."""
    new = _sampled(search, found, wanted)
    judged = answer.certificate
    if judged is not None and judged.feasible:
        # An extremal costs no more than a path beside it, but for the errors of that path.
        error = _DEARER + judged.residuals[Condition.DYNAMICS] + judged.residuals[Condition.END]
        if new.objective > answer.objective + error * abs(answer.objective):
            return answer
    new = replace(new, certificate=certify(search.stated, new))
    assert new.certificate is not None
    return new if new.certificate.holds else answer


def _sampled(search: Bench, found: BoundaryValues, wanted: float) -> Solution:
    """Return boundary values as samples, with those at both ends of each arc."""
    problem, longest = search.stated, found.lengths.sum() / _FEWEST_SAMPLES
    points_, of = build_points(found, wanted, longest, _MOST_SAMPLES)
    # Where the start of each interval, and the end of each arc, stand in a row.
    starts, last = np.arange(len(of)) + of, np.flatnonzero(np.diff(of, append=-1))
    t, arc = np.empty(len(of) + len(last)), np.empty(len(of) + len(last), dtype=np.int64)
    t[starts], arc[starts] = points_[:-1], of
    t[starts[last] + 1], arc[starts[last] + 1] = points_[last + 1], of[last]
    k, part = found.where(t, arc)
    z, u = found.at(k, part)
    x, lam = z[:, :problem.n], z[:, problem.n:]
    free = found.free[k]
    for _ in range(2):
        _, Hu, Huu = search.kit.judge.hamiltonian(problem, x, u, lam)
        whole = np.where(free[:, :, None], Huu, np.eye(problem.m))
        u = u - np.linalg.solve(whole, np.where(free, Hu, 0.0)[:, :, None])[:, :, 0]
    off, drift = _in_the_mean(found, t, arc)
    u = u + off
    by_u = (1 - part)[:, None, None] * found.by_u[k, 0] + part[:, None, None] * found.by_u[k, 1]
    z = z + np.einsum('kzj,kj->kz', by_u, drift)
    x, lam = z[:, :problem.n], z[:, problem.n:]
    u = np.clip(u, problem.u_lower, problem.u_upper)
    new = _joined(found, k, u)
    t, x, u, lam = t[new], x[new], u[new], lam[new]
    H, _, _ = search.kit.judge.hamiltonian(problem, x, u, lam)
    return Solution(
        status=Status.NOT_CONVERGED, message='', objective=found.cost, t=t, x=x, u=u, lam=lam,
        hamiltonian=H, nu=found.nu, switching_times=np.cumsum(found.lengths)[:-1],
        iterations=search.monitor.iterations)


def _in_the_mean(found: BoundaryValues, t: Array, arc: Index) -> tuple[Array, Array]:
    """
    Return by how much samples are off u*, and the integral of what their interpolation is off.

    Samples of u* itself would be off it by h^2/12 of its second derivative in the mean, always
    to the same side; in each arc they are moved so that the interpolation has the integral of u*.
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
        # Where an input comes to a bound it is at the bound: its neighbour is moved instead.
        for end, beside, meets in ((0, 1, number - 1), (-1, -2, number + 1)):
            if 0 <= meets < len(free) and len(rows) > 2:
                share[beside] += np.where(free[meets], 0.0, share[end])
                share[end] = np.where(free[meets], share[end], 0.0)
        mass = np.append(length, 0.0) / 2
        mass[1:] += length[:, 0] / 2
        # Between rounded times there may be none.
        move = np.divide(-share, mass[:, None], out=np.zeros_like(share),
                         where=of & (mass > 0)[:, None])
        off[rows] = move
        drift[rows[1:]] = np.where(of, np.cumsum(
            length * (move[1:] + move[:-1]) / 2 + 2 * lost, axis=0), 0.0)
    return off, drift


def _joined(found: BoundaryValues, k: Index, u: Array) -> NDArray[np.bool_]:
    """Make inputs that do not jump between arcs the same, in place; return which samples stay."""
    new = np.ones(len(k), dtype=bool)
    size = np.abs(found.u).max(axis=(0, 1))
    for row in np.flatnonzero(np.diff(found.arc_of[k]) > 0):
        a, b = k[row], k[row + 1]
        same = np.abs(found.u[a, 1] - found.u[b, 0]) <= _SAME * size
        held = np.where(found.free[a], u[row + 1], u[row])
        both = found.free[a] & found.free[b]
        value = np.where(both, (u[row] + u[row + 1]) / 2, held)
        u[row] = np.where(same, value, u[row])
        u[row + 1] = np.where(same, value, u[row + 1])
        new[row + 1] = not np.all(same)
    return new
