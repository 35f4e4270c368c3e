# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The meter of a solve: iterations, work and time, their limits, and reports of progress."""

import math
import time

from obc_ros.core.ocp.solution import MAX_INTERVALS, Report
from obc_ros.core.solver.trace import Trace


class Meter:
    """
    Counts iterations, work and time, reports progress, and decides when to stop.

    Work is counted in iterations times `each`, so that it does not depend on the load of the
    machine.

    :param whole, work: for a part of the work: what it is a part of, and its budget.
    :ivar stopped: '' while work goes on, then 'cancelled', 'timed_out', 'accepted' or, for a part
        of the work, 'spent'.
    :ivar iterations, most: so far, and at which the present solve ends. `stopped` stays '' then.
    :ivar effort: work of the solves that led to outcomes, from `credit`: by it a search compares
        how much its parts took. Failed attempts before a second one, phases and other parts are
        left out.
    :ivar deadline: on the monotonic clock [s].
    :ivar kept: time after the deadline for a certificate and a path within the bounds [s].
    """

    def __init__(self, time_limit: float = math.inf, report: Report | None = None,
                 max_intervals: int = MAX_INTERVALS, kept: float = 0.0, *,
                 trace: Trace | None = None, whole: 'Meter | None' = None,
                 work: float = math.inf) -> None:
        self.max_intervals, self.kept = max_intervals, kept
        self.deadline = time.monotonic() + time_limit
        self.trace = Trace() if trace is None else trace
        self.iterations, self.most = 0, 1_000_000
        self.each, self.effort = 1, 0
        self._whole, self._left = whole, work
        self._report, self._reason = report, ''

    @property
    def stopped(self) -> str:
        """Return why work is to stop, '' while it goes on."""
        return (self._whole.stopped if self._whole else '') or self._reason

    def accept(self) -> None:
        """Stop work because a path was found that the caller accepts."""
        self._reason = self._reason or 'accepted'

    def resume(self) -> None:
        """Allow work on the path that was accepted, such as on its certificate."""
        self._reason = '' if self._reason == 'accepted' else self._reason

    def limit(self, iterations: int, each: int = 1) -> None:
        """
        Limit the iterations of the next solve.

        :param each: work of one iteration: intervals, with collocation times 1 + stages.
        """
        self.most, self.each = self.iterations + iterations, each
        if self._whole:
            self._whole.limit(iterations, each)

    def credit(self, work: int) -> None:
        """Add the work of an outcome to `effort`."""
        self.effort += work

    @property
    def spent(self) -> bool:
        """Return whether the present solve has used up its iterations."""
        return self.iterations >= self.most

    def allows(self, intervals: int) -> bool:
        """Return whether a mesh may have so many intervals; the trace notes if it may not."""
        if intervals > self.max_intervals:
            self.trace.note_refused_mesh()
        return intervals <= self.max_intervals

    def part(self, work: float = math.inf, time_limit: float = math.inf) -> 'Meter':
        """
        Return a meter that begins at zero, with its own budget, which also counts for this one.

        It stops with this one, too.

        :param work: budget, after which `stopped` is 'spent'; without limit if left out.
        :param time_limit: [s], so that a slow machine keeps time for the rest.
        """
        return Meter(min(time_limit, self.remaining()), max_intervals=self.max_intervals,
                     trace=self.trace, whole=self, work=work)

    def overtime(self, least: float) -> 'Meter':
        """
        Return a meter of the time that was kept beyond the deadline, for after it.

        :param least: part of it that is left for the certificate [s].
        """
        return Meter(self.remaining() + self.kept - least, self._report, self.max_intervals,
                     trace=self.trace)

    def extend(self, work: int) -> None:
        """Increase the budget of a part, and of the parts that contain it; the whole has none."""
        self._left += work
        if self._whole:
            self._whole.extend(work)

    def remaining(self) -> float:
        """Return the time left [s]."""
        return self.deadline - time.monotonic()

    def step(self, cost: float, infeasibility: float) -> bool:
        """
        Count an iteration; return whether to stop.

        :param cost, infeasibility: of the iterate: cost, and largest violation of a constraint.
        """
        if self._whole:
            self._whole.step(cost, infeasibility)
        else:
            self.trace.spend(self.each)
            if self._report is not None and self._report(
                    self.trace.describe(), self.iterations + 1, cost, infeasibility):
                self._reason = 'cancelled'
        self.iterations += 1
        self._left -= self.each
        if not self._reason and self._left < 0:
            self._reason = 'spent'
        if not self.stopped and time.monotonic() > self.deadline:
            self._reason = 'timed_out'
        if self._reason == 'timed_out' and not self._whole:
            self.trace.note_time_up()
        return bool(self.stopped) or self.spent
