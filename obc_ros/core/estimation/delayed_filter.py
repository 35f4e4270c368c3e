# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A filter whose measurements come late and out of order.

Inputs and measurements are kept in the order of their stamps, each with the estimate after it. A
late one is put in its place and what follows is filtered again, so that the result is that of
the same measurements in order. What is older than the longest lag is dropped. Everything is
counted.

Nothing is filtered on arrival, but once before the next result is read. Filtering on arrival
would repeat what follows for each late measurement: the later they come, the longer each takes,
and an estimator that has fallen behind never catches up.
"""

from bisect import bisect_left, bisect_right
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile
import math

import numpy as np
from obc_ros.core.estimation.consistency import InnovationMonitor
from obc_ros.core.estimation.filter import Belief, KalmanFilter, Update
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import DynamicsError, quote, StatementError

NANOSECONDS = 1_000_000_000
MOST_REJECTED = 20   # outliers of one sensor in a row after which the filter restarts
NOTHING = Belief(np.zeros(0), np.zeros((0, 0)))   # before an event is filtered
_INTERVALS = 21      # whose median is the period of a sensor


@dataclass(eq=False)
class _Event:
    """An input or a measurement, and the estimate after it."""

    stamp: int
    u: Array | None = None
    sensor: tuple[int, ...] = ()   # its group of outputs
    at: tuple[int, ...] = ()       # those with a finite value
    y: Array | None = None
    after: Belief = NOTHING
    input_after: Array = field(default_factory=lambda: np.zeros(0))
    update: Update | None = None
    is_counted: bool = False


@dataclass(eq=False)
class _Sensor:
    """What is known of the measurements of one group of outputs."""

    newest: int | None = None
    rejected: int = 0
    intervals: deque[int] = field(default_factory=lambda: deque(maxlen=_INTERVALS))


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    The estimate at an instant.

    Attributes
    ----------
    stamp : int
        [ns]
    x : ndarray, shape (n,)
        Mean.
    P : ndarray, shape (n, n)
        Covariance of the error.

    """

    stamp: int
    x: Array
    P: Array


