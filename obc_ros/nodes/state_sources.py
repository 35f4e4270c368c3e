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

from collections.abc import Callable, Sequence
from typing import Any

from nav_msgs.msg import Odometry
from obc_ros.core.errors import shown, StatementError
from obc_ros.core.system import System
from obc_ros.msg import State
from obc_ros.nodes.conversions import OdometryMap

SOURCES = {'state': State, 'odom': Odometry}
STATE_SOURCE = 'topic of the states, with its type: state (State) or odom (Odometry)'

Read = Callable[[Any], Sequence[float]]


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
                f"odometry with child_frame_id = header.frame_id = '{shown(child)}': its twist "
                'belongs in the frame of the body')
        if self._frame and child != self._frame:
            raise FrameError(f"odometry of '{shown(child)}', after that of '{shown(self._frame)}'")

    def keep(self, message: Odometry) -> None:
        """Take the body of a message for the one that is read."""
        self._frame = message.child_frame_id


def conversion(topic: str, system: System) -> Read:
    """
    Return what makes a state (n,) of one message, whatever came before it.

    Raises
    ------
    StatementError
        If the messages of the topic, a key of `SOURCES`, do not tell the state of the system.
        What is returned raises it for a message that tells none.

    """
    if topic == 'state':
        return lambda message: message.x  # type: ignore[no-any-return] # array of double
    odometry = OdometryMap(system)
    if not odometry.readable:
        raise StatementError(f'state_source = odom: a pose and a twist do not tell the state of '
                             f'{system.name} ({", ".join(system.state_names)})')
    return lambda message: odometry.state(message).tolist()  # type: ignore[no-any-return]


def source(topic: str, system: System) -> Read:
    """Return what makes a state (n,) of each message of a topic, as `conversion`; of one body."""
    convert, body = conversion(topic, system), Body()
    if topic == 'state':
        return convert

    def state(message: Odometry) -> Sequence[float]:
        body.check(message)
        x = convert(message)
        body.keep(message)
        return x

    return state
