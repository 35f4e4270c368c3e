# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Mesh refinement by the Hamiltonian loss, with mesh points at the kinks of the minimising input.

Along a path with costates the Hamiltonian loss H(x, u, lam) - min H(x, ., lam) is the excess of
the running cost at each time. Its integral is the excess of the cost over the minimum, to first
order. Where the minimising input u* meets a bound it has a kink; a piecewise linear input follows
it only with a mesh point there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, Mask
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.adjoint.costates import CostateIntegrator, Extremal
from obc_ros.core.solver.transcription.mesh import choose_cuts, Mesh, Path, split

# Violation of a constraint between nodes, relative to its size: aimed at (above it the constraint
# is tightened), and above which it is not tightened, only the mesh refined.
EXCEEDED = 2e-8, 2e-6


@dataclass(frozen=True, eq=False)
class Error:
    """
    Errors of all intervals (N,), and the order with which they decrease.

    :ivar share: error that an interval may have.
    :ivar rate: power of the length to which the error of an interval is proportional.
    """

    values: Array
    share: float
    rate: float


@dataclass(frozen=True, eq=False)
class HamiltonianLoss:
    """
    The Hamiltonian loss of a path.

    :ivar lost: (N,), loss in each interval, in units of the cost.
    :ivar chords: (N,), the part of it due to inputs on a chord between two points of a curved
        constraint.
    :ivar kinks: times at which u* meets or leaves a bound [s].
    :ivar drift: (N,), variation of H within each interval, relative to the largest sum of its
        terms.
    :ivar spread: variation of H on the whole path, relative to the same.
    """

    lost: Array
    chords: Array
    kinks: Array
    drift: Array
    spread: float

    @property
    def chorded(self) -> bool:
        """Return whether most of the loss is due to chords."""
        return bool(self.chords.sum() > 0.5 * self.lost.sum())


def measure_loss(problem: Problem, integrator: CostateIntegrator, course: Extremal,
                 slack: Array | None = None) -> HamiltonianLoss:
    """
    Compute the Hamiltonian loss of a path, from the quadratic model of H at the input.

    :param slack: (2, K), optional, multipliers times distances of path constraints from their
        bounds, at the start and at the end of each part (`Fitter.slack`).
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
    over = problem.edges_in(course.t[::course.parts])
    H[over] = H[over, :1]
    change = np.where(over, energy[1, course.parts - 1::course.parts] - energy[
        0, ::course.parts], 0.0) / max(size, 1e-300)
    H = H - np.append(0.0, np.cumsum(change)[:-1])[:, None]
    kinks = list[float]()
    for bound in (problem.u_lower, problem.u_upper):
        a, b = targets[0] - bound, targets[1] - bound
        with np.errstate(invalid='ignore'):
            rows, columns = np.nonzero(np.isfinite(a) & np.isfinite(b) & (a * b < 0))
        part = a[rows, columns] / (a[rows, columns] - b[rows, columns])
        kinks.extend(course.t[rows] + part * h[rows])
    return HamiltonianLoss(
        lost, chords, np.sort(np.array(kinks)), np.ptp(H, axis=1), float(np.ptp(H)))


def _best(problem: Problem, u: Array, Hu: Array, Huu: Array) -> tuple[Array, Array]:
    """
    Return the loss (K,) and the minimiser (K, m) of the quadratic model of H.

    The loss is that within the bounds. The minimiser of an input is not limited by its bounds, and
    nan where H is not convex in it.
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


