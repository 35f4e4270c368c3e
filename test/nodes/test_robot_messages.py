# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Odometry, twists and wrenches of plants from files: their fields, not their names, decide."""

import math
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given
from hypothesis import strategies as st
from lqr_bench import Bench
from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.core.systems.file import build_system
from obc_ros.core.systems.registry import get_system
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import Command, State
from obc_ros.nodes.control.command_sinks import Sink
from obc_ros.nodes.lqr.settings import judge_lqr_settings, Settings
from obc_ros.ros.conversions import make_body_reader, make_state_reader, OdometryMap
from obc_ros.ros.state_sources import NamesError
import pytest
from scipy.spatial.transform import Rotation

number = st.floats(-5.0, 5.0)

# A car whose inputs are in the other order than those of the registered vehicle.
CAR = """
name: vehicle
states: [px, py, theta]
inputs: [phi, v]
parameters: {wheelbase: 0.5}
units: {px: m, py: m, theta: rad, phi: rad, v: m/s}
dynamics: {px: v*cos(theta), py: v*sin(theta), theta: (v/wheelbase)*tan(phi)}
setpoint_input: {v: 1}
plane: horizontal
"""
TWIST = 'ros: {cmd_vel: {linear.x: v, angular.z: (v/wheelbase)*tan(phi)}}\n'
BASE = {
    'states': ['px', 'py', 'theta'], 'inputs': ['omega', 'v'],
    'dynamics': {'px': 'v*cos(theta)', 'py': 'v*sin(theta)', 'theta': 'omega'},
    'units': {'v': 'm/s', 'omega': 'rad/s'}, 'plane': 'horizontal'}


def judge(folder: Path, text: str, **values: Any) -> Any:
    """Return what lqr_node makes of a plant file."""
    file = folder / f'plant{len(list(folder.iterdir()))}.yaml'   # a file is read once
    file.write_text(text)
    values.setdefault('setpoint_input', (0.0, 1.0))
    values.setdefault('u_limits', (-0.5, 0.5, 0.0, 2.0))
    return judge_lqr_settings(Settings(system=str(file), **values))


def send(topic: str, system: Any, u: Any, **options: Any) -> dict[str, float]:
    """Return the fields of the message of an input that are not 0."""
    message = Sink(topic, system, **options).message(u, Time())
    body = getattr(message, 'twist', getattr(message, 'wrench', message))
    return {f'{part}.{axis}': value for part in body.get_fields_and_field_types()
            for axis in 'xyz' if (value := getattr(getattr(body, part), axis))}


# cmd_vel and wrench


@given(st.floats(0.1, 2.0), st.floats(-0.5, 0.5))
def test_a_twist_has_the_fields_that_the_file_states(v: float, phi: float) -> None:
    """A car of a file named vehicle: the order of its inputs does not matter."""
    import yaml
    car = build_system(yaml.safe_load(CAR + TWIST))
    wanted = {'linear.x': v, 'angular.z': v / 0.5 * math.tan(phi)}
    found = send('cmd_vel', car, [phi, v])
    assert {'linear.x': 0.0, 'angular.z': 0.0, **found} == pytest.approx(wanted, rel=1e-14)
    longer = send('cmd_vel', car.with_parameters({'wheelbase': 5.0}), [phi, v])
    assert longer.get('angular.z', 0.0) == pytest.approx(wanted['angular.z'] / 10.0, rel=1e-14)


def test_no_name_of_a_plant_chooses_its_messages(tmp_path: Path) -> None:
    """Without `ros`, a file named vehicle has no twist; the refusal gives the line to add."""
    with pytest.raises(StatementError, match='carries the inputs of vehicle; add to its file: '
                                             r'ros: \{cmd_vel: \{linear\.x: v, angular\.z: EXPR'):
        judge(tmp_path, CAR, command_sink='cmd_vel')
    assert judge(tmp_path, CAR + TWIST, command_sink='cmd_vel').settings.command_sink == 'cmd_vel'


