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
        self._kinds: dict[str, _Kind] = {}

    def info(self, kind: str, sentence: str) -> None:
        """Log an expected event."""
        if words := self._due(kind, sentence):
            self._node.get_logger().info(words)

    def warning(self, kind: str, sentence: str) -> None:
        """Log an event that needs attention."""
        if words := self._due(kind, sentence):
            self._node.get_logger().warning(words)

    def _due(self, kind: str, sentence: str) -> str:
        """Return the line to log, or an empty text."""
        left_out = self._kinds.setdefault(kind, _Kind()).take(monotonic())
        if left_out < 0:
            return ''
        return f'{sentence} ({left_out} more since the last such line)' if left_out else sentence


class _Kind:
    """The number of lines of a kind that may still be logged, and of omitted ones."""

    def __init__(self) -> None:
        self._left, self._looked, self._left_out = float(LOG_BURST), monotonic(), 0

    def take(self, now: float) -> int:
        """Return the number of lines omitted before this one; -1 if this one is omitted, too."""
        self._left = min(self._left + (now - self._looked) / PERIOD, LOG_BURST)
        self._looked = now
        if self._left < 1.0:
            self._left_out += 1
            return -1
        self._left -= 1.0
        left_out, self._left_out = self._left_out, 0
        return left_out
