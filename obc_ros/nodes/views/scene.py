# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The markers of one topic: those that are no longer shown are removed."""

from collections.abc import Sequence

from rclpy.node import Node
from rclpy.qos import QoSProfile
from visualization_msgs.msg import Marker, MarkerArray


class Scene:
    """
    A topic of markers.

    :param node: the node that publishes.
    :param topic: name of the topic.
    :param qos: its quality of service.
    """

    def __init__(self, node: Node, topic: str, qos: QoSProfile | int) -> None:
        self._publisher = node.create_publisher(MarkerArray, topic, qos)
        self._shown: set[tuple[str, int]] = set()

    @property
    def is_watched(self) -> bool:
        """Return whether there is a subscriber."""
        return bool(self._publisher.get_subscription_count())

    def show(self, markers: Sequence[Marker]) -> None:
        """Publish all markers of the topic; those of the last call without a successor vanish."""
        now = {(marker.ns, marker.id) for marker in markers}
        gone = [Marker(ns=name, id=number, action=Marker.DELETE)
                for name, number in sorted(self._shown - now)]
        self._publisher.publish(MarkerArray(markers=[*gone, *markers]))
        self._shown = now

    def clear(self) -> None:
        """Remove the markers that are shown."""
        if self._shown:
            self.show([])
