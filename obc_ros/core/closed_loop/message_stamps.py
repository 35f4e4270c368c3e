# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Stamps of messages: their age and order, and when the next command is due."""

NS = 1e-9  # [s]
OTHER_CLOCK = 3600.0  # [s] a larger difference means that the stamp is from another clock


def compute_age(stamp: int, clock: int) -> float | None:
    """Return the age [s] of a stamp [ns] by a clock [ns]; None: they are not of one clock."""
    seconds = (clock - stamp) * NS
    return seconds if abs(seconds) < OTHER_CLOCK else None


class StampOrder:
    """The order of the stamps of a run, and the stamps at which a command is due."""

    def __init__(self) -> None:
        self.answered: int | None = None
        self._last: int | None = None
        self._late: int | None = None
        self._due: int | None = None

    def order(self, stamp: int, far: float) -> str:
        """Return '' (later than the last), 'repeated', 'late' or 'restarted'."""
        last, late = self._last, self._late
        if last is not None and stamp < last:
            # Two earlier stamps in a row, or one more than far [s] earlier, mean a restart.
            if not (late is not None and stamp >= late) and (last - stamp) * NS <= far:
                self._late = stamp
                return 'late'
            self.answered = self._due = None
        self._last, self._late = stamp, None
        if last is None or stamp > last:
            return ''
        return 'repeated' if stamp == last else 'restarted'

    def is_due(self, stamp: int, period: int) -> bool:
        """Return whether a command is due, at most one in `period` [ns]; 0: always."""
        if not period or stamp == self.answered:
            return True
        # The rounding of the plant's own period must not skip a state.
        if self._due is not None and stamp < self._due - period // 1000:
            return False
        in_step = self._due is not None and stamp - self._due < period
        self._due = (self._due if in_step and self._due is not None else stamp) + period
        return True
