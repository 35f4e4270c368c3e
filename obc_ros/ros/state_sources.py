# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sources of states: the message of this package, or odometry of robots; see `conversions`."""

from collections.abc import Sequence

from nav_msgs.msg import Odometry
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.msg import State

SOURCES = {'state': State, 'odom': Odometry}
STATE_SOURCE = 'topic of the states, with its type: state (State) or odom (Odometry)'


class FrameError(StatementError):
    """The frame of a message is invalid, or differs from that of earlier messages."""


class NamesError(StatementError):
    """The components of a message are not those of the system."""


class Components:
    """The named states or inputs of a system, in messages that may name them, in any order."""

    def __init__(self, system: str, names: Sequence[str]) -> None:
        self._system, self._names = system, list(names)
        self._permuted: tuple[list[str], list[int]] = list(names), []   # the last one, its order

    def arrange(self, names: list[str], values: Sequence[float]) -> Sequence[float]:
        """
        Return the values of a message in the order of the system.

        :param names: names in the message; empty: not stated, and not checked.
        :param values: the values in the message.
        :raises NamesError: if other names are stated, or more or fewer than values.
        """
        if not names or names == self._names:
            return values
        if names != self._permuted[0]:
            if sorted(names) != sorted(self._names):
                raise NamesError(
                    f'its components are ({quote(", ".join(names), 200)}); wanted '
                    f'({", ".join(self._names)}) of {self._system}')
            self._permuted = list(names), [names.index(name) for name in self._names]
        if len(values) != len(names):
            raise NamesError(f'it has {len(names)} names and {len(values)} numbers')
        return [values[index] for index in self._permuted[1]]


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
