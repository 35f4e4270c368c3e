# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Markers of bodies, of the input and of the set point, without nodes."""

from array import array
import math

from builtin_interfaces.msg import Time
import hostile
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from numpy.testing import assert_allclose
from obc_ros.core.systems import registry
from obc_ros.core.systems.system import define, Signal
from obc_ros.msg import LqrDesign
from obc_ros.nodes.views.bodies import (
    BodyMarkers,
    EXHAUST_LENGTH,
    InputMarkers,
    SetPointMarkers,
)
from obc_ros.nodes.views.plant_view import make_transform
from obc_ros.nodes.views.scene import PlaneMap
from obc_ros.ros.conversions import OdometryMap
import pytest
from visualization_msgs.msg import Marker

NAMES = ('aircraft', 'vehicle', 'vehicle_lateral', 'two_wheeled')
REAL = st.floats(-1e3, 1e3)
PLACES = st.tuples(REAL, REAL, st.floats(-7.0, 7.0))


def load(name):
    """Return a system and the map of its plane."""
    system = registry.get_system(name)
    return system, PlaneMap(system.state_names, system.plane)


def vector(point):
    return np.array([point.x, point.y, point.z])


def rotation(q):
    """Return the rotation matrix of a unit quaternion."""
    return np.array([
        [1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y - q.z * q.w), 2 * (q.x * q.z + q.y * q.w)],
        [2 * (q.x * q.y + q.z * q.w), 1 - 2 * (q.x**2 + q.z**2), 2 * (q.y * q.z - q.x * q.w)],
        [2 * (q.x * q.z - q.y * q.w), 2 * (q.y * q.z + q.x * q.w), 1 - 2 * (q.x**2 + q.y**2)]])


@given(PLACES)
@pytest.mark.parametrize('name', ['aircraft', 'vehicle', 'two_wheeled'])
def test_a_pose_is_that_of_the_odometry(name, place):
    system, plane = load(name)
    x = np.zeros(system.n)
    x[:3] = place
    odometry = OdometryMap(system)
    message = odometry.message(np.zeros(system.n))
    odometry.fill(message, x, np.zeros(system.n))
    assert plane.locate(x) == place
    assert plane.pose(*place) == message.pose.pose
    transform = make_transform(plane.pose(*place), Time(sec=3))
    assert (transform.header.frame_id, transform.child_frame_id) == ('odom', 'base_link')
    assert transform.header.stamp.sec == 3
    assert_allclose(vector(transform.transform.translation), vector(message.pose.pose.position))
    assert transform.transform.rotation == message.pose.pose.orientation


@pytest.mark.slow
@given(PLACES, st.floats(-0.6, 0.6))
@pytest.mark.parametrize('name', NAMES)
def test_a_body_moves_as_one(name, place, value):
    """Seen from the body, each part is where it is at the origin."""
    system, plane = load(name)
    u = np.full(system.m, value)
    markers = BodyMarkers(system, plane, 'body')
    home = [(vector(each.pose.position), rotation(each.pose.orientation))
            for each in markers.fill((0.0, 0.0, 0.0), u, Time())]
    pose = plane.pose(*place)
    turned = rotation(pose.orientation)
    for marker, (position, orientation) in zip(
            markers.fill(place, u, Time(sec=7)), home, strict=True):
        assert_allclose(vector(marker.pose.position), vector(pose.position) + turned @ position,
                        atol=1e-9)
        assert_allclose(rotation(marker.pose.orientation), turned @ orientation, atol=1e-12)
        assert (marker.ns, marker.header.frame_id, marker.header.stamp.sec) == ('body', 'odom', 7)
        assert min(marker.scale.x, marker.scale.y, marker.scale.z) > 0


@given(PLACES, st.floats(-100, 100), st.floats(-100, 100))
def test_the_exhaust_is_opposite_to_the_force_on_the_aircraft(place, f1, f2):
    """The force is m (v' + g) in the frame of the world; it acts r below the centre."""
    system, plane = load('aircraft')
    markers = InputMarkers(system, plane).fill(place, (f1, f2), Time())
    if math.hypot(f1, f2) < 0.08:
        assert markers == []
        return
    [arrow] = markers
    turned = rotation(arrow.pose.orientation)
    begin, end = (vector(arrow.pose.position) + turned @ vector(each) for each in arrow.points)
    m, _, r, g, _ = system.p_value
    x = np.array([*place, 0.0, 0.0, 0.0])
    rates = system.f(x, np.array([f1, f2]))
    force = m * np.array([rates[3], 0.0, rates[4] + g])
    assert_allclose(end - begin, -EXHAUST_LENGTH * force, atol=1e-9)
    below = np.array([math.sin(place[2]), 0.0, -math.cos(place[2])])
    assert_allclose(begin, vector(plane.pose(*place).position) + r * below, atol=1e-9)


