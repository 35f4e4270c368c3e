# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Answers that the middleware drops, as rclpy tells of it: by a warning."""

from collections.abc import Callable
import logging
from typing import Any
import warnings

from obc_ros.ros.service_qos import be_patient
import pytest


class LossyService:
    """Drops the first answers."""

    srv_name, callback_group = '/get_parameters', None

    def __init__(self, dropped: int) -> None:
        self.dropped = dropped
        self.sent: list[tuple[Any, Any]] = []

    def send_response(self, response: Any, header: Any) -> None:
        """Send, or say that it was dropped."""
        self.sent.append((response, header))
        if len(self.sent) <= self.dropped:
            warnings.warn('failed to send response (timeout): client will not receive response',
                          RuntimeWarning, stacklevel=1)


class Waiting:
    """A node's timers, run one after the other at once."""

    def __init__(self) -> None:
        self.delays: list[float] = []
        self.timers: list[Callable[[], None]] = []

    def create_timer(self, delay: float, callback: Callable[[], None], *_: Any) -> Any:
        """Keep the callback."""
        self.delays.append(delay)
        self.timers.append(callback)
        return callback

    def destroy_timer(self, timer: Any) -> None:
        """Forget it."""
        self.timers.remove(timer)

    def get_logger(self) -> logging.Logger:
        """Return a logger that pytest looks at."""
        return logging.getLogger('node')

    def run(self) -> None:
        """Let the time pass that all timers take."""
        while self.timers:
            self.timers[0]()


def test_an_answer_is_sent_again_until_it_gets_through() -> None:
    service, node = LossyService(dropped=2), Waiting()
    be_patient(node, service)
    service.send_response('answer', 'header')
    node.run()
    assert service.sent == 3 * [('answer', 'header')]
    assert node.delays == pytest.approx([0.2, 0.4])


def test_a_client_that_has_gone_is_told_of_and_given_up(caplog: Any) -> None:
    service, node = LossyService(dropped=1000), Waiting()
    be_patient(node, service)
    service.send_response('answer', 'header')
    node.run()
    assert [each.message for each in caplog.records] == [
        '/get_parameters: a client that cannot be reached got no response']
    assert 5.0 < sum(node.delays) < 20.0
