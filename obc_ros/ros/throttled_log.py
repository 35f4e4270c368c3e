# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A log that messages and requests of others cannot flood."""

from time import monotonic
from typing import Any

LOG_BURST = 10    # lines of a kind that are logged at once
PERIOD = 1.0  # [s] per further line


class ThrottledLog:
    """
    Logs at most `LOG_BURST` lines of a kind at once, then one in each `PERIOD`.

    A line that follows omitted ones has their number.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self.warned: set[str] = set()
        # By kind: how many lines may still be logged, at which time, and how many were omitted.
        self._kinds: dict[str, tuple[float, float, int]] = {}

    def info(self, kind: str, sentence: str) -> None:
        """Log an expected event."""
        if words := self._due(kind, sentence):
            self._node.get_logger().info(words)

    def warning(self, kind: str, sentence: str) -> None:
        """Log an event that needs attention."""
        if words := self._due(kind, sentence):
            self._node.get_logger().warning(words)

    def warn_once(self, sentence: str) -> None:
        """Log a warning the first time; the words before the colon are its kind."""
        if (kind := sentence.split(':')[0]) not in self.warned:
            self.warned.add(kind)
            self._node.get_logger().warning(
                f'{sentence}; further cases are counted in diagnostics')

    def _due(self, kind: str, sentence: str) -> str:
        now = monotonic()
        left, looked, omitted = self._kinds.get(kind, (LOG_BURST, now, 0))
        left = min(left + (now - looked) / PERIOD, LOG_BURST)
        if left < 1.0:
            self._kinds[kind] = left, now, omitted + 1
            return ''
        self._kinds[kind] = left - 1.0, now, 0
        return f'{sentence} ({omitted} more since the last such line)' if omitted else sentence
