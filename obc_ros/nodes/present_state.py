# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where the plant is now, for a node that needs it only when it is asked."""

from time import monotonic
from typing import Any

from obc_ros.core.errors import StatementError
from obc_ros.msg import State
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

LAST = (2**31 - 2) * 10**9  # [ns] up to which a stamp leaves room for what comes after it
SOURCE = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class PresentState:
    """The last state of a node's topic ``state``; it is looked at when asked."""

    def __init__(self, node: Node) -> None:
        self._message: State | None = None
        self._came = 0.0
        self._subscription = node.create_subscription(State, 'state', self._take, SOURCE)

    def start(self, timeout: float) -> Any:
        """
        Return the state (n,).

        Raises
        ------
        StatementError
            If none has come, or the last one came longer than `timeout` [s] ago.

        """
        topic = self._subscription.topic_name
        if self._message is None:
            raise StatementError(f'start is empty, which means the present state, and no state '
                                 f'has come on {topic}')
        age = monotonic() - self._came
        if age > timeout:
            raise StatementError(f'start is empty, which means the present state, and the last '
                                 f'state on {topic} came {age:.3g} s ago; wanted at most '
                                 f'{timeout:g} s (state_timeout)')
        return self._message.x

    def stamp(self, timeout: float) -> int | None:
        """Return the stamp of the last state [ns]; None: none has come within `timeout` [s]."""
        if self._message is None or monotonic() - self._came > timeout:
            return None
        stamp = self._message.header.stamp
        time = int(stamp.sec) * 10**9 + int(stamp.nanosec)
        return time if 0 <= time <= LAST else None

    def _take(self, message: State) -> None:
        self._message, self._came = message, monotonic()
