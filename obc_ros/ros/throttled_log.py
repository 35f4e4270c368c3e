# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Lines of a node's log that others can provoke: they cannot flood it."""

from time import monotonic
from typing import Any

LOG_BURST = 10    # lines of a kind that may come at once
PERIOD = 1.0  # [s] in which one more may come


class ThrottledLog:
    """
    Logs at most `LOG_BURST` lines of a kind at once, and afterwards one in each `PERIOD`.

    A line that comes after others were left out says how many.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self._kinds: dict[str, _Kind] = {}

    def info(self, kind: str, sentence: str) -> None:
        """Log what goes as it should."""
        if words := self._due(kind, sentence):
            self._node.get_logger().info(words)

    def warning(self, kind: str, sentence: str) -> None:
        """Log what somebody should look at."""
        if words := self._due(kind, sentence):
            self._node.get_logger().warning(words)

    def _due(self, kind: str, sentence: str) -> str:
        """Return the line to log; empty: none."""
        left_out = self._kinds.setdefault(kind, _Kind()).take(monotonic())
        if left_out < 0:
            return ''
        return f'{sentence} ({left_out} more since the last such line)' if left_out else sentence


class _Kind:
    """How many lines of a kind may still come, and how many were left out."""

    def __init__(self) -> None:
        self._left, self._looked, self._left_out = float(LOG_BURST), monotonic(), 0

    def take(self, now: float) -> int:
        """Return how many lines were left out before one that is due; -1: it is left out, too."""
        self._left = min(self._left + (now - self._looked) / PERIOD, LOG_BURST)
        self._looked = now
        if self._left < 1.0:
            self._left_out += 1
            return -1
        self._left -= 1.0
        left_out, self._left_out = self._left_out, 0
        return left_out
