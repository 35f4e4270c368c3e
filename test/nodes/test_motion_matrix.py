# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Loops over DDS, for each controller, source and sink, and several plants.

The test is the plant and the converter of the messages; its formulas are its own. lqr_node is
compared with the loop in one process; mpc_node reaches its set point. A car at one heading makes
the same motion, turned, as at another.
"""

import math

import numpy as np
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems.registry import get_system
from obc_ros.nodes.lqr.settings import judge_lqr_settings, Settings
import pytest
from robot_bench import LANES, LOCKSTEP, place_beside_lane, RobotBench, see_from_lane

pytestmark = [pytest.mark.slow, pytest.mark.nodes]
BESIDE = 0.3, 0.4, 0.1            # of a car, from its lane
ROUNDING = 1e-9                   # of states of order 1 to 100, over 150 steps
LANE = 1e-3                       # [m]
WHEELBASE, ARM = 2.0, 0.25        # of the vehicle and the aircraft [m]
AIRCRAFT = [1.0, -1.0, 0.1, 0.0, 0.0, 0.0]
# Without `angles`: from odometry a heading is an angle.
CAR = """
name: car
states: [px, py, theta]
inputs: [speed, turn]
plane: horizontal
dynamics: {px: speed*cos(theta), py: speed*sin(theta), theta: turn}
setpoint_input: {speed: 2.0, turn: 0.0}
input_bounds: {speed: [-4.0, 4.0], turn: [-2.0, 2.0]}
"""


@pytest.fixture
def car(tmp_path):
    file = tmp_path / 'car.yaml'
    file.write_text(CAR)
    return str(file)


def read_input(sink, message):
    """Return the input (m,) of a message of the vehicle or the aircraft."""
    if sink == 'cmd_vel':
        speed, rate = message.twist.linear.x, message.twist.angular.z
        return [speed, math.atan(rate * WHEELBASE / speed) if speed else 0.0]
    if sink == 'wrench':
        force, torque = message.wrench.force, message.wrench.torque
        assert torque.y == pytest.approx(-ARM * force.x, abs=1e-12)
        return [force.x, force.z]
    return list(message.u)


def fly(bench, system, x0, seconds):
    """Return the states (k, n) of a plant in the loop over DDS."""
    simulator = Simulator(system, x0)

    def move(message):
        simulator.command(read_input(bench.sink, message))
        simulator.advance(round(bench.period * 1e-9 / simulator.conditions.dt))

    return bench.run(seconds, lambda: simulator.x, move)


def fly_in_one_process(loop, system, x0, bench, count):
    """Return the states (count, n) of a plant in the loop without ROS, up to the bench's time."""
    simulator, wanted = Simulator(system, x0), []
    for k in range(count):
        stamp = bench.time + (k - count) * bench.period
        wanted.append(simulator.x)
        simulator.command(loop.answer(stamp, simulator.x.tolist(), stamp * 1e-9))
        simulator.advance(round(bench.period * 1e-9 / simulator.conditions.dt))
    return np.array(wanted)


def make_settings(bench, **parameters):
    return Settings(**LOCKSTEP, state_source=bench.source, command_sink=bench.sink, **parameters)


@pytest.mark.parametrize(('system', 'sink', 'limits', 'x0'), [
    ('aircraft', 'command', (30.0, 90.0), AIRCRAFT),
    ('aircraft', 'wrench', (-4.0, 4.0, 20.0, 60.0), AIRCRAFT),
    ('double_integrator', 'command', (0.6,), [1.0, 0.5]),
], ids=['aircraft-command', 'aircraft-wrench', 'double_integrator-command'])
def test_lqr_node_moves_a_plant_as_the_loop_in_one_process(
        spawn, probe, system, sink, limits, x0):
    bench = RobotBench(spawn, probe, 'lqr_node', 'state', sink, 0.02, system=system,
                       u_limits=list(limits))
    plant = get_system(system)
    loop = ControlLoop(judge_lqr_settings(
        make_settings(bench, system=system, u_limits=limits)).control)
    x = fly(bench, plant, x0, 3.0)
    wanted = fly_in_one_process(loop, plant, x0, bench, len(x))
    assert np.abs(x - wanted).max() < ROUNDING
    assert np.linalg.norm(x[-1]) < 0.5 * np.linalg.norm(x0), 'it does not go to its set point'


