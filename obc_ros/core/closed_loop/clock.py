# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The order of stamped messages: which follows, repeats, is late, or tells of a jump of time.

Only the stamps decide, so that the same messages mean the same at any speed of the simulation.
"""

from enum import auto, Enum
from typing import NamedTuple

NS = 1e-9  # [s]
FAR = 1.0  # [s] step back of the stamps that counts as a jump if there is no time-out


class Tick(Enum):
    """What a stamp means after the one before."""

    FIRST = auto()
    NEXT = auto()
    SAME = auto()
    LATE = auto()      # older than the last one: to be dropped
    OUTAGE = auto()    # later by more than the time-out
    RESTART = auto()   # earlier by more than the time-out


class Order(NamedTuple):
    """A tick, and the absolute difference [s] to the last stamp."""

    tick: Tick
    by: float


class StampClock:
    """
    Judges the stamps of one source in the order of their arrival.

    :ivar last: last stamp [ns] that was not late.
    """

    def __init__(self) -> None:
        self.last: int | None = None
        self._is_new = False

    def renew(self) -> None:
        """Expect stamps of another source: one that seems to be late is the first."""
        self._is_new = True

    def order(self, stamp: int, timeout: float) -> Order:
        """
        Return what a stamp means, and remember it unless it is late.

        :param stamp: [ns].
        :param timeout: larger steps are jumps [s]; 0: only steps back by more than `FAR` are.
        """
        last, far = self.last, timeout or FAR
        by = 0.0 if last is None else (stamp - last) * NS
        is_behind, is_new, self._is_new = -far <= by < 0.0, self._is_new, False
        if is_behind and not is_new:
            return Order(Tick.LATE, -by)
        self.last = stamp
        if last is None or is_behind:
            return Order(Tick.FIRST, 0.0)
        if by < 0.0:
            return Order(Tick.RESTART, -by)
        if 0.0 < timeout < by:
            return Order(Tick.OUTAGE, by)
        return Order(Tick.NEXT if by else Tick.SAME, by)


class Pace:
    """
    The stamps at which a command is due: on average at most one in a period.

    Of the stamps around the end of a period the nearest one counts, as far as their last distance
    tells, so that jitter skips no state; the grid of the periods stays where it is.
    """

    def __init__(self) -> None:
        self._answered: int | None = None
        self._due: int | None = None
        self._last: int | None = None

    def forget(self) -> None:
        """Begin a new grid with the next stamp."""
        self._answered = self._due = self._last = None

    def is_due(self, stamp: int, period: int) -> bool:
        """Return whether a command is due at a stamp [ns], for a period [ns]; 0: always."""
        if not period or stamp == self._answered:
            return True
        due, apart = self._due, 0 if self._last is None else stamp - self._last
        self._last = stamp
        if due is not None and stamp < due - max(apart // 2, period // 1000):
            return False
        self._due = (stamp if due is None or stamp - due >= period else due) + period
        self._answered = stamp
        return True
