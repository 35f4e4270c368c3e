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
                  forces: Sequence[float] | None = None, *, arm: float = ARM,
                  plume: float = PLUME, alpha: float = 1.0, zorder: float = 3.0) -> list[Any]:
    """
    Draw the aircraft of Figure 2.3 from the front, with the exhaust of its thrust.

    Parameters
    ----------
    axes : Axes
        With equal scales.
    x, y, theta : float
        Centre of mass [m] and attitude [rad], counter-clockwise.
    forces : sequence of float, optional
        (f1, f2) [N] on the aircraft, along its x and its y axis. The exhaust is opposite to them.
    arm : float
        Distance of the thrust from the centre of mass [m].
    plume : float
        Length of the exhaust [m/N].
    alpha : float
        Opacity.
    zorder : float
        Of the drawing among other artists.

    Returns
    -------
    list of Artist
        All that was drawn.

    """
    scale = arm / ARM
    nozzle = np.array([(0.055, -0.16), (0.035, -ARM), (-0.035, -ARM), (-0.055, -0.16)])
    hull = np.vstack([_HALF, _HALF[::-1] * [-1, 1]])
    parts = [(_FIN, SKIN), (nozzle, '#7a828c'), (hull, SKIN), (_CANOPY, GLASS)]
    drawn = [_fill(axes, place_points(scale * shape, x, y, theta), colour, alpha, zorder)
             for shape, colour in parts]
    if forces is not None:
        thrust = -plume * np.asarray(forces, dtype=float)
        side = 0.035 * scale * np.array([-thrust[1], thrust[0]]) / max(np.hypot(*thrust), 1e-12)
        flame = np.array([0.0, -arm]) + np.array([side, thrust, -side])
        drawn.insert(0, axes.add_patch(Polygon(
            place_points(flame, x, y, theta), facecolor=FIRE, edgecolor='none', alpha=0.85 * alpha,
            zorder=zorder - 0.1)))
    return drawn


def draw_vehicle(axes: Axes, x: float, y: float, theta: float, phi: float = 0.0, *,
                 length: float = WHEELBASE, alpha: float = 1.0, zorder: float = 3.0
                 ) -> list[Any]:
    """
    Draw the vehicle of Example 1.1 from above.

    Parameters
    ----------
    axes : Axes
        With equal scales.
    x, y, theta : float
        Middle of the rear axle [m] and heading [rad].
    phi : float
        Angle of the front wheels [rad], positive to the left.
    length : float
        Wheelbase [m].
    alpha : float
        Opacity.
    zorder : float
        Of the drawing among other artists.

    Returns
    -------
    list of Artist
        All that was drawn.

    """
    body = length * np.array([(-0.22, -0.2), (1.1, -0.2), (1.22, -0.1), (1.22, 0.1), (1.1, 0.2),
                              (-0.22, 0.2)])
    window = length * np.array([(0.62, -0.15), (0.8, -0.17), (0.8, 0.17), (0.62, 0.15)])
    wheel = length * np.array([(-0.14, -0.04), (0.14, -0.04), (0.14, 0.04), (-0.14, 0.04)])
    drawn = []
    for px, py, angle in ((0, -0.24, 0), (0, 0.24, 0), (1, -0.24, phi), (1, 0.24, phi)):
        turned = place_points(wheel, length * px, length * py, angle)
        drawn.append(_fill(axes, place_points(turned, x, y, theta), INK, alpha, zorder))
    return drawn + [_fill(axes, place_points(shape, x, y, theta), colour, alpha, zorder)
                    for shape, colour in ((body, SKIN), (window, GLASS))]


def draw_two_wheeled(axes: Axes, x: float, y: float, theta: float, *, width: float = 0.5,
                     colour: str = LINE_COLOURS[5], alpha: float = 1.0, zorder: float = 3.0
                     ) -> list[Any]:
    """
    Draw the two-wheeled robot of Exercise 2.6 from above; its platform points forward.

    Parameters
    ----------
    axes : Axes
        With equal scales.
    x, y, theta : float
        Middle of the axle [m] and heading [rad].
    width : float
        Distance of the wheels [m].
    colour : str
        Of the platform.
    alpha : float
        Opacity.
    zorder : float
        Of the drawing among other artists.

    Returns
    -------
    list of Artist
        All that was drawn.

    """
    wheel = width * np.array([(-0.3, -0.08), (0.3, -0.08), (0.3, 0.08), (-0.3, 0.08)])
    platform = width * np.array([(-0.25, -0.36), (0.15, -0.36), (0.5, 0.0), (0.15, 0.36),
                                 (-0.25, 0.36)])
    shapes = [(wheel + [0, side * width / 2], INK) for side in (-1, 1)] + [(platform, colour)]
    return [_fill(axes, place_points(shape, x, y, theta), colour, alpha, zorder)
            for shape, colour in shapes]


def place_points(points: Array, x: float, y: float, theta: float) -> Array:
    """
    Return points of a body in the coordinates of the plane.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        In the frame of the body [m].
    x, y, theta : float
        Origin [m] and angle [rad] of that frame.

    Returns
    -------
    ndarray, shape (N, 2)
        The points, turned by theta and moved to (x, y).

    """
    c, s = np.cos(theta), np.sin(theta)
    placed: Array = points @ np.array([[c, s], [-s, c]]) + np.array([x, y])
    return placed


def _fill(axes: Axes, corners: Array, colour: str, alpha: float, zorder: float) -> Any:
    return axes.add_patch(Polygon(corners, facecolor=colour, edgecolor=INK, linewidth=0.8,
                                  joinstyle='round', alpha=alpha, zorder=zorder))
