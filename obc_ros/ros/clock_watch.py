# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A node with ``use_sim_time`` whose /clock nobody publishes: its time stands still.

Such a node answers services and looks alive, but its timers do not run and its stamps are 0.
"""

from time import monotonic

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

CLOCK_APPEARS = 2.0  # [s] in which the publisher of /clock may be discovered


class ClockWatch:
    """
    Looks for a publisher of /clock; nothing depends on the time that stands still.

    :param node: whose parameter ``use_sim_time`` and whose log are used.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._missing_since: float | None = None
        self._is_reported = False

    def find_fault(self) -> str:
        """
        Return what is wrong, and log it once; call it every second from a steady timer.

        :return: empty: the node uses the system clock, or /clock has a publisher, or had one
            within the last 2 s.
        """
        node = self._node
        if not node.get_parameter('use_sim_time').value or node.count_publishers('/clock'):
            self._missing_since, self._is_reported = None, False
            return ''
        if self._missing_since is None:
            self._missing_since = monotonic()
        if monotonic() - self._missing_since < CLOCK_APPEARS:
            return ''
        sentence = 'use_sim_time is true, but no node publishes /clock: time stands still'
        if not self._is_reported:
            self._is_reported = True
            node.get_logger().warning(sentence)
        return sentence

    def add_fault(self, status: DiagnosticStatus) -> None:
        """Make a status an error, and add what is wrong, if there is a fault."""
        if fault := self.find_fault():
            status.level, status.message = DiagnosticStatus.ERROR, f'{status.message}; {fault}'
