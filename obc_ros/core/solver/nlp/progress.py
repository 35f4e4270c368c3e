# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Watching a solver at work: progress goes out, a wish to stop comes in."""

from collections.abc import Sequence
import math
import time

import casadi as ca
import numpy as np
from obc_ros.core.ocp.solution import MAX_INTERVALS, Report
from obc_ros.core.solver.nlp.best_path import BestPath


class ProgressMonitor:
    """
    Passes progress on and says when to stop.

    `stopped` is '' while nothing asked to stop, then 'cancelled', 'timed_out' or, for a part of
    the work, 'spent'. A solver that passes `most` iterations is ended without that. No mesh has
    more than `max_intervals`; `short` says whether one was wanted. `best`: who wants to know of
    paths on the way.
    """

    def __init__(self, time_limit: float = math.inf, report: Report | None = None,
                 max_intervals: int = MAX_INTERVALS) -> None:
        self.max_intervals, self.short = max_intervals, False
        self.deadline = time.monotonic() + time_limit
        self.stopped = ''
        self.phase = 'transcription'
        self.iterations = 0
        self.most = 1_000_000
        self.each = 1
        self.best: BestPath | None = None
        self._report = report

    def limit(self, iterations: int, each: int = 1) -> None:
        """Let the solver that follows end after so many iterations; work that each of them is."""
        self.most, self.each = self.iterations + iterations, each

    @property
    def spent(self) -> bool:
        """Return whether a solver has used up its iterations."""
        return self.iterations >= self.most

    def allows(self, intervals: int) -> bool:
        """Return whether a mesh may have so many intervals; remember if it may not."""
        self.short |= intervals > self.max_intervals
        return intervals <= self.max_intervals

    def part(self, work: int, time_limit: float = math.inf) -> 'ProgressMonitor':
        """
        Return a monitor for something besides, which ends after so much work.

        Work and not time, so that what comes of it does not depend on what else a machine has to
        do; `time_limit` [s] keeps it from taking what a slow machine needs for the rest.
        """
        return _Part(self, work, min(time_limit, self.remaining()))

    def extend(self, work: int) -> None:
        """Let parts of the work go on for so much longer: it leads somewhere."""

    def remaining(self) -> float:
        """Return the time left [s]."""
        return self.deadline - time.monotonic()

    def step(self, cost: float, infeasibility: float) -> bool:
        """Count an iteration; return whether to stop."""
        self.iterations += 1
        if self._report is not None and self._report(
                self.phase, self.iterations, cost, infeasibility):
            self.stopped = 'cancelled'
        elif not self.stopped and time.monotonic() > self.deadline:
            self.stopped = 'timed_out'
        return bool(self.stopped) or self.iterations >= self.most


class _Part(ProgressMonitor):
    """A monitor that passes cancelling on from the whole, but keeps limits of its own."""

    def __init__(self, whole: ProgressMonitor, work: int, time_limit: float) -> None:
        super().__init__(time_limit, max_intervals=whole.max_intervals)
        self._whole, self._left = whole, work
        self.phase, self.stopped, self.best = whole.phase, whole.stopped, whole.best

    def limit(self, iterations: int, each: int = 1) -> None:
        super().limit(iterations, each)
        self._whole.limit(iterations, each)

    def extend(self, work: int) -> None:
        self._left += work
        self._whole.extend(work)

    def step(self, cost: float, infeasibility: float) -> bool:
        self._whole.step(cost, infeasibility)
        self._left -= self.each
        self.stopped = self._whole.stopped or self.stopped or ('spent' if self._left < 0 else '')
        return super().step(cost, infeasibility)


class Watch(ca.Callback):
    """IPOPT's iteration callback; the monitor and the scale of the cost change between solves."""

    def __init__(self, unknowns: int, rows: int, constants: int) -> None:
        ca.Callback.__init__(self)
        self._sizes = {'x': unknowns, 'f': 1, 'g': rows, 'lam_x': unknowns, 'lam_g': rows,
                       'lam_p': constants}
        self.monitor = ProgressMonitor()
        self.lower = self.upper = np.zeros(rows)
        self.cost_scale = 1.0
        self.construct('watch', {})

    def get_n_in(self) -> int:
        """Return the number of inputs: what the solver shows after an iteration."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of an input."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def eval(self, arg: Sequence[ca.DM]) -> Sequence[ca.DM]:
        """Return whether the solver is to stop."""
        g = arg[2].full().ravel()
        violation = np.maximum(self.lower - g, g - self.upper)
        return [ca.DM(int(self.monitor.step(
            float(arg[1]) * self.cost_scale, float(np.max(violation, initial=0.0)))))]
