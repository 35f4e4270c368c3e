# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Wheeled vehicles.

The steered vehicle of Example 1.1, its lateral motion (Exercise 2.10) and the two wheeled robot
of Exercise 2.6.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import inf
from typing import Any

import casadi as ca
from obc_ros.core.systems.system import define, Parameter, Signal, System

STEERING_LIMIT = 0.6  # [rad]
# Exercise 2.10 sets no limit, and its slalom of 1 m and 1 Hz needs 0.67 rad at 10 m/s.
LATERAL_STEERING_LIMIT = 1.2  # [rad]

_PY = Signal('py', 'm', description='position of the rear axle, to the left')
_THETA = Signal('theta', 'rad', angle=True, description='heading, counter-clockwise')
_PHI = Signal('phi', 'rad', -STEERING_LIMIT, STEERING_LIMIT,
              description='angle of the front wheels, positive to the left')
_LENGTH = Parameter('l', 2.0, 'm', 1e-3, description='wheelbase')
_TWIST = {'linear.x': 'v', 'angular.z': '(v/l)*tan(phi)'}


def system() -> System:
    """
    Return the vehicle.

    px' = v cos(theta), py' = v sin(theta), theta' = (v / l) tan(phi)

    (px, py) is the middle of the rear axle. The default set point moves on along px at 10 m/s.

    Book, Example 1.1 and Exercise 2.10.
    """
    return define(
        'vehicle',
        states=(Signal('px', 'm', description='position of the rear axle'), _PY, _THETA),
        inputs=(Signal('v', 'm/s', 0.0, inf, description='speed of the rear axle'), _PHI),
        parameters=(_LENGTH,),
        dynamics=_dynamics,
        setpoint_input=(10.0, 0.0),
        description='vehicle with front wheel steering (Example 1.1)',
        plane='horizontal',
        outputs=(
            Signal('gps_x', description='position of the rear axle'),
            Signal('gps_y', description='position of the rear axle, to the left'),
            Signal('compass', description='heading, counter-clockwise')),
        output_map=lambda x, u, p: x,
        ros={'cmd_vel': _TWIST})


def lateral() -> System:
    """
    Return the vehicle at a given speed, without its position along the road.

    py' = v sin(theta), theta' = (v / l) tan(phi)

    Book, Exercise 2.10.
    """
    return define(
        'vehicle_lateral',
        states=(_PY, _THETA),
        inputs=(replace(_PHI, lower=-LATERAL_STEERING_LIMIT, upper=LATERAL_STEERING_LIMIT),),
        parameters=(
            Parameter('v', 10.0, 'm/s', 1e-3, description='speed of the rear axle'), _LENGTH),
        dynamics=_lateral_dynamics,
        description='motion of the vehicle across the road (Exercise 2.10)',
        plane='horizontal',
        ros={'cmd_vel': _TWIST})


def define_two_wheeled() -> System:
    """
    Return the robot, whose limits |v| <= L and |omega| <= M are parameters.

    px' = v cos(theta), py' = v sin(theta), theta' = omega

    (px, py) is the middle of the axle. The default set point moves on along px at L / 2: at rest
    no linear feedback can hold the position.

    Book, Exercise 2.6.
    """
    return _two_wheeled({'L': 1.0, 'M': 1.0})


def _dynamics(x: list[ca.SX], u: list[ca.SX], p: list[ca.SX]) -> tuple[Any, ...]:
    theta, (v, phi), l = x[2], u, p[0]  # noqa: E741 - the letter of the book
    return v * ca.cos(theta), v * ca.sin(theta), v / l * ca.tan(phi)


def _lateral_dynamics(x: list[ca.SX], u: list[ca.SX], p: list[ca.SX]) -> tuple[Any, ...]:
    theta, phi, (v, l) = x[1], u[0], p  # noqa: E741 - the letter of the book
    return v * ca.sin(theta), v / l * ca.tan(phi)


def _two_wheeled(values: Mapping[str, float]) -> System:
    L, M = values['L'], values['M']
    return define(
        'two_wheeled',
        states=(
            Signal('px', 'm', description='position of the axle'),
            Signal('py', 'm', description='position of the axle, to the left'),
            Signal('theta', 'rad', angle=True, description='heading, counter-clockwise')),
        inputs=(
            Signal('v', 'm/s', -L, L, description='speed'),
            Signal('omega', 'rad/s', -M, M, description='spinning rate, positive to the left')),
        parameters=(
            Parameter('L', L, 'm/s', 1e-6, description='largest speed'),
            Parameter('M', M, 'rad/s', 1e-6, description='largest spinning rate')),
        dynamics=_two_wheeled_dynamics,
        setpoint_input=(L / 2, 0.0),
        description='two wheeled robot (Exercise 2.6)',
        plane='horizontal',
        rebuild=lambda new: _two_wheeled({**values, **new}),
        ros={'cmd_vel': {'linear.x': 'v', 'angular.z': 'omega'}})


def _two_wheeled_dynamics(x: list[ca.SX], u: list[ca.SX], _: list[ca.SX]) -> tuple[Any, ...]:
    theta, (v, omega) = x[2], u
    return v * ca.cos(theta), v * ca.sin(theta), omega
