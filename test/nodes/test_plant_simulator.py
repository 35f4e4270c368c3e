# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""plant_simulator over DDS: real time, lockstep, services, refusals and faults."""

from array import array
import math
import os
from pathlib import Path
import random
import re
import signal

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from obc_ros.core.simulation.flow import Conditions, Gust
from obc_ros.core.simulation.paced_plant import HELD_UP
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from obc_ros.msg import Command, State
from obc_ros.nodes.plant_simulator import PlantSimulator
from obc_ros.ros.messages import read_nanoseconds
import pytest
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

NODE = '/plant_simulator'
SLOW = {'publish_rate': 50.0}  # a low rate, for a busy machine
LOCKSTEP = {'lockstep': True, 'speed': 0.0}
FREE = {'hold_until_command': False}


def command(u, stamp=None):
    message = Command(u=array('d', u))
    if stamp is not None:
        message.header.stamp = stamp
    return message


def stamps(states):
    return np.array([read_nanoseconds(state.header.stamp) for state in states])


def values(diagnostics):
    return {each.key: each.value for each in diagnostics[-1].status[0].values}


class Loop:
    """A controller that answers every state with u = law(x)."""

    def __init__(self, probe, law, namespace=''):
        self.law = law
        self.states = []
        self.publisher = probe.node.create_publisher(Command, f'{namespace}command', 10)
        probe.node.create_subscription(State, f'{namespace}state', self.answer, 10)

    def answer(self, state):
        if not self.states or state.header.stamp != self.states[-1].header.stamp:
            self.states.append(state)
        self.publisher.publish(command(self.law(np.array(state.x)), state.header.stamp))

    @property
    def x(self):
        return np.array([state.x for state in self.states])


def hover(x):
    """Return the input that holds the aircraft near the origin."""
    return [0.5 * x[0] + x[3] - 8.0 * x[2] - 2.0 * x[5], 39.2 - x[1] - 3.0 * x[4]]


def test_the_plant_rests_until_the_first_command(spawn, probe):
    plant = spawn('plant_simulator', {'x0': [3, 4, 0, 0, 0, 0], **FREE, **SLOW})
    states = probe.listen(State, 'state')
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    probe.wait_for(lambda: len(states) > 100, what='two seconds of states')
    wall = probe.node.get_clock().now().nanoseconds
    assert_allclose([state.x for state in states], [[3, 4, 0, 0, 0, 0]] * len(states), atol=1e-11)
    assert states[0].header.frame_id == 'odom'
    # Stamps are on a grid of 20 ms, except for the drift between two clocks. After a delay longer
    # than HELD_UP the plant begins a new grid.
    steps = np.diff(stamps(states)) / 20e6
    kept = steps[steps * 0.02 < HELD_UP]
    assert len(kept) > 90
    assert_allclose(kept, np.round(kept), atol=0.05)
    assert abs(wall - stamps(states)[-1]) < 1e9
    assert plant.output().count('its input is f1 = 0 N, f2 = 39.2 N') == 1
    probe.wait_for(lambda: diagnostics, what='diagnostics')
    status = diagnostics[-1].status[0]
    assert status.name == 'plant_simulator: plant'
    assert (status.level, status.message) == (b'\0', 'no command yet')


# slow enough to be held by a controller that answers late on a busy machine
FALLING = {'system': 'scalar', 'system_parameters.a': 2.0, 'x0': [1e-3], **SLOW}


