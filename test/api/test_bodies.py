# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Drawings of bodies: their place, their attitude, their exhaust, and their removal."""

from collections.abc import Callable
from typing import Any

from matplotlib.figure import Figure
from matplotlib.patches import Polygon
import numpy as np
from obc_ros.api.figures import bodies
import pytest

POSES = [(0.0, 0.0, 0.0), (1.0, -2.0, 0.7), (-3.0, 4.0, -2.5)]
BODIES = [bodies.draw_aircraft, bodies.draw_vehicle, bodies.draw_two_wheeled]
EACH_POSE = pytest.mark.parametrize('pose', POSES)


def corners(draw: Callable[..., list[Any]], *given: Any, **options: Any) -> np.ndarray:
    """Return the corners of what is drawn, without the closing ones."""
    drawn = draw(Figure().subplots(), *given, **options)
    return np.vstack([each.get_xy()[:-1] for each in drawn if isinstance(each, Polygon)])


@EACH_POSE
def test_points_are_turned_counter_clockwise(pose: tuple[float, float, float]) -> None:
    x, y, theta = pose
    points = bodies.place_points(np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 1.0]]), x, y, theta)
    assert points[0] == pytest.approx([x, y])
    assert points[1] - points[0] == pytest.approx([2 * np.cos(theta), 2 * np.sin(theta)])
    assert points[2] - points[0] == pytest.approx([-np.sin(theta), np.cos(theta)])


@EACH_POSE
@pytest.mark.parametrize('draw', BODIES)
def test_a_body_is_moved_as_a_whole(draw: Callable[..., list[Any]],
                                    pose: tuple[float, float, float]) -> None:
    assert corners(draw, *pose) == pytest.approx(
        bodies.place_points(corners(draw, 0, 0, 0), *pose))


@EACH_POSE
def test_the_exhaust_is_opposite_to_the_force(pose: tuple[float, float, float]) -> None:
    """The force acts at the distance `arm` below the centre of mass."""
    x, y, theta = pose
    forces, arm = np.array([-8.0, 30.0]), 0.4
    flame, *_ = bodies.draw_aircraft(Figure().subplots(), *pose, forces, arm=arm, plume=0.1)
    left, tip, right = flame.get_xy()[:3]
    point = bodies.place_points(np.array([[0.0, -arm]]), *pose)[0]
    assert (left + right) / 2 == pytest.approx(point)
    turn = bodies.place_points(forces[None], 0, 0, theta)[0]
    assert tip - point == pytest.approx(-0.1 * turn)


def test_an_engine_that_is_off_has_no_exhaust() -> None:
    flame, *_ = bodies.draw_aircraft(Figure().subplots(), 0, 0, 0, (0.0, 0.0))
    assert np.ptp(flame.get_xy(), axis=0) == pytest.approx([0, 0])


def test_the_front_wheels_are_steered() -> None:
    straight, turned = (corners(bodies.draw_vehicle, 0, 0, 0, phi) for phi in (0.0, 0.5))
    assert turned[:8] == pytest.approx(straight[:8])
    front = straight[8:16] - np.repeat([[2, -0.48], [2, 0.48]], 4, axis=0)
    assert turned[8:16] - straight[8:16] == pytest.approx(
        bodies.place_points(front, 0, 0, 0.5) - front)
    assert turned[16:] == pytest.approx(straight[16:])


@pytest.mark.parametrize('draw', BODIES)
def test_what_is_drawn_can_be_removed(draw: Callable[..., list[Any]]) -> None:
    axes = Figure().subplots()
    before = len(axes.get_children())
    drawn = draw(axes, 1, 2, 0.3)
    assert len(axes.get_children()) == before + len(drawn) > before
    for artist in drawn:
        artist.remove()
    assert len(axes.get_children()) == before
