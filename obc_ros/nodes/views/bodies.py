# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Plants as markers: the body, the input and the set point.

The bodies are an aircraft, a vehicle, a two-wheeled robot, and a sphere with axes.

The vehicles are drawn at their true wheelbase. The aircraft has the exhaust of its thrust, which
points away from the force on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.system import System
from obc_ros.nodes.views.scene import PlaneMap
from obc_ros.ros.conversions import ODOM
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

Colour = tuple[float, float, float]
PlanarPose = tuple[float, float, float]   # px, py [m], theta [rad]
SKIN, INK, GLASS, FIRE = (0.86, 0.89, 0.92), (0.11, 0.12, 0.14), (0.56, 0.71, 0.82), (0.9, 0.62, 0)
BLUE, RED, GREEN = (0.0, 0.45, 0.7), (0.84, 0.37, 0.0), (0.0, 0.62, 0.45)
EXHAUST_LENGTH = 0.012    # [m/N] length of the exhaust
LEAST = 1e-3     # [m] length of an arrow below which it is not drawn
GHOST = 0.3      # opacity of a body at the set point or at a goal
AT_REST = 1e-6          # [m/s] of the set point
BEHIND, AHEAD = 10.0, 40.0   # [m] of the line, from the place of the plant


@dataclass(frozen=True)
class Part:
    """
    A part of a body, in its own frame.

    :ivar kind: `Marker.CUBE`, `SPHERE` or `CYLINDER` (its axis is normal to a horizontal plane).
    :ivar at: centre along and across the body in the plane [m].
    :ivar size: along, across, and normal to the plane [m].
    :ivar aside: distance of the centre from the plane [m].
    :ivar turn: angle in the plane [rad].
    """

    kind: int
    at: tuple[float, float]
    size: tuple[float, float, float]
    colour: Colour
    aside: float = 0.0
    turn: float = 0.0


_AIRCRAFT = (
    Part(Marker.SPHERE, (0.0, 0.0), (0.26, 0.34, 0.6), SKIN),
    Part(Marker.CUBE, (0.0, 0.0), (1.0, 0.04, 0.25), SKIN),
    Part(Marker.CUBE, (0.0, 0.26), (0.025, 0.2, 0.15), BLUE),
    Part(Marker.SPHERE, (0.0, 0.1), (0.12, 0.1, 0.3), GLASS, aside=0.18),
    Part(Marker.CUBE, (0.0, -0.205), (0.09, 0.09, 0.09), INK))
_ROBOT = (
    Part(Marker.CYLINDER, (0.0, 0.0), (0.42, 0.42, 0.12), BLUE, aside=0.1),
    Part(Marker.CUBE, (0.18, 0.0), (0.1, 0.06, 0.05), FIRE, aside=0.17),
    Part(Marker.CUBE, (0.0, 0.24), (0.2, 0.05, 0.2), INK, aside=0.1),
    Part(Marker.CUBE, (0.0, -0.24), (0.2, 0.05, 0.2), INK, aside=0.1))
_POINT = (
    Part(Marker.SPHERE, (0.0, 0.0), (0.2, 0.2, 0.2), BLUE),
    Part(Marker.CUBE, (0.25, 0.0), (0.5, 0.03, 0.03), RED),
    Part(Marker.CUBE, (0.0, 0.25), (0.03, 0.5, 0.03), GREEN))


def list_parts(system: System, u: Sequence[float] | Array) -> tuple[Part, ...]:
    """Return the parts of the body of a plant with the input u (m,)."""
    if system.name == 'aircraft':
        return _AIRCRAFT
    if system.name in ('vehicle', 'vehicle_lateral'):
        return _list_vehicle(_find_parameter(system, 'l'), u[system.input_names.index('phi')])
    return _ROBOT if system.name == 'two_wheeled' else _POINT


def _list_vehicle(length: float, phi: float) -> tuple[Part, ...]:
    """Return the parts of a vehicle; the middle of its rear axle is the origin."""
    wheel = (0.28 * length, 0.08 * length, 0.28 * length)
    high = 0.14 * length
    return (
        Part(Marker.CUBE, (0.5 * length, 0.0), (1.44 * length, 0.4 * length, 0.16 * length), SKIN,
             aside=1.6 * high),
        Part(Marker.CUBE, (0.4 * length, 0.0), (0.7 * length, 0.34 * length, 0.14 * length), GLASS,
             aside=2.6 * high),
        *(Part(Marker.CUBE, (along * length, side * 0.24 * length), wheel, INK, aside=high,
               turn=phi * along)
          for along in (0, 1) for side in (-1, 1)))


def _find_parameter(system: System, name: str) -> float:
    return next(each.value for each in system.parameters if each.name == name)


