# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Vehicles of the book.

The steered vehicle of Example 1.1, its lateral motion (Exercise 2.10), the two wheeled robot of
Exercise 2.6 and the thrust vectored aircraft of figure 2.3.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
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


def define_vehicle() -> System:
    """
    Return the vehicle of Example 1.1 and Exercise 2.10.

    px' = v cos(theta), py' = v sin(theta), theta' = (v / l) tan(phi)

    (px, py) is the middle of the rear axle. The default set point moves on along px at 10 m/s.
    """
    return define(
        'vehicle',
        states=(Signal('px', 'm', description='position of the rear axle'), _PY, _THETA),
        inputs=(Signal('v', 'm/s', 0.0, inf, description='speed of the rear axle'), _PHI),
        parameters=(_LENGTH,),
        dynamics=lambda x, u, p: (
            u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[0] / p[0] * ca.tan(u[1])),
        setpoint_input=(10.0, 0.0),
        description='vehicle with front wheel steering (Example 1.1)',
        plane='horizontal',
        outputs=(
            Signal('gps_x', description='position of the rear axle'),
            Signal('gps_y', description='position of the rear axle, to the left'),
            Signal('compass', description='heading, counter-clockwise')),
        output_map=lambda x, u, p: x,
        ros={'cmd_vel': _TWIST})


def define_lateral() -> System:
    """
    Return the vehicle at a given speed, without its position along the road (Exercise 2.10).

    py' = v sin(theta), theta' = (v / l) tan(phi)
    """
    return define(
        'vehicle_lateral',
        states=(_PY, _THETA),
        inputs=(replace(_PHI, lower=-LATERAL_STEERING_LIMIT, upper=LATERAL_STEERING_LIMIT),),
        parameters=(
            Parameter('v', 10.0, 'm/s', 1e-3, description='speed of the rear axle'), _LENGTH),
        dynamics=lambda x, u, p: (p[0] * ca.sin(x[1]), p[0] / p[1] * ca.tan(u[0])),
        description='motion of the vehicle across the road (Exercise 2.10)',
        plane='horizontal',
        ros={'cmd_vel': _TWIST})


def define_two_wheeled() -> System:
    """
    Return the robot of Exercise 2.6, whose limits |v| <= L and |omega| <= M are parameters.

    px' = v cos(theta), py' = v sin(theta), theta' = omega

    (px, py) is the middle of the axle. The default set point moves on along px at L / 2: at rest
    no linear feedback can hold the position.
    """
    return _two_wheeled({'L': 1.0, 'M': 1.0})


def _two_wheeled(values: Mapping[str, float]) -> System:
    L, M = values['L'], values['M']
    return define(
        'two_wheeled',
        states=(
            Signal('px', 'm', description='position of the axle'),
            Signal('py', 'm', description='position of the axle, to the left'), _THETA),
        inputs=(
            Signal('v', 'm/s', -L, L, description='speed'),
            Signal('omega', 'rad/s', -M, M, description='spinning rate, positive to the left')),
        parameters=(
            Parameter('L', L, 'm/s', 1e-6, description='largest speed'),
            Parameter('M', M, 'rad/s', 1e-6, description='largest spinning rate')),
        dynamics=lambda x, u, _: (u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1]),
        setpoint_input=(L / 2, 0.0),
        description='two wheeled robot (Exercise 2.6)',
        plane='horizontal',
        rebuild=partial(_change_two_wheeled, values),
        ros={'cmd_vel': {'linear.x': 'v', 'angular.z': 'omega'}})


def _change_two_wheeled(values: Mapping[str, float], new: Mapping[str, float]) -> System:
    return _two_wheeled({**values, **new})


def define_aircraft() -> System:
    """
    Return the aircraft, a rigid body in the vertical plane with thrust off its centre of mass.

    m vx' = f1 cos(theta) - f2 sin(theta) - c vx
    m vy' = f1 sin(theta) + f2 cos(theta) - c vy - m g
    J omega' = r f1

    px is to the right, py up, theta counter-clockwise. f1 and f2 act at the distance r below the
    centre of mass, f1 along the x axis of the body and f2 along its y axis. At theta = 0 a
    positive f1 accelerates to the right and counter-clockwise; f2 balances the weight.

    Book, figure 2.3 and Example 2.5; Astrom and Murray, Feedback Systems, Example 2.9.
    """
    return define(
        'aircraft',
        states=(
            Signal('px', 'm', description='horizontal position'),
            Signal('py', 'm', description='vertical position, up'),
            Signal('theta', 'rad', angle=True, description='attitude, counter-clockwise'),
            Signal('vx', 'm/s', description='horizontal velocity'),
            Signal('vy', 'm/s', description='vertical velocity'),
            Signal('omega', 'rad/s', description='angular velocity')),
        inputs=(
            Signal('f1', 'N', description='sideways thrust, along the body x axis'),
            Signal('f2', 'N', description='thrust along the body y axis')),
        parameters=(
            Parameter('m', 4.0, 'kg', 1e-6, description='mass'),
            Parameter('J', 0.0475, 'kg m^2', 1e-9, description='moment of inertia'),
            Parameter('r', 0.25, 'm', 0.0, description='distance of the thrust from the centre'),
            Parameter('g', 9.8, 'm/s^2', 0.0, description='gravity'),
            Parameter('c', 0.05, 'N s/m', 0.0, description='damping')),
        dynamics=_fly,
        description='thrust vectored aircraft in the vertical plane (Example 2.5)',
        plane='vertical',
        outputs=(
            Signal('gps_x', description='horizontal position'),
            Signal('gps_y', description='vertical position'),
            Signal('attitude', description='attitude, counter-clockwise'),
            Signal('gyro', description='angular velocity')),
        output_map=lambda x, u, p: (x[0], x[1], x[2], x[5]),
        # at its centre of mass; nose up is a negative rotation about y
        ros={'wrench': {'force.x': 'f1', 'force.z': 'f2', 'torque.y': '-r*f1'}})


def _fly(x: list[ca.SX], u: list[ca.SX], p: list[ca.SX]) -> tuple[Any, ...]:
    _, _, theta, vx, vy, omega = x
    f1, f2 = u
    m, J, r, g, c = p
    return (
        vx, vy, omega,
        (f1 * ca.cos(theta) - f2 * ca.sin(theta) - c * vx) / m,
        (f1 * ca.sin(theta) + f2 * ca.cos(theta) - c * vy) / m - g,
        r * f1 / J)
