# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which of several publishers of the states a controller uses: the first, until it is silent."""

from dataclasses import dataclass
from enum import auto, Enum

FAR = 1000   # messages: more are not lost in a row before the source counts as silent


class Source(Enum):
    """What a message tells of its publisher."""

    SAME = auto()
    OTHER = auto()      # a second publisher, not to be used
    REPLACED = auto()   # the first one is silent


@dataclass
class SourceWatch:
    """
    Tells publishers apart by the numbers that the middleware gives their messages.

    rclpy does not say who has sent a message, but every publisher counts its own messages. Two
    that began together cannot be told apart by their numbers; the graph shows both.
    """

    _last: int | None = None
    _heard: float = 0.0

    def is_next(self, number: int | None, now: float) -> bool:
        """Return whether a message surely is of the same publisher; if not, `judge` it."""
        last = self._last   # the same number again is that of a message delivered twice
        if number is None or last is None or not last <= number <= last + FAR:
            return False
        self._last, self._heard = number, now
        return True

    def identify(self, number: int | None, now: float, patience: float) -> Source:
        """
        Return whose message this is.

        :param number: number of the message by its publisher; None: the middleware gives none.
        :param now: steady clock [s].
        :param patience: silence [s] after which another publisher is used.
        """
        if number is None or self.is_next(number, now):
            return Source.SAME
        is_first = self._last is None
        if not is_first and now - self._heard < patience:
            return Source.OTHER
        self._last, self._heard = number, now
        return Source.SAME if is_first else Source.REPLACED