@given(st.floats(-0.6, 0.6))
def test_the_front_wheels_are_steered_within_the_drawn_limits(phi):
    system, plane = load('vehicle')
    length = system.p_value[0]
    body = BodyMarkers(system, plane, 'body').fill((0.0, 0.0, 0.0), (10.0, phi), Time())
    headings = sorted((round(each.pose.position.x, 9), 2 * math.atan2(
        each.pose.orientation.z, each.pose.orientation.w)) for each in body[2:])
    assert_allclose([each[0] for each in headings], [0, 0, length, length])
    assert_allclose([each[1] for each in headings], [0, 0, phi, phi], atol=1e-12)
    [lines] = InputMarkers(system, plane).fill((0.0, 0.0, 0.0), (10.0, phi), Time())
    ends = np.array([vector(each) for each in lines.points[1::2]]) - [length, 0, 0]
    assert_allclose(np.arctan2(ends[:, 1], ends[:, 0]), [system.u_min[1], system.u_max[1]])


@pytest.mark.parametrize('names, plane, has_places', [
    (('px', 'py'), '', True), (('py', 'vx', 'px'), 'vertical', True), (('px', 'vx'), '', False),
    (('py', 'theta'), 'horizontal', True), (('x', 'y'), 'horizontal', False), ((), '', False)])
def test_a_plant_with_positions_in_a_plane_has_places(names, plane, has_places):
    assert PlaneMap(names, plane).has_places == has_places


def test_any_other_plant_with_positions_is_a_sphere_with_axes():
    system = define('mass', (Signal('py'), Signal('px')), (Signal('u'),), (),
                    lambda x, u, p: (u[0], x[0]))
    plane = PlaneMap(system.state_names, system.plane)
    markers = BodyMarkers(system, plane, 'body').fill(plane.locate([3.0, 4.0]), [0.0], Time())
    assert [each.type for each in markers] == [Marker.SPHERE, Marker.CUBE, Marker.CUBE]
    assert_allclose(vector(markers[0].pose.position), [4, 3, 0])
    assert InputMarkers(system, plane).fill((4.0, 3.0, 0.0), [0.0], Time()) == []


def design(system, xe, ue):
    return LqrDesign(system=system, xe=array('d', xe), ue=array('d', ue))


def test_a_set_point_at_rest_is_a_body_and_one_that_moves_is_its_line():
    aircraft = SetPointMarkers(*load('aircraft'))
    assert aircraft.fill((0.0, 0.0, 0.0), Time()) == []
    aircraft.take(design('aircraft', [2, 1, 0, 0, 0, 0], [0, 39.2]))
    assert_allclose(vector(aircraft.fill((9.0, 9.0, 1.0), Time())[0].pose.position), [2, 0, 1])
    vehicle = SetPointMarkers(*load('vehicle'))
    theta = 0.3
    vehicle.take(design('vehicle', [5, -2, theta], [10, 0]))
    [line] = vehicle.fill((105.0, 40.0, 0.0), Time())
    along = np.array([math.cos(theta), math.sin(theta), 0.0])
    for point in line.points:
        assert abs(np.cross(vector(point) - [5, -2, 0], along)[2]) < 1e-9
    first, last = ((vector(each) - [105, 40, 0]) @ along for each in line.points)
    assert_allclose([first, last], [-10, 40])


@pytest.mark.slow
@given(hostile.messages(LqrDesign) | hostile.spoilt(
    design('aircraft', [2, 1, 0, 0, 0, 0], [0, 39.2])))
def test_a_hostile_design_leaves_a_set_point_of_finite_numbers_or_none(message):
    markers = SetPointMarkers(*load('aircraft'))
    markers.take(message)
    for each in markers.fill((0.0, 0.0, 0.0), Time()):
        assert np.isfinite(vector(each.pose.position)).all()
        assert all(np.isfinite(vector(point)).all() for point in each.points)
