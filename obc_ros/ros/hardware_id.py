# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The field hardware_id of the diagnostics of a node (REP 107)."""

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

HARDWARE = ('hardware_id of the diagnostics, such as the name of the robot; empty: the namespace, '
            'else the name of the system')


def identify(statuses: list[DiagnosticStatus], node: Node, given: str, otherwise: str) -> None:
    """
    Set the hardware_id of each status.

    :param statuses: changed in place.
    :param node: the node that publishes them.
    :param given: value of the parameter ``hardware_id``.
    :param otherwise: value if that is empty and the node has no namespace; not empty.
    """
    hardware = given.strip() or node.get_namespace().strip('/') or otherwise
    for status in statuses:
        status.hardware_id = hardware
