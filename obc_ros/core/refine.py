# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Where a mesh is too coarse: what the input gives away, and where the best one has kinks.

Along a path with costates, H(x, u) - min H(x, .) is what the input gives away at each time; its
integral is the cost above the least one, to first order. Where u* meets a bound it has a kink,
which a linear input can follow only with a mesh point there.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.extremal import Extremal, Integrator
from obc_ros.core.mesh import Mesh
from obc_ros.core.problem import Problem

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_MOST_CUTS = 4
_FOLLOWING = 12   # Newton steps at a point


@dataclass(frozen=True, eq=False)
class Judgement:
    """
    What a path gives away.

    `lost` (N,) cost given away in each interval; `kinks` times at which u* meets or leaves a
    bound.
    """

    lost: Array
    kinks: Array


def judge(problem: Problem, integrator: Integrator, course: Extremal) -> Judgement:
    """Return what the input of a path gives away."""
    gaps, targets = [], []
    sides = ((course.x, course.ua, course.lam), (course.x_end, course.ub, course.lam_end))
    for side, (x, u, lam) in enumerate(sides):
        mu = None if course.density_path is None else course.density_path[:, side]
        _, Hu, Huu = integrator.hamiltonian(problem, x, u, lam, mu)
        gap, target = _best(problem, u, Hu, Huu)
        gaps.append(gap)
        targets.append(target)
    h = np.diff(course.t)
    lost = (0.5 * h * (gaps[0] + gaps[1])).reshape(-1, course.parts).sum(axis=1)
    return Judgement(lost, _crossings(problem, course.t, targets))


def followed(problem: Problem, integrator: Integrator, course: Extremal) -> Array:
    """
    Return inputs at the interval ends, (N + 1, m), that follow one least point of H in time.

    A direction that winds around between coarse points is taken back to the shortest way.
    """
    places = np.arange(0, len(course.x), course.parts)
    x = np.vstack([course.x[places], course.x_end[-1:]])
    lam = np.vstack([course.lam[places], course.lam_end[-1:]])
    u, rows = course.ua[0].copy(), []
    for point, costate in zip(x, lam, strict=True):
        for _ in range(_FOLLOWING):
            H, Hu, Huu = integrator.hamiltonian(
                problem, point[None], u[None], costate[None])
            if not (np.all(np.isfinite(Hu)) and np.all(np.isfinite(Huu))):
                break
            values, vectors = np.linalg.eigh(Huu[0])
            # Also where H is concave the step goes down, at most by a third of a turn.
            size = np.maximum(np.abs(values), 1e-9 * np.abs(values).max() + 1e-300)
            step = -vectors @ ((vectors.T @ Hu[0]) / size)
            step *= min(1.0, 1.0 / max(np.abs(step).max(), 1e-300))
            new = np.clip(u + step, problem.u_lower, problem.u_upper)
            if np.max(np.abs(new - u)) < 1e-6 or not np.all(np.isfinite(new)):
                break
            u = new
        rows.append(u)
    return np.array(rows)


def _best(problem: Problem, u: Array, Hu: Array, Huu: Array) -> tuple[Array, Array]:
    """
    Return what each input gives away in the quadratic model of H, and where H would be least.

    The second, shape (K, m), is not held to the bounds; nan where H has no curvature.
    """
    lower, upper = problem.u_lower - u, problem.u_upper - u
    d, free = np.zeros_like(u), np.full_like(u, np.nan)
    for _ in range(8 if problem.m > 1 else 1):
        before = d.copy()
        for i in range(problem.m):
            slope = Hu[:, i] + np.einsum('kj,kj->k', Huu[:, i], d) - Huu[:, i, i] * d[:, i]
            curved = Huu[:, i, i] > 0
            with np.errstate(divide='ignore', invalid='ignore'):
                free[:, i] = np.where(curved, -slope / Huu[:, i, i], np.nan)
            edge = np.where(slope > 0, lower[:, i], upper[:, i])
            edge = np.where(np.isfinite(edge) & (slope != 0), edge, 0.0)
            d[:, i] = np.where(curved, np.clip(free[:, i], lower[:, i], upper[:, i]), edge)
        if np.array_equal(d, before):
            break
    gap = -np.einsum('kj,kj->k', Hu, d) - 0.5 * np.einsum('ki,kij,kj->k', d, Huu, d)
    return np.maximum(np.nan_to_num(gap), 0.0), u + free


def _crossings(problem: Problem, t: Array, targets: list[Array]) -> Array:
    """Return the times at which the least point of H crosses a bound."""
    found: list[float] = []
    for bound in (problem.u_lower, problem.u_upper):
        a, b = targets[0] - bound, targets[1] - bound
        with np.errstate(invalid='ignore'):
            rows, columns = np.nonzero(np.isfinite(a) & np.isfinite(b) & (a * b < 0))
        part = a[rows, columns] / (a[rows, columns] - b[rows, columns])
        found.extend(t[rows] + part * (t[rows + 1] - t[rows]))
    return np.sort(np.array(found))


def cuts(errors: Array, wanted: float, rate: float = 5.0) -> Index:
    """
    Return into how many parts to cut each interval so that errors sum up to `wanted` at most.

    An interval's error falls with the power `rate` of its length.
    """
    share = max(wanted, 1e-300) / len(errors)
    number = np.ceil((np.minimum(errors, 1e30 * share) / share) ** (1 / rate))
    return np.clip(number, 1, _MOST_CUTS).astype(np.int64)


def aligned(mesh: Mesh, t: Array, kinks: Array) -> Mesh:
    """
    Return the mesh with a point at each of the given times.

    A mesh point nearby is moved there; else an interval is cut. Ends of phases stay.
    """
    starts = np.concatenate([[0], np.cumsum([p.intervals for p in mesh.layout.phases])])
    phases, fractions = [], []
    for number, phase in enumerate(mesh.layout.phases):
        points = t[starts[number]:starts[number + 1] + 1].copy()
        inside = kinks[(kinks > points[0]) & (kinks < points[-1])]
        taken = np.zeros(len(points), dtype=bool)
        taken[[0, -1]] = True
        for kink in inside:
            k = int(np.searchsorted(points, kink))
            h = points[k] - points[k - 1]
            near = k if points[k] - kink < kink - points[k - 1] else k - 1
            if abs(points[near] - kink) < 1e-3 * h:
                taken[near] = True
            elif not taken[near] and abs(points[near] - kink) < 0.3 * h:
                points[near], taken[near] = kink, True
            elif min(kink - points[k - 1], points[k] - kink) > 0.02 * h:
                points, taken = np.insert(points, k, kink), np.insert(taken, k, True)
        fractions.append(np.diff(points) / (points[-1] - points[0]))
        phases.append(replace(phase, intervals=len(points) - 1))
    return Mesh(replace(mesh.layout, phases=tuple(phases)), np.concatenate(fractions), mesh.held)