def test_an_unstable_plant_is_held_until_its_controller_is_there(spawn, probe):
    """Two seconds would multiply its state by e^4; after ~/reset it is held again."""
    plant = spawn('plant_simulator', FALLING)
    states = probe.listen(State, 'state')
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    probe.wait_for(lambda: len(states) > 100 and diagnostics, what='two seconds of states')
    assert {(*state.x, *state.names, state.restarts) for state in states} == {(1e-3, 'x', 0)}
    assert (np.diff(stamps(states)) > 0).all()
    assert diagnostics[-1].status[0].message == 'held until the first command'
    assert plant.output().count('scalar at (0.001); until the first command it is held there') == 1
    loop = Loop(probe, lambda x: [-6.0 * x[0]])
    probe.wait_for(lambda: len(loop.states) > 50 and abs(states[-1].x[0]) < 1e-6)
    plant.wait_for_output('the first command has come: the plant moves from')
    loop.law = lambda x: [math.nan]   # no valid command any more
    answer = probe.call(Trigger, f'{NODE}/reset')
    assert answer.success
    probe.wait_for(lambda: states[-1].restarts == 1, what='a state after the reset')
    states.clear()
    probe.wait_for(lambda: len(states) > 50)
    assert {(*state.x, state.restarts) for state in states} == {(1e-3, 1)}


def test_the_odometry_of_a_held_vehicle_stands_still(spawn, probe):
    spawn('plant_simulator', {'system': 'vehicle', **SLOW})
    odometry = probe.listen(Odometry, 'odom')
    publisher = probe.publisher(Command, 'command')
    probe.wait_for(lambda: len(odometry) > 5)
    assert {each.twist.twist.linear.x for each in odometry} == {0.0}
    publisher.publish(command([3.0, 0.0]))
    probe.wait_for(lambda: odometry[-1].twist.twist.linear.x == pytest.approx(3.0))


@pytest.mark.alone
def test_real_time_does_not_drift(spawn, probe):
    clock, delays = probe.node.get_clock(), []   # [s], of each state at its arrival

    def record(state):
        delays.append((clock.now() - Time.from_msg(state.header.stamp)).nanoseconds * 1e-9)

    probe.node.create_subscription(State, 'state', record, 10)
    spawn('plant_simulator')
    probe.wait_for(lambda: len(delays) > 500, what='states of some seconds')
    # A single state may be delayed in transit; the minimum of 160 states is not.
    begin, end = min(delays[20:180]), min(delays[-160:])
    assert max(begin, end) < 0.5
    assert abs(end - begin) < 0.1


def fly(spawn, probe, parameters, law, count, system='aircraft'):
    loop = Loop(probe, law)
    plant = spawn('plant_simulator', {'system': system, **LOCKSTEP, **parameters})
    probe.wait_for(lambda: len(loop.states) >= count, what=f'{count} states')
    plant.interrupt()
    return loop.states[:count]


def test_the_loop_over_dds_equals_the_loop_in_one_process(spawn, probe):
    count = 600
    received_states = fly(spawn, probe, {'x0': [1.0, -1.0, 0.1, 0.0, 0.0, 0.0]}, hover, count)
    simulator = Simulator(registry.get_system('aircraft'), [1.0, -1.0, 0.1, 0.0, 0.0, 0.0])
    wanted = [simulator.x]
    for _ in range(count - 1):
        simulator.command(hover(simulator.x))
        simulator.advance(5)
        wanted.append(simulator.x)
    assert_array_equal([state.x for state in received_states], wanted)
    assert_array_equal(stamps(received_states), 5_000_000 * np.arange(count))


def test_two_runs_in_lockstep_are_bitwise_equal(spawn, probe):
    parameters = {
        'x0': [1.0, -1.0, 0.1, 0.0, 0.0, 0.0], 'seed': 7,
        'input_delay': 0.0071, 'actuator_lag': 0.02,
        **{f'noise.{name}': 0.01 for name in registry.get_system('aircraft').state_names},
        'disturbance.gust.vx': 1.0, 'disturbance.gust_start': 0.1, 'disturbance.constant.vy': 0.1}
    first, second = (fly(spawn, probe, parameters, hover, 200) for _ in range(2))
    assert [state.x.tobytes() for state in first] == [state.x.tobytes() for state in second]
    simulator = Simulator(registry.get_system('aircraft'), [1.0, -1.0, 0.1, 0.0, 0.0, 0.0],
                          Conditions(
        noise=(0.01,), actuator_lag=(0.02,), input_delay=0.0071, seed=7,
        disturbance=(0, 0, 0, 0, 0.1, 0), gust=Gust((0, 0, 0, 1.0, 0, 0), 0.1, 1.0)))
    for state in first:
        x = simulator.measure()
        assert_array_equal(state.x, x)
        simulator.command(hover(x))
        simulator.advance(5)


