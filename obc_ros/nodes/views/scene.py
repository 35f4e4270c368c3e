# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The plane in which a body moves, in the frame odom, and the markers of one topic."""

from collections.abc import Sequence
import math

from geometry_msgs.msg import Point, Pose
from obc_ros.core.numerics.arrays import Array
from rclpy.node import Node
from rclpy.qos import QoSProfile
from visualization_msgs.msg import Marker, MarkerArray

_COORDINATES = ('px', 'py', 'theta')


class PlaneMap:
    """
    Map from states to places in a plane.

    :param names: names of the states. Without px, py or theta that coordinate is 0.
    :param plane: as in `System`; empty: horizontal, and then px and py have to be among the
        states.
    :ivar has_places: whether a state has a place.
    """

    def __init__(self, names: Sequence[str], plane: str) -> None:
        self.is_vertical = plane == 'vertical'
        self._at = [names.index(name) if name in names else None for name in _COORDINATES]
        known = sum(index is not None for index in self._at[:2])
        self.has_places = known == 2 or (bool(plane) and known == 1)

    def locate(self, x: Sequence[float] | Array) -> tuple[float, float, float]:
        """Return (px [m], py [m], theta [rad]) of a state or of its derivative, shape (n,)."""
        px, py, theta = (0.0 if index is None else float(x[index]) for index in self._at)
        return px, py, theta

    def point(self, px: float, py: float, aside: float = 0.0) -> Point:
        """Return a point of the plane, moved by `aside` [m] along the normal of the plane."""
        return Point(x=px, y=-aside, z=py) if self.is_vertical else Point(x=px, y=py, z=aside)

    def pose(self, px: float, py: float, theta: float, aside: float = 0.0) -> Pose:
        """Return a pose; angles are positive as in `conversions`."""
        pose = Pose(position=self.point(px, py, aside))
        pose.orientation.w = math.cos(theta / 2)
        if self.is_vertical:
            pose.orientation.y = -math.sin(theta / 2)
        else:
            pose.orientation.z = math.sin(theta / 2)
        return pose


class Scene:
    """A topic of markers: those that are no longer shown are removed."""

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