def refine_mesh(mesh: Mesh, path: Path, kinks: Array, errors: Sequence[Error], longest: float,
                most: int) -> Mesh:
    """
    Refine a mesh where errors are too large, and merge intervals where they are small.

    :param kinks: times [s] that become mesh points.
    :param longest: length [s] up to which two intervals with a straight input between them are
        merged.
    :param most: maximum number of intervals of a mesh of one phase; more are returned only if the
        present mesh has nearly as many.
    :return: with every interval halved if all errors are small.
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
    # The parts of an interval that a kink cuts are cut in proportion to their lengths. Phases may
    # have vanished.
    part = np.diff(points) / np.where(h[k] > 0, h[k], np.inf)
    parts = np.ceil(number[k] * np.minimum(part, 1.0) - 1e-6)
    return _within(mesh, np.maximum(parts, 1).astype(np.int64), most)


def _within(mesh: Mesh, number: Index, most: int) -> Mesh:
    """Return the mesh with intervals cut into `number` parts, or `most` intervals like them."""
    # A mesh that needs more than the maximum gets it, if it has less than 0.7 of it so far.
    if len(mesh.layout.phases) > 1 or not len(number) < 0.7 * most < 0.7 * number.sum():
        return split(mesh, number)
    cut = np.append(0.0, np.cumsum(number) / number.sum())
    points = np.interp(np.linspace(0.0, 1.0, most + 1), cut,
                       np.append(0.0, np.cumsum(mesh.fractions)))
    phase = replace(mesh.layout.phases[0], intervals=most)
    return replace(mesh, layout=replace(mesh.layout, phases=(phase,)), fractions=np.diff(points))


def _straight(path: Path, phase_of: Index) -> Mask:
    """Return for each inner mesh point whether all inputs are straight and continuous there."""
    h = np.diff(path.t)
    part = (h[:-1] / np.maximum(h[:-1] + h[1:], 1e-300))[:, None]
    between = path.ua[:-1] + part * (path.ub[1:] - path.ua[:-1])
    size = 1e-6 * np.maximum(np.abs(path.ua).max(axis=0), np.abs(path.ub).max(axis=0))
    off = np.maximum(np.abs(path.ub[:-1] - between), np.abs(path.ua[1:] - between))
    return np.asarray(np.all(off <= size, axis=1) & (phase_of[:-1] == phase_of[1:]))


def align_mesh(mesh: Mesh, t: Array, kinks: Array, spare: Mask) -> Mesh:
    """
    Return the mesh with points at the kinks and without spare inner points.

    The nearest mesh point is moved to a kink if it is close, otherwise an interval is cut. Ends
    of phases stay.

    :param t: (N + 1,), times of the mesh [s].
    :param kinks: times [s], sorted.
    :param spare: (N - 1,), inner points that are removed.
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


def compute_tightening(problem: Problem, value: Array, size: Array, course: Extremal,
                       margin: Array, most: float) -> tuple[Array, Array]:
    """
    Compute the tightening of bounds, and their violation in each interval.

    The cost of a large tightening exceeds the loss of the mesh, so the mesh is refined where
    bounds are violated, too.

    :param value, size: (K + 1, n + l), x and the path constraints along the course, and their
        sizes (n + l,).
    :param margin: (n + l,), tightening with which the course was found.
    :param most: violation above which a constraint is not tightened, relative to its size.
    :return: margin: (n + l,), new tightening, 0 where none is needed or the mesh is too coarse;
        exceeded: (N,), violation in each interval, relative to the sizes of the constraints.
    """
    lower, upper = problem.row_bounds
    lower, upper = lower + margin, upper - margin
    excess = np.maximum(lower - value, value - upper)
    over = np.max(excess, axis=0)
    tightened = (over > EXCEEDED[0] * size) & (over < most * size) & (lower < upper)
    drawn = np.where(tightened, 1.2 * over, 0.0)
    # Equalities cannot be tightened: 25 times the violation is aimed at.
    size = np.where(size > 0, size, 1.0) * np.where(lower < upper, 1.0, 25.0)
    relative = np.max(excess / size, axis=1)
    relative[::course.parts] = 0.0   # nodes are held
    # The violation between two nodes on a bound is proportional to h^2. The factor is taken as
    # the largest of neighbouring intervals.
    h2 = np.diff(course.t[::course.parts])**2
    seen = h2 > (1e-9 * course.t[-1])**2   # phases may have vanished
    bend = relative[:-1].reshape(-1, course.parts).max(axis=1) / np.where(seen, h2, np.inf)
    bend = np.pad(bend, 2)
    bend = np.lib.stride_tricks.sliding_window_view(bend, 5).max(axis=1)
    return drawn, np.maximum(bend, 0.0) * h2


def is_below(cost: float, other: float, part: float) -> bool:
    """Return whether a cost is lower than another one by more than a part of |other|."""
    return cost < other - part * abs(other)
