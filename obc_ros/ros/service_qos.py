# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Services lose no answer, however many clients use them at once.

Every client of a service hears the answers to all; with the default depth of ten, requests or
answers that come in a burst push each other out. And a request can arrive before the reader of
its client is known here: the middleware then waits 0.1 s, drops the answer and has rclpy warn.
"""

from typing import Any
import warnings

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.service import Service

BURST = QoSProfile(depth=1000)  # for the service, and for clients in a crowd
FIRST, LAST = 0.2, 5.0          # [s] until a dropped answer is sent again, each time twice as long


def be_patient(node: Node, service: Service) -> None:
    """Have the answers of a service sent again when the middleware has dropped them."""
    send, clock = service.send_response, Clock(clock_type=ClockType.STEADY_TIME)

    def send_or_retry(response: Any, header: Any, delay: float = FIRST) -> None:
        with warnings.catch_warnings(record=True) as dropped:
            warnings.simplefilter('always')
            send(response, header)
        if dropped and delay > LAST:
            node.get_logger().warning(
                f'{service.srv_name}: a client that cannot be reached got no answer')
        elif dropped:
            def retry() -> None:
                node.destroy_timer(timer)
                send_or_retry(response, header, 2.0 * delay)

            timer = node.create_timer(delay, retry, service.callback_group, clock)

    service.send_response = send_or_retry
