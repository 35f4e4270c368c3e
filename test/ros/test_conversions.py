# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Odometry by REP 103 and by finite differences; time stamps; parameters of systems."""

from builtin_interfaces.msg import Time
from hypothesis import example, given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
import numpy as np
from numpy.testing import assert_allclose
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import DynamicsError, StatementError
from obc_ros.ros.conversions import OdometryMap
from obc_ros.ros.messages import read_nanoseconds, set_stamp
from obc_ros.ros.parameters.system_parameters import (
    choose_system,
    list_system_parameters,
)
import pytest
from scipy.spatial.transform import Rotation

PLANE = ('aircraft', 'vehicle', 'two_wheeled')
small = st.floats(-10.0, 10.0)
angle = st.floats(-3.14, 3.14)


def odometry(system, x, u):
    x = np.array(x, dtype=float)
    converter = OdometryMap(system)
    message = converter.message([0.0] * system.n)
    converter.fill(message, x, system.f(x, np.array(u, dtype=float)))
    return message


def vector(point):
    return np.array([point.x, point.y, point.z])


def rotation(message):
    q = message.pose.pose.orientation
    return Rotation.from_quat([q.x, q.y, q.z, q.w])


@pytest.mark.parametrize(('name', 'x0', 'u'), [
    ('aircraft', [1, 2, 0.3, 4, -5, 2.0], [0.7, 30.0]),
    ('aircraft', [1, 2, -2.5, 4, -5, -1.0], [-0.7, 30.0]),
    ('vehicle', [1, 2, 0.5], [8.0, 0.4]),
    ('two_wheeled', [1, 2, -2.0], [-0.7, 0.8])])
def test_the_body_frame_twist_is_the_derivative_of_the_pose(name, x0, u):
    system, h = registry.get_system(name), 1e-4
    slope = system.f(np.array(x0, dtype=float), np.array(u))
    before, message, after = (odometry(system, x0 + step * slope, u) for step in (-h, 0, h))
    velocity = (vector(after.pose.pose.position) - vector(before.pose.pose.position)) / (2 * h)
    turn = (rotation(before).inv() * rotation(after)).as_rotvec() / (2 * h)
    assert_allclose(rotation(message).apply(vector(message.twist.twist.linear)), velocity,
                    atol=1e-6)
    assert_allclose(vector(message.twist.twist.angular), turn, atol=1e-6)


def test_vehicle_odometry_follows_rep_103():
    """REP 103: x forward, y left, z up; yaw is counter-clockwise seen from above."""
    vehicle = Simulator(registry.get_system('vehicle'))
    vehicle.command([10.0, 0.2])
    vehicle.advance(500)
    message = odometry(vehicle.system, vehicle.x, vehicle.u)
    assert message.header.frame_id == 'odom'
    assert message.child_frame_id == 'base_link'
    position = message.pose.pose.position
    assert position.x > 0
    assert position.y > 0, 'to the left'
    assert position.z == 0
    yaw, pitch, roll = rotation(message).as_euler('ZYX')
    assert yaw == pytest.approx(vehicle.x[2])
    assert yaw > 0
    assert (pitch, roll) == (0, 0)
    assert_allclose(vector(message.twist.twist.linear), [10, 0, 0], atol=1e-12)
    assert message.twist.twist.angular.z == pytest.approx(10 / 2 * np.tan(0.2))


def test_aircraft_odometry_is_in_the_xz_plane():
    """REP 103: x forward, z up; a pitch that raises the nose is negative."""
    aircraft = registry.get_system('aircraft')
    message = odometry(aircraft, [1, 2, 0.3, 0, 0, 0.5], [0, 39.2])
    assert_allclose(vector(message.pose.pose.position), [1, 0, 2])
    nose = rotation(message).apply([1, 0, 0])
    assert_allclose(nose, [np.cos(0.3), 0, np.sin(0.3)], atol=1e-15)
    yaw, pitch, roll = rotation(message).as_euler('ZYX')
    assert pitch == pytest.approx(-0.3)
    assert_allclose([yaw, roll], 0, atol=1e-15)
    assert_allclose(vector(message.twist.twist.angular), [0, -0.5, 0])


def test_thrust_directions_of_the_aircraft_are_those_of_figure_2_3():
    aircraft = Simulator(registry.get_system('aircraft'))
    aircraft.command([1.0, 45.0])
    aircraft.advance(20)
    message = odometry(aircraft.system, aircraft.x, aircraft.u)
    assert message.pose.pose.position.x > 0, 'f1 pushes forward'
    assert message.pose.pose.position.z > 0, 'f2 beyond the weight lifts'
    assert rotation(message).apply([1, 0, 0])[2] > 0, 'f1 turns the nose up'
    assert message.twist.twist.angular.y < 0


