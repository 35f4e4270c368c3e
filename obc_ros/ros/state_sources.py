# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Where a node takes states from: this package's own message, or that of robots.

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
    """A message is of another frame than the ones before."""


class Body:
    """Whose odometry is read: that of the child frame that is kept first."""

    def __init__(self) -> None:
        self._frame = ''

    def check(self, message: Odometry) -> None:
        """Raise FrameError for a twist that is of no body, or of another one."""
        child = message.child_frame_id
        if child == message.header.frame_id:
            raise FrameError(
                f"odometry with child_frame_id = header.frame_id = '{quote(child)}': its twist "
                'belongs in the frame of the body')
        if self._frame and child != self._frame:
            raise FrameError(f"odometry of '{quote(child)}', after that of '{quote(self._frame)}'")

    def keep(self, message: Odometry) -> None:
        """Take the body of a message for the one that is read."""
        self._frame = message.child_frame_id
