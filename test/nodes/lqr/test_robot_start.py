# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A safe start of a robot: moving set points, limits, the first command, the log."""

import math
from pathlib import Path
import re
import shlex
from typing import Any

from geometry_msgs.msg import TwistStamped
from lqr_bench import Bench, HOVER, matrix
from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.msg import Command, LqrWeights
from obc_ros.nodes.lqr_node import LqrNode
from obc_ros.srv import TryDesign
import pytest

pytestmark = pytest.mark.nodes

PAGE = Path(__file__).parents[3] / 'docs' / 'workspace.md'
ROBOT = {'system': 'vehicle', 'state_source': 'odom', 'command_sink': 'cmd_vel'}
MOVING = 'the set point of vehicle moves, dpx/dt = 10 m/s, and must be given: add ' \
         'setpoint_input: [10.0, 0.0] (px = 0 m, py = 0 m, theta = 0 rad; v = 10 m/s, phi = 0 rad)'
UNLIMITED = 'the inputs of vehicle need limits, and u_limits '


@pytest.mark.parametrize(('parameters', 'sentence'), [
    (ROBOT, MOVING),
    ({'system': 'vehicle'}, MOVING),
    ({'system': 'vehicle', 'setpoint': [0.0, -2.0, 0.0]}, 'add setpoint_input: [10.0, 0.0]'),
    ({'system': 'two_wheeled'}, 'add setpoint_input: [0.5, 0.0] '),
    ({'system': 'drifting'}, 'the set point of drifting moves, dp/dt = 2 m/s, and must be '
     'given: add setpoint: [0.0, 2.0] ('),
    ({'system': 'cruise'}, 'the set point of cruise moves, v = 20 m/s, and must be given: '
     'add setpoint: [20.0] ('),
    ({**ROBOT, 'setpoint_input': [1.0, 0.0]}, UNLIMITED + 'is missing: add u_limits: '
     '[0.0, HIGHEST_v, -0.6, 0.6] (lower and upper limit of v [m/s], phi [rad]), or unlimited: '),
    ({**ROBOT, 'setpoint_input': [1.0, 0.0], 'u_limits': [math.inf, 0.5]},
     UNLIMITED + 'leaves v unlimited: add u_limits: [0.0, HIGHEST_v, -0.5, 0.5]'),
    ({'system': 'aircraft', 'command_sink': 'wrench'},
     'the inputs of aircraft need limits, and u_limits is missing'),
    ({'system': 'aircraft'}, 'the inputs of aircraft need limits, and u_limits is missing: add '
     'u_limits: [LOWEST_f1, HIGHEST_f1, LOWEST_f2, HIGHEST_f2] (lower and upper limit of f1 [N], '
     'f2 [N]), or unlimited: true if the plant is simulated'),
    ({'u_max': [5.0, 50.0]}, 'u_max does not limit the inputs: write u_limits:'
     ' [-.inf, 5.0, -.inf, 50.0]'),
    ({'u_min': [-5.0, 0.0], 'u_max': [5.0, 50.0]}, 'u_min and u_max do not limit the '
     'inputs: write u_limits: [-5.0, 5.0, 0.0, 50.0]'),
    ({'u_min': [-5.0, 0.0], 'weights': 'bryson', 'u_max': [5.0, 50.0]}, 'u_min does not '
     'limit the inputs: write u_limits: [-5.0, .inf, 0.0, .inf]'),
    ({'weights': 'bryson', 'Qx': [1.0] * 6}, 'Qx is not used with weights = bryson; write weights:'
     ' matrices as well, or leave Qx out'),
    ({'cmd_vel_stamped': False}, 'cmd_vel_stamped is not used with command_sink = command; write '
     'command_sink: cmd_vel as well, or leave cmd_vel_stamped out'),
])
def test_an_unsafe_start_is_refused(probe: Any, tmp_path: Path, parameters: Any, sentence: str
                                    ) -> None:
    """The error shows the parameter to add."""
    for name, text in {
            'drifting': 'states: [p, v]\ninputs: [a]\ndynamics: {p: v, v: a}\n'
                        'units: {p: m, v: m/s}\nsetpoint: {v: 2}\n',
            'cruise': 'states: [v]\ninputs: [a]\ndynamics: {v: a - v/10}\nunits: {v: m/s}\n'
                      'setpoint: {v: 20}\nsetpoint_input: {a: 2}\n'}.items():
        (tmp_path / f'{name}.yaml').write_text(f'name: {name}\n{text}')
    if (tmp_path / f'{parameters.get("system")}.yaml').is_file():
        parameters = {**parameters, 'system': str(tmp_path / f'{parameters["system"]}.yaml')}
    assert sentence in probe.refusal(LqrNode, parameters)


