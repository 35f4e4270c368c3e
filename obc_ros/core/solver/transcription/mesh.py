# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The mesh of a transcription, and a path on it.

[0, T] is divided into phases, and these into intervals. The lengths of phases may be unknown.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.numerics.collocation import compute_gauss_points
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.ocp.problem import Problem

LINEAR, STEPPED, HELD = 'linear', 'stepped', 'held'


@dataclass(frozen=True)
class Phase:
    """
    Consecutive intervals, and the form of each input in them.

    :ivar modes: length m, LINEAR (continuous, linear in each interval), STEPPED (constant in each
        interval) or HELD (at a given value).
    """

    intervals: int
    modes: tuple[str, ...]


@dataclass(frozen=True)
class Layout:
    """The form of a program: phases, scheme, and whether the final time is unknown."""

    phases: tuple[Phase, ...]
    stages: int   # Gauss points in an interval; 0 for Runge-Kutta steps
    free_time: bool

    @property
    def intervals(self) -> int:
        """Return the number of intervals of all phases."""
        return sum(phase.intervals for phase in self.phases)

    @property
    def free_durations(self) -> bool:
        """Return whether the lengths of the phases are unknown."""
        return self.free_time or len(self.phases) > 1

    def describe(self) -> str:
        """Return intervals, phases and scheme in words."""
        phases = f' in {len(self.phases)} phases' if len(self.phases) > 1 else ''
        scheme = f'{self.stages} Gauss points' if self.stages else 'Runge-Kutta'
        return f'{self.intervals} intervals{phases}, {scheme}'

    @cached_property
    def phase_of(self) -> Index:
        """Return the phase of each interval."""
        return np.repeat(np.arange(len(self.phases)), [p.intervals for p in self.phases])


@dataclass(frozen=True, eq=False)
class Mesh:
    """
    A layout with its numbers.

    :ivar fractions: (N,), length of each interval as a part of its phase.
    :ivar held: (phases, m), values of the inputs that are HELD.
    :ivar on: (phases, n + l), optional, bounds of (x, c) on which phases begin and end: 1 upper,
        -1 lower, 0 none.
    """

    layout: Layout
    fractions: Array
    held: Array
    on: Index | None = None

    def hold(self, lower: Array, upper: Array, places: Index, rows: slice) -> None:
        """
        Set lower and upper bounds equal at junctions on a bound of some rows of (x, c).

        `places` (N, number of rows): places in `lower` and `upper` of each row at the start of
        each interval.
        """
        if self.on is None:
            return
        on = np.where(self.on[1:] != 0, self.on[1:], self.on[:-1])[:, rows]
        first = np.flatnonzero(np.diff(self.layout.phase_of)) + 1
        phase, row = np.nonzero(on)
        at = places[first[phase], row]
        lower[at] = upper[at] = np.where(on[phase, row] > 0, upper[at], lower[at])


@dataclass(frozen=True, eq=False)
class Path:
    """
    States and inputs over time: an initial guess or a solution.

    :ivar t: (N + 1,), mesh points [s].
    :ivar x: (N + 1, n), states at the mesh points.
    :ivar inner: (N, s, n), states at the Gauss points; s is 0 for Runge-Kutta steps.
    :ivar ua, ub: (N, m), inputs at the start and at the end of each interval.
    :ivar durations: (phases,), lengths of the phases [s].
    :ivar origin: how an initial guess was made, in words.
    :ivar rollout: whether it is a rollout of random inputs: a solve that fails from it says little
        about the problem.
    """

    t: Array
    x: Array
    inner: Array
    ua: Array
    ub: Array
    durations: Array
    origin: str = ''
    rollout: bool = False

    @property
    def u(self) -> Array:
        """Return the inputs at the mesh points, those after a jump, shape (N + 1, m)."""
        return np.vstack([self.ua, self.ub[-1:]])

    def in_one_phase(self) -> 'Path':
        """Return the path for a mesh of one phase."""
        return replace(self, durations=self.t[-1:])

    def states_at(self, times: Array) -> Array:
        """Return states (K, n) at times (K,) [s], by linear interpolation."""
        t, x = self.t, self.x
        if self.inner.shape[1]:
            c = compute_gauss_points(self.inner.shape[1])
            t = np.append(t[:-1, None] + np.diff(t)[:, None] * np.append(0.0, c), t[-1])
            x = np.vstack([np.concatenate([x[:-1, None], self.inner], axis=1).reshape(
                -1, x.shape[1]), x[-1:]])
        return interpolate_columns(times, t, x)

    def inputs_at(self, times: Array, after: bool) -> Array:
        """
        Return inputs (K, m) at times (K,) [s], at a mesh point `after` it or before it.

        Times that differ from a mesh point by rounding only are that point, so that rounding does
        not decide which side of a jump is returned.
        """
        same = 1e-10 * self.t[-1]   # rounding
        found = (np.searchsorted(self.t, times + same, 'right') if after
                 else np.searchsorted(self.t, times - same, 'left'))
        k = np.clip(found - 1, 0, len(self.ua) - 1)
        length = np.maximum(self.t[k + 1] - self.t[k], 1e-300)
        part = np.clip((times - self.t[k]) / length, 0.0, 1.0)[:, None]
        return np.asarray((1 - part) * self.ua[k] + part * self.ub[k])


