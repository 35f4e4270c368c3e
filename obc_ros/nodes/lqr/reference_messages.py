# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""References that lqr_node receives as messages."""

from obc_ros.core.lqr.design.reference_tracking import Course, read_course
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.msg import Trajectory
from obc_ros.ros.messages import read_nanoseconds


def read_courses(message: Trajectory, system: System, frame: str, followed: tuple[Course, ...]
                 ) -> tuple[Course, ...]:
    """
    Return the references to follow after a message, in the order of their beginnings.

    :param message: the new reference; without samples: no reference.
    :param system: the system that follows.
    :param frame: frame of its states; empty: not known.
    :param followed: the one that is followed, if any: it goes on until the new one begins.
    :raises StatementError: if the message is not a reference for the system.
    """
    if not message.t and not message.x and not message.u:
        return ()
    if message.system not in ('', system.name):
        raise StatementError(f"system = '{quote(message.system)}': wanted {system.name}")
    given = message.header.frame_id
    if given and frame and given != frame:
        raise StatementError(f"frame_id = '{quote(given)}': wanted the frame of the states, "
                             f"'{quote(frame)}'")
    stamp = read_nanoseconds(message.header.stamp)
    new = read_course(system, (message.state_names, message.input_names), message.t, message.x,
                      message.u, message.interpolation, stamp or None)
    return (*followed, new)


def is_same_reference(one: Trajectory, other: Trajectory) -> bool:
    """Return whether two messages are the same reference, whatever else they contain."""
    return all(getattr(one, name) == getattr(other, name)
               for name in ('header', 'system', 't', 'x', 'u'))