def test_a_refused_start_ends_the_node_with_one_line(spawn: Any) -> None:
    process = spawn('lqr_node', ROBOT)
    assert process.wait() == 1
    lines = [line for line in process.output().splitlines() if '[INFO]' not in line]
    assert len(lines) == 1, process.output()
    assert MOVING in lines[0], process.output()


def test_u_limits_limit_with_any_weights(spawn: Any, probe: Any) -> None:
    """u_limits replaces u_min and u_max and does not depend on the weights."""
    bench = Bench(spawn, probe, u_limits=[-math.inf, 5.0, 30.0, math.inf])
    for revision, (x, y) in enumerate(((9.0, -9.0), (-9.0, 9.0), (9.0, 9.0)), start=1):
        state = [x, y, 0.0, 0.0, 0.0, 0.0]
        wanted = HOVER - matrix(bench.design(revision).k, 2) @ state
        assert wanted[0] > 5.0 or wanted[1] < 30.0
        np.testing.assert_allclose(
            bench.answer(state), [min(wanted[0], 5.0), max(wanted[1], 30.0)])
        assert bench.set(weights='bryson', u_max=[1.0 + revision, 2.0]).successful
    assert bench.set(u_limits=[3.0, 50.0]).successful  # the maximum absolute value of each
    assert (np.abs(bench.answer([90.0, -90.0, 0.0, 0.0, 0.0, 0.0])) == [3.0, 50.0]).all()


class Robot:
    """A simulated robot with odometry and cmd_vel, controlled by the command of the page."""

    def __init__(self, spawn: Any, probe: Any) -> None:
        command, = re.findall(r'^\$ (ros2 run obc_ros lqr_node .*command_sink:=cmd_vel.*)$',
                              PAGE.read_text(encoding='utf-8'), re.MULTILINE)
        words = shlex.split(command)[4:]
        self.probe = probe
        self.twists: list[Any] = probe.listen(TwistStamped, 'cmd_vel')
        words += ['-p', 'stamp_timeout:=0.0']   # stamps begin at 0
        self.process = spawn('lqr_node', arguments=words)
        self.odom = probe.publisher(Odometry, 'odom')
        probe.wait_for(lambda: probe.node.count_publishers('cmd_vel'), what='cmd_vel')
        self.x, self.stamp, self.length = np.array([3.0, 0.0, 0.0]), 0, 2.0

    def step(self) -> tuple[float, float]:
        """Publish the odometry, and apply the twist for 20 ms; return (v, omega)."""
        self.stamp += 20_000_000
        message = Odometry(child_frame_id='base_link')
        message.header.frame_id = 'odom'
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.stamp, 10**9)
        message.pose.pose.position.x, message.pose.pose.position.y = self.x[:2].tolist()
        message.pose.pose.orientation.z = math.sin(self.x[2] / 2)
        message.pose.pose.orientation.w = math.cos(self.x[2] / 2)
        seen = len(self.twists)
        while len(self.twists) == seen:  # at first DDS may lose messages
            self.odom.publish(message)
            self.probe.spin_until(lambda: len(self.twists) > seen, 0.05)
        twist = self.twists[-1].twist
        v, omega = twist.linear.x, twist.angular.z
        self.x += 0.02 * np.array([v * math.cos(self.x[2]), v * math.sin(self.x[2]), omega])
        return v, omega


