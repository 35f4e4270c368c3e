# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Shortest paths of a car: time of a sampled path, and of a path without points.

Compared with OMPL's ReedsSheppStateSpace on the same pairs of poses, with --peers; all lengths are
compared, too.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Callable
from math import pi
from typing import Any

import numpy as np
from obc_ros.core.systems.reeds_shepp import find_shortest_path

PAIRS = 20_000
TIMED = 500     # pairs that are timed one by one
POINTS = 50     # points of a sampled path
OURS, THEIRS = 'obc_ros', 'OMPL'


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments('shortest paths of a car, radius 1, in [-5, 5]^2 x [-pi, pi]')
    half = np.array([5.0, 5.0, pi])
    rng = np.random.default_rng(1)
    starts, goals = rng.uniform(-half, half, (2, PAIRS, 3))
    base = timing.peer('ompl.base') if args.peers else None
    ompl = Ompl(base) if base else None
    pairs = list(zip(starts.tolist(), goals.tolist(), strict=True))
    sampled(pairs[:TIMED], ompl)
    one_by_one(pairs[:TIMED], ompl)
    if ompl:
        compare_lengths(pairs, ompl)
    return timing.finish()


def sampled(pairs: list[Any], ompl: 'Ompl | None') -> None:
    """Time a path with its points."""
    rivals: dict[str, Callable[[], object]] = {
        OURS: lambda: [find_shortest_path(a, b, 1.0).sample(POINTS) for a, b in pairs]}
    if ompl:
        rivals[THEIRS] = lambda: [ompl.sample(a, b) for a, b in pairs]
    times = timing.measure(rivals, per=TIMED)
    timing.times_table(f'A path of {POINTS} points', times, THEIRS if ompl else OURS)
    if ompl:
        timing.require(f'{POINTS}-point path against OMPL', times[OURS].ratio(times[THEIRS]), 0.6)


def one_by_one(pairs: list[Any], ompl: 'Ompl | None') -> None:
    """Time a path without points."""
    rivals: dict[str, Callable[[], object]] = {
        OURS: lambda: [find_shortest_path(a, b, 1.0) for a, b in pairs]}
    if ompl:
        rivals[THEIRS] = lambda: [ompl.length(a, b) for a, b in pairs]
    times = timing.measure(rivals, per=TIMED)
    timing.times_table('A path, one at a time', times, THEIRS if ompl else OURS)


def compare_lengths(pairs: list[Any], ompl: 'Ompl') -> None:
    """Compare the lengths of all paths."""
    worst = max(abs(find_shortest_path(a, b, 1.0).length - ompl.length(a, b)) for a, b in pairs)
    timing.require('largest difference of a length from OMPL', worst, 1e-9)


class Ompl:
    """OMPL's state space with the same interface."""

    def __init__(self, base: Any) -> None:
        self.space = base.ReedsSheppStateSpace(1.0)
        self.a, self.b, self.between = (self.space.allocState() for _ in range(3))

    def length(self, start: list[float], goal: list[float]) -> float:
        """Return the length of the shortest path."""
        self._set(start, goal)
        return float(self.space.distance(self.a, self.b))

    def sample(self, start: list[float], goal: list[float]) -> None:
        """Compute points at equal distances along the path."""
        self._set(start, goal)
        for k in range(POINTS):
            self.space.interpolate(self.a, self.b, k / (POINTS - 1), self.between)

    def _set(self, start: list[float], goal: list[float]) -> None:
        for state, (x, y, theta) in ((self.a, start), (self.b, goal)):
            state.setX(x)
            state.setY(y)
            state.setYaw(theta)


if __name__ == '__main__':
    sys.exit(main())
