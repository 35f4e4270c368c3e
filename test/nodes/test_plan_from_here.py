# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""``~/plan`` without a start: plans from the present state of the plant, over DDS."""

import math
import os
import re
import signal
from typing import Any

from lqr_bench import LATCHED, nanoseconds
from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.msg import State, Trajectory
from obc_ros.srv import PlanMotion
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from support import children, DEMO

pytestmark = pytest.mark.nodes

ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def plan_integrator(probe: Any, final_time: float = 3.0, **fields: Any) -> Any:
    """Request a plan for the double integrator; return the response."""
    return probe.call(PlanMotion, '/trajectory_server/plan', PlanMotion.Request(
        system='double_integrator', objective='effort', final_time=final_time, goal=[2.0, 0.0],
        **fields))


def plan_aircraft(probe: Any, final_time: float = 3.0, **fields: Any) -> Any:
    """Request a plan for the aircraft to the origin; return the response."""
    return probe.call(PlanMotion, '/trajectory_server/plan', PlanMotion.Request(
        system='aircraft', objective='effort', final_time=final_time, goal=[0.0] * 6, **fields))


def odometry(px: float, py: float, theta: float, vx: float, vy: float, omega: float,
             child: str = 'base_link') -> Odometry:
    """Return odometry in the vertical plane: px forward, py up, theta positive for nose up."""
    message, c, s = Odometry(child_frame_id=child), math.cos(theta), math.sin(theta)
    message.header.frame_id, message.header.stamp.sec = 'odom', 7
    message.pose.pose.position.x, message.pose.pose.position.z = px, py
    message.pose.pose.orientation.w = math.cos(theta / 2)
    message.pose.pose.orientation.y = -math.sin(theta / 2)   # nose up: negative about y
    message.twist.twist.linear.x = c * vx + s * vy
    message.twist.twist.linear.z = c * vy - s * vx
    message.twist.twist.angular.y = -omega
    return message


def repeat(probe: Any, publisher: Any, message: Any) -> None:
    """Publish a message ten times, since DDS may lose the first one before it is connected."""
    for _ in range(10):
        publisher.publish(message)
        probe.spin_for(0.05)


def test_a_plan_without_a_recent_state_is_refused(spawn: Any, probe: Any) -> None:
    """No state has arrived, or the last one is too old; the log has the refusals too."""
    spawn('trajectory_server', {'workers': 1, 'state_timeout': 0.3})
    log = probe.listen(Log, '/rosout', ROSOUT)
    answer = plan_integrator(probe)
    assert not answer.success
    assert answer.status == 'malformed'
    assert answer.message == (
        'start is empty (the present state), and no state has arrived on /state')
    publisher = probe.publisher(State, 'state')
    repeat(probe, publisher, State(x=[5.0, 0.0]))
    probe.spin_for(1.0)
    answer = plan_integrator(probe)
    assert not answer.success
    assert 'the last state on /state arrived 1.' in answer.message
    assert answer.message.endswith(' s ago; wanted at most 0.3 s (state_timeout)')
    assert plan_integrator(probe, start=[0.0, 0.0]).success   # a start needs no state
    repeat(probe, publisher, State(names=['p', 'v'], x=[1.0, 2.0]))
    assert plan_integrator(probe).message == (
        'start is empty (the present state), and the state on /state is of another system: its '
        'components are (p, v); wanted (x1, x2) of double_integrator')
    repeat(probe, publisher, State(x=[1.0, 2.0, 3.0]))
    answer = plan_integrator(probe)
    assert not answer.success
    assert 'start' in answer.message
    assert '2' in answer.message
    lines = probe.wait_for(lambda: [
        each for each in log if 'a request to ~/plan was rejected' in each.msg][2:],
        what='three refusals in the log')
    assert lines[0].level == Log.WARN
    assert lines[0].name == 'trajectory_server'


