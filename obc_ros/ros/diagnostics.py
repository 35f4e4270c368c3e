# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The diagnostics of a node (REP 107); its log says once what they say at WARN or ERROR.

A condition begins with words that its status has not had within `CALM`; numbers in them do not
count. Conditions that alternate are hence logged once each.
"""

from collections.abc import Collection
import re
from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from obc_ros.ros.clock_watch import ClockWatch
from obc_ros.ros.hardware_id import identify

CALM = 10.0   # [s] after which the same words are logged again
_NUMBER = re.compile(r'\d[\d.]*(e[+-]?\d+)?')


class Diagnostics:
    """
    Publishes the statuses of a node.

    :param node: whose log is used.
    :param clock: judges the first status; it has a log of its own.
    """

    def __init__(self, node: Any, clock: ClockWatch | None = None) -> None:
        self._node, self._clock = node, clock
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._said: dict[tuple[str, str], float] = {}

    def publish(self, statuses: list[DiagnosticStatus], stamp: Any, given: str, otherwise: str,
                told: Collection[str] = ()) -> None:
        """
        Publish statuses, and log what begins.

        :param statuses: their hardware_id is set.
        :param stamp: the present time.
        :param given, otherwise: see `hardware_id.identify`.
        :param told: names of statuses whose condition the log has already.
        """
        identify(statuses, self._node, given, otherwise)
        for status in statuses:
            self._log(status, status.name in told)
        if self._clock is not None:
            self._clock.add_fault(statuses[0])
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
