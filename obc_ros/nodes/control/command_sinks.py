# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Command messages of a controller: a `Sink` converts an input to a message.

No name of a system decides anything here: see `robot_fields`. The wrench acts in base_link (x
forward, z up).
"""

from array import array
from collections.abc import Sequence
import math
from typing import Any

from builtin_interfaces.msg import Time
import casadi as ca
from geometry_msgs.msg import Twist, TwistStamped, WrenchStamped
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.robot_fields import suggest_command_line
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import Command
from obc_ros.ros.conversions import BASE

SINKS = {'command': Command, 'cmd_vel': TwistStamped, 'wrench': WrenchStamped}


class Sink:
    """
    Converter from inputs to messages.

    :param topic: a key of `SINKS`.
    :ivar type: type of the messages.
    :raises StatementError: if the system does not say how the message carries all of its inputs.
    """

    def __init__(self, topic: str, system: System, is_stamped: bool = True) -> None:
        self.type = Twist if topic == 'cmd_vel' and not is_stamped else SINKS[topic]
        self._message = self.type()
        self._header = getattr(self._message, 'header', None)
        if topic == 'command':
            self._message.names = list(system.input_names)
            self._fill = self._command
            return
        self._fill = self._fields
        if self._header is not None:
            self._header.frame_id = BASE
        fields = _find_fields(topic, system)
        body = getattr(self._message, 'twist', getattr(self._message, 'wrench', self._message))
        self._places = [(getattr(body, part), axis)
                        for part, axis in (name.split('.') for name in fields)]
        made = ca.substitute(ca.vertcat(*fields.values()), system.p, ca.DM(system.p_value))
        self._function = ca.Function(topic, [system.u], [ca.densify(made)])
        # A buffer is several times faster than a call.
        self._u, self._values = np.zeros(system.m), np.zeros(len(fields))
        self._buffer, self._evaluate = self._function.buffer()
        self._buffer.set_arg(0, self._u.data)  # type: ignore[call-arg] # as in C++
        self._buffer.set_res(0, self._values.data)  # type: ignore[call-arg] # as in C++

    def message(self, u: Sequence[float], stamp: Time) -> Any:
        """
        Return the message of an input (m,); the next call changes it in place.

        If a field would not be finite, all fields remain those of the last message.
        """
        if self._header is not None:
            self._header.stamp = stamp
        self._fill(u)
        return self._message

    def check(self, u: Sequence[float] | Array, where: str) -> None:
        """Raise StatementError if the message of an input (m,) is not finite."""
        if self._fill == self._command:
            return
        for (_, axis), value in zip(self._places, self._evaluated(u), strict=True):
            if not math.isfinite(value):
                raise StatementError(f'the message of the input {where}, {list(u)}, is not '
                                     f'finite: its field {axis} is {value}')

    def _command(self, u: Sequence[float]) -> None:
        self._message.u = array('d', u)

    def _fields(self, u: Sequence[float]) -> None:
        values = self._evaluated(u)
        if all(map(math.isfinite, values)):
            for (part, axis), value in zip(self._places, values, strict=True):
                setattr(part, axis, value)

    def _evaluated(self, u: Sequence[float] | Array) -> list[float]:
        self._u[:] = u
        self._evaluate()
        return self._values.tolist()


def _find_fields(topic: str, system: System) -> dict[str, ca.SX]:
    fields = dict(system.robot.commands.get(topic, {}))
    inputs = [(each.name, each.unit) for each in system.inputs]
    if not fields:
        raise StatementError(
            f'command_sink = {topic}: it is not known how this message carries the inputs of '
            f'{system.name}; add to its file: {suggest_command_line(topic, inputs)}')
    carried = ca.vertcat(*fields.values())
    missing = [name for j, (name, _) in enumerate(inputs) if not ca.depends_on(
        carried, system.u[j])]
    if missing:
        raise StatementError(f'command_sink = {topic}: no field of ros.{topic} of {system.name} '
                             f'contains {" or ".join(missing)}')
    return fields
