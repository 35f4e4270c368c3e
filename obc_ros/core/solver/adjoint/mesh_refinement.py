# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Where a mesh is too coarse: what the input gives away, and where the best one has kinks.

Along a path with costates, H(x, u) - min H(x, .) is what the input gives away at each time; its
integral is the cost above the least one, to first order. Where u* meets a bound it has a kink,
which a linear input can follow only with a mesh point there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.adjoint.costates import CostateIntegrator, Extremal
from obc_ros.core.solver.transcription.mesh import Mesh, Path, split

_MOST_CUTS = 4
_WORTH = 0.7       # of the most intervals: with more no finer mesh is tried
EXCEEDED = 2e-8, 2e-6   # of its size: by how much a constraint may be exceeded, or be drawn in
_EQUAL = 25.0      # times that, for an equality: nothing can be drawn in
_STRAIGHT = 1e-6   # of its size: by how much an input may be off a straight line
_CHORDED = 0.5     # of what is given away
_FOLLOWING = 12   # Newton steps at a point
_NO_LENGTH = 1e-9   # of T


@dataclass(frozen=True, eq=False)
class Error:
    """Errors of all intervals, (N,), that grow with a power of their length; `share` of each."""

    values: Array
    share: float
    rate: float


@dataclass(frozen=True, eq=False)
class Judgement:
    """
    What a path gives away.

    `lost` (N,) cost given away in each interval, `chords` (N,) the part of it by which inputs
    between two points of a curved constraint are off it; `kinks` times at which u* meets or
    leaves a bound; `drift` (N,) by how much H changes within each interval and `spread` from its
    least to its largest value, relative to the largest sum of its terms.
    """

    lost: Array
    chords: Array
    kinks: Array
    drift: Array
    spread: float

    @property
    def chorded(self) -> bool:
        """Return whether most of what is given away is so by chords."""
        return bool(self.chords.sum() > _CHORDED * self.lost.sum())


def measure_loss(problem: Problem, integrator: CostateIntegrator, course: Extremal,
                 slack: Array | None = None) -> Judgement:
    """
    Return what the input of a path gives away.

    `slack` (2, K): what path constraints weigh that are not quite met at the start and at the
    end of each part.
    """
    # All starts of parts, then all their ends.
    x, u, lam = (np.vstack(pair) for pair in (
        (course.x, course.x_end), (course.ua, course.ub), (course.lam, course.lam_end)))
    mu = None if course.density_path is None else np.vstack(
        [course.density_path[:, 0], course.density_path[:, 1]])
    H, Hu, Huu = integrator.hamiltonian(problem, x, u, lam, mu)
    gap, target = _best(problem, u, Hu, Huu)
    gaps, energy = gap.reshape(2, -1), H.reshape(2, -1)
    targets = target.reshape(2, -1, problem.m)
    h = np.diff(course.t)
    slack = np.zeros_like(gaps) if slack is None else slack
    lost, chords = ((0.5 * h * (values[0] + values[1])).reshape(-1, course.parts).sum(axis=1)
                    for values in (gaps + slack, slack))
    moved = course.lam * (course.x_end - course.x) / np.maximum(h, 1e-300)[:, None]
    size = np.max(np.abs(energy[0] - moved.sum(axis=1)) + np.abs(moved).sum(axis=1))
    H = np.nan_to_num(energy.T.reshape(len(lost), -1) / max(size, 1e-300))
    return Judgement(lost, chords, _crossings(problem, course.t, targets), np.ptp(H, axis=1),
                     float(np.ptp(H)))


def follow_minimum(problem: Problem, integrator: CostateIntegrator, course: Extremal) -> Array:
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
        if np.all(np.abs(d - before) <= 1e-9 * np.abs(d)):
            break
    gap = -np.einsum('kj,kj->k', Hu, d) - 0.5 * np.einsum('ki,kij,kj->k', d, Huu, d)
    return np.maximum(np.nan_to_num(gap), 0.0), u + free


def _crossings(problem: Problem, t: Array, targets: Array) -> Array:
    """Return the times at which the least point of H crosses a bound."""
    found: list[float] = []
    for bound in (problem.u_lower, problem.u_upper):
        a, b = targets[0] - bound, targets[1] - bound
        with np.errstate(invalid='ignore'):
            rows, columns = np.nonzero(np.isfinite(a) & np.isfinite(b) & (a * b < 0))
        part = a[rows, columns] / (a[rows, columns] - b[rows, columns])
        found.extend(t[rows] + part * (t[rows + 1] - t[rows]))
    return np.sort(np.array(found))


def choose_cuts(errors: Array, share: float, rate: float) -> Index:
    """
    Return into how many parts to cut each interval so that its error is `share` at most.

    An interval's error falls with the power `rate` of its length.
    """
    share = max(share, 1e-300)
    number = np.ceil((np.minimum(errors, 1e30 * share) / share) ** (1 / rate))
    return np.clip(number, 1, _MOST_CUTS).astype(np.int64)