def test_lockstep_waits_for_a_later_controller(spawn, probe):
    spawn('plant_simulator', LOCKSTEP)
    received = probe.listen(State, 'state')
    probe.wait_for(lambda: len(received) > 2, what='the repeated unanswered state')
    assert set(stamps(received)) == {0}
    loop = Loop(probe, hover)
    probe.wait_for(lambda: len(loop.states) > 50)


@pytest.mark.parametrize('speed', [1.0, 0.0])
def test_a_killed_and_restarted_plant_rejoins_the_loop(spawn, probe, speed):
    loop = Loop(probe, hover)
    parameters = {'lockstep': speed == 0.0, 'speed': speed, **SLOW}
    plant = spawn('plant_simulator', parameters)
    probe.wait_for(lambda: len(loop.states) > 20)
    plant.kill()
    before = len(loop.states)
    spawn('plant_simulator', parameters)
    probe.wait_for(lambda: len(loop.states) > before + 20, what='states of the new plant')
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    probe.wait_for(lambda: diagnostics and int(values(diagnostics)['commands taken']) > 20)


def test_a_stopped_plant_resumes_from_its_state(spawn, probe):
    plant = spawn('plant_simulator', {
        'system': 'double_integrator', 'x0': [0, 1], **FREE, **SLOW})
    states = probe.listen(State, 'state')
    probe.wait_for(lambda: len(states) > 10)
    plant.popen.send_signal(signal.SIGSTOP)
    probe.spin_for(1.0)
    count, before = len(states), states[-1].x[0]
    plant.popen.send_signal(signal.SIGCONT)
    probe.wait_for(lambda: len(states) > count + 2)
    assert states[count].x[0] - before < 0.5


def test_each_jump_of_the_simulated_time_is_reported_at_once(spawn, probe):
    """A page tells from it when a gust acts: a status a second would miss most of the steps."""
    spawn('plant_simulator', {'system': 'double_integrator', **FREE, **SLOW})
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    probe.wait_for(lambda: diagnostics)
    assert probe.call(SetBool, f'{NODE}/pause', SetBool.Request(data=True)).success
    probe.wait_for(lambda: diagnostics[-1].status[0].message == 'paused')
    diagnostics.clear()
    said = {re.search('[0-9.]+', probe.call(Trigger, f'{NODE}/step').message)[0]
            for _ in range(8)}
    probe.wait_for(lambda: said <= {
        value.value for each in diagnostics for value in each.status[0].values
        if value.key == 'simulated time [s]'}, what='a status for each step')


