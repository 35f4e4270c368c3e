# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
How time is cut for a transcription, and a path on such a mesh.

[0, T] is cut into phases and these into intervals; phases may have unknown lengths.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.numerics.collocation import compute_gauss_points
from obc_ros.core.ocp.problem import Problem

LINEAR, STEPPED, HELD = 'linear', 'stepped', 'held'
_SAME_TIME = 1e-10   # of T: times that differ by rounding only


@dataclass(frozen=True)
class Phase:
    """
    Intervals in a row, and for each input how it is found in them.

    `modes`: LINEAR (continuous, linear in each interval), STEPPED (constant in each) or HELD (at a
    given value).
    `joined`: whether an input starts at the value with which the phase before ended.
    """

    intervals: int
    modes: tuple[str, ...]
    joined: tuple[bool, ...]


@dataclass(frozen=True)
class Layout:
    """What fixes the form of the program: its phases, Gauss points, and what is unknown."""

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

    @cached_property
    def phase_of(self) -> Index:
        """Return the phase of each interval."""
        return np.repeat(np.arange(len(self.phases)), [p.intervals for p in self.phases])


@dataclass(frozen=True, eq=False)
class Mesh:
    """
    A layout with its numbers.

    Attributes
    ----------
    layout : Layout
    fractions : ndarray, shape (N,)
        Length of each interval as a part of its phase.
    held : ndarray, shape (number of phases, m)
        Values of the inputs that are HELD.
    on : ndarray, shape (number of phases, n + l), optional
        Bounds of (x, c) on which phases begin and end: +1 upper, -1 lower, 0 none.

    """

    layout: Layout
    fractions: Array
    held: Array
    on: Index | None = None

    def hold(self, lower: Array, upper: Array, places: Index, rows: slice) -> None:
        """
        Close bounds where phases begin or end on a bound of some rows of (x, c).

        `places` (N, number of rows): where in `lower` and `upper` those of each row stand, for
        the mesh point at which each interval begins.
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
    States and inputs over time: where a search starts or what it found.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        Mesh points.
    x : ndarray, shape (N + 1, n)
    inner : ndarray, shape (N, s, n)
        States at the Gauss points.
    ua, ub : ndarray, shape (N, m)
        Inputs at the start and at the end of each interval.
    durations : ndarray
        Lengths of the phases.

    """

    t: Array
    x: Array
    inner: Array
    ua: Array
    ub: Array
    durations: Array

    def states_at(self, times: Array) -> Array:
        """Return states at any times, linear between all known ones."""
        t, x = self.t, self.x
        if self.inner.shape[1]:
            c = compute_gauss_points(self.inner.shape[1])
            t = np.append(t[:-1, None] + np.diff(t)[:, None] * np.append(0.0, c), t[-1])
            x = np.vstack([np.concatenate([x[:-1, None], self.inner], axis=1).reshape(
                -1, x.shape[1]), x[-1:]])
        return np.column_stack([np.interp(times, t, column) for column in x.T])

    def inputs_at(self, times: Array, after: bool) -> Array:
        """
        Return inputs at any times; `after` a jump or before it.

        A time that is a mesh point up to rounding is that point: else the last bit of a sum of
        lengths says which side of a jump is taken.
        """
        same = _SAME_TIME * self.t[-1]
        found = (np.searchsorted(self.t, times + same, 'right') if after
                 else np.searchsorted(self.t, times - same, 'left'))
        k = np.clip(found - 1, 0, len(self.ua) - 1)
        length = np.maximum(self.t[k + 1] - self.t[k], 1e-300)
        part = np.clip((times - self.t[k]) / length, 0.0, 1.0)[:, None]
        return np.asarray((1 - part) * self.ua[k] + part * self.ub[k])


def build_uniform_mesh(problem: Problem, intervals: int, stages: int, mode: str = LINEAR) -> Mesh:
    """Return a mesh of one phase and equal intervals."""
    phase = Phase(intervals, (mode,) * problem.m, (False,) * problem.m)
    layout = Layout((phase,), stages, problem.final_time.free)
    return Mesh(layout, np.full(intervals, 1.0 / intervals), np.zeros((1, problem.m)))


def split(mesh: Mesh, counts: Index) -> Mesh:
    """Return the mesh with its intervals cut into equal parts, as many as `counts` says."""
    number = np.bincount(mesh.layout.phase_of, weights=counts).astype(int)
    phases = tuple(replace(p, intervals=int(k))
                   for p, k in zip(mesh.layout.phases, number, strict=True))
    return replace(mesh, layout=replace(mesh.layout, phases=phases),
                   fractions=np.repeat(mesh.fractions / counts, counts))
