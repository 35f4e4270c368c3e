# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A filter whose measurements come late and out of order: see docs/estimation.md.

Nothing is filtered on arrival, but once before the next result is read. Filtering on arrival would
repeat what follows for each late measurement: the later they come, the longer each takes, and an
estimator that has fallen behind never catches up.
"""

from bisect import bisect_left, bisect_right
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile
import math

import numpy as np
from obc_ros.core.closed_loop.clock import StampClock, Tick
from obc_ros.core.estimation.filter import (
    assess_innovations,
    Belief,
    Consistency,
    KalmanFilter,
    Update,
)
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import DynamicsError, quote, StatementError

NANOSECONDS = 1_000_000_000
ENOUGH = 20          # outliers that agree with each other
MOST_LATE = 20       # measurements in a row, all too late, after which the filter begins anew
NOTHING = Belief(np.zeros(0), np.zeros((0, 0)))   # before an event is filtered
_KEPT = 200          # innovations of which the consistency is told
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
    rival: Belief | None = None    # of the rival, after the event
    is_counted: bool = False


@dataclass(eq=False)
class _Rival:
    """
    The hypothesis that a filter has lost the plant, against the one that outliers are wrong.

    Wrong measurements need not agree with each other, with the other sensors, or for long; those
    of a lost plant do. docs/estimation.md says when a rival is given up and when it wins.

    :ivar origin: the outlier at which it begins.
    :ivar start: before the outlier.
    :ivar explained, refused: how many outliers of the filter since then pass its test, and do not.
    """

    origin: _Event
    start: Belief
    explained: int = 0
    refused: int = 0

    def vote(self, sensor: tuple[int, ...], of_filter: Update, own: Update) -> bool:
        """Count a measurement after the first one; return whether the rival is kept."""
        if not of_filter.is_outlier:
            return not own.is_outlier and sensor != self.origin.sensor
        self.refused += own.is_outlier
        self.explained += not own.is_outlier
        return self.refused <= self.explained


@dataclass(eq=False)
class _Sensor:
    """What is known of the measurements of one group of outputs."""

    clock: StampClock = field(default_factory=StampClock)
    is_proven: bool = False   # whether a measurement has been used since the filter began
    intervals: deque[float] = field(default_factory=lambda: deque(maxlen=_INTERVALS))


@dataclass(frozen=True, eq=False)
class Estimate:
    """The estimate at an instant: its stamp [ns], mean x (n,) and covariance P (n, n)."""

    stamp: int
    x: Array
    P: Array


class DelayedFilter:
    """
    The estimate of a system from inputs and measurements with stamps.

    :param x0, P0: mean (n,) before the first measurement, and its covariance (n, n), also used
        when the filter restarts.
    :param u0: (m,), input before the first command.
    :param longest_lag: [s] A measurement that is older than the newest one by more is dropped.
    :param longest_gap: [s] After a longer time without measurements the filter restarts; also
        after a longer step of a sensor's stamps back, and for this time outliers must agree with
        each other.
    :param outputs: names of the outputs that are used; empty: all.
    :ivar reason: why the filter was restarted last.
    """

    def __init__(self, kalman: KalmanFilter, x0: Array, P0: Array, u0: Array,
                 longest_lag: float = 0.5, longest_gap: float = 2.0,
                 outputs: Sequence[str] = ()) -> None:
        self._kalman, self._x0, self._P0 = kalman, np.array(x0), np.array(P0)
        self._u, self._limits = np.array(u0), (kalman.system.u_min, kalman.system.u_max)
        self._lag, self._gap = (round(each * NANOSECONDS) for each in (longest_lag, longest_gap))
        self._events: list[_Event] = []
        self._filtered = 0   # how many of them, from the first on
        self._newest: int | None = None
        self._sensors: dict[tuple[int, ...], _Sensor] = {}
        self._names = {name: i for i, name in enumerate(kalman.system.output_names)}
        self._outputs = frozenset(outputs or self._names)
        self._counts: Counter[str] = Counter()
        self._squares: deque[tuple[float, int]] = deque(maxlen=_KEPT)
        self._last: tuple[tuple[str, ...], Update] | None = None
        self._rival: _Rival | None = None
        self._too_late = 0
        self.reason = ''

    @property
    def counts(self) -> Counter[str]:
        """
        Return how many measurements there were of each kind.

        'used', 'late' (filtered again), 'out of order' (older than another of its sensor),
        'too late', 'repeated', 'missing', 'not used', 'not finite', 'out of range' (these three
        entries), 'malformed', 'outliers', 'restarts', 'faults'.
        """
        self._catch_up()
        return self._counts

    @property
    def consistency(self) -> Consistency:
        """Return the consistency of the last innovations."""
        self._catch_up()
        return assess_innovations(self._squares)

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
        self._kalman, self._rival = kalman, None
        self._squares.clear()
        self._limits = kalman.system.u_min, kalman.system.u_max
        self._x0, self._P0 = np.array(x0), np.array(P0)

    def command(self, stamp: int, u: Array) -> None:
        """
        Receive an input that acts from a stamp [ns] on.

        :raises StatementError: if it is not m finite numbers; nothing changes.
        """
        given = np.asarray(u, dtype=float)
        if given.shape != self._u.shape or not np.isfinite(given).all():
            self._counts['malformed'] += 1
            raise StatementError(f'a command of {given.size} numbers was dropped: wanted '
                                 f'{self._u.size} finite numbers')
        given = np.minimum(np.maximum(given, self._limits[0]), self._limits[1])
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

        :param stamp: instant of the measurement [ns].
        :param names, y: the measured outputs and their values; an entry that is not finite is left
            out.
        :return: whether it is used; otherwise it has been counted.
        :raises StatementError: if a name is unknown or stands twice, or the lengths differ;
            nothing changes.
        """
        at, values = self._read(names, y)
        group = tuple(at)
        sensor = self._sensors.setdefault(group, _Sensor())
        at, values = self._keep_usable(at, values)
        if not at or self._is_late(stamp, group, sensor):
            return False
        if self._newest is None or stamp - self._newest > self._gap:
            self._catch_up()
            self._restart(stamp)
        self._insert(_Event(stamp, sensor=group, y=values, at=tuple(at)))
        self._newest = max(stamp, self._newest or stamp)
        self._forget()
        return True

    def estimate(self, stamp: int) -> Estimate:
        """
        Return the estimate at an instant that is not before the newest measurement.

        :raises StatementError: if there was no measurement.
        :raises DynamicsError: if the estimate cannot be predicted to the instant.
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

    def _keep_usable(self, at: list[int], values: Array) -> tuple[list[int], Array]:
        """Count and leave out the entries that are no numbers that the sensor can measure."""
        # NaN is not below its limit either.
        usable = np.abs(values) <= self._kalman.largest[at]
        if usable.all():
            return at, values
        finite = int(np.isfinite(values).sum())
        self._counts['not finite'] += len(at) - finite
        self._counts['out of range'] += finite - int(usable.sum())
        return [i for i, fine in zip(at, usable, strict=True) if fine], values[usable]

    def _is_late(self, stamp: int, at: tuple[int, ...], sensor: _Sensor) -> bool:
        """Count how late a measurement is; return whether it cannot be used."""
        order = sensor.clock.order(stamp, self._gap / NANOSECONDS)
        if order.tick is Tick.RESTART:
            self._forget_all(f'time went back by {order.by:.3g} s')
        elif self._newest is not None and stamp < max(self._newest - self._lag,
                                                      self._events[0].stamp):
            self._counts['too late'] += 1
            self._too_late += 1
            if self._too_late < MOST_LATE:
                return True
            # The newest stamp was wrong.
            self._forget_all(f'{MOST_LATE} measurements in a row were too late')
        self._too_late = 0
        first = bisect_left(self._events, stamp, key=lambda event: event.stamp)
        same = takewhile(lambda event: event.stamp == stamp, self._events[first:])
        if any(set(event.at) & set(at) for event in same):
            self._counts['repeated'] += 1
            return True
        if order.tick is Tick.LATE:
            self._counts['out of order'] += 1
            self._counts['missing'] -= self._counts['missing'] > 0  # it was counted as missing
        elif order.tick is Tick.NEXT:
            if len(sensor.intervals) >= 3:
                period = sorted(sensor.intervals)[len(sensor.intervals) // 2]
                self._counts['missing'] += max(0, round(order.by / period) - 1)
            sensor.intervals.append(order.by)
        self._counts['late'] += self._newest is not None and stamp < self._newest
        return False

    def _forget_all(self, reason: str) -> None:
        """Begin anew at the next measurement, as at the first one."""
        self._catch_up()
        self._events, self._filtered, self._newest, self._too_late = [], 0, None, 0
        self._rival = None
        self._sensors = {at: _Sensor() for at in self._sensors}
        self._note_restart(reason)

    def _note_restart(self, reason: str) -> None:
        self._counts['restarts'] += 1
        self.reason = reason

    def _restart(self, stamp: int) -> None:
        """Begin anew at a stamp; after the first time with the last mean."""
        mean, u = self._x0, self._u
        if self._events:
            self._note_restart(f'no measurement for {(stamp - (self._newest or 0)) * 1e-9:.3g} s')
            mean, u = self._events[-1].after.x, self._events[-1].input_after
        self._begin(stamp, Belief(mean, self._P0), u)

    def _begin(self, stamp: int, belief: Belief, u: Array) -> None:
        """Forget what was filtered, and begin at a stamp with an estimate and an input."""
        start = _Event(stamp, after=belief, input_after=u)
        self._events, self._filtered = [start, *self._events[self._filtered:]], 1
        self._rival = None
        for sensor in self._sensors.values():
            sensor.is_proven = False
        self._squares.clear()

    def _insert(self, event: _Event) -> None:
        """Put an event in its place; what follows has to be filtered again."""
        index = bisect_right(self._events, event.stamp, key=lambda each: each.stamp)
        self._events.insert(index, event)
        self._filtered = min(self._filtered, index)

    def _catch_up(self) -> None:
        while self._filtered < len(self._events):
            before, event = self._events[self._filtered - 1], self._events[self._filtered]
            self._filtered += 1
            event.input_after = before.input_after if event.u is None else event.u
            try:
                event.after, event.update = self._filter(before, before.after, event)
            except (DynamicsError, np.linalg.LinAlgError):
                # The estimate has left the range of numbers: the mean is lost too.
                self._counts['faults'] += 1
                self._note_restart('the estimate left the range of double precision')
                self._begin(event.stamp, Belief(self._x0, self._P0), event.input_after)
                continue
            own = self._follow_rival(before, event)
            if event.update is not None and not event.is_counted:
                self._count(event, event.update, own)

    def _filter(self, before: _Event, belief: Belief, event: _Event
                ) -> tuple[Belief, Update | None]:
        """Return the estimate after an event, and what its measurement did."""
        belief = self._kalman.predict(belief, before.input_after,
                                      (event.stamp - before.stamp) / NANOSECONDS)
        if event.y is None:
            return belief, None
        update = self._kalman.update(belief, event.input_after, event.at, event.y)
        if not update.belief.is_finite:
            raise DynamicsError('the estimate exceeds the range of double precision')
        return update.belief, update

    def _follow_rival(self, before: _Event, event: _Event) -> Update | None:
        """Bring the rival to an event; return what its measurement did; None: no rival."""
        event.rival = None
        if self._rival is None:
            return None
        if event is self._rival.origin:
            event.rival = self._rival.start
        elif before.rival is not None:
            try:
                event.rival, update = self._filter(before, before.rival, event)
            except (DynamicsError, np.linalg.LinAlgError):
                self._rival = None
            else:
                return update
        return None

    def _count(self, event: _Event, update: Update, own: Update | None) -> None:
        """Count a new measurement, and its vote on the rival."""
        event.is_counted = True
        self._counts['outliers' if update.is_outlier else 'used'] += 1
        self._squares.append((update.nis, len(event.at)))
        self._last = tuple(self._kalman.system.output_names[i] for i in event.at), update
        sensor, rival = self._sensors[event.sensor], self._rival
        sensor.is_proven = sensor.is_proven or not update.is_outlier
        if rival is not None and own is not None and not rival.vote(event.sensor, update, own):
            self._rival = rival = None
        if rival is None:
            if update.is_outlier:
                self._begin_rival(event, update)
            return
        # What has never been used since the beginning is no evidence against the rival.
        lasted = event.stamp - rival.origin.stamp
        if (event.rival is not None and rival.explained >= ENOUGH
                and lasted >= self._gap * sensor.is_proven):
            self._note_restart(f'{rival.explained} outliers have agreed with each other for '
                               f'{lasted / NANOSECONDS:.3g} s')
            self._begin(event.stamp, event.rival, event.input_after)

    def _begin_rival(self, event: _Event, update: Update) -> None:
        """
        Begin a rival at an outlier.

        Its covariance is the one of a restart, multiplied until no entry of the innovation is
        above its standard deviation. There is no rival if that exceeds double precision.
        """
        mean, innovation = event.after.x, update.innovation
        C = self._kalman.system.measure(mean, event.input_after)[1][list(event.at)]
        variances = np.einsum('ij,jk,ik->i', C, self._P0, C)
        seen = variances > 0.0   # the others are functions of the input alone
        with np.errstate(over='ignore'):
            ratio = float((innovation[seen]**2 / variances[seen]).max(initial=1.0))
            P = self._P0 * ratio
        if np.isfinite(P).all():
            event.rival = Belief(mean, P)
            self._rival = _Rival(event, event.rival)

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

    :raises StatementError: if their number is another one, or one is not positive and finite.
    """
    if len(values) not in (1, len(names)):
        raise StatementError(f'{name}: wanted 1 or {len(names)} numbers ({", ".join(names)}), '
                             f'found {len(values)}')
    for value in values:
        if not (math.isfinite(value) and value > 0.0):
            raise StatementError(f'{name} = {value:g}: wanted positive numbers')
    return np.diag(np.broadcast_to(np.square(np.array(values, dtype=float)), (len(names),)))
