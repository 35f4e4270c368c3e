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
from obc_ros.core.arcs import find_arcs
from obc_ros.core.certificate import certify
from obc_ros.core.indirect import BoundaryValues
from obc_ros.core.kit import Answered
from obc_ros.core.search import Search
from obc_ros.core.solution import Solution, Status
from scipy.linalg import solve_banded

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_PRECISE, _QUICK = 2e-7, 1e-5   # of its size: how far u may be off u*, alone and after a search
_FEWEST_SAMPLES, _MOST_SAMPLES = 64, 4000
_WORTH_IT = 1000   # iterations times intervals
_LEAST = 0.5       # [s] without which an answer is left as it is
_LARGEST = 3e7     # entries of the matrices of all intervals
_SAME = 1e-9       # of its size: inputs on both sides of a switch that does not jump
_DEARER = 1e-8     # relative: by how much an answer may seem to cost more


def polished(search: Search, answer: Solution) -> Solution:
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
    return _better(search, answer, found, _counts(found, _PRECISE))


def touched_up(search: Search, answer: Solution) -> Solution:
    """
    Return the indirect answer near one found by a search, or that one.

    Where an answer is found so soon that this would take longer it is left as it is.
    """
    kit = search.kit
    if (search.last is None or search.work < _WORTH_IT and not kit.touched_up
            or search.monitor.remaining() < _LEAST or not _smooth(search, search.last)):
        return answer
    found = _boundary_values(search)
    if found is None:
        return answer
    for wanted in (_QUICK, _PRECISE):
        new = _better(search, answer, found, _counts(found, wanted))
        if new is not answer:
            kit.touched_up = True
            break
    return new


def _smooth(search: Search, last: Answered) -> bool:
    """Return whether neither bounds of the state nor kinks say what the extremal is."""
    return not search.kit.twin and search.course(last.outcome).density_x is None


def _boundary_values(search: Search) -> BoundaryValues | None:
    """Return the solution of the boundary value problem near what a search found last."""
    assert search.last is not None
    problem, outcome = search.stated, search.last.outcome
    arcs = find_arcs(problem, outcome.path, (True,) * problem.m)
    singular = any(linear and np.isnan(level) for arc in arcs
                   for linear, level in zip(search.kit.switching, arc.levels, strict=True))
    if singular or outcome.mesh.layout.intervals * (6 * problem.n)**2 > _LARGEST:
        return None
    return search.kit.indirect.solve(
        problem, arcs, search.course(outcome), outcome.path.t, search.sizes(outcome))


def _better(search: Search, answer: Solution, found: BoundaryValues, counts: Index) -> Solution:
    """Return the answer made of boundary values if its certificate holds, else the other."""
    if counts.sum() > _MOST_SAMPLES:
        counts = np.maximum(1, (counts * (_MOST_SAMPLES / counts.sum())).astype(np.int64))
    new = _sampled(search, found, counts)
    judged = answer.certificate
    if judged is not None and judged.holds:
        # An extremal costs no more than a path beside it, but for the errors of that path.
        error = _DEARER + judged.residuals['dynamics'] + judged.residuals['end']
        if new.objective > answer.objective + error * abs(answer.objective):
            return answer
    new = replace(new, certificate=certify(search.stated, new))
    assert new.certificate is not None
    return new if new.certificate.holds else answer


def _counts(found: BoundaryValues, wanted: float) -> Index:
    """Return into how many parts to cut each interval."""
    size = np.maximum(np.abs(found.u).max(axis=(0, 1)), 1e-300)
    bend = np.abs(np.diff(found.du, axis=1)[:, 0]) * found.h[:, None] / size
    parts = np.sqrt(bend.max(axis=1) / (12 * wanted))
    counts: Index = np.ceil(np.maximum(parts, _FEWEST_SAMPLES / len(parts))).astype(np.int64)
    return counts


def _sampled(search: Search, found: BoundaryValues, counts: Index) -> Solution:
    """Return boundary values as samples."""
    problem = search.stated
    last = np.append(np.diff(found.arc_of) > 0, True)
    each = counts + last   # the end of an arc is a sample of its own
    k = np.repeat(np.arange(len(each)), each)
    part = (np.arange(len(k)) - np.repeat(np.cumsum(each) - each, each)) / counts[k]
    starts = np.append(0.0, np.cumsum(found.h))
    t = starts[k] + part * found.h[k]
    z, u = found.at(k, part)
    x, lam = z[:, :problem.n], z[:, problem.n:]
    free = found.free[k]
    for _ in range(2):
        _, Hu, Huu = search.kit.judge.hamiltonian(problem, x, u, lam)
        whole = np.where(free[:, :, None], Huu, np.eye(problem.m))
        u = u - np.linalg.solve(whole, np.where(free, Hu, 0.0)[:, :, None])[:, :, 0]
    off, drift = _in_the_mean(found, counts, k, part)
    u = u + off
    by_u = (1 - part)[:, None, None] * found.by_u[k, 0] + part[:, None, None] * found.by_u[k, 1]
    z = z + np.einsum('kzj,kj->kz', by_u, drift)
    x, lam = z[:, :problem.n], z[:, problem.n:]
    u = np.clip(u, problem.u_lower, problem.u_upper)
    new = _joined(found, k, u)
    t, x, u, lam = t[new], x[new], u[new], lam[new]
    H, _, _ = search.kit.judge.hamiltonian(problem, x, u, lam)
    return Solution(Status.NOT_CONVERGED, '', found.cost, t, x, u, lam, H, found.nu,
                    switching_times=np.cumsum(found.lengths)[:-1],
                    iterations=search.monitor.iterations)


def _in_the_mean(found: BoundaryValues, counts: Index, k: Index, part: Array
                 ) -> tuple[Array, Array]:
    """
    Return by how much samples are off u*, and the integral of what their interpolation is off.

    Samples of u* itself would be off it by h^2/12 of its second derivative in the mean, always
    to the same side; in each arc they are moved so that the interpolation has the moments of u*.
    """
    off, drift = np.zeros((len(k), found.u.shape[2])), np.zeros((len(k), found.u.shape[2]))
    arc = found.arc_of[k]
    for number in range(len(found.lengths)):
        rows = np.flatnonzero(arc == number)
        of = k[rows[:-1]]
        length = (found.h / counts)[of][:, None]
        lost = found.bend(of, part[rows[:-1]] + 0.5 / counts[of]) * length**3 / 24
        bands = np.zeros((3, len(rows)))
        bands[0, 1:] = bands[2, :-1] = length[:, 0] / 6
        bands[1, :-1] += length[:, 0] / 3
        bands[1, 1:] += length[:, 0] / 3
        right = np.zeros((len(rows), off.shape[1]))
        right[:-1] -= lost
        right[1:] -= lost
        move = np.where(found.free[of[0]], solve_banded((1, 1), bands, right), 0.0)
        off[rows] = move
        drift[rows[1:]] = np.where(found.free[of[0]], np.cumsum(
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
