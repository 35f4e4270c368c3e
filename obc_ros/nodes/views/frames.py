# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The frame of a body in the tree of tf2, if tf2_msgs is installed."""

from importlib import import_module, util
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, TransformStamped
from obc_ros.core.text.errors import StatementError
from obc_ros.ros.conversions import BASE, ODOM
from rclpy.node import Node

MESSAGES = 'tf2_msgs'   # not among the wheels of ROS 2


def check_frames() -> None:
    """Raise StatementError if there are no messages for frames."""
    if util.find_spec(MESSAGES) is None:
        raise StatementError('publish_tf: the package tf2_msgs is missing; install it '
                             '(ros-$ROS_DISTRO-tf2-msgs), or leave publish_tf out')


class FrameBroadcaster:
    """
    Publisher of the frame of the body in odom, on the topic tf.

    :param node: the node that publishes.
    """

    def __init__(self, node: Node) -> None:
        self._type = import_module('tf2_msgs.msg').TFMessage
        self._publisher = node.create_publisher(self._type, 'tf', 100)   # as tf2_ros does

    @property
    def is_watched(self) -> bool:
        """Return whether there is a subscriber."""
        return bool(self._publisher.get_subscription_count() > 0)

    def publish(self, pose: Pose, stamp: Time) -> None:
        """Publish the pose of the body."""
        self._publisher.publish(self._type(transforms=[make_transform(pose, stamp)]))


def make_transform(pose: Pose, stamp: Time) -> Any:
    """Return the transform from the body at a pose to odom."""
    message = TransformStamped(child_frame_id=BASE)
    message.header.frame_id, message.header.stamp = ODOM, stamp
    position, translation = pose.position, message.transform.translation
    translation.x, translation.y, translation.z = position.x, position.y, position.z
    message.transform.rotation = pose.orientation
    return message
