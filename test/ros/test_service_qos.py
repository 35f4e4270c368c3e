# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Responses that the middleware drops; rclpy reports this by a warning."""

from collections.abc import Callable
import logging
from typing import Any
import warnings

from obc_ros.ros.service_qos import be_patient
import pytest


class LossyService:
    """A service that drops its first `dropped` responses."""

    srv_name, callback_group = '/get_parameters', None

    def __init__(self, dropped: int) -> None:
        self.dropped = dropped
        self.sent: list[tuple[Any, Any]] = []

    def send_response(self, response: Any, header: Any) -> None:
        """Record the response; warn as rclpy does if it is dropped."""
        self.sent.append((response, header))
        if len(self.sent) <= self.dropped:
            warnings.warn('failed to send response (timeout): client will not receive response',
                          RuntimeWarning, stacklevel=1)


class NodeTimers:
    """A node whose timers run one after the other, without waiting."""

    def __init__(self) -> None:
        self.delays: list[float] = []
        self.timers: list[Callable[[], None]] = []

    def create_timer(self, delay: float, callback: Callable[[], None], *_: Any) -> Any:
        """Keep the callback."""
        self.delays.append(delay)
        self.timers.append(callback)
        return callback

    def destroy_timer(self, timer: Any) -> None:
        """Remove the callback."""
        self.timers.remove(timer)

    def get_logger(self) -> logging.Logger:
        """Return a logger that `caplog` records."""
        return logging.getLogger('node')

    def run(self) -> None:
        """Run the timers until none is left."""
        while self.timers:
            self.timers[0]()


def test_a_dropped_response_is_sent_again() -> None:
    service, node = LossyService(dropped=2), NodeTimers()
    be_patient(node, service)
    service.send_response('answer', 'header')
    node.run()
    assert service.sent == 3 * [('answer', 'header')]
    assert node.delays == pytest.approx([0.2, 0.4])


def test_an_unreachable_client_is_logged_and_given_up(caplog: Any) -> None:
    service, node = LossyService(dropped=1000), NodeTimers()
    be_patient(node, service)
    service.send_response('answer', 'header')
    node.run()
    assert [each.message for each in caplog.records] == [
        '/get_parameters: a client that cannot be reached got no response']
    assert 5.0 < sum(node.delays) < 20.0