class DelayedFilter:
    """
    The estimate of a system from inputs and measurements with stamps.

    Parameters
    ----------
    kalman : KalmanFilter
        The filter; it may be replaced by `adopt`.
    x0 : ndarray, shape (n,)
        Mean before the first measurement.
    P0 : ndarray, shape (n, n)
        Its covariance; also used when the filter restarts. After a row of outliers it is
        enlarged by the square of their largest distance, so that the filter finds the plant.
    u0 : ndarray, shape (m,)
        Input before the first command.
    longest_lag : float
        [s] A measurement that is older than the newest one by more is dropped.
    longest_gap : float
        [s] After a longer time without measurements the filter restarts.
    outputs : sequence of str
        Names of the outputs that are used; empty: all.

    """

    def __init__(self, kalman: KalmanFilter, x0: Array, P0: Array, u0: Array,
                 longest_lag: float = 0.5, longest_gap: float = 2.0,
                 outputs: Sequence[str] = ()) -> None:
        self._kalman, self._x0, self._P0 = kalman, np.array(x0), np.array(P0)
        self._u = np.array(u0)
        self._lag, self._gap = (round(each * NANOSECONDS) for each in (longest_lag, longest_gap))
        self._events: list[_Event] = []
        self._filtered = 0   # how many of them, from the first on
        self._newest: int | None = None
        self._sensors: dict[tuple[int, ...], _Sensor] = {}
        self._names = {name: i for i, name in enumerate(kalman.system.output_names)}
        self._outputs = frozenset(outputs or self._names)
        self._counts: Counter[str] = Counter()
        self._monitor = InnovationMonitor()
        self._last: tuple[tuple[str, ...], Update] | None = None
        self._too_late = 0

    @property
    def counts(self) -> Counter[str]:
        """
        Return how many measurements there were of each kind.

        'used', 'late' (filtered again), 'out of order' (older than another of its sensor),
        'too late', 'repeated', 'missing', 'not used', 'not finite' (both entries), 'malformed',
        'outliers', 'restarts', 'faults'.
        """
        self._catch_up()
        return self._counts

    @property
    def monitor(self) -> InnovationMonitor:
        """Return the statistics of the innovations."""
        self._catch_up()
        return self._monitor

    @property
    def last(self) -> tuple[tuple[str, ...], Update] | None:
        """Return the outputs of the newest measurement, and what it did; None: there was none."""
        self._catch_up()
        return self._last

    @property
    def newest(self) -> int | None:
        """Return the stamp of the newest measurement [ns]; None: there was none."""
        return self._newest

    @property
    def u(self) -> Array:
        """Return the newest input, shape (m,)."""
        self._catch_up()
        return self._events[-1].input_after if self._events else self._u

    @property
    def measured(self) -> tuple[str, ...]:
        """Return the names of the outputs that have been measured."""
        at = {i for group in self._sensors for i in group}
        return tuple(name for name, i in self._names.items() if i in at)

    def adopt(self, kalman: KalmanFilter, x0: Array, P0: Array, outputs: Sequence[str] = ()
              ) -> None:
        """Use another filter from the newest measurement on; x0, P0, outputs as for the class."""
        self._catch_up()
        self._outputs = frozenset(outputs or self._names)
        self._kalman, self._monitor = kalman, InnovationMonitor()
        self._x0, self._P0 = np.array(x0), np.array(P0)

    def command(self, stamp: int, u: Array) -> None:
        """
        Receive an input that acts from a stamp [ns] on.

        Raises
        ------
        StatementError
            If it is not m finite numbers; nothing changes.

        """
        given = np.asarray(u, dtype=float)
        if given.shape != self._u.shape or not np.isfinite(given).all():
            self._counts['malformed'] += 1
            raise StatementError(f'a command of {given.size} numbers was dropped: wanted '
                                 f'{self._u.size} finite numbers')
        system = self._kalman.system
        given = np.clip(given, system.u_min, system.u_max)
        if not self._events or stamp > (self._newest or 0) + self._gap:
            self._u = given
            self._catch_up()
            if self._events:   # the next measurement restarts the filter with this input
                self._events[-1].input_after = given
        elif stamp < self._events[0].stamp:
            self._counts['too late'] += 1
        else:
            self._insert(_Event(stamp, u=given))

    def measure(self, stamp: int, names: Sequence[str], y: Sequence[float] | Array) -> bool:
        """
        Receive a measurement.

        Parameters
        ----------
        stamp : int
            Instant of the measurement [ns].
        names : sequence of str
            The measured outputs.
        y : sequence of float
            Their values; an entry that is not finite is left out.

        Returns
        -------
        bool
            Whether it is used; otherwise it has been counted.

        Raises
        ------
        StatementError
            If a name is unknown or stands twice, or the lengths differ; nothing changes.

        """
        at, values = self._read(names, y)
        finite = np.isfinite(values)
        self._counts['not finite'] += int((~finite).sum())
        sensor = self._sensors.setdefault(tuple(at), _Sensor())
        if not finite.any():
            return False
        if self._is_late(stamp, tuple(at), sensor):
            return False
        if self._newest is None or stamp - self._newest > self._gap:
            self._catch_up()
            self._restart(stamp)
        self._insert(_Event(
            stamp, sensor=tuple(at), y=values[finite],
            at=tuple(i for i, fine in zip(at, finite, strict=True) if fine)))
        self._newest = max(stamp, self._newest or stamp)
        self._forget()
        return True

    def estimate(self, stamp: int) -> Estimate:
        """
        Return the estimate at an instant that is not before the newest measurement.

        Raises
        ------
        StatementError
            If there was no measurement.
        DynamicsError
            If the estimate cannot be predicted to the instant.

        """
        self._catch_up()
        if not self._events:
            raise StatementError('there was no measurement')
        stamp = max(stamp, self._newest or stamp)
        # An input that acts later than the instant is not used yet.
        index = bisect_right(self._events, stamp, key=lambda event: event.stamp) - 1
        base = self._events[index]
        belief = self._kalman.predict(base.after, base.input_after,
                                      (stamp - base.stamp) / NANOSECONDS)
        return Estimate(stamp, belief.x, belief.P)

    def _read(self, names: Sequence[str], y: Sequence[float] | Array) -> tuple[list[int], Array]:
        values = np.asarray(y, dtype=float).ravel()
        unknown = [name for name in names if name not in self._names]
        reason = ''
        if not len(names) or len(names) != len(values):
            reason = f'{len(names)} names but {len(values)} numbers'
        elif unknown:
            reason = (f"'{quote(str(unknown[0]))}' is not an output of "
                      f'{self._kalman.system.name} ({", ".join(self._names)})')
        elif len(set(names)) < len(names):
            reason = 'a name stands twice'
        if reason:
            self._counts['malformed'] += 1
            raise StatementError(f'a measurement was dropped: {reason}')
        used = [k for k, name in enumerate(names) if name in self._outputs]
        self._counts['not used'] += len(names) - len(used)
        return [self._names[names[k]] for k in used], values[used]

    def _is_late(self, stamp: int, at: tuple[int, ...], sensor: _Sensor) -> bool:
        """Count how late a measurement is; return whether it cannot be used."""
        if self._newest is not None and stamp < max(self._newest - self._lag,
                                                    self._events[0].stamp):
            self._counts['too late'] += 1
            self._too_late += 1
            if self._too_late >= MOST_REJECTED:   # the clock was set back
                self._events, self._filtered, self._newest, self._too_late = [], 0, None, 0
                self._counts['restarts'] += 1
            return True
        self._too_late = 0
        first = bisect_left(self._events, stamp, key=lambda event: event.stamp)
        same = takewhile(lambda event: event.stamp == stamp, self._events[first:])
        if any(set(event.at) & set(at) for event in same):
            self._counts['repeated'] += 1
            return True
        if sensor.newest is None or stamp > sensor.newest:
            if sensor.newest is not None:
                interval = stamp - sensor.newest
                if len(sensor.intervals) >= 3:
                    period = sorted(sensor.intervals)[len(sensor.intervals) // 2]
                    self._counts['missing'] += max(0, round(interval / period) - 1)
                sensor.intervals.append(interval)
            sensor.newest = stamp
        else:
            self._counts['out of order'] += 1
            self._counts['missing'] -= self._counts['missing'] > 0  # it was counted as missing
        self._counts['late'] += self._newest is not None and stamp < self._newest
        return False

    def _restart(self, stamp: int) -> None:
        """Begin anew at a stamp; after the first time with the last mean."""
        mean, u = self._x0, self._u
        if self._events:
            self._counts['restarts'] += 1
            mean, u = self._events[-1].after.x, self._events[-1].input_after
        self._begin(stamp, mean, u, self._P0)

    def _begin(self, stamp: int, mean: Array, u: Array, P: Array) -> None:
        """Forget what was filtered, and begin at a stamp with a mean, its covariance, an input."""
        start = _Event(stamp, after=Belief(mean, P), input_after=u)
        self._events, self._filtered = [start, *self._events[self._filtered:]], 1
        self._sensors = {at: _Sensor() for at in self._sensors}
        self._monitor = InnovationMonitor()

    def _insert(self, event: _Event) -> None:
        """Put an event in its place; what follows has to be filtered again."""
        index = bisect_right(self._events, event.stamp, key=lambda each: each.stamp)
        self._events.insert(index, event)
        self._filtered = min(self._filtered, index)

    def _catch_up(self) -> None:
        """Filter what has not been filtered."""
        while self._filtered < len(self._events):
            before, event = self._events[self._filtered - 1], self._events[self._filtered]
            self._filtered += 1
            try:
                self._filter(before, event)
            except (DynamicsError, np.linalg.LinAlgError):
                # The estimate has left the range of numbers: the mean is lost too.
                self._counts['faults'] += 1
                self._begin(event.stamp, self._x0,
                            before.input_after if event.u is None else event.u, self._P0)
                continue
            if event.update is not None and not event.is_counted:
                self._count(event, event.update)

    def _filter(self, before: _Event, event: _Event) -> None:
        belief = self._kalman.predict(before.after, before.input_after,
                                      (event.stamp - before.stamp) / NANOSECONDS)
        event.input_after = before.input_after if event.u is None else event.u
        if event.y is not None:
            event.update = self._kalman.update(belief, event.input_after, event.at, event.y)
            belief = event.update.belief
        if not (np.isfinite(belief.x).all() and np.isfinite(belief.P).all()):
            raise DynamicsError('the estimate exceeds the range of double precision')
        event.after = belief

    def _count(self, event: _Event, update: Update) -> None:
        """Count a new measurement; restart after a row of outliers of one sensor."""
        event.is_counted = True
        self._counts['outliers' if update.is_outlier else 'used'] += 1
        self._monitor.add(update.nis, len(event.at))
        self._last = tuple(self._kalman.system.output_names[i] for i in event.at), update
        sensor = self._sensors[event.sensor]
        sensor.rejected = sensor.rejected + 1 if update.is_outlier else 0
        if sensor.rejected >= MOST_REJECTED:
            self._counts['restarts'] += 1
            self._begin(event.stamp, event.after.x, event.input_after, self._widen(event, update))

    def _widen(self, event: _Event, update: Update) -> Array:
        """Return P0, enlarged such that no entry of an innovation is above its deviation."""
        C = self._kalman.system.measure(event.after.x, event.input_after)[1][list(event.at)]
        variances = np.einsum('ij,jk,ik->i', C, self._P0, C)
        seen = variances > 0.0   # the others are functions of the input alone
        ratios = update.innovation[seen]**2 / variances[seen]
        return self._P0 * float(ratios.max(initial=1.0))

    def _forget(self) -> None:
        """Remove events that no accepted measurement can precede, but one."""
        oldest = (self._newest or 0) - self._lag
        if (self._filtered < len(self._events)
                and self._events[self._filtered].stamp <= oldest):   # nobody reads the results
            self._catch_up()
        first = bisect_right(self._events, oldest, key=lambda each: each.stamp) - 1
        if first > 0:
            del self._events[:first]
            self._filtered -= first


def spread_deviations(name: str, values: Sequence[float], names: Sequence[str]) -> Array:
    """
    Return variances, as a diagonal matrix, from standard deviations: one, or one for each name.

    Raises
    ------
    StatementError
        If their number is another one, or one is not positive and finite.

    """
    if len(values) not in (1, len(names)):
        raise StatementError(f'{name}: wanted 1 or {len(names)} numbers ({", ".join(names)}), '
                             f'found {len(values)}')
    for value in values:
        if not (math.isfinite(value) and value > 0.0):
            raise StatementError(f'{name} = {value:g}: wanted positive numbers')
    return np.diag(np.broadcast_to(np.square(np.array(values, dtype=float)), (len(names),)))
