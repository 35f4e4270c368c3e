# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The set point of a regulator as markers.

A set point at rest is a transparent body. One that moves, such as that of the vehicle, is the line
along which it moves: where it is now only the regulator knows.
"""

from collections.abc import Sequence
import math
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.system import System
from obc_ros.nodes.views.bodies import BodyMarkers, GHOST, GREEN, make_marker
from obc_ros.nodes.views.plane import PlaneMap
from visualization_msgs.msg import Marker

AT_REST = 1e-6          # [m/s] of the set point
BEHIND, AHEAD = 10.0, 40.0   # [m] of the line, from the place of the plant


class SetPointMarkers:
    """
    Markers of the set point of a design.

    :param system: the plant.
    :param plane: of its states.
    """

    def __init__(self, system: System, plane: PlaneMap) -> None:
        self._system, self._plane = system, plane
        self._body = BodyMarkers(system, plane, 'set_point', GHOST)
        self._line = make_marker('set_point_course', 0, Marker.LINE_STRIP, GREEN, 0.6)
        self._line.scale.x = 0.04
        self._input: Sequence[float] | Array = ()
        self._place: tuple[float, float, float] | None = None
        self._velocity = 0.0, 0.0

    def take(self, design: Any) -> None:
        """Take the equilibrium of an `LqrDesign`; one of another system is no set point here."""
        system = self._system
        xe, ue = np.array(design.xe), np.array(design.ue)
        self._place = None
        if design.system != system.name or (len(xe), len(ue)) != (system.n, system.m) or not (
                np.isfinite(xe).all() and np.isfinite(ue).all()):
            return
        velocity = self._plane.locate(system.f(xe, ue))[:2]
        if np.isfinite(velocity).all():
            self._place, self._input, self._velocity = self._plane.locate(xe), ue, velocity

    def fill(self, place: tuple[float, float, float], stamp: Time) -> list[Marker]:
        """Return the markers, for a plant at (px, py, theta); the next call fills them."""
        if self._place is None:
            return []
        speed = math.hypot(*self._velocity)
        if speed <= AT_REST:
            return self._body.fill(self._place, self._input, stamp)
        self._line.header.stamp = stamp
        self._line.points = [self._point(place, speed, ahead) for ahead in (-BEHIND, AHEAD)]
        return [self._line]

    def _point(self, place: tuple[float, float, float], speed: float, ahead: float) -> Any:
        """Return the point of the line that is `ahead` [m] of the plant."""
        along, across = (each / speed for each in self._velocity)
        px, py, _ = self._place or place
        passed = along * (place[0] - px) + across * (place[1] - py) + ahead
        return self._plane.point(px + along * passed, py + across * passed)