@pytest.mark.parametrize(('fields', 'words'), [
    ('linear.x: v', 'no field of ros.cmd_vel of vehicle contains phi'),
    ('linear.x: v, angular.z: (v/l)*tan(phi)', "ros.cmd_vel.angular.z: unknown name 'l'"),
    ('linear.x: v, angular.q: phi', 'ros.cmd_vel.angular.q: unknown key'),
    ('linear.x: v, angular.z: tan(theta)*phi', "ros.cmd_vel.angular.z: unknown name 'theta'"),
    ('linear.x: v, angular.z: v/phi', 'the message of the input at rest, [0.0, 0.0], is not '
     'finite: its field z is nan')])
def test_a_message_that_cannot_be_made_is_refused_at_the_start(tmp_path: Path, fields: str,
                                                               words: str) -> None:
    with pytest.raises(StatementError) as error:
        judge(tmp_path, f'{CAR}ros: {{cmd_vel: {{{fields}}}}}\n', command_sink='cmd_vel')
    assert words in str(error.value)


def test_inputs_named_v_and_omega_with_their_units_are_a_twist() -> None:
    """In any order; without their units nothing is assumed."""
    assert send('cmd_vel', build_system(BASE), [0.25, 2.0]) == {'linear.x': 2.0, 'angular.z': 0.25}
    for units in ({}, {'v': 'm/s'}, {'v': 'km/h', 'omega': 'rad/s'}):
        with pytest.raises(StatementError, match='it is not known how this message carries'):
            Sink('cmd_vel', build_system({**BASE, 'units': units}))


@pytest.mark.slow
@given(number, number)
def test_registered_systems_state_their_messages(a: float, b: float) -> None:
    """The twist moves the body as the dynamics do; the wrench has the forces of figure 2.3."""
    for name in ('vehicle', 'two_wheeled'):
        system, u = get_system(name), np.array([a, b / 5.0])
        along, _, turned = system.f(np.zeros(3), u)
        found = {'linear.x': 0.0, 'angular.z': 0.0, **send('cmd_vel', system, u.tolist())}
        assert found == pytest.approx({'linear.x': along, 'angular.z': turned}, abs=1e-12)
    lateral = get_system('vehicle_lateral')
    found = {'angular.z': 0.0, **send('cmd_vel', lateral, [b / 5.0])}
    assert found == pytest.approx(
        {'linear.x': 10.0, 'angular.z': lateral.f(np.zeros(2), np.array([b / 5.0]))[1]}, abs=1e-12)
    assert {'force.x': 0.0, 'force.z': 0.0, 'torque.y': 0.0, **send(
        'wrench', get_system('aircraft'), [a, b])} == pytest.approx(
            {'force.x': a, 'force.z': b, 'torque.y': -0.25 * a}, abs=1e-12)


def test_a_field_that_is_not_finite_leaves_the_last_message() -> None:
    car = build_system({**BASE, 'units': {}, 'ros': {
        'cmd_vel': {'linear.x': 'v', 'angular.z': 'log(omega)'}}})
    sink = Sink('cmd_vel', car)
    sink.message([1.0, 0.5], Time())
    twist = sink.message([-1.0, 7.0], Time()).twist
    assert (twist.linear.x, twist.angular.z) == (0.5, 0.0)


# Names of components


@given(st.permutations(range(6)), st.lists(number, min_size=6, max_size=6))
def test_named_components_are_put_in_order(order: list[int], x: list[float]) -> None:
    system = get_system('aircraft')
    read = make_state_reader('state', system)
    message = State(names=[system.state_names[i] for i in order], x=[x[i] for i in order])
    for _ in range(2):
        assert list(read(message)) == x
    assert list(read(State(x=x))) == x   # not stated: not checked