class BodyMarkers:
    """Markers of the body of one plant; `name` is their namespace, `opacity` from 0 to 1."""

    def __init__(self, system: System, plane: PlaneMap, name: str, opacity: float = 1.0) -> None:
        self._system, self._plane = system, plane
        self._markers = [make_marker(name, number, part.kind, part.colour, opacity)
                         for number, part in enumerate(list_parts(system, (0.0,) * system.m))]

    def fill(self, place: PlanarPose, u: Sequence[float] | Array, stamp: Time) -> list[Marker]:
        """Return the markers at (px, py, theta) with input u (m,); the next call reuses them."""
        px, py, theta = place
        c, s = math.cos(theta), math.sin(theta)
        for marker, part in zip(self._markers, list_parts(self._system, u), strict=True):
            (along, across), marker.header.stamp = part.at, stamp
            marker.pose = self._plane.pose(
                px + c * along - s * across, py + s * along + c * across, theta + part.turn,
                part.aside)
            marker.scale.x, second, third = part.size
            marker.scale.y, marker.scale.z = (
                (third, second) if self._plane.is_vertical else (second, third))
        return self._markers


class InputMarkers:
    """Markers of the input: the exhaust of the aircraft, the limits of the steering angle."""

    def __init__(self, system: System, plane: PlaneMap) -> None:
        self._plane = plane
        self._marker: Marker | None = None
        self._arm: float | None = None   # of the thrust
        if system.name == 'aircraft':
            self._arm = _find_parameter(system, 'r')
            self._marker = make_marker('thrust', 0, Marker.ARROW, FIRE)
        elif system.name in ('vehicle', 'vehicle_lateral'):
            self._marker = self._draw_limits(system)

    def fill(self, place: PlanarPose, u: Sequence[float] | Array, stamp: Time) -> list[Marker]:
        """Return the markers at (px, py, theta) with input u (m,); the next call reuses them."""
        marker = self._marker
        if marker is None:
            return []
        if self._arm is not None:   # the exhaust, in the body frame
            along, across = (-EXHAUST_LENGTH * float(force) for force in u)
            length = math.hypot(along, across)
            if length <= LEAST:
                return []
            marker.points = [self._plane.point(0.0, -self._arm),
                             self._plane.point(along, across - self._arm)]
            marker.scale.x, marker.scale.y, marker.scale.z = 0.05, 0.1, 0.3 * length
        if not marker.points:
            return []
        marker.header.stamp, marker.pose = stamp, self._plane.pose(*place)
        return [marker]

    def _draw_limits(self, system: System) -> Marker:
        """Return the limits of the front wheels' angle as two lines, in the body frame."""
        marker = make_marker('limits', 0, Marker.LINE_LIST, RED, 0.6)
        marker.scale.x, length = 0.03, _find_parameter(system, 'l')
        index = system.input_names.index('phi')
        for limit in map(float, (system.u_min[index], system.u_max[index])):
            if math.isfinite(limit):
                marker.points += [self._plane.point(length, 0.0), self._plane.point(
                    length * (1 + math.cos(limit)), length * math.sin(limit))]
        return marker


class SetPointMarkers:
    """
    Markers of the set point of a design.

    A set point at rest is a transparent body. One that moves, such as that of the vehicle, is the
    line along which it moves: where it is now only the regulator knows.
    """

    def __init__(self, system: System, plane: PlaneMap) -> None:
        self._system, self._plane = system, plane
        self._body = BodyMarkers(system, plane, 'set_point', GHOST)
        self._line = make_marker('set_point_course', 0, Marker.LINE_STRIP, GREEN, 0.6)
        self._line.scale.x = 0.04
        self._input: Sequence[float] | Array = ()
        self._place: PlanarPose | None = None
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

    def fill(self, place: PlanarPose, stamp: Time) -> list[Marker]:
        """Return the markers, for a plant at (px, py, theta); the next call fills them."""
        if self._place is None:
            return []
        speed = math.hypot(*self._velocity)
        if speed <= AT_REST:
            return self._body.fill(self._place, self._input, stamp)
        along, across = (each / speed for each in self._velocity)
        px, py, _ = self._place
        passed = along * (place[0] - px) + across * (place[1] - py)
        self._line.header.stamp = stamp
        self._line.points = [
            self._plane.point(px + along * (passed + ahead), py + across * (passed + ahead))
            for ahead in (-BEHIND, AHEAD)]
        return [self._line]


def make_marker(name: str, number: int, kind: int, colour: Colour, opacity: float = 1.0) -> Marker:
    """Return a marker in the frame odom, without a size."""
    red, green, blue = map(float, colour)
    marker = Marker(ns=name, id=number, type=kind, action=Marker.ADD,
                    color=ColorRGBA(r=red, g=green, b=blue, a=opacity))
    marker.header.frame_id = ODOM
    return marker