@pytest.mark.parametrize('name', PLANE)
@given(data=st.data())
def test_the_state_is_recovered_from_its_odometry(name, data):
    system = registry.get_system(name)
    x = np.array([data.draw(angle if angular else small) for angular in system.angles])
    u = [data.draw(small) for _ in system.inputs]
    assert_allclose(OdometryMap(system).state(odometry(system, x, u)), x, atol=1e-12)


@given(st.tuples(small, small, angle), small, small)
def test_a_reduced_model_reads_its_states_from_the_pose(x, v, phi):
    message = odometry(registry.get_system('vehicle'), x, [v, phi / 10])
    lateral = OdometryMap(registry.get_system('vehicle_lateral'))
    assert lateral.readable
    assert not lateral.complete
    assert_allclose(lateral.state(message), x[1:], atol=1e-12)


def turned(length, theta):
    """Return odometry of the aircraft whose quaternion has a norm."""
    message = odometry(registry.get_system('aircraft'), [0, 0, theta, 0, 0, 0], [0, 0])
    q = message.pose.pose.orientation
    q.x, q.y, q.z, q.w = (length * value for value in (q.x, q.y, q.z, q.w))
    return message


@pytest.mark.slow
@given(st.floats(0.9901, 1.0099), angle)
def test_rounding_of_a_quaternion_is_removed(length, theta):
    aircraft = OdometryMap(registry.get_system('aircraft'))
    assert aircraft.state(turned(length, theta))[2] == pytest.approx(theta, abs=1e-12)


@pytest.mark.slow
@given(st.floats(0.0, 0.9899) | st.floats(1.0101, 100.0), angle)
@example(0.05, 3.1)   # w was never set
def test_a_quaternion_that_is_not_of_norm_1_is_no_orientation(length, theta):
    aircraft = OdometryMap(registry.get_system('aircraft'))
    with pytest.raises(StatementError, match='is no rotation: its norm is'):
        aircraft.state(turned(length, theta))


@pytest.mark.parametrize(('field', 'value', 'words'), [
    ('pose.pose.orientation.w', 0.0, 'no rotation'),
    ('pose.pose.orientation.w', np.nan, 'no rotation'),
    ('pose.pose.position.x', np.inf, 'not finite'),
    ('twist.twist.linear.x', np.nan, 'not finite'),
    ('twist.twist.angular.y', np.nan, 'not finite')])
def test_invalid_odometry_is_refused_with_a_reason(field, value, words):
    message = Odometry()
    *path, last = field.split('.')
    part = message
    for name in path:
        part = getattr(part, name)
    setattr(part, last, value)
    with pytest.raises(StatementError, match=words):
        OdometryMap(registry.get_system('aircraft')).state(message)


def test_systems_without_a_pose_have_no_odometry():
    for name in ('double_integrator', 'scalar', 'brockett'):
        converter = OdometryMap(registry.get_system(name))
        assert not converter.complete
        assert not converter.readable


def test_the_noise_is_published_as_covariance():
    message = OdometryMap(registry.get_system('aircraft')).message([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    pose = np.reshape(message.pose.covariance, (6, 6))
    twist = np.reshape(message.twist.covariance, (6, 6))
    assert_allclose(np.diag(pose), [0.01, 0, 0.04, 0, 0.09, 0])
    assert_allclose(np.diag(twist), [0.25, 0, 0.25, 0, 0.36, 0])
    assert np.count_nonzero(pose) == 3


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_keep_nanoseconds(time):
    stamp = Time()
    set_stamp(stamp, time)
    assert read_nanoseconds(stamp) == time


def test_a_system_lists_its_parameters_and_options():
    def declared(name):
        return {entry.name: entry
                for entry in list_system_parameters({'system': name})}

    aircraft = declared('aircraft')
    assert set(aircraft) == {'m', 'J', 'r', 'g', 'c'}
    assert aircraft['m'].default == 4.0
    assert aircraft['m'].unit == 'kg'
    assert declared('brockett')['m'].default == 3
    assert set(declared('linear')) == {'A', 'B', 'states', 'inputs'}
    with pytest.raises(DynamicsError, match='unknown system'):
        declared('aeroplane')


def test_only_changed_values_override_the_parameters_of_a_system(tmp_path):
    path = tmp_path / 'plant.yaml'
    path.write_text('states: [x]\ninputs: [u]\nparameters: {m: 1, M: 2*m}\n'
                    'dynamics: {x: u/M}\n')
    chosen = choose_system(str(path), {'m': 3.0, 'M': 2.0})
    assert_allclose(chosen.p_value, [3, 6])
    linear = choose_system('linear', {'A': (0.0, 1.0, 0.0, 0.0), 'B': (0.0, 1.0)})
    assert linear.n == 2