def test_reset_pause_and_step(spawn, probe):
    spawn('plant_simulator', {'system': 'double_integrator', 'x0': [0, 1], 'publish_clock': True,
                              **FREE, **SLOW})
    states = probe.listen(State, 'state')
    clock = probe.listen(Clock, '/clock', qos_profile_sensor_data)
    probe.wait_for(lambda: len(states) > 10 and clock)
    refused = probe.call(Trigger, f'{NODE}/step')
    assert (refused.success, refused.message) == (False, 'the plant is not paused')
    answer = probe.call(SetBool, f'{NODE}/pause', SetBool.Request(data=True))
    assert answer.success
    paused_at = float(re.fullmatch(r'paused at t = ([0-9.]+) s', answer.message)[1])

    # Wait for the states in transit; one that was due at this moment is not sent any more.
    probe.wait_for(
        lambda: paused_at - 0.02 - 1e-6 < read_nanoseconds(states[-1].header.stamp) * 1e-9,
        what='the last state before the plant was paused')
    count, last = len(states), states[-1]
    assert read_nanoseconds(last.header.stamp) * 1e-9 < paused_at + 1e-3
    probe.spin_for(0.2)
    assert len(states) == count
    for k in range(1, 4):
        assert probe.call(Trigger, f'{NODE}/step').success
        probe.wait_for(lambda: len(states) == count + k)  # noqa: B023 - called at once
        passed = read_nanoseconds(states[-1].header.stamp) - read_nanoseconds(last.header.stamp)
        assert passed == k * 20e6
        assert states[-1].x[0] == pytest.approx(last.x[0] + 0.02 * k)
    assert probe.call(Trigger, f'{NODE}/reset').message == 'at (0, 1)'
    probe.wait_for(lambda: read_nanoseconds(states[-1].header.stamp) == 0)
    assert list(states[-1].x) == [0, 1]
    assert probe.set_parameters(NODE, x0=[5, 0])[0].successful
    assert probe.call(Trigger, f'{NODE}/reset').message == 'at (5, 0)'
    probe.wait_for(lambda: list(states[-1].x) == [5, 0])
    assert probe.call(SetBool, f'{NODE}/pause', SetBool.Request(data=False)).success
    probe.wait_for(lambda: read_nanoseconds(states[-1].header.stamp) > 0)
    probe.wait_for(lambda: read_nanoseconds(clock[-1].clock) > 0)


def test_invalid_commands_are_dropped_and_counted(spawn, probe):
    plant = spawn('plant_simulator', {'system': 'double_integrator', 'publish_clock': True,
                                      **SLOW})
    states = probe.listen(State, 'state')
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    publisher = probe.publisher(Command, 'command')
    probe.wait_for(lambda: len(states) > 5)
    now = states[-1].header.stamp
    for u in ([math.nan], [math.inf], [], [1.0, 2.0]):
        publisher.publish(command(u, now))
    publisher.publish(command([0.0], now))
    publisher.publish(command([1.0], states[0].header.stamp))
    future = states[-1].header.stamp.__class__(sec=10**6)
    publisher.publish(command([1.0], future))
    probe.wait_for(lambda: diagnostics and values(diagnostics)['commands dropped'] == '6')
    counts = values(diagnostics)
    assert counts['commands dropped, malformed'] == '4'
    assert counts['commands dropped, stale: older than the previous command'] == '1'
    assert counts['commands dropped, stale: stamped later than the last state'] == '1'
    assert counts['commands taken'] == '1'
    assert list(states[-1].x) == [0, 0]
    assert plant.output().count('command dropped, malformed: u: u = nan') == 1


def test_command_timeout_restores_the_equilibrium_input(spawn, probe):
    spawn('plant_simulator', {'system': 'double_integrator', 'command_timeout': 0.2, **SLOW})
    states = probe.listen(State, 'state')
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    publisher = probe.publisher(Command, 'command')
    publisher.publish(command([2.0]))
    probe.wait_for(lambda: diagnostics and values(diagnostics)['times without commands'] == '1')
    count = len(states)
    probe.wait_for(lambda: len(states) > count + 5)
    assert states[-1].x[1] == states[-2].x[1] > 0, 'constant speed at zero input'


def test_a_plant_pauses_at_a_time_given_while_it_runs(spawn, probe):
    spawn('plant_simulator', {'system': 'double_integrator', 'publish_clock': True, **SLOW})
    states = probe.listen(State, 'state')
    probe.wait_for(lambda: states and states[-1].header.stamp.nanosec > 200_000_000)
    refused = probe.set_parameters_atomically(NODE, pause_at=0.1)
    assert not refused.successful and re.match(
        r'pause_at = 0.1 s: the simulated time is already [0-9.]+ s', refused.reason)
    moment = math.ceil(stamps(states)[-1] * 1e-9) + 2.0
    assert probe.set_parameters_atomically(NODE, pause_at=moment).successful
    probe.wait_for(lambda: stamps(states)[-1] >= moment * 1e9)
    answer = probe.call(SetBool, f'{NODE}/pause', SetBool.Request(data=True))
    assert answer.message == f'paused at t = {moment:.9g} s'