@pytest.mark.parametrize(('names', 'x', 'words'), [
    (['position', 'angle'], [0.0, 0.0], 'its components are (position, angle); wanted (x1, x2)'),
    (['x1'], [0.0], 'its components are (x1); wanted (x1, x2) of double_integrator'),
    (['x1', 'x1'], [0.0, 0.0], 'its components are (x1, x1); wanted'),
    (['x2', 'x1'], [0.0], 'it has 2 names and 1 numbers'),
    (['\x1b[31m' * 99, ''], [0.0, 0.0], r'(\x1b[31m')])
def test_states_of_another_system_are_refused(names: list[str], x: list[float], words: str
                                              ) -> None:
    """Row 19: a state has names, or none."""
    read = make_state_reader('state', get_system('double_integrator'))
    with pytest.raises(NamesError) as error:
        read(State(names=names, x=x))
    assert words in str(error.value)
    assert len(str(error.value)) < 400


@pytest.mark.nodes
def test_a_second_publisher_of_another_plant_is_not_used(spawn: Any, probe: Any) -> None:
    """Six numbers are six numbers; their names say whose they are."""
    bench = Bench(spawn, probe)
    x, names = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], list(get_system('aircraft').state_names)
    wanted = bench.ask(x)
    other, seen = State(names=['s1', 's2', 's3', 's4', 's5', 's6'], x=[9.0] * 6), len(
        bench.commands)
    bench.publisher.publish(other)
    bench.process.wait_for_output('its components are (s1, s2, s3, s4, s5, s6); wanted (px, py, ')
    assert len(bench.commands) == seen
    message = State(names=names[::-1], x=x[::-1])
    message.header.stamp.sec = 1000
    bench.publisher.publish(message)
    command = probe.wait_for(lambda: bench.commands[seen:] or None)[0]
    assert list(command.u) == wanted.tolist()
    assert command.names == ['f1', 'f2']


@pytest.mark.nodes
def test_commands_of_another_plant_are_dropped(spawn: Any, probe: Any) -> None:
    """plant_simulator names its states, and uses commands with the names of its inputs."""
    spawn('plant_simulator', {'system': 'two_wheeled', 'publish_rate': 50.0, 'publish_clock': True,
                              'x0': [0.0, 0.0, 0.0]})
    states: list[Any] = probe.listen(State, 'state')
    commands = probe.publisher(Command, 'command')
    probe.wait_for(lambda: states and probe.node.count_subscribers('command'))
    assert states[0].names == ['px', 'py', 'theta']

    def turned(names: list[str], u: list[float]) -> float:
        """Return the heading after a command in order, 0.2 s later."""
        last = states[-1]
        message = Command(names=names, u=u)
        message.header.stamp = last.header.stamp
        commands.publish(message)
        seen = len(states)
        probe.wait_for(lambda: len(states) >= seen + 10)
        return float(states[-1].x[2] - last.x[2])

    assert turned(['v', 'phi'], [0.0, 0.5]) == 0.0
    assert probe.wait_for(lambda: turned(['omega', 'v'], [0.5, 0.0]) > 0.0)
    reports = probe.listen(DiagnosticArray, '/diagnostics')
    probe.wait_for(lambda: any(
        each.key == 'commands dropped, other components' and each.value == '1'
        for array in reports for status in array.status for each in status.values))


# odom


def pose(x: float, y: float, yaw: float, forward: float = 0.0, turn: float = 0.0) -> Odometry:
    message = Odometry(child_frame_id='base_link')
    message.header.frame_id = 'odom'
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    turned = message.pose.pose.orientation
    turned.x, turned.y, turned.z, turned.w = Rotation.from_euler('z', yaw).as_quat()
    message.twist.twist.linear.x, message.twist.twist.angular.z = forward, turn
    return message