def test_the_command_of_the_page_starts_smoothly(spawn: Any, probe: Any) -> None:
    """The robot accelerates from rest, within its limits, to the 0.5 m/s of the page."""
    robot = Robot(spawn, probe)
    v = np.array([robot.step()[0] for _ in range(150)])
    assert v[0] == 0.0
    assert (np.diff(v) >= -1e-12).all()
    assert np.diff(v).max() < 0.5 * 1.5 * 0.02 * 1.01
    assert v[25] == pytest.approx(0.25, abs=0.01)   # half of the transition of 1 s
    assert v[51:] == pytest.approx(0.5, abs=1e-9)   # the set point has not run ahead
    assert robot.x[1:] == pytest.approx([0.0, 0.0], abs=1e-12)
    robot.x[0] -= 50.0  # carried back by 50 m: the limit holds
    assert robot.step()[0] <= 1.0
    for _ in range(50):
        assert 0.0 <= robot.step()[0] <= 1.0


def test_the_first_log_line_names_set_point_and_limits(spawn: Any, probe: Any) -> None:
    robot = Robot(spawn, probe)
    robot.process.wait_for_output('revision 1')
    first = robot.process.output().splitlines()[0]
    assert 'system: vehicle; xe: px = 0 m, py = 0 m, theta = 0 rad, moving: dpx/dt = 0.5 m/s; ' \
        'ue: v = 0.5 m/s, phi = 0 rad; limits: v in [0, 1] m/s, phi in [-0.5, 0.5] rad; ' \
        'source: odom; sink: cmd_vel; frame: that of the first state' in first


def test_required_limits_and_set_points_cannot_be_removed(spawn: Any, probe: Any) -> None:
    """A change must satisfy the conditions of the start."""
    bench = Bench(spawn, probe, sink=TwistStamped, commands='cmd_vel', system='vehicle',
                  command_sink='cmd_vel', setpoint_input=[1.0, 0.0], u_limits=[2.0, 0.5])
    assert UNLIMITED + 'is missing' in bench.set(u_limits=[]).reason
    assert UNLIMITED + 'leaves v' in bench.set(u_limits=[0.0, math.inf, -0.5, 0.5]).reason
    assert 'add setpoint_input' in bench.set(setpoint_input=[]).reason
    assert bench.set(unlimited=True).successful
    assert bench.set(u_limits=[]).successful
    assert UNLIMITED + 'is missing' in bench.set(unlimited=False).reason
    assert bench.set(unlimited=False, u_limits=[2.0, 0.5]).successful
    assert probe.get_parameters('/lqr_node', 'transition_time') == {'transition_time': 1.0}


def test_unused_weights_are_refused_or_reset(spawn: Any, probe: Any) -> None:
    """Changes without effect are refused; the change that the refusal suggests is accepted."""
    bench = Bench(spawn, probe, system='vehicle', setpoint_input=[10.0, 0.0], weights='bryson',
                  x_max=[1.0, 0.2, 0.1], u_max=[1.0, 0.1])
    words = '{} is not used with weights = bryson; set weights to matrices first, or both with ' \
        'set_parameters_atomically'
    assert bench.set(Qx=[1, 2, 1]).reason == words.format('Qx')
    assert bench.set(Qu='[-1, 1]').reason == words.format('Qu')
    assert bench.set(Qx=[], x_max=[1.0, 0.2, 0.1]).successful  # the present values
    assert bench.design(1).revision == len(bench.designs)
    assert not bench.set(weights='matrices', Qx=[1, 2, 1], Qu=[-1, 1]).successful
    assert bench.set(weights='matrices', Qx=[1, 2, 1]).successful
    np.testing.assert_allclose(bench.design(2).qx, np.diag([1.0, 2.0, 1.0]).ravel())
    assert probe.get_parameters('/lqr_node', 'x_max', 'u_max') == {'x_max': [], 'u_max': []}
    bench.process.wait_for_output('x_max, u_max: not used any more, back at the default')
    tried = probe.call(TryDesign, '/lqr_node/try_design',
                       TryDesign.Request(weights=LqrWeights(x_max=[1.0] * 3)))
    assert not tried.success
    assert tried.message == 'x_max is not used with weights = matrices'


