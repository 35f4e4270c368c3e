# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""mpc_node with its solver over DDS: limits that the regulator exceeds are kept."""

import subprocess
import sys

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import GetState
import numpy as np
from obc_ros.core.receding.formulation import state_receding_problem
from obc_ros.core.systems.registry import get_system
from obc_ros.msg import Command, LqrDesign, State
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import SetBool
from support import DEMO

pytestmark = [pytest.mark.slow, pytest.mark.nodes]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
INF = float('inf')
SPEED, TILT = 0.4, 0.2
BOUNDS = [-INF, INF, -INF, INF, -TILT, TILT, -SPEED, SPEED, -INF, INF, -INF, INF]
LIMITS = {**DEMO, 'system': 'aircraft', 'x_bounds': BOUNDS, 'u_limits': [-6.0, 6.0, 20.0, 60.0],
          'horizon': 0.4, 'stamp_timeout': 0.0}   # the stamps of lockstep are simulated
X0 = [1.0, 0.5, 0.0, 0.0, 0.0, 0.0]
LONG = 90.0   # [s] reached only by a failing test
# Keeps a core busy for 50 ms of every 100 ms.
BURSTS = """
import time
while True:
    end = time.monotonic() + 0.05
    while time.monotonic() < end:
        pass
    time.sleep(0.05)
"""


def fly(spawn, probe, x0=X0, **parameters):
    """Start plant and node; return the states, the commands and the node."""
    states = probe.listen(State, 'state', QoSProfile(depth=1000))
    commands = probe.listen(Command, 'command', QoSProfile(depth=1000))
    spawn('plant_simulator', {
        'system': 'aircraft', 'x0': x0, 'publish_rate': 50.0, 'lockstep': True})
    return states, commands, spawn('mpc_node', {**LIMITS, **parameters})


def pause(probe, wanted):
    assert probe.call(SetBool, '/plant_simulator/pause', SetBool.Request(data=wanted)).success


def settles(states):
    """Return whether the last state is at the set point."""
    return bool(states) and np.abs(states[-1].x).max() < 0.02


def test_the_regulator_alone_exceeds_the_limits():
    problem = state_receding_problem(get_system('aircraft'), horizon=20, period=0.02)
    x, fastest = np.array(X0), 0.0
    for _ in range(200):
        x = problem.model(x, -problem.K @ x).full().ravel()
        fastest = max(fastest, np.abs(x[3]))
    assert fastest > 1.3 * SPEED


@pytest.mark.parametrize('bursts', [0, 2], ids=['quiet', 'beside bursts of load'])
def test_limits_are_kept_on_the_way_to_the_set_point(spawn, probe, bursts):
    others = [subprocess.Popen([sys.executable, '-c', BURSTS]) for _ in range(bursts)]
    try:
        states, commands, node = fly(spawn, probe)
        node.wait_for_output('ends outside of the set in which the regulator is proved', LONG)
        probe.wait_for(lambda: settles(states), LONG, 'the set point')
    finally:
        for other in others:
            other.kill()
            other.wait()
    x, u = np.array([each.x for each in states]), np.array([each.u for each in commands])
    # A late plan leaves the feedback along the one before it, which keeps the bounds nearly.
    slack = 0.02
    assert np.abs(x[:, 3]).max() <= SPEED * (1.0 + slack)
    assert np.abs(x[:, 2]).max() <= TILT * (1.0 + slack)
    assert np.abs(u[:, 0]).max() <= 6.0
    assert (u[:, 1] >= 20.0).all() and (u[:, 1] <= 60.0).all()


def test_the_vehicle_goes_back_to_its_lane_within_its_limits(spawn, probe):
    """The set point moves at 10 m/s and begins at the vehicle, wherever that is."""
    states = probe.listen(State, 'state', QoSProfile(depth=1000))
    commands = probe.listen(Command, 'command', QoSProfile(depth=1000))
    spawn('plant_simulator', {
        'system': 'vehicle', 'x0': [50.0, 1.5, 0.0], 'publish_rate': 50.0, 'lockstep': True})
    spawn('mpc_node', {
        **DEMO, 'system': 'vehicle', 'setpoint': [0.0, 0.0, 0.0], 'setpoint_input': [10.0, 0.0],
        'x_bounds': [-INF, INF, -INF, INF, -0.15, 0.15], 'u_limits': [5.0, 15.0, -0.1, 0.1],
        'horizon': 0.6, 'stamp_timeout': 0.0})
    probe.wait_for(lambda: states and np.abs(states[-1].x[1:]).max() < 0.02, LONG, 'the lane')
    x, u = np.array([each.x for each in states]), np.array([each.u for each in commands])
    assert np.abs(x[:, 2]).max() <= 0.15 * 1.02
    assert np.abs(u[:, 1]).max() <= 0.1
    assert u[-1] == pytest.approx([10.0, 0.0], abs=0.1)
    assert x[-1, 0] > 60.0


