# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Quality of service of topics, and of services with many clients: no response is lost.

Every client of a service receives the responses to all clients. With the default depth of 10, a
burst of requests or responses overflows the queues. A request can also arrive before the reader
of its client has been discovered: the middleware then waits 0.1 s, drops the response, and rclpy
warns.
"""

from typing import Any
import warnings

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.service import Service

STEADY = Clock(clock_type=ClockType.STEADY_TIME)   # for timers: simulated time may stand still
# rclpy writes overrides of parameters into a profile: such a topic takes a copy.
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BURST = QoSProfile(depth=1000)  # for the service and for its clients
FIRST, LAST = 0.2, 5.0          # [s] until a dropped response is sent again; doubled each time


def be_patient(node: Node, service: Service) -> None:
    """Have responses of a service sent again that the middleware has dropped."""
    send = service.send_response

    def send_or_retry(response: Any, header: Any, delay: float = FIRST) -> None:
        with warnings.catch_warnings(record=True) as dropped:
            warnings.simplefilter('always')
            send(response, header)
        if dropped and delay > LAST:
            node.get_logger().warning(
                f'{service.srv_name}: a client that cannot be reached got no response')
        elif dropped:
            def retry() -> None:
                node.destroy_timer(timer)
                send_or_retry(response, header, 2.0 * delay)

            timer = node.create_timer(delay, retry, service.callback_group, STEADY)

    service.send_response = send_or_retry
