# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The baseline of benchmarks/latency.py: a node that replies to each State with a Command."""

from array import array
from contextlib import suppress

from obc_ros.msg import Command, State
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

U = array('d', (0.0, 39.2))


def main() -> None:
    """Echo until a signal ends it."""
    rclpy.init()
    node = Node('echo')
    publisher = node.create_publisher(Command, 'command', QoSProfile(depth=1))
    answer = Command(u=U, names=['f1', 'f2'])   # as lqr_node does

    def on_state(message: State) -> None:
        answer.header.stamp = message.header.stamp
        answer.u = U
        publisher.publish(answer)

    node.create_subscription(
        State, 'state', on_state, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main()
