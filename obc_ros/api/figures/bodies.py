# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Drawings of the aircraft, the vehicle and the two-wheeled robot at a pose, at their true scale.

Each function returns what it has drawn, so that an animation can remove it before the next pose.
"""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Polygon
import numpy as np
from obc_ros.api.figures.style import LINE_COLOURS
from obc_ros.core.numerics.arrays import Array

ARM = 0.25  # [m] from the centre of mass of the aircraft to the point where its thrust acts
WHEELBASE = 2.0  # [m] of the vehicle
PLUME = 0.012  # [m/N] length of the exhaust
INK, SKIN, GLASS, FIRE = '#1b1f24', '#dce3ea', '#8fb4d0', '#E69F00'
# Front view of the right half of the aircraft, from the top to the bottom [m].
_HALF = np.array([(0.0, 0.17), (0.05, 0.165), (0.1, 0.12), (0.125, 0.07), (0.5, 0.0),
                  (0.5, -0.03), (0.13, -0.01), (0.14, -0.06), (0.09, -0.14), (0.055, -0.18)])
_CANOPY = np.array([(-0.06, 0.1), (-0.045, 0.145), (0.0, 0.155), (0.045, 0.145), (0.06, 0.1)])
_FIN = np.array([(-0.012, 0.165), (-0.006, 0.36), (0.006, 0.36), (0.012, 0.165)])


def draw_aircraft(axes: Axes, x: float, y: float, theta: float,
                  forces: Sequence[float] | None = None, *, arm: float = ARM, plume: float = PLUME
                  ) -> list[Any]:
    """
    Draw the aircraft of Figure 2.3 from the front, with the exhaust of its thrust.

    :param x, y, theta: centre of mass [m] and attitude [rad], counter-clockwise.
    :param forces: f1 and f2 [N], along its x and its y axis. The exhaust is opposite to them.
    :param arm: distance of the thrust from the centre of mass [m].
    :param plume: length of the exhaust [m/N].
    """
    scale = arm / ARM
    nozzle = np.array([(0.055, -0.16), (0.035, -ARM), (-0.035, -ARM), (-0.055, -0.16)])
    hull = np.vstack([_HALF, _HALF[::-1] * [-1, 1]])
    parts = [(_FIN, SKIN), (nozzle, '#7a828c'), (hull, SKIN), (_CANOPY, GLASS)]
    drawn = [_fill(axes, place_points(scale * shape, x, y, theta), colour)
             for shape, colour in parts]
    if forces is not None:
        thrust = -plume * np.asarray(forces, dtype=float)
        side = 0.035 * scale * np.array([-thrust[1], thrust[0]]) / max(np.hypot(*thrust), 1e-12)
        flame = np.array([0.0, -arm]) + np.array([side, thrust, -side])
        drawn.insert(0, axes.add_patch(Polygon(
            place_points(flame, x, y, theta), facecolor=FIRE, edgecolor='none', alpha=0.85,
            zorder=2.9)))
    return drawn


def draw_vehicle(axes: Axes, x: float, y: float, theta: float, phi: float = 0.0) -> list[Any]:
    """
    Draw the vehicle of Example 1.1 from above.

    :param x, y, theta: middle of the rear axle [m] and heading [rad].
    :param phi: angle of the front wheels [rad], positive to the left.
    """
    body = WHEELBASE * np.array([(-0.22, -0.2), (1.1, -0.2), (1.22, -0.1), (1.22, 0.1),
                                 (1.1, 0.2), (-0.22, 0.2)])
    window = WHEELBASE * np.array([(0.62, -0.15), (0.8, -0.17), (0.8, 0.17), (0.62, 0.15)])
    wheel = WHEELBASE * np.array([(-0.14, -0.04), (0.14, -0.04), (0.14, 0.04), (-0.14, 0.04)])
    wheels = [place_points(wheel, WHEELBASE * px, WHEELBASE * py, angle) for px, py, angle in (
        (0, -0.24, 0), (0, 0.24, 0), (1, -0.24, phi), (1, 0.24, phi))]
    return [_fill(axes, place_points(shape, x, y, theta), colour) for shape, colour in (
        *((each, INK) for each in wheels), (body, SKIN), (window, GLASS))]


def draw_two_wheeled(axes: Axes, x: float, y: float, theta: float, *, width: float = 0.5,
                     colour: str = LINE_COLOURS[5]) -> list[Any]:
    """Draw the robot of Exercise 2.6, of a width [m], from above; its platform points forward."""
    wheel = width * np.array([(-0.3, -0.08), (0.3, -0.08), (0.3, 0.08), (-0.3, 0.08)])
    platform = width * np.array([(-0.25, -0.36), (0.15, -0.36), (0.5, 0.0), (0.15, 0.36),
                                 (-0.25, 0.36)])
    shapes = [(wheel + [0, side * width / 2], INK) for side in (-1, 1)] + [(platform, colour)]
    return [_fill(axes, place_points(shape, x, y, theta), colour) for shape, colour in shapes]


def place_points(points: Array, x: float, y: float, theta: float) -> Array:
    """Return points (N, 2) of a body, turned by theta and moved to (x, y)."""
    c, s = np.cos(theta), np.sin(theta)
    placed: Array = points @ np.array([[c, s], [-s, c]]) + np.array([x, y])
    return placed


def _fill(axes: Axes, corners: Array, colour: str) -> Any:
    return axes.add_patch(Polygon(corners, facecolor=colour, edgecolor=INK, linewidth=0.8,
                                  joinstyle='round', zorder=3.0))