def test_values_of_one_request_are_checked_together(spawn: Any, probe: Any) -> None:
    """`ros2 param load` sends a file in alphabetical order; only invalid values are refused."""
    bench = Bench(spawn, probe)
    file = {'design': 'sampled', 'delay': 0.05, 'sample_time': 0.05, 'u_max': [5.0, 5.0],
            'weights': 'bryson', 'x_max': [2.0] * 6}
    results = probe.set_parameters('/lqr_node', **file)
    assert [each.reason for each in results] == [''] * 6
    assert bench.design(2).revision == 2
    assert bench.design(2).sample_time == 0.05
    file |= {'Qx': [], 'u_max': [2.0, 2.0], 'x_max': [3.0] * 6, 'rho': 2.0}
    results = probe.set_parameters('/lqr_node', **file)
    assert [each.successful for each in results] == [name != 'rho' for name in file]
    assert results[-1].reason.startswith('rho is not used with weights = bryson; ')
    found = bench.design(4)
    np.testing.assert_allclose(found.qx, (np.eye(6) / 9.0).ravel())
    np.testing.assert_allclose(found.qu, (np.eye(2) / 4.0).ravel())


def test_an_accepted_frame_and_wheelbase_take_effect(spawn: Any, probe: Any) -> None:
    """States of the previous frame are dropped; the twist uses the new wheelbase."""
    robot = Robot(spawn, probe)
    robot.step()
    robot.x[:] = 3.0, 0.1, 0.0
    for _ in range(60):
        v, omega = robot.step()
    assert probe.set_parameters('/lqr_node', **{'system_parameters.l': 4.0})[0].successful
    robot.x[:] = robot.x[0], 0.5, 0.0   # the steering is at its limit
    for _ in range(55):
        robot.x[1:] = 0.5, 0.0
        v, omega = robot.step()
    assert omega == pytest.approx(v / 4.0 * math.tan(-0.5), rel=1e-9)
    assert probe.set_parameters('/lqr_node', frame_id='map')[0].successful
    message, seen = Odometry(child_frame_id='base_link'), len(robot.twists)
    message.header.frame_id = 'odom'
    message.header.stamp.sec, message.pose.pose.orientation.w = 100, 1.0
    robot.odom.publish(message)
    robot.process.wait_for_output("a state in the frame 'odom' was dropped: wanted 'map'")
    assert len(robot.twists) == seen


PLANT = """
name: cart
states: [p, v]
inputs: [a]
dynamics: {p: v, v: a}
"""


@pytest.mark.parametrize('node', ['lqr_node', 'mpc_node'])
def test_an_own_plant_on_command_needs_limits(spawn: Any, tmp_path: Path, node: str) -> None:
    """Row 17: whatever its topics are; the sentence gives the line to add."""
    (tmp_path / 'cart.yaml').write_text(PLANT)
    process = spawn(node, {'system': str(tmp_path / 'cart.yaml')})
    assert process.wait() == 1
    assert 'the inputs of cart need limits, and u_limits is missing: add u_limits: [LOWEST_a, ' \
        'HIGHEST_a] (lower and upper limit of a [1]), or unlimited: true' in process.output()


def test_an_own_plant_on_command_starts_from_rest(spawn: Any, probe: Any, tmp_path: Path) -> None:
    """Row 17: its own limits are enough; the law has half of its effect after half a second."""
    (tmp_path / 'cart.yaml').write_text(PLANT + 'input_bounds: {a: [-9, 9]}')
    bench = Bench(spawn, probe, sink=Command, commands='/command',
                  system=str(tmp_path / 'cart.yaml'))
    assert probe.get_parameters('/lqr_node', 'transition_time', 'unlimited') == {
        'transition_time': 1.0, 'unlimited': False}
    x, K = [1.0, 0.0], matrix(bench.design(1).k, 1)
    bench.ask(x)
    first = bench.stamp * 1e-9
    for t, part in ((0.25, 0.25**2 * 2.5), (0.5, 0.5), (0.75, 0.84375), (1.0, 1.0)):
        found = bench.answer(x, first + t)   # 3 s^2 - 2 s^3
        np.testing.assert_allclose(found, -K @ x * part, rtol=0.15, atol=1e-9)


def test_without_a_system_the_aircraft_of_the_simulator_flies_at_once(spawn: Any, probe: Any
                                                                      ) -> None:
    """Row 17: `ros2 run obc_ros lqr_node` alone needs nothing."""
    process = spawn('lqr_node')
    process.wait_for_output('revision 1')
    assert probe.get_parameters('/lqr_node', 'transition_time', 'unlimited') == {
        'transition_time': 0.0, 'unlimited': True}
