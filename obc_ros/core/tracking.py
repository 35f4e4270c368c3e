# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The vehicle on a course: its feedforward by flatness, its gains scheduled on speed (Exercise 2.10).

The position (px, py) of the rear axle is a flat output of

    px' = v cos(theta), py' = v sin(theta), theta' = (v / l) tan(phi)

so that a course given with two derivatives determines heading, speed and steering. Gains along
any other reference, from (2.7), are in `following`.
"""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.errors import StatementError
from obc_ros.core.lqr import lqr
from obc_ros.core.weights import Weights

Array = NDArray[np.float64]
Plant = Callable[[float], tuple[Array, Array]]

_SLOWEST = 1e-6  # [m/s] below which a position has no heading
_MOST_GAINS = 1025


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


@dataclass(frozen=True, eq=False)
class Schedule:
    """
    Gains for a range of a parameter, such as the speed.

    Attributes
    ----------
    values : ndarray, shape (N,)
        Increasing values of the parameter.
    gains : ndarray, shape (N, m, n)
        The gain for each; linear in between, the nearest outside.

    """

    values: Array
    gains: Array

    def at(self, value: float) -> Array:
        """Return the gain (m, n) for a value of the parameter."""
        k = bisect_right(self._list, value) - 1
        if k < 0 or value != value:
            return np.asarray(self.gains[0])
        if k + 1 >= len(self.values):
            return np.asarray(self.gains[-1])
        part = (value - self._list[k]) / (self._list[k + 1] - self._list[k])
        gain: Array = (1.0 - part) * self.gains[k] + part * self.gains[k + 1]
        return gain

    @cached_property
    def _list(self) -> list[float]:
        return [float(value) for value in self.values]


def schedule(plant: Plant, weights: Weights, lower: float, upper: float, *,
             tolerance: float = 0.01) -> Schedule:
    """
    Return gains for every value of a parameter in a range.

    A value is added where the interpolated gain is further than `tolerance` from the designed one,
    or leaves the closed loop slower than half of it; so at each fixed value the loop is stable.

    Parameters
    ----------
    plant : callable
        (A, B) for a value of the parameter.
    weights : Weights
        One cost for all values.
    lower, upper : float
        The range.
    tolerance : float
        Of the gain, relative to its largest entry.

    Raises
    ------
    StatementError
        If the range is empty, or the gain changes too fast for a table.
    RefusedDesignError
        If no gain can be proved to stabilise at some value.

    """
    if not (math.isfinite(lower) and math.isfinite(upper) and lower < upper):
        raise StatementError(f'a schedule from {lower:g} to {upper:g}: wanted a range')

    def gain(value: float) -> Array:
        return lqr(*plant(value), weights.Qx, weights.Qu, cross=weights.cross,
                   stability=weights.stability).K

    found = {lower: gain(lower), upper: gain(upper)}
    open_intervals = [(lower, upper)]
    while open_intervals:
        low, high = open_intervals.pop()
        middle = 0.5 * (low + high)
        wanted, between = gain(middle), 0.5 * (found[low] + found[high])
        if _is_near(plant(middle), between, wanted, tolerance):
            continue
        if len(found) >= _MOST_GAINS:
            raise StatementError(f'the gain changes too fast near {middle:g} for a schedule')
        found[middle] = wanted
        open_intervals += [(low, middle), (middle, high)]
    values = sorted(found)
    return Schedule(np.array(values), np.array([found[value] for value in values]))


def _is_near(plant: tuple[Array, Array], K: Array, wanted: Array, tolerance: float) -> bool:
    A, B = plant
    if np.abs(K - wanted).max() > tolerance * np.abs(wanted).max():
        return False
    slowest = [float(np.linalg.eigvals(A - B @ gain).real.max()) for gain in (K, wanted)]
    return slowest[0] < 0.5 * slowest[1]
