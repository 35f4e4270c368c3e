# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Command messages of a controller: a `Sink` converts an input to a message.

==========  ================  ==========================================================
topic       type              meaning
==========  ================  ==========================================================
command     Command           u
cmd_vel     TwistStamped, or  vehicle: linear.x = v, angular.z = (v / l) tan(phi); two_wheeled:
            Twist             linear.x = v, angular.z = omega
wrench      WrenchStamped     aircraft, at its centre of mass in base_link (x forward, z up):
                              force.x = f1, force.z = f2, torque.y = -r f1 (nose up positive
                              is a rotation about -y)
==========  ================  ==========================================================
"""

from array import array
from collections.abc import Callable, Sequence
import math
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist, TwistStamped, WrenchStamped
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import Command
from obc_ros.ros.conversions import BASE

SINKS = {'command': Command, 'cmd_vel': TwistStamped, 'wrench': WrenchStamped}
ROBOTS = ('cmd_vel', 'wrench')  # sinks to which no simulated plant of this package subscribes

Fill = Callable[[Sequence[float]], None]


class Sink:
    """
    Converter from inputs to messages.

    Parameters
    ----------
    topic : str
        A key of `SINKS`.
    system : System
        The system of the inputs.
    is_stamped : bool
        Whether cmd_vel has a header.

    Attributes
    ----------
    type : type
        Type of the messages.

    """

    def __init__(self, topic: str, system: System, is_stamped: bool = True) -> None:
        self.type = Twist if topic == 'cmd_vel' and not is_stamped else SINKS[topic]
        self._message = self.type()
        self._header = getattr(self._message, 'header', None)
        self._fill = self._command if topic == 'command' else _filler(topic, self._message, system)
        if topic != 'command' and self._header is not None:
            self._header.frame_id = BASE

    def message(self, u: Sequence[float], stamp: Time) -> Any:
        """Return the message of an input (m,); the next call changes it in place."""
        if self._header is not None:
            self._header.stamp = stamp
        self._fill(u)
        return self._message

    def _command(self, u: Sequence[float]) -> None:
        self._message.u = array('d', u)


def _filler(topic: str, message: Any, system: System) -> Fill:
    p = {each.name: each.value for each in system.parameters}
    twist = message if isinstance(message, Twist) else getattr(message, 'twist', None)

    def vehicle(u: Sequence[float]) -> None:
        twist.linear.x = u[0]
        twist.angular.z = u[0] / p['l'] * math.tan(u[1])

    def two_wheeled(u: Sequence[float]) -> None:
        twist.linear.x, twist.angular.z = u

    def aircraft(u: Sequence[float]) -> None:
        message.wrench.force.x, message.wrench.force.z = u
        message.wrench.torque.y = -p['r'] * u[0]

    known: dict[tuple[str, str], Fill] = {
        ('cmd_vel', 'vehicle'): vehicle,
        ('cmd_vel', 'two_wheeled'): two_wheeled,
        ('wrench', 'aircraft'): aircraft}
    if (topic, system.name) not in known:
        raise StatementError(f'command_sink = {topic}: this message does not carry the inputs of '
                             f'{system.name} ({", ".join(system.input_names)})')
    return known[topic, system.name]