@pytest.mark.parametrize(('name', 'source', 'sink', 'speed', 'limits'), [
    ('vehicle', 'odom', 'cmd_vel', 10.0, (0.0, 15.0, -0.3, 0.3)),
    ('vehicle', 'state', 'command', 10.0, (0.0, 15.0, -0.3, 0.3)),
    ('car', 'odom', 'command', 2.0, (-4.0, 4.0, -2.0, 2.0)),
], ids=['vehicle-odom-cmd_vel', 'vehicle-state-command', 'car-odom-command'])
def test_lqr_node_moves_a_car_at_each_heading_as_the_loop_in_one_process(
        spawn, probe, car, name, source, sink, speed, limits):
    system = car if name == 'car' else name
    given = {'system': system, 'u_limits': limits, 'setpoint_input': (speed, 0.0)}
    plant, seen = get_system(system), []
    bench = RobotBench(spawn, probe, 'lqr_node', source, sink, 0.02, system=system,
                       u_limits=list(limits), setpoint_input=[speed, 0.0])
    loop = None
    for lane in LANES:
        bench.set(setpoint=list(lane))
        control = judge_lqr_settings(make_settings(bench, **given, setpoint=lane)).control
        loop = loop or ControlLoop(control)
        loop.adopt(control)
        bench.begin_anew()   # the set point begins beside the car
        x0 = place_beside_lane(BESIDE, lane)
        x = fly(bench, plant, x0, 3.0)
        wanted = fly_in_one_process(loop, plant, x0, bench, len(x))
        assert np.abs(x - wanted).max() < ROUNDING
        seen.append(see_from_lane(x, lane))
    assert max(np.abs(each - seen[0]).max() for each in seen) < ROUNDING
    assert np.abs(seen[0][-1, 1:]).max() < 0.5 * BESIDE[1]


@pytest.mark.parametrize(('system', 'source', 'sink', 'limits', 'x0'), [
    ('aircraft', 'state', 'wrench', (-6.0, 6.0, 20.0, 60.0), AIRCRAFT),
    ('double_integrator', 'state', 'command', (0.6,), [1.0, 0.5]),
], ids=['aircraft-state-wrench', 'double_integrator-state-command'])
def test_mpc_node_brings_a_plant_to_its_set_point(
        spawn, probe, system, source, sink, limits, x0):
    bench = RobotBench(spawn, probe, 'mpc_node', source, sink, 0.1, system=system,
                       u_limits=list(limits), horizon=1.0)
    x = fly(bench, get_system(system), x0, 24.0)   # 9 times 1 / 0.375 s
    assert np.abs(x[-1]).max() < LANE


@pytest.mark.parametrize(('name', 'source', 'sink', 'speed', 'limits'), [
    ('vehicle', 'odom', 'cmd_vel', 10.0, (5.0, 15.0, -0.3, 0.3)),
    ('car', 'state', 'command', 2.0, (-4.0, 4.0, -2.0, 2.0)),
], ids=['vehicle-odom-cmd_vel', 'car-state-command'])
def test_mpc_node_brings_a_car_to_its_lane_at_each_heading(
        spawn, probe, car, name, source, sink, speed, limits):
    system = car if name == 'car' else name
    plant, seen = get_system(system), []
    bench = RobotBench(spawn, probe, 'mpc_node', source, sink, 0.1, system=system,
                       u_limits=list(limits), setpoint_input=[speed, 0.0], horizon=1.0)
    for lane in LANES:
        x0 = place_beside_lane(BESIDE, lane)
        bench.set(setpoint=list(lane))
        bench.begin_anew()
        seen.append(see_from_lane(fly(bench, plant, x0, 9.0), lane))
        assert np.abs(seen[-1][-10:, 1]).max() < LANE
        assert np.abs(seen[-1][-10:, 2]).max() < LANE
    # To the tolerance of the solver; the first lane begins with the first plan, the others, after
    # a jump of the stamps, with the regulator.
    assert max(np.abs(each - seen[1]).max() for each in seen[1:]) < LANE
