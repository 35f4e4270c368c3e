# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The two wheeled robot of Exercise 2.6."""

from collections.abc import Mapping
from typing import Any

import casadi as ca
from obc_ros.core.systems.system import define, Parameter, Signal, System


def system() -> System:
    """
    Return the robot, whose limits |v| <= L and |omega| <= M are parameters.

    px' = v cos(theta), py' = v sin(theta), theta' = omega

    (px, py) is the middle of the axle. The default set point moves on along px at L / 2: at rest
    no linear feedback can hold the position.

    References
    ----------
    Book, Exercise 2.6.

    """
    return _with({'L': 1.0, 'M': 1.0})


def _with(values: Mapping[str, float]) -> System:
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
        dynamics=_dynamics,
        setpoint_input=(L / 2, 0.0),
        description='two wheeled robot (Exercise 2.6)',
        plane='horizontal',
        rebuild=lambda new: _with({**values, **new}))


def _dynamics(x: list[ca.SX], u: list[ca.SX], _: list[ca.SX]) -> tuple[Any, ...]:
    theta, (v, omega) = x[2], u
    return v * ca.cos(theta), v * ca.sin(theta), omega
