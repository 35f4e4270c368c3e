# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The vehicle on a course: its feedforward by flatness (Exercise 2.10).

The position (px, py) of the rear axle is a flat output of

    px' = v cos(theta), py' = v sin(theta), theta' = (v / l) tan(phi)

so that a course given with two derivatives determines heading, speed and steering. Gains that
follow the speed are in `schedule`, those along any reference, from (2.7), in `following`.
"""

import math

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.errors import StatementError

Array = NDArray[np.float64]

_SLOWEST = 1e-6  # [m/s] below which a position has no heading


def vehicle_reference(velocity: Array, acceleration: Array, position: Array, length: float
                      ) -> tuple[Array, Array]:
    """
    Return states and inputs of the vehicle that drives a course exactly.

    Parameters
    ----------
    velocity, acceleration, position : ndarray, shape (N, 2)
        Of (px, py) [m/s], [m/s^2], [m].
    length : float
        Wheelbase l [m].

    Returns
    -------
    x : ndarray, shape (N, 3)
        px [m], py [m], theta [rad] without jumps of 2 pi.
    u : ndarray, shape (N, 2)
        v [m/s], phi [rad].

    Raises
    ------
    StatementError
        If the course stands still somewhere: its heading is then undetermined.

    """
    v = np.hypot(velocity[:, 0], velocity[:, 1])
    if not v.size or not v.min() > _SLOWEST:
        raise StatementError('the course stands still somewhere: there it has no heading')
    theta = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    turn = (velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0]) / v**2
    phi = np.arctan(length * turn / v)
    return np.column_stack([position, theta]), np.column_stack([v, phi])


def lateral_reference(y: Array, dy: Array, ddy: Array, speed: float, length: float
                      ) -> tuple[Array, Array]:
    """
    Return states and input of the vehicle at a given speed that drives py = y(t) exactly.

    Parameters
    ----------
    y, dy, ddy : ndarray, shape (N,)
        Position across the road [m] and its derivatives.
    speed, length : float
        v [m/s] and wheelbase l [m].

    Returns
    -------
    x : ndarray, shape (N, 2)
        py [m], theta [rad].
    u : ndarray, shape (N, 1)
        phi [rad].

    Raises
    ------
    StatementError
        If the course asks for more than the speed across the road.

    """
    if not np.abs(dy).max(initial=0.0) < speed:
        raise StatementError(f'the course moves across the road at up to {np.abs(dy).max():.3g} '
                             f'm/s; the vehicle has {speed:g} m/s in all')
    turn = ddy / np.sqrt(speed**2 - dy**2)
    x = np.column_stack([y, np.arcsin(dy / speed)])
    return x, np.arctan(length * turn / speed)[:, None]


def slalom(t: Array, amplitude: float = 1.0, frequency: float = 1.0, fade: float = 1.0
           ) -> tuple[Array, Array, Array]:
    """
    Return y = amplitude sin(2 pi frequency t) and two derivatives, faded in over `fade` seconds.

    The fading is smooth to the third derivative, so that the steering has no jump.
    """
    w = 2.0 * math.pi * frequency
    s = np.clip(t / fade, 0.0, 1.0)
    a = s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)
    da = 140.0 * s**3 * (1.0 - s)**3 / fade
    dda = 420.0 * s**2 * (1.0 - s)**2 * (1.0 - 2.0 * s) / fade**2
    sine, cosine = np.sin(w * t), np.cos(w * t)
    y = amplitude * a * sine
    dy = amplitude * (da * sine + a * w * cosine)
    ddy = amplitude * (dda * sine + 2.0 * da * w * cosine - a * w**2 * sine)
    return y, dy, ddy


def vehicle_at(speed: float, length: float) -> tuple[Array, Array]:
    """Return (A, B) of the vehicle across the road at a speed [m/s]; the state is (py, theta)."""
    A = np.array([[0.0, speed], [0.0, 0.0]])
    return A, np.array([[0.0], [speed / length]])