BAD = {
    "unknown system 'aircarft' (did you mean 'aircraft'?)": {'system': 'aircarft'},
    'system_parameters.m = -1': {'system_parameters.m': -1.0},
    'x0: wanted 6 numbers (px, py, theta, vx, vy, omega), found 2': {'x0': [1, 2]},
    'dt = 0': {'dt': 0.0},
    'requires 1000000000 steps': {'dt': 1e-6, 'publish_rate': 0.001},
    "integrator = 'euler'": {'integrator': 'euler'},
    'actuator_lag: wanted 2 numbers (f1, f2), found 3': {'actuator_lag': [0.1, 0.1, 0.1]},
    'noise.px = -1': {'noise.px': -1.0},
    'input_delay = nan': {'input_delay': math.nan},
    'speed: wanted a number': {'speed': 'fast'},
    'linear.A: wanted': {'system': 'linear'},
    'nowhere.yaml: cannot be read': {'system': 'nowhere.yaml'},
}


def test_bad_parameters_refuse_the_start(probe):
    for words, parameters in BAD.items():
        assert words in probe.refusal(PlantSimulator, parameters)


def test_bad_parameters_end_the_node_with_one_sentence(spawn):
    process = spawn('plant_simulator', {'system': 'aircarft'})
    assert process.wait() == 1
    assert "unknown system 'aircarft' (did you mean 'aircraft'?)" in process.output()
    assert 'Traceback' not in process.output()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signals_end_the_node_with_status_0(spawn, probe, number):
    plant = spawn('plant_simulator', {'speed': 0.0 if number == signal.SIGTERM else 1.0})
    probe.wait_for_node('plant_simulator')
    plant.popen.send_signal(number)
    assert plant.wait() == 0
    assert 'Traceback' not in plant.output()


def test_parameter_changes_take_effect_or_are_refused(spawn, probe):
    spawn('plant_simulator', {'system': 'double_integrator', **FREE, **SLOW})
    states = probe.listen(State, 'state')
    probe.wait_for(lambda: states)
    setting = {'disturbance.constant.x2': 1.0, 'noise.x1': 0.5, 'actuator_lag': 0.1,
               'input_delay': 0.01, 'integrator': 'adaptive'}
    assert all(each.successful for each in probe.set_parameters(NODE, **setting))
    count = len(states)
    probe.wait_for(lambda: len(states) > count + 20)
    assert states[-1].x[1] > states[count].x[1], 'the constant disturbance accelerates'
    assert len({state.x[0] for state in states[count + 5:]}) > 10
    for name, value, words in (
            ('noise.x1', -1.0, 'noise.x1'), ('speed', 2.0, 'start with publish_clock'),
            ('speed', 0.0, 'start with publish_clock'), ('dt', 0.1, 'read-only'),
            ('x0', [1.0], 'x0: wanted 2 numbers'), ('tolerance', 1e-20, 'tolerance'),
            ('noise.x3', 1.0, "no parameter 'noise.x3'")):
        result = probe.set_parameters(NODE, **{name: value})[0]
        assert not result.successful
        assert words in result.reason, (name, result.reason)
    count = len(states)
    probe.wait_for(lambda: len(states) > count + 5)


def test_parameters_of_the_system_can_change_in_flight(spawn, probe):
    spawn('plant_simulator', {**FREE, **SLOW})
    states = probe.listen(State, 'state')
    probe.wait_for(lambda: states)
    assert probe.set_parameters(NODE, **{'system_parameters.m': 8.0})[0].successful
    probe.wait_for(lambda: states[-1].x[4] < -0.1, what='the heavier aircraft falls')
    result = probe.set_parameters(NODE, **{'system_parameters.m': -8.0})[0]
    assert 'system_parameters.m = -8' in result.reason


