# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The thrust vectored aircraft of figure 2.3."""

from typing import Any

import casadi as ca
from obc_ros.core.systems.system import define, Parameter, Signal, System


def system() -> System:
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
        dynamics=_dynamics,
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


def _dynamics(x: list[ca.SX], u: list[ca.SX], p: list[ca.SX]) -> tuple[Any, ...]:
    _, _, theta, vx, vy, omega = x
    f1, f2 = u
    m, J, r, g, c = p
    return (
        vx, vy, omega,
        (f1 * ca.cos(theta) - f2 * ca.sin(theta) - c * vx) / m,
        (f1 * ca.sin(theta) + f2 * ca.cos(theta) - c * vy) / m - g,
        r * f1 / J)
