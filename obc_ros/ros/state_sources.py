# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Sources of states: the message of this package, or odometry of robots.

=====  ========  ==========================================================
topic  type      meaning
=====  ========  ==========================================================
state  State     x
odom   Odometry  pose, and twist in the child frame; see `conversions`
=====  ========  ==========================================================
"""

from nav_msgs.msg import Odometry
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.msg import State

SOURCES = {'state': State, 'odom': Odometry}
STATE_SOURCE = 'topic of the states, with its type: state (State) or odom (Odometry)'


class FrameError(StatementError):
    """The frame of a message is invalid, or differs from that of earlier messages."""


class Body:
    """The body whose odometry is read, identified by the child frame."""

    def __init__(self) -> None:
        self._frame = ''

    def check(self, message: Odometry) -> None:
        """Raise FrameError if the child frame is no body frame or that of another body."""
        child = message.child_frame_id
        if child == message.header.frame_id:
            raise FrameError(
                f"odometry with child_frame_id = header.frame_id = '{quote(child)}': the twist "
                'needs the frame of the body')
        if self._frame and child != self._frame:
            raise FrameError(f"odometry of '{quote(child)}', after that of '{quote(self._frame)}'")

    def keep(self, message: Odometry) -> None:
        """Set the body to that of a message."""
        self._frame = message.child_frame_id
