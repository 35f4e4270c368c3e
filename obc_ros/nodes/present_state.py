# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where the plant is now, for a node that needs it only when it is asked."""

from collections.abc import Sequence
from time import monotonic
from typing import Any

from obc_ros.core.text.errors import StatementError
from obc_ros.ros.messages import check_size, read_parameters
from obc_ros.ros.state_sources import Body, FrameError, SOURCES
from obc_ros.ros.throttled_log import ThrottledLog
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

LAST = (2**31 - 2) * 10**9  # [ns] up to which a stamp leaves room for what comes after it
SOURCE = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class PresentState:
    """
    The last state that came to a node; it is looked at when asked.

    Parameters
    ----------
    node : rclpy.node.Node
        Whose topic it is.
    topic : str
        A key of `SOURCES`.
    log : ThrottledLog
        For what is dropped.

    """

    def __init__(self, node: Node, topic: str, log: ThrottledLog) -> None:
        self._topic, self._log, self._body = topic, log, Body()
        self._message: Any = None
        self._came = 0.0
        self._subscription = node.create_subscription(
            SOURCES[topic], topic, self._take if topic == 'state' else self._take_odometry, SOURCE)

    def start(self, request: Any, timeout: float) -> Sequence[float]:
        """
        Return the state (n,).

        Parameters
        ----------
        request : PlanMotion.Request
            Its system is the one that odometry is read for.
        timeout : float
            Largest age [s].

        Raises
        ------
        ObcError
            If none has come, or the last one came longer than `timeout` ago; for odometry, also if
            it tells no state of the system, or there is no such system.

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
        if self._topic == 'state':
            return self._message.x  # type: ignore[no-any-return] # array of double
        # Imported where used: CasADi takes a third of a second, and few ask for plans.
        from obc_ros.core.solver.motion_planning import find_registered
        from obc_ros.ros.conversions import make_state_reader
        check_size(request)
        given = read_parameters('system_parameters', request.system_parameters)
        return make_state_reader(self._topic,
                                 find_registered(request.system, given))(self._message)

    def stamp(self, timeout: float) -> int | None:
        """Return the stamp of the last state [ns]; None: none has come within `timeout` [s]."""
        if self._message is None or monotonic() - self._came > timeout:
            return None
        stamp = self._message.header.stamp
        time = int(stamp.sec) * 10**9 + int(stamp.nanosec)
        return time if 0 <= time <= LAST else None

    def _take(self, message: Any) -> None:
        self._message, self._came = message, monotonic()

    def _take_odometry(self, message: Any) -> None:
        try:
            self._body.check(message)
        except FrameError as error:
            self._log.warning('frame', f'a state was dropped: {error}')
        else:
            self._body.keep(message)
            self._take(message)