@given(number, number, st.floats(-3.14, 3.14), number, number)
def test_odometry_is_read_into_the_states_that_the_file_names(
        x: float, y: float, yaw: float, forward: float, turn: float) -> None:
    """Names, order and direction are those of the file; without `plane` the fields tell it."""
    system = build_system({
        'states': ['speed', 'psi', 'left', 'x', 'spin'], 'inputs': ['a', 'b'],
        'dynamics': {'speed': 'a', 'psi': 'spin', 'left': 'speed*sin(psi)',
                     'x': 'speed*cos(psi)', 'spin': 'b'},
        'ros': {'odom': {'x': 'x', 'y': '-left', 'yaw': 'psi', 'linear.x': 'speed',
                         'angular.z': 'spin'}}})
    assert system.plane == 'horizontal'
    read = make_body_reader('odom', system)
    assert read(pose(x, y, yaw, forward, turn)) == pytest.approx(
        [forward, yaw, -y, x, turn], abs=1e-12)


@given(st.lists(number, min_size=5, max_size=5))
def test_published_odometry_is_read_again(x: list[float]) -> None:
    """With fields of a file in the vertical plane, whose pitch is the negative of an angle."""
    system = build_system({
        'states': ['h', 'w', 'd', 'a', 'rate'], 'inputs': ['f'],
        'dynamics': {'h': 'w', 'w': 'f', 'd': '1', 'a': 'rate', 'rate': '-a'},
        'ros': {'odom': {'z': 'h', 'vz': 'w', 'x': 'd', 'pitch': '-a', 'angular.y': '-rate'}}})
    converter, state = OdometryMap(system), np.array(x)
    assert (system.plane, converter.complete, converter.readable) == ('vertical', True, True)
    message = converter.message([0.1] * 5)
    # vz is the rate of z: the second state is its rate
    converter.fill(message, state, system.f(state, np.zeros(1)))
    again = converter.state(message)
    again[3] += 2 * math.pi * round((state[3] - again[3]) / (2 * math.pi))
    np.testing.assert_allclose(again, state, atol=1e-12)


@pytest.mark.parametrize(('fields', 'words'), [
    ({'x': 'px', 'y': 'px'}, 'ros.odom: two fields are the same state'),
    ({'x': '2*px'}, 'these fields do not tell the plane'),
    ({'yaw': 'theta + 1'}, 'ros.odom.yaw: wanted one of the states px, py, theta, or the neg'),
    ({'yaw': 'omega'}, "ros.odom.yaw: unknown name 'omega'"),
    ({'yaw': 'theta', 'pitch': 'theta'}, 'these fields do not tell the plane'),
    ({'heading': 'theta'}, 'these fields do not tell the plane')])
def test_malformed_fields_are_refused(fields: Any, words: str) -> None:
    with pytest.raises(StatementError) as error:
        build_system({**BASE, 'plane': '', 'ros': {'odom': fields}})
    assert words in str(error.value)


def test_odometry_that_does_not_tell_the_state_is_refused(tmp_path: Path) -> None:
    for text in (CAR.replace('plane: horizontal', ''), CAR.replace('theta: rad', 'theta: deg')):
        with pytest.raises(StatementError, match='do not determine the state of vehicle .*ros: '):
            judge(tmp_path, text, state_source='odom')


@pytest.mark.parametrize('heading', [0.0, 0.02, math.pi / 2, math.pi])
def test_a_heading_from_odometry_is_an_angle(tmp_path: Path, heading: float) -> None:
    """Row 15: the file does not say `angles: [theta]`; the error is the short way round."""
    found = judge(tmp_path, CAR + TWIST, state_source='odom', command_sink='cmd_vel',
                  setpoint=(0.0, 0.0, heading))
    read = make_body_reader('odom', found.design.plant.system)
    for off in (0.1, -0.1):
        x = read(pose(0.0, 0.0, heading + off))
        error = found.control.limits.error(x, found.control.regulator.x)
        assert error[2] == pytest.approx(off, abs=1e-12)
    assert found.design.plant.system.angles == (False, False, True)