def build_path(t: Array, x: Array, ua: Array, ub: Array, durations: Array | None = None) -> Path:
    """Return a path without states inside of intervals; one phase without `durations`."""
    return Path(t, x, np.zeros((len(ua), 0, x.shape[1])), ua, ub,
                t[-1:] if durations is None else durations)


def label_paths(paths: Iterable[Path], origin: str) -> Iterator[Path]:
    """Yield initial guesses, with how they were made if that is not known."""
    for path in paths:
        yield path if path.origin else replace(path, origin=origin)


def build_uniform_mesh(problem: Problem, intervals: int, stages: int, mode: str = LINEAR) -> Mesh:
    """
    Return a mesh of one phase with equal intervals, and one mode of all inputs.

    The problem gives m, and whether T is free.
    """
    phase = Phase(intervals, (mode,) * problem.m)
    layout = Layout((phase,), stages, problem.final_time.free)
    return Mesh(layout, np.full(intervals, 1.0 / intervals), np.zeros((1, problem.m)))


def keep_breaks(problem: Problem, mesh: Mesh, duration: float) -> Mesh:
    """
    Return a mesh of one phase with points where expressions are not smooth in the time.

    Points close to them, and within edges, are left out. Meshes of several phases remain
    as they are.

    :param duration: T [s], an initial guess of it if it is free.
    """
    breaks = problem.breaks[problem.breaks < duration * (1 - 1e-9)] / duration
    if not breaks.size or len(mesh.layout.phases) > 1:
        return mesh
    points = np.cumsum(mesh.fractions)[:-1]
    points = points[~problem.edges_in(duration * np.repeat(points, 2))[::2]]
    gaps = np.diff(np.concatenate([[0.0], points, [1.0]]))
    away = np.abs(points - breaks[np.clip(np.searchsorted(
        0.5 * (breaks[1:] + breaks[:-1]), points), 0, len(breaks) - 1)])
    kept = points[away > 0.3 * np.minimum(gaps[1:], gaps[:-1])]
    fractions = np.diff(np.concatenate([[0.0], np.sort(np.append(kept, breaks)), [1.0]]))
    phase = replace(mesh.layout.phases[0], intervals=len(fractions))
    return replace(mesh, layout=replace(mesh.layout, phases=(phase,)), fractions=fractions)


def split(mesh: Mesh, counts: Index) -> Mesh:
    """Cut the intervals of a mesh into equal parts, `counts` (N,) of each."""
    number = np.bincount(mesh.layout.phase_of, weights=counts).astype(int)
    phases = tuple(replace(p, intervals=int(k))
                   for p, k in zip(mesh.layout.phases, number, strict=True))
    return replace(mesh, layout=replace(mesh.layout, phases=phases),
                   fractions=np.repeat(mesh.fractions / counts, counts))


def choose_cuts(errors: Array, share: float, rate: float, most: int = 4) -> Index:
    """
    Return the number of parts of each interval, up to `most`, for an error of at most `share`.

    The error of an interval is proportional to the power `rate` of its length; NaN counts as
    infinite.
    """
    share = max(share, 1e-300)
    number = np.ceil((np.fmin(errors, 1e30 * share) / share) ** (1 / rate))
    return np.clip(number, 1, most).astype(np.int64)