def refine_mesh(mesh: Mesh, path: Path, kinks: Array, errors: Sequence[Error], longest: float,
                most: int) -> Mesh:
    """
    Return a mesh that is finer where errors are too large, and no finer than needed.

    Intervals at the inner points where inputs go straight on may become one, up to a length. A
    mesh of one phase has at most `most` intervals, unless it has nearly as many already.
    """
    def cut(of: Sequence[Array]) -> Index:
        counts = [choose_cuts(values, error.share, error.rate)
                  for values, error in zip(of, errors, strict=True)]
        return np.asarray(np.max(counts, axis=0))

    number = cut([error.values for error in errors])
    merged = cut([2 ** (error.rate - 1) * (error.values[:-1] + error.values[1:])
                  for error in errors])
    h, spare = np.diff(path.t), np.zeros(len(number) - 1, dtype=bool)
    if np.all(number == 1):
        number[:] = 2
    else:
        may = _straight(path, mesh.layout.phase_of) & (merged == 1) & (h[:-1] + h[1:] < longest)
        for k in np.flatnonzero(may):
            spare[k] = not spare[k - 1]
    mesh = align_mesh(mesh, path.t, kinks, spare)
    points = np.append(0.0, np.cumsum(mesh.fractions * path.durations[mesh.layout.phase_of]))
    middle = (points[:-1] + points[1:]) / 2
    k = np.clip(np.searchsorted(path.t, middle) - 1, 0, len(number) - 1)
    # Of an interval that a kink cuts each part is cut in proportion to its length; arcs may have
    # shrunk to nothing.
    part = np.diff(points) / np.where(h[k] > 0, h[k], np.inf)
    parts = np.ceil(number[k] * np.minimum(part, 1.0) - 1e-6)
    return _within(mesh, np.maximum(parts, 1).astype(np.int64), most)


def _within(mesh: Mesh, number: Index, most: int) -> Mesh:
    """Return the mesh cut into these numbers, or spread like them where they are too many."""
    if len(mesh.layout.phases) > 1 or not len(number) < _WORTH * most < _WORTH * number.sum():
        return split(mesh, number)
    cut = np.append(0.0, np.cumsum(number) / number.sum())
    points = np.interp(np.linspace(0.0, 1.0, most + 1), cut,
                       np.append(0.0, np.cumsum(mesh.fractions)))
    phase = replace(mesh.layout.phases[0], intervals=most)
    return replace(mesh, layout=replace(mesh.layout, phases=(phase,)), fractions=np.diff(points))


def _straight(path: Path, phase_of: Index) -> NDArray[np.bool_]:
    """Return for each mesh point but the ends whether inputs go straight through it."""
    h = np.diff(path.t)
    part = (h[:-1] / np.maximum(h[:-1] + h[1:], 1e-300))[:, None]
    between = path.ua[:-1] + part * (path.ub[1:] - path.ua[:-1])
    size = _STRAIGHT * np.maximum(np.abs(path.ua).max(axis=0), np.abs(path.ub).max(axis=0))
    off = np.maximum(np.abs(path.ub[:-1] - between), np.abs(path.ua[1:] - between))
    return np.asarray(np.all(off <= size, axis=1) & (phase_of[:-1] == phase_of[1:]))


def align_mesh(mesh: Mesh, t: Array, kinks: Array, spare: NDArray[np.bool_]) -> Mesh:
    """
    Return the mesh with a point at each of the given times and without spare inner points.

    A mesh point nearby is moved there; else an interval is cut. Ends of phases stay.
    """
    kept = np.pad(~spare, 1, constant_values=True)
    starts = np.concatenate([[0], np.cumsum([p.intervals for p in mesh.layout.phases])])
    phases, fractions = [], []
    for number, phase in enumerate(mesh.layout.phases):
        span = slice(starts[number], starts[number + 1] + 1)
        points = t[span][kept[span]]
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
        length = points[-1] - points[0]
        fractions.append(np.diff(points) / length if length > 0 else
                         np.full(len(points) - 1, 1.0 / (len(points) - 1)))
        phases.append(replace(phase, intervals=len(points) - 1))
    return replace(mesh, layout=replace(mesh.layout, phases=tuple(phases)),
                   fractions=np.concatenate(fractions))


def compute_tightening(problem: Problem, value: Array, course: Extremal,
                       margin: Array) -> tuple[Array, Array]:
    """
    Return by how much to draw in bounds, (n + l,), and by how much intervals exceed them, (N,).

    `value` (K, n + l) of x and of the path constraints along a course; `margin` by which their
    bounds were drawn in for it. The second is relative to their sizes. What drawing in costs is
    soon more than what else a mesh gives away: where bounds are exceeded it is to be finer, too.
    """
    size = np.abs(value).max(axis=0)
    lower = np.append(problem.x_lower, problem.path_lower) + margin
    upper = np.append(problem.x_upper, problem.path_upper) - margin
    excess = np.maximum(lower - value, value - upper)
    over = np.max(excess, axis=0)
    least, most = (part * size for part in EXCEEDED)
    drawn = np.where((over > least) & (over < most) & (lower < upper), 1.2 * over, 0.0)
    size = np.where(size > 0, size, 1.0) * np.where(lower < upper, 1.0, _EQUAL)
    relative = np.max(excess / size, axis=1)
    relative[::course.parts] = 0.0   # nodes are held
    # Between a bound and a path that bends it grows with h^2: what is seen of one interval
    # holds for those beside it.
    h2 = np.diff(course.t[::course.parts])**2
    seen = h2 > (_NO_LENGTH * course.t[-1])**2   # of phases that vanish nothing is seen
    bend = relative[:-1].reshape(-1, course.parts).max(axis=1) / np.where(seen, h2, np.inf)
    bend = np.pad(bend, 2)
    bend = np.lib.stride_tricks.sliding_window_view(bend, 5).max(axis=1)
    return drawn, np.maximum(bend, 0.0) * h2


def is_below(cost: float, other: float, part: float) -> bool:
    """Return whether a cost is below another by more than a part of it."""
    return cost < other - part * abs(other)
