# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The diagnostics of a node (REP 107); its log says once what they say at WARN or ERROR.

A condition begins with words that its status has not had within `CALM`; numbers in them do not
count. Conditions that alternate are hence logged once each.
"""

from collections.abc import Collection, Mapping
import re
from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

CALM = 10.0   # [s] after which the same words are logged again
CLOCK_APPEARS = 2.0  # [s] in which the publisher of /clock may be discovered
HARDWARE = ('hardware_id of the diagnostics, such as the name of the robot; empty: the namespace, '
            'else the name of the system')
_NUMBER = re.compile(r'\d[\d.]*(e[+-]?\d+)?')


class Diagnostics:
    """
    Publishes the statuses of a node.

    A node with ``use_sim_time`` whose /clock nobody publishes answers services and looks alive,
    but its timers do not run and its stamps are 0: its first status becomes an error.

    :param needs_clock: whether the node needs the time of /clock.
    """

    def __init__(self, node: Any, needs_clock: bool = False) -> None:
        self._node, self._needs_clock = node, needs_clock
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._said: dict[tuple[str, str], float] = {}
        self._missing_since: float | None = None   # of the publisher of /clock
        self._is_reported = False

    def publish(self, statuses: list[DiagnosticStatus], stamp: Any, given: str, otherwise: str,
                told: Collection[str] = ()) -> None:
        """
        Publish statuses, and log what begins; call it every second from a steady timer.

        :param statuses: their hardware_id is set.
        :param stamp: the present time.
        :param given: value of the parameter ``hardware_id``.
        :param otherwise: hardware_id if that is empty and the node has no namespace; not empty.
        :param told: names of statuses whose condition the log has already.
        """
        hardware = given.strip() or self._node.get_namespace().strip('/') or otherwise
        for status in statuses:
            status.hardware_id = hardware
            self._log(status, status.name in told)
        if self._needs_clock and (fault := self._find_clock_fault()):
            first = statuses[0]
            first.level, first.message = DiagnosticStatus.ERROR, f'{first.message}; {fault}'
        array = DiagnosticArray(status=statuses)
        array.header.stamp = stamp
        self._publisher.publish(array)

    def _log(self, status: DiagnosticStatus, is_told: bool) -> None:
        if status.level == DiagnosticStatus.OK:
            return
        now, key = monotonic(), (status.name, _NUMBER.sub('#', status.message))
        recent = {each: at for each, at in self._said.items() if now - at < CALM}
        self._said = {**recent, key: now}
        if key in recent or is_told:
            return
        words, log = f'{status.name.split(": ")[-1]}: {status.message}', self._node.get_logger()
        if status.level == DiagnosticStatus.WARN:
            log.warning(words)
        else:   # rclpy wants a severity of its own at each place
            log.error(words)

    def _find_clock_fault(self) -> str:
        """Return why the time stands still, and log it once; empty: it does not."""
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


def make_status(name: str, level: bytes, message: str, values: Mapping[str, Any]
                ) -> DiagnosticStatus:
    """Return a status with its values as texts."""
    return DiagnosticStatus(name=name, level=level, message=message, values=[
        KeyValue(key=key, value=str(value)) for key, value in values.items()])