def test_odometry_agrees_with_the_state_of_the_vehicle(spawn, probe):
    spawn('plant_simulator', {'system': 'vehicle', **SLOW})
    odometry = probe.listen(Odometry, 'odom')
    states = probe.listen(State, 'state')
    publisher = probe.publisher(Command, 'command')
    publisher.publish(command([5.0, 0.3]))
    probe.wait_for(lambda: odometry and odometry[-1].pose.pose.orientation.z > 0.1)
    by_stamp = {read_nanoseconds(state.header.stamp): state.x for state in states}
    last = probe.wait_for(lambda: next((each for each in reversed(odometry) if read_nanoseconds(
        each.header.stamp) in by_stamp), None))
    x = by_stamp[read_nanoseconds(last.header.stamp)]
    pose, twist = last.pose.pose, last.twist.twist
    assert (pose.position.x, pose.position.y) == (x[0], x[1])
    assert 2 * math.atan2(pose.orientation.z, pose.orientation.w) == pytest.approx(x[2])
    assert twist.linear.x == pytest.approx(5.0)
    assert twist.linear.y == pytest.approx(0.0, abs=1e-12)
    assert twist.angular.z == pytest.approx(5.0 / 2.0 * math.tan(0.3))


def test_speed_0_runs_faster_than_real_time_with_a_clock(spawn, probe):
    spawn('plant_simulator', {'speed': 0.0})
    clock = probe.listen(Clock, '/clock', qos_profile_sensor_data)
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    probe.wait_for(lambda: clock and read_nanoseconds(clock[-1].clock) > 5e9)
    probe.wait_for(lambda: diagnostics and float(
        values(diagnostics)['simulated seconds a second']) > 1.5)


def test_with_use_sim_time_the_plant_follows_the_clock(spawn, probe):
    clock = probe.node.create_publisher(Clock, '/clock', 1)
    spawn('plant_simulator', {'use_sim_time': True, **SLOW})
    states = probe.listen(State, 'state')
    probe.wait_for(lambda: clock.get_subscription_count())
    message = Clock()

    def tick():
        message.clock.sec, message.clock.nanosec = divmod(
            read_nanoseconds(message.clock) + 10_000_000, 10**9)
        clock.publish(message)
        return len(states) > 30

    probe.wait_for(tick)
    delays = read_nanoseconds(message.clock) - stamps(states)
    assert (delays >= 0).all()
    # A plant that is held up after its first state begins a new grid.
    assert_allclose(np.diff(stamps(states))[1:] % 20_000_000, 0)


def test_two_controllers_are_reported(spawn, probe):
    plant = spawn('plant_simulator', SLOW)
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    states = probe.listen(State, 'state')
    one = Loop(probe, hover)
    probe.publisher(Command, 'command')  # without messages, like that of a killed controller
    probe.wait_for(lambda: len(diagnostics) > 1)
    assert diagnostics[-1].status[0].level == b'\0'
    count = len(states)
    Loop(probe, hover)
    probe.wait_for(lambda: diagnostics[-1].status[0].level == b'\1')
    assert diagnostics[-1].status[0].message == (
        '3 nodes publish commands; the latest one is followed')
    assert plant.output().count('3 nodes publish commands') == 1
    assert len(one.states) > count


def test_an_incompatible_qos_of_commands_is_reported(spawn, probe):
    plant = spawn('plant_simulator', SLOW)
    states = probe.listen(State, 'state')
    probe.wait_for(lambda: len(states) > 5)
    probe.node.create_publisher(Command, 'command', qos_profile_sensor_data)
    probe.wait_for(lambda: 'incompatible QoS' in plant.output(), what='a warning')
    count = len(states)
    probe.wait_for(lambda: len(states) > count + 5)


