# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The messages that show a plan: a path, and markers.

A path constraint that depends on px, py and constants only is g(px, py) in [lower, upper]. Its
boundaries are the curves where g equals one of the two, found on a grid around the plan. Bounds on
px and py are straight lines. Other constraints cannot be drawn in the plane.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from builtin_interfaces.msg import Time
import casadi as ca
from contourpy import contour_generator
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.systems import registry
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Trajectory
from obc_ros.nodes.views.bodies import (
    BLUE,
    BodyMarkers,
    Colour,
    FIRE,
    GHOST,
    GREEN,
    make_marker,
    RED,
)
from obc_ros.nodes.views.scene import PlaneMap
from obc_ros.ros.conversions import ODOM
from obc_ros.ros.messages import read_nanoseconds, set_stamp
from visualization_msgs.msg import Marker

MOST_POSES = 200   # of a path
MOST_SWITCHES = 200
GRID = 201      # points of the grid along px and along py
MARGIN = 0.5    # part of the larger side of a plan, by which the grid is larger than the plan
SMALLEST = 0.5  # [m] margin of a plan that stays where it is
MOST_POINTS = 5_000   # of all curves

Rectangle = tuple[float, float, float, float]


def make_path(plan: Trajectory) -> Path | None:
    """
    Return the path of a plan; None if its states have no place in a plane.

    :param plan: a stamp of a pose is that of the plan and its time.
    :return: at most `MOST_POSES` samples of the plan, the first and the last one included.
    """
    places, plane = _list_places(plan)
    if not plane.has_places:
        return None
    path = Path()
    begin = read_nanoseconds(plan.header.stamp)
    path.header.frame_id, path.header.stamp = ODOM, plan.header.stamp
    for index in _choose(plan.t):
        pose = PoseStamped(pose=plane.pose(*map(float, places[index])))
        pose.header.frame_id = ODOM
        set_stamp(pose.header.stamp, begin + round((plan.t[index] - plan.t[0]) * 1e9))
        path.poses.append(pose)
    return path


def make_markers(plan: Trajectory, statement: Mapping[str, Any] | None) -> list[Marker]:
    """
    Return the markers of a plan; none if its states have no place in a plane.

    :param statement: its problem, as in a file, for the obstacles.
    :return: start, goal, switching times, and boundaries of path constraints and bounds on px and
        py.
    """
    places, plane = _list_places(plan)
    if not plane.has_places:
        return []
    system = _find_system(plan.system)
    px, py, theta = map(float, places[-1])
    markers = [_draw_points('start', [places[0]], plane, BLUE),
               _draw_points('goal', [places[-1]], plane, GREEN)]
    if system is not None:
        u = plan.u[-system.m:] if len(plan.u) >= system.m else (0.0,) * system.m
        markers += BodyMarkers(system, plane, 'goal_body', GHOST).fill((px, py, theta), u, Time())
    if times := plan.switching_times[:MOST_SWITCHES]:
        markers.append(_draw_points('switching_times', np.column_stack([
            np.interp(times, plan.t, column) for column in places.T]), plane, FIRE))
    if statement and (statement.get('path_constraints') or statement.get('state_bounds')):
        curves = find_boundaries(statement, find_box(places[:, :2]))
        if curves:
            markers.append(_draw_curves('obstacles', curves, plane))
    return markers


def _list_places(plan: Trajectory) -> tuple[Array, PlaneMap]:
    """Return (px, py, theta) of the samples, shape (N, 3), and the map of the plane."""
    system = _find_system(plan.system)
    plane = PlaneMap(plan.state_names, system.plane if system else '')
    x = np.array(plan.x).reshape(len(plan.t), -1)
    return np.array([plane.locate(row) for row in x]), plane


def _find_system(name: str) -> System | None:
    try:
        return registry.get_registered(name) if name else None
    except ObcError:
        return None


def _choose(t: Sequence[float]) -> Array:
    """Return the indices of samples at nearly equal distances in time."""
    wanted = np.linspace(t[0], t[-1], MOST_POSES)
    found = np.unique(np.searchsorted(np.array(t), wanted).clip(0, len(t) - 1))
    found[-1] = len(t) - 1
    return found


def _draw_points(name: str, places: Sequence[Array] | Array, plane: PlaneMap, colour: Colour
                 ) -> Marker:
    marker = make_marker(name, 0, Marker.SPHERE_LIST, colour)
    marker.scale.x = marker.scale.y = marker.scale.z = 0.1
    marker.points = [plane.point(float(px), float(py)) for px, py, _ in places]
    return marker


def _draw_curves(name: str, curves: Sequence[Array], plane: PlaneMap) -> Marker:
    marker = make_marker(name, 0, Marker.LINE_LIST, RED)
    marker.scale.x = 0.04
    for curve in curves:
        points: list[Point] = [plane.point(*map(float, each)) for each in curve]
        for pair in zip(points, points[1:], strict=False):
            marker.points += pair
    return marker


def find_box(places: Array) -> Rectangle:
    """Return (px, px, py, py) [m] of a rectangle around points, shape (N, 2), with a margin."""
    low, high = places.min(axis=0), places.max(axis=0)
    margin = max(MARGIN * float((high - low).max()), SMALLEST)
    return (float(low[0]) - margin, float(high[0]) + margin,
            float(low[1]) - margin, float(high[1]) + margin)


def find_boundaries(statement: Mapping[str, Any], box: Rectangle) -> list[Array]:
    """
    Return the curves that bound where px and py may be.

    :param box: (px, px, py, py) [m]: what is outside is not drawn.
    :return: (K, 2), points (px, py) [m], joined by lines. At most `MOST_POINTS`; further curves
        are left out.
    """
    problem = build_problem(statement)
    if not {'px', 'py'} <= set(problem.states):
        return []
    curves, left = [], MOST_POINTS
    for curve in (*_trace_bounds(problem, box), *_trace_constraints(problem, box)):
        left -= len(curve)
        if left < 0:
            break
        curves.append(curve)
    return curves


def _trace_bounds(problem: Problem, box: Rectangle) -> Iterator[Array]:
    for name, axis in (('px', 0), ('py', 1)):
        index = problem.states.index(name)
        across = box[2:] if axis == 0 else box[:2]
        for bound in (problem.x_lower[index], problem.x_upper[index]):
            if box[2 * axis] <= bound <= box[2 * axis + 1]:
                line = np.empty((2, 2))
                line[:, axis], line[:, 1 - axis] = bound, across
                yield line


def _trace_constraints(problem: Problem, box: Rectangle) -> Iterator[Array]:
    """Yield curves where a path constraint of px and py alone is at a bound."""
    at = [problem.states.index(name) for name in ('px', 'py')]
    places = ca.vertcat(*(problem.x[index] for index in at))
    others = ca.vertcat(*(problem.x[index] for index in range(len(problem.states))
                          if index not in at), problem.u)
    px, py = np.linspace(*box[:2], GRID), np.linspace(*box[2:], GRID)
    points = np.stack(np.meshgrid(px, py)).reshape(2, -1)
    rows = zip(ca.vertsplit(problem.path), problem.path_lower, problem.path_upper, strict=True)
    for row, *bounds in rows:
        if ca.depends_on(row, others) or not ca.depends_on(row, places):
            continue
        g = ca.Function('g', [places, problem.p], [row])
        values = g(points, problem.p_value).full().reshape(GRID, GRID)
        traced = contour_generator(px, py, np.ma.masked_invalid(values))
        for bound in filter(np.isfinite, bounds):
            yield from cast(list[Array], traced.lines(float(bound)))   # of separate curves
