# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Feedforward of the vehicle along a lateral course, by flatness (Exercise 2.10).

The position py of the rear axle is a flat output of

    py' = v sin(theta), theta' = (v / l) tan(phi)

so that a course py(t) and two derivatives determine heading and steering. Gains scheduled with the
speed are in `gain_schedule`, gains along a reference, from (2.7), in `reference_tracking`.
"""

import math

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import StatementError


def build_lateral_reference(y: Array, dy: Array, ddy: Array, speed: float, length: float
                            ) -> tuple[Array, Array]:
    """
    Return the states and the input of the vehicle that follow py = y(t) exactly.

    :param y, dy, ddy: (N,), position across the road [m] and its derivatives.
    :param speed, length: v [m/s] and wheelbase l [m].
    :return: x: (N, 2), py [m], theta [rad]; u: (N, 1), phi [rad].
    """
    if not np.abs(dy).max(initial=0.0) < speed:
        raise StatementError(f'the course requires a lateral speed of {np.abs(dy).max():.3g} '
                             f'm/s; the speed of the vehicle is {speed:g} m/s')
    turn = ddy / np.sqrt(speed**2 - dy**2)
    x = np.column_stack([y, np.arcsin(dy / speed)])
    return x, np.arctan(length * turn / speed)[:, None]


def make_slalom(t: Array, amplitude: float = 1.0, frequency: float = 1.0, fade: float = 1.0,
                end: float = math.inf) -> tuple[Array, Array, Array]:
    """
    Return y = amplitude sin(2 pi frequency t) and two derivatives, faded in and out.

    The fade has three continuous derivatives, so that the steering is continuous.

    :param fade, end: duration of fading in and of fading out [s]; end of the slalom [s].
    :return: y, dy, ddy: (N,), [m], [m/s], [m/s^2].
    """
    w = 2.0 * math.pi * frequency
    s = np.clip(np.minimum(t, end - t) / fade, 0.0, 1.0)
    way = np.where(t < end - t, 1.0, -1.0)
    a = s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)
    da = way * 140.0 * s**3 * (1.0 - s)**3 / fade
    dda = 420.0 * s**2 * (1.0 - s)**2 * (1.0 - 2.0 * s) / fade**2
    sine, cosine = np.sin(w * t), np.cos(w * t)
    y = amplitude * a * sine
    dy = amplitude * (da * sine + a * w * cosine)
    ddy = amplitude * (dda * sine + 2.0 * da * w * cosine - a * w**2 * sine)
    return y, dy, ddy