@pytest.mark.alone
def test_one_call_plans_and_executes_from_the_present_state(spawn: Any, probe: Any) -> None:
    """The plant moves from 3 to 2 along the plan; the request does not contain its state."""
    spawn('plant_simulator', {'system': 'double_integrator', 'x0': [3.0, 0.0]})
    spawn('lqr_node', {**DEMO, 'system': 'double_integrator', 'setpoint': [3.0, 0.0]})
    spawn('trajectory_server', {'workers': 1})
    log = probe.listen(Log, '/rosout', ROSOUT)
    plans = probe.listen(Trajectory, 'reference', LATCHED)
    states = probe.listen(State, 'state', 100)
    probe.wait_for(lambda: states, what='states')
    probe.wait_for_node('lqr_node')
    answer = plan_integrator(probe, 10.0, execute=True)   # slow, for a busy machine
    assert answer.success, answer.message
    path = np.reshape(answer.trajectory.x, (-1, 2))
    assert path[0] == pytest.approx([3.0, 0.0], abs=1e-6)
    assert path[-1] == pytest.approx([2.0, 0.0], abs=1e-6)
    probe.wait_for(lambda: plans, what='the reference')
    begin = nanoseconds(plans[0])
    for words in ('a plan of 10 s for double_integrator is published on /reference',
                  'the reference of 10 s begins', 'the reference of 10 s has ended'):
        probe.wait_for(lambda words=words: [each for each in log if words in each.msg],
                       what=words)
    probe.wait_for(lambda: nanoseconds(states[-1]) >= begin + 10 * 10**9,
                   what='the state at the end')
    t = np.array([nanoseconds(each) - begin for each in states]) * 1e-9
    x = np.array([each.x for each in states])
    assert t[0] < 0.0
    during = (t >= 0.0) & (t <= 10.0)
    expected = np.interp(t[during], answer.trajectory.t, path[:, 0])
    assert np.abs(x[during, 0] - expected).max() < 0.05
    assert not [each.msg for each in log if 'rejected' in each.msg]


def test_a_plan_is_stamped_by_the_clock_of_the_states(spawn: Any, probe: Any) -> None:
    """The stamps of a simulation differ from the clock of the server; `plan_lead` counts in it."""
    spawn('trajectory_server', {'workers': 1, 'state_timeout': 30.0, 'plan_lead': 1.25})
    publisher = probe.publisher(State, 'state')
    received = probe.listen(Trajectory, 'reference', LATCHED)
    message = State(x=[5.0, 0.0])
    message.header.stamp.sec, message.header.stamp.nanosec = 41, 750_000_000
    repeat(probe, publisher, message)
    assert plan_integrator(probe, execute=True).success
    probe.wait_for(lambda: received, what='the reference')
    assert (received[0].header.stamp.sec, received[0].header.stamp.nanosec) == (43, 0)


def test_a_plan_starts_at_the_state_of_odometry(spawn: Any, probe: Any) -> None:
    """Pose and twist give the state as in lqr_node; insufficient odometry is refused."""
    spawn('trajectory_server', {'workers': 1, 'state_source': 'odom', 'state_timeout': 30.0})
    log = probe.listen(Log, '/rosout', ROSOUT)
    received = probe.listen(Trajectory, 'reference', LATCHED)
    answer = plan_aircraft(probe)
    assert (answer.success, answer.status) == (False, 'malformed')
    assert answer.message.endswith('no state has arrived on /odom')
    publisher, x = probe.publisher(Odometry, 'odom'), [1.5, 2.0, 0.3, 0.4, -0.2, 0.1]
    repeat(probe, publisher, odometry(*x))
    repeat(probe, publisher, odometry(*[9.0] * 6, child='another_robot'))
    answer = plan_aircraft(probe, execute=True)
    assert answer.success, answer.message
    assert np.reshape(answer.trajectory.x, (-1, 6))[0] == pytest.approx(x, abs=1e-6)
    stamp = probe.wait_for(lambda: received, what='the reference')[0].header.stamp
    assert (stamp.sec, stamp.nanosec) == (7, 500_000_000)   # clock of the odometry
    probe.wait_for(lambda: [each for each in log if "a state was dropped: odometry of "
                            "'another_robot', after that of 'base_link'" in each.msg],
                   what='the dropped state')
    repeat(probe, publisher, odometry(*x))
    answer = plan_integrator(probe)
    assert not answer.success
    assert answer.message.startswith('state_source = odom: a pose and a twist do not determine '
                                     'the state of double_integrator (x1, x2)')
    repeat(probe, publisher, odometry(math.nan, *x[1:]))
    assert 'not finite' in plan_aircraft(probe).message
    answer = probe.call(PlanMotion, '/trajectory_server/plan', PlanMotion.Request(system='boat'))
    assert not answer.success
    assert "unknown system 'boat'" in answer.message