def test_a_plant_of_a_file_goes_around_an_obstacle(spawn, probe, tmp_path):
    file = tmp_path / 'cart.yaml'
    file.write_text('name: cart\nstates: [x, y, vx, vy]\ninputs: [ax, ay]\n'
                    'dynamics: {x: vx, y: vy, vx: ax - 0.1*vx, vy: ay - 0.1*vy}\n')
    states = probe.listen(State, 'state', QoSProfile(depth=1000))
    spawn('plant_simulator', {'system': str(file), 'x0': [-2.0, 0.1, 0.0, 0.0],
                              'publish_rate': 20.0, 'lockstep': True})
    spawn('mpc_node', {
        **DEMO, 'system': str(file), 'rate': 20.0, 'horizon': 2.0, 'u_limits': [2.0, 2.0],
        'stamp_timeout': 0.0,
        'path_constraints': ['0.25 - (x + 1)**2 - y**2']})
    probe.wait_for(lambda: settles(states), LONG, 'the set point')
    x = np.array([each.x for each in states])
    assert np.hypot(x[:, 0] + 1.0, x[:, 1]).min() >= 0.5 * 0.98


def test_lost_and_late_states_are_bridged_by_the_plan(spawn, probe):
    """Of ten states one is lost, and one comes after the next one, which is dropped."""
    states, passed = probe.listen(State, 'state', QoSProfile(depth=1000)), []
    reports = probe.listen(DiagnosticArray, '/diagnostics')
    spawn('plant_simulator', {'system': 'aircraft', 'x0': X0, 'publish_rate': 50.0},
          remappings={'state': 'true_state'})
    spawn('mpc_node', LIMITS)
    relay = probe.publisher(State, 'state')

    def pass_on(state):
        passed.append(state)
        place = len(passed) % 10
        if place not in (0, 5):
            relay.publish(state)
        if place == 6:
            relay.publish(passed[-2])

    probe.node.create_subscription(State, 'true_state', pass_on, QoSProfile(depth=1000))
    probe.wait_for(lambda: settles(passed), LONG, 'the set point')
    x = np.array([each.x for each in passed])
    # The input is held in a period without a command. The regulator alone exceeds 1.3 SPEED.
    assert np.abs(x[:, 3]).max() <= 1.3 * SPEED
    assert len(states) < len(passed)

    def read(kind):
        return next((int(each.value) for report in reversed(reports) for status in report.status
                     if status.name.startswith('mpc_node') for each in status.values
                     if each.key == kind), 0)

    # Deadlines are those of states that have come: one of ten is lost, one is dropped.
    probe.wait_for(lambda: read('deadlines wanted') > 50, LONG)
    assert read('deadlines wanted') < 0.75 * len(passed)


def test_a_start_from_which_no_plan_keeps_the_limits_is_refused(spawn, probe):
    states, commands, node = fly(spawn, probe, x0=[1.0, 0.5, 0.0, 3.0 * SPEED, 0.0, 0.0])
    node.wait_for_output('not active yet: no plan from the present state keeps all limits', LONG)
    assert probe.call(GetState, 'mpc_node/get_state').current_state.label == 'inactive'
    probe.wait_for(lambda: states, LONG, 'a state: the node may be faster than the probe')
    assert not commands


def test_an_obstacle_that_appears_is_passed(spawn, probe):
    states, _, node = fly(spawn, probe, state_timeout=0.0)
    designs = probe.listen(LqrDesign, 'mpc_node/design', LATCHED)
    node.wait_for_output('activated: the loop runs', LONG)
    probe.wait_for(lambda: states and states[-1].x[0] < 0.9, LONG, 'to be on the way')
    # A circle beside the set point, above it: the straight way leads through its edge.
    obstacle = '0.01 - (px - 0.3)**2 - (py - 0.4)**2'
    # A busy machine may prepare the change for seconds: the aircraft waits in front of it.
    pause(probe, True)
    result = probe.set_parameters('/mpc_node', path_constraints=[obstacle])[0]
    assert result.successful, result.reason
    pause(probe, False)
    adopted = len(states)
    probe.wait_for(lambda: settles(states), LONG, 'the set point')
    after = np.array([each.x for each in states[adopted:]])
    assert np.hypot(after[:, 0] - 0.3, after[:, 1] - 0.4).min() >= 0.1 * (1.0 - 0.02)
    assert designs
    # One on the set point is refused: the loop goes on as before.
    result = probe.set_parameters('/mpc_node', path_constraints=['0.01 - px**2 - py**2'])[0]
    assert not result.successful
    assert 'path_constraints' in result.reason
    assert settles(states)
