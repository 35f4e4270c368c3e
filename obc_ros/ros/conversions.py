# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Conversions between odometry and states.

Odometry of a body that moves in a plane (REP 103: x forward, y left, z up, right-handed):

===========  ==================================  =======================================
plane        horizontal (seen from above)        vertical (px to the right, py up)
===========  ==================================  =======================================
position     (px, py, 0)                         (px, 0, py)
orientation  theta about z: yaw                  theta about -y: nose up, pitch = -theta
twist        in the body's frame: (forward, left, 0), or (forward, 0, up); rate about z or y
===========  ==================================  =======================================
"""

from collections.abc import Callable, Iterator, Sequence
import math
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError
from obc_ros.ros.state_sources import Body, Components

Read = Callable[[Any], Sequence[float]]

ODOM, BASE = 'odom', 'base_link'  # REP 105
# Squares of the norms 0.99 and 1.01: beyond, a quaternion is not rounded but incomplete.
LEAST, MOST = 0.99**2, 1.01**2
_HORIZONTAL, _VERTICAL = ('x', 'y', 'yaw'), ('x', 'z', 'pitch')
_HORIZONTAL_RATES = 'vx', 'vy', 'angular.z', 'linear.x', 'linear.y'
_VERTICAL_RATES = 'vx', 'vz', 'angular.y', 'linear.x', 'linear.z'
_XX, _YY, _ZZ, _PITCH, _YAW = 0, 7, 14, 28, 35  # of a 6 x 6 covariance


class OdometryMap:
    """
    Conversion between the states of a system and odometry.

    :param system: see its attributes `plane` and `robot`.
    :ivar complete: whether a state determines the pose.
    :ivar readable: whether pose and twist determine the state.
    """

    def __init__(self, system: System) -> None:
        self._fields, self._n = system.robot.odometry, system.n
        self._vertical = system.plane == 'vertical'
        self._pose, self._rates = (_VERTICAL, _VERTICAL_RATES) if self._vertical else (
            _HORIZONTAL, _HORIZONTAL_RATES)
        self.complete = all(name in self._fields for name in self._pose)
        self.readable = {index for index, _ in self._fields.values()} == set(range(system.n))

    def message(self, noise: Sequence[float] | Array) -> Odometry:
        """Return a message with frames, and with variances from the noise (n,) of the states."""
        message = Odometry(child_frame_id=BASE)
        message.header.frame_id = ODOM

        def largest(*names: str) -> float:
            return max(noise[self._fields[name][0]]**2 if name in self._fields else 0.0
                       for name in names)

        up, about = (_ZZ, _PITCH) if self._vertical else (_YY, _YAW)
        pose, twist = message.pose.covariance, message.twist.covariance
        pose[_XX], pose[up], pose[about] = map(largest, self._pose)
        # In the frame of the body the axes mix; the larger variance is a bound for both.
        twist[_XX] = twist[up] = largest('vx', 'vy', 'vz', 'linear.x', 'linear.y', 'linear.z')
        twist[about] = largest('angular.y', 'angular.z')
        return message

    def fill(self, message: Odometry, x: Array, slope: Array | None) -> None:
        """
        Set pose and twist of a message.

        :param message: changed in place; other fields are kept.
        :param slope: (n,), or None, its derivative; None: the body is held, and only velocities
            that are states count.
        """
        along, up, turned = self._values(self._pose, x)
        theta = -turned if self._vertical else turned   # nose up is a negative pitch
        c, s = math.cos(theta), math.sin(theta)
        if slope is not None:
            v_along, v_up, rate = self._values(self._pose, slope)
        else:
            v_along, v_up, rate, ahead, left = self._values(self._rates, x)
            v_along, v_up = v_along + c * ahead - s * left, v_up + s * ahead + c * left
        position, turn = message.pose.pose.position, message.pose.pose.orientation
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        forward, aside = c * v_along + s * v_up, c * v_up - s * v_along
        turn.w = math.cos(turned / 2)
        position.x, linear.x = along, forward
        if self._vertical:
            position.z, linear.z = up, aside
            turn.y, angular.y = math.sin(turned / 2), rate
        else:
            position.y, linear.y = up, aside
            turn.z, angular.z = math.sin(turned / 2), rate

    def _values(self, names: tuple[str, ...], x: Array) -> Iterator[float]:
        """Yield the values of fields in a state or its derivative; 0: no state."""
        for name in names:
            index, sign = self._fields.get(name, (0, 0.0))
            yield sign * float(x[index])

    def state(self, message: Odometry) -> Array:
        """Return the state (n,) in a message, its heading in [-pi, pi]; StatementError: none."""
        position, turn = message.pose.pose.position, message.pose.pose.orientation
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        qx, qy, qz, qw = turn.x, turn.y, turn.z, turn.w
        size = qx * qx + qy * qy + qz * qz + qw * qw
        if not LEAST < size < MOST:
            raise StatementError(
                f'the orientation ({qx:g}, {qy:g}, {qz:g}, {qw:g}) is no rotation: its norm is '
                f'{math.sqrt(size):.3g}, wanted 1')
        # The direction of the x axis of the body, seen from above or from the side.
        ahead = size - 2 * (qy * qy + qz * qz)
        if self._vertical:
            theta = math.atan2(2 * (qx * qz - qw * qy), ahead)
        else:
            theta = math.atan2(2 * (qx * qy + qw * qz), ahead)
        c, s = math.cos(theta), math.sin(theta)
        aside = linear.z if self._vertical else linear.y
        up = s * linear.x + c * aside
        known = {'x': position.x, 'y': position.y, 'z': position.z, 'yaw': theta, 'pitch': -theta,
                 'vx': c * linear.x - s * aside, 'vy': up, 'vz': up,
                 'linear.x': linear.x, 'linear.y': linear.y, 'linear.z': linear.z,
                 'angular.y': angular.y, 'angular.z': angular.z}
        x = np.zeros(self._n)
        for name, (index, sign) in self._fields.items():
            x[index] = sign * known[name]
        if not np.isfinite(x).all():
            raise StatementError('the odometry has numbers that are not finite')
        return x


def make_state_reader(topic: str, system: System) -> Read:
    """
    Return the function that converts a message to a state, whatever messages came before.

    :param topic: a key of `state_sources.SOURCES`.
    :return: returns the state (n,) of a message; raises StatementError if the message has none, or
        that of another system.
    :raises StatementError: if messages of the topic do not determine the state of the system.
    """
    if topic == 'state':
        components = Components(system.name, system.state_names)
        return lambda message: components.arrange(message.names, message.x)
    odometry = OdometryMap(system)
    if not odometry.readable:
        raise StatementError(
            f'state_source = odom: a pose and a twist do not determine the state of {system.name} '
            f'({", ".join(system.state_names)}); its file says which states they are, such as '
            'ros: {odom: {x: px, y: py, yaw: theta}}')
    return lambda message: odometry.state(message).tolist()


def make_body_reader(topic: str, system: System) -> Read:
    """
    Return the function that converts the messages of a topic, all of one body, to states.

    :param topic: a key of `state_sources.SOURCES`.
    :return: as that of `make_state_reader`; it also raises FrameError for odometry of another
        body.
    :raises StatementError: if messages of the topic do not determine the state of the system.
    """
    convert, body = make_state_reader(topic, system), Body()
    if topic == 'state':
        return convert

    def state(message: Odometry) -> Sequence[float]:
        body.check(message)
        x = convert(message)
        body.keep(message)
        return x

    return state