def test_a_plan_from_old_odometry_is_refused(spawn: Any, probe: Any) -> None:
    """The reason has the age; the server does not subscribe to /state."""
    spawn('trajectory_server', {'workers': 1, 'state_source': 'odom', 'state_timeout': 0.3})
    publisher = probe.publisher(Odometry, 'odom')
    repeat(probe, publisher, odometry(*[0.5] * 6))
    probe.spin_for(1.0)
    answer = plan_aircraft(probe)
    assert (answer.success, answer.status) == (False, 'malformed')
    found = re.fullmatch(r'.*the last state on /odom arrived (\S+) s ago; '
                         r'wanted at most 0\.3 s \(state_timeout\)', answer.message)
    assert found, answer.message
    assert float(found[1]) >= 1.0, answer.message
    assert not probe.node.count_subscribers('/state')


def test_a_loop_over_odometry_executes_a_plan_from_its_state(spawn: Any, probe: Any) -> None:
    """Controller and server read odometry; the plan starts at the plant."""
    x0 = [0.4, 0.5, 0.0, 0.0, 0.0, 0.0]
    spawn('plant_simulator', {'x0': x0})
    spawn('lqr_node', {'state_source': 'odom', 'setpoint': x0,
                       'start_tolerance': [math.inf] * 6})   # for a busy machine
    spawn('trajectory_server', {'workers': 1, 'state_source': 'odom'})
    log = probe.listen(Log, '/rosout', ROSOUT)
    states = probe.listen(State, 'state', 100)
    probe.wait_for(lambda: states, what='states')
    probe.wait_for_node('lqr_node')
    answer = plan_aircraft(probe, 6.0, execute=True)
    assert answer.success, answer.message
    assert np.reshape(answer.trajectory.x, (-1, 6))[0] == pytest.approx(x0, abs=0.01)
    probe.wait_for(lambda: [each for each in log if 'the reference of 6 s has ended' in each.msg],
                   what='the end of the reference')
    probe.wait_for(lambda: np.abs(states[-1].x).max() < 0.05, what='the goal')
    assert not [each.msg for each in log if 'rejected' in each.msg]


@pytest.mark.parametrize('start', [[], [5.0, 0.0]])
def test_a_plan_is_not_executed_after_the_states_ended(
        start: list[float], spawn: Any, probe: Any) -> None:
    """The worker is stopped until the state is too old; the plan is returned, not executed."""
    process = spawn('trajectory_server', {'workers': 1, 'state_timeout': 2.0})
    log = probe.listen(Log, '/rosout', ROSOUT)
    received = probe.listen(Trajectory, 'reference', LATCHED)
    assert plan_integrator(probe, start=[5.0, 0.0]).success
    publisher, workers = probe.publisher(State, 'state'), children(process.pid)
    client = probe.node.create_client(PlanMotion, '/trajectory_server/plan')
    probe.wait_for(client.service_is_ready, what='the service')
    repeat(probe, publisher, State(x=[5.0, 0.0]))
    for pid in workers:
        os.kill(pid, signal.SIGSTOP)
    future = client.call_async(PlanMotion.Request(
        system='double_integrator', objective='effort', final_time=3.0, goal=[2.0, 0.0],
        start=start, execute=True))
    probe.spin_for(2.5)
    assert not future.done()
    for pid in workers:
        os.kill(pid, signal.SIGCONT)
    answer = probe.wait_for(lambda: future.done() and future.result(), what='the answer')
    assert (answer.success, answer.status) == (False, 'cancelled')
    found = re.fullmatch(r'the plan is solved, but not executed: the last state on /state arrived '
                         r'(\S+) s ago; wanted at most 2 s \(state_timeout\)', answer.message)
    assert found, answer.message
    assert float(found[1]) > 2.0
    assert np.reshape(answer.trajectory.x, (-1, 2))[-1] == pytest.approx([2.0, 0.0], abs=1e-6)
    probe.wait_for(lambda: [each for each in log if 'but not executed' in each.msg],
                   what='the refusal in the log')
    assert not received