def test_a_diverging_plant_stops_and_can_be_reset(spawn, probe):
    plant = spawn('plant_simulator', {
        'system': 'cubic', 'system_parameters.a': -1.0, 'x0': [2.0], **SLOW})
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    publisher = probe.publisher(Command, 'command')
    publisher.publish(command([0.0]))
    plant.wait_for_output('exceeds the range of double precision')
    probe.wait_for(lambda: diagnostics and diagnostics[-1].status[0].level == b'\2')
    states = probe.listen(State, 'state')
    assert probe.call(Trigger, f'{NODE}/reset').success
    probe.wait_for(lambda: states and math.isfinite(states[-1].x[0]))


def test_loops_in_namespaces_are_separate(spawn, probe):
    spawn('plant_simulator', SLOW, namespace='/a')
    spawn('plant_simulator', {'system': 'vehicle', **SLOW}, namespace='/b')
    a, b = (probe.listen(State, f'/{name}/state') for name in 'ab')
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    probe.wait_for(lambda: len(a) > 5 and len(b) > 5)
    assert {len(state.x) for state in a} == {6}
    assert {len(state.x) for state in b} == {3}
    names = {'a/plant_simulator: plant', 'b/plant_simulator: plant'}
    probe.wait_for(lambda: {each.status[0].name for each in diagnostics} == names)


def test_the_plant_survives_hostile_commands_and_parameters(spawn, probe):
    generator = random.Random(1)
    spawn('plant_simulator', {'publish_clock': True, **SLOW})
    states = probe.listen(State, 'state')
    publisher = probe.publisher(Command, 'command')
    numbers = (0.0, -0.0, 1.0, 1e308, -1e308, 5e-324, math.nan, math.inf, -math.inf)
    for _ in range(300):
        message = command(generator.choices(numbers, k=generator.choice((0, 1, 2, 2, 2, 3, 1000))))
        message.header.stamp.sec = generator.choice((0, 1, -1, 2**31 - 1, -2**31))
        message.header.stamp.nanosec = generator.choice((0, 10**9 - 1, 2**32 - 1))
        message.header.frame_id = generator.choice(('', 'x' * 10_000, '\u2603'))
        publisher.publish(message)
    texts = ('', '__import__("os")', 'x' * 10_000, '../../etc/passwd', '\u2603\n')
    for name in ('x0', 'speed', 'noise.px', 'disturbance.gust_start', 'system', 'seed', 'dt',
                 'lockstep', 'actuator_lag', 'integrator', 'nothing', 'x' * 1000, ''):
        for value in (*numbers, *texts, True, 2**62, -1, [], [math.nan] * 6, [1.0] * 1000, ['a']):
            parameter = Parameter(name, value=value)
            if name and parameter.type_ is not Parameter.Type.NOT_SET and not (
                    name == 'speed' and value in (0.0, 5e-324)):
                result = probe.set_parameters(NODE, **{name: value})[0]
                assert result.successful or result.reason
    probe.set_parameters(NODE, speed=1.0)
    assert probe.call(Trigger, f'{NODE}/reset').success
    count = len(states)
    probe.wait_for(lambda: len(states) > count + 10)


def may_have_priority():
    """Return whether this process may set a real-time priority."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


def priorities(pid):
    """Return policy and priority of the DDS threads and of the main thread of a process."""
    threads = [int(each.name) for each in Path(f'/proc/{pid}/task').iterdir()
               if each.joinpath('comm').read_text().startswith('dds.')]
    of_dds, main = ({(os.sched_getscheduler(each), os.sched_getparam(each).sched_priority)
                     for each in some} for some in (threads, [pid]))
    return of_dds, main


def test_the_priority_is_set_or_its_refusal_is_explained(spawn, probe):
    plant = spawn('plant_simulator', {'priority': 7, **SLOW})
    probe.wait_for_node('plant_simulator')
    if may_have_priority():
        probe.wait_for(lambda: priorities(plant.pid) == (
            {(os.SCHED_FIFO, 7)}, {(os.SCHED_FIFO, 6)}), what='its priority')
    else:
        plant.wait_for_output('limits.conf')
