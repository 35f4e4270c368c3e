# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""``~/plan`` for a plant that moves, over DDS: a stand-in of lqr_node, then the node itself."""

from collections.abc import Callable
import os
import signal
from typing import Any

from lqr_bench import LATCHED, nanoseconds
import numpy as np
from obc_ros.msg import State, Trajectory
from obc_ros.ros.messages import read_nanoseconds, set_stamp
from obc_ros.srv import FollowReference, PlanMotion, PredictState
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger
from support import children

pytestmark = pytest.mark.nodes

ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ORIGIN = 5_000 * 10**9   # [ns] stamp of x1 = 0
SPEED = 0.7


class StandIn:
    """A plant with x1 = SPEED t, and the services of the lqr_node that moves it."""

    def __init__(self, probe: Any, is_at_rest: bool = False, verdict: str = '') -> None:
        self.probe, self.verdict, self.is_at_rest = probe, verdict, is_at_rest
        self.names = ['x1', 'x2']
        self.absence = ''
        self.predicted: list[int] = []
        self.offered: list[Trajectory] = []
        self.on_predict: Callable[[], None] = lambda: None
        self.stamp = ORIGIN
        node = probe.node
        self.states = probe.publisher(State, 'state')
        node.create_timer(0.02, self._send)
        node.create_service(PredictState, 'lqr_node/predict_state', self._predict)
        node.create_service(FollowReference, 'lqr_node/follow_reference', self._follow)
        probe.wait_for(lambda: self.stamp > ORIGIN + 10**9, what='states')

    def at(self, stamp: int) -> list[float]:
        """Return the state at a stamp [ns]."""
        speed = 0.0 if self.is_at_rest else SPEED
        return [speed * (stamp - ORIGIN) * 1e-9, speed]

    def _send(self) -> None:
        self.stamp += 20_000_000
        message = State(x=self.at(self.stamp), names=['x1', 'x2'])
        set_stamp(message.header.stamp, self.stamp)
        self.states.publish(message)

    def _predict(self, request: Any, response: Any) -> Any:
        if self.absence:
            response.message = self.absence
            return response
        stamp = read_nanoseconds(request.stamp)
        self.predicted.append(stamp)
        self.on_predict()
        response.success, response.names, response.x = True, self.names, self.at(stamp)
        response.header.stamp, response.header.frame_id = request.stamp, 'odom'
        response.at_rest = self.is_at_rest
        return response

    def _follow(self, request: Any, response: Any) -> Any:
        self.offered.append(request.reference)
        response.success = not self.verdict
        response.message = self.verdict or 'a reference of 3 s, then its end is held'
        return response


class Held:
    """The worker of a server, stopped at each prediction until the plan would begin."""

    def __init__(self, stand_in: StandIn, pid: int, times: int) -> None:
        self.stand_in, self.left = stand_in, times
        self.pids = children(pid)
        stand_in.on_predict = self._stop
        stand_in.probe.node.create_timer(0.02, self._go_on)

    def _stop(self) -> None:
        if self.left:
            self.left -= 1
            self._kill(signal.SIGSTOP)

    def _go_on(self) -> None:
        if self.stand_in.predicted and self.stand_in.stamp > self.stand_in.predicted[-1] + 10**8:
            self._kill(signal.SIGCONT)

    def _kill(self, number: int) -> None:
        for pid in self.pids:
            os.kill(pid, number)


def plan(probe: Any, final_time: float = 3.0, **fields: Any) -> Any:
    """Request a plan for the double integrator; return the response."""
    request = {'system': 'double_integrator', 'objective': 'effort', 'final_time': final_time,
               'goal': [9.0, 0.0], **fields}
    return probe.call(PlanMotion, '/trajectory_server/plan', PlanMotion.Request(**request))


def first(answer: Any) -> list[float]:
    """Return the first state of a plan."""
    return list(answer.trajectory.x[:len(answer.trajectory.state_names)])


def test_the_first_plan_in_motion_begins_at_the_predicted_state(spawn: Any, probe: Any) -> None:
    """It begins at its stamp, which is to come, and has the words of lqr_node."""
    spawn('trajectory_server', {'workers': 1, 'plan_lead': 5.0})
    stand_in = StandIn(probe)
    seen = probe.listen(Trajectory, 'reference', LATCHED)
    answer = plan(probe, execute=True)
    assert answer.success, answer.message
    assert answer.message.endswith('; lqr_node: a reference of 3 s, then its end is held')
    begin = nanoseconds(answer.trajectory)
    assert [begin] == stand_in.predicted
    assert first(answer) == pytest.approx(stand_in.at(begin), abs=1e-9)
    assert begin >= stand_in.stamp
    assert stand_in.offered == [answer.trajectory]
    assert answer.trajectory.header.frame_id == 'odom'
    probe.wait_for(lambda: seen, what='the reference')
    assert seen[0].t == answer.trajectory.t
    shown = plan(probe)   # not executed: with its stamp, nobody is asked to follow it
    assert nanoseconds(shown.trajectory) == stand_in.predicted[-1]
    assert len(stand_in.offered) == 1


def test_what_lqr_node_rejects_is_no_success(spawn: Any, probe: Any) -> None:
    """The client gets the reason; nothing is published."""
    spawn('trajectory_server', {'workers': 1, 'plan_lead': 5.0})
    stand_in = StandIn(probe, verdict="x1 is 0.31443 m from the plan's start 1 m")
    seen = probe.listen(Trajectory, 'reference', LATCHED)
    for start in ([], [1.0, 0.0]):
        answer = plan(probe, execute=True, start=start)
        assert (answer.success, answer.status) == (False, 'cancelled')
        assert answer.message == ('the plan is solved, but not executed: lqr_node rejected it: '
                                  + stand_in.verdict)
        assert answer.trajectory.t
    assert len(stand_in.offered) == 2
    probe.spin_for(0.3)
    assert not seen


@pytest.mark.parametrize('is_at_rest', [True, False])
def test_a_late_plan_is_shifted_at_rest_and_asked_for_again_in_motion(
        is_at_rest: bool, spawn: Any, probe: Any) -> None:
    """The worker is stopped until the plan would have begun."""
    server = spawn('trajectory_server', {'workers': 1, 'plan_lead': 1.0})
    assert plan(probe, start=[0.0, 0.0]).success
    stand_in = StandIn(probe, is_at_rest)
    Held(stand_in, server.pid, times=1)
    answer = plan(probe, execute=True)
    assert answer.success, answer.message
    begin = nanoseconds(answer.trajectory)
    assert first(answer) == pytest.approx(stand_in.at(begin), abs=1e-9)
    assert begin > stand_in.predicted[0]
    if is_at_rest:
        assert len(stand_in.predicted) == 1
        assert nanoseconds(plan(probe).trajectory) == 0   # it may begin at any time
    else:
        asked, again = stand_in.predicted
        assert begin == again
        assert again - asked > 2 * 10**9   # the lead of 1 s, and the time that the plan took


def test_a_plan_without_certificate_is_executed_only_if_that_is_allowed(
        spawn: Any, probe: Any) -> None:
    """The mesh is too coarse for a certificate: the deadline makes the best path the answer."""
    spawn('trajectory_server', {'workers': 1, 'max_intervals': 10})
    stand_in = StandIn(probe, is_at_rest=True)
    wanted = {'path_constraints': ['x2 - 3.9'], 'deadline': 15.0}   # without it x2 is up to 4.5
    answer = plan(probe, **wanted)
    assert (answer.success, answer.status) == (True, 'feasible'), answer.message
    assert 'no certificate of optimality' in answer.message
    assert not answer.certificate.holds and answer.certificate.excess > 0.0
    assert 0.0 < answer.first_path_time < 15.0
    assert max(answer.trajectory.x[1::2]) <= 3.9 * (1 + 1e-6)
    answer = plan(probe, execute=True, **wanted)
    assert (answer.success, answer.status) == (False, 'cancelled')
    assert answer.message == (
        'the plan meets all constraints, but not executed: it has no certificate of optimality '
        '(execute_feasible = false)')
    assert not stand_in.offered
    assert probe.set_parameters('/trajectory_server', execute_feasible=True)[0].successful
    answer = plan(probe, execute=True, **wanted)
    assert (answer.success, answer.status) == (True, 'feasible'), answer.message
    assert len(stand_in.offered) == 1
    answer = plan(probe, **{**wanted, 'deadline': -1.0})
    assert (answer.success, answer.status) == (False, 'malformed')
    assert answer.message.startswith('deadline = -1: wanted seconds')


def test_a_plan_that_is_late_twice_says_so(spawn: Any, probe: Any) -> None:
    """A plant that moves is not given a plan from where it was."""
    server = spawn('trajectory_server', {'workers': 1, 'plan_lead': 0.5})
    assert plan(probe, start=[0.0, 0.0]).success
    stand_in = StandIn(probe)
    Held(stand_in, server.pid, times=2)
    answer = plan(probe, execute=True)
    assert (answer.success, answer.status) == (False, 'timed_out')
    assert 'but too late: the plant moves, and it came ' in answer.message
    assert answer.message.endswith(' s after its beginning (plan_lead = 0.5 s)')
    assert len(stand_in.predicted) == 2
    assert not stand_in.offered


def test_a_prediction_of_another_plant_or_none_is_said_in_words(spawn: Any, probe: Any) -> None:
    """Names are compared; without a prediction the plan begins at the last state."""
    spawn('trajectory_server', {'workers': 1, 'plan_lead': 5.0})
    stand_in = StandIn(probe)
    stand_in.names = ['px', 'vx']
    answer = plan(probe)
    assert (answer.success, answer.status) == (False, 'malformed')
    assert answer.message == 'start: the state of the plant has px, vx; wanted x1, x2'
    stand_in.absence = 'the node is inactive'
    stand_in.is_at_rest, now = True, stand_in.stamp
    probe.wait_for(lambda: stand_in.stamp > now + 10**9, what='states at rest')
    answer = plan(probe)
    assert answer.success, answer.message
    assert answer.message.endswith('; lqr_node predicts no state (the node is inactive): the plan '
                                   'begins at the last state')
    assert first(answer) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_without_lqr_node_nobody_has_accepted_a_plan(spawn: Any, probe: Any) -> None:
    """It is published from the last state as before, and the message says so."""
    spawn('trajectory_server', {'workers': 1, 'state_timeout': 30.0, 'plan_lead': 2.0})
    publisher = probe.publisher(State, 'state')
    message = State(x=[5.0, 0.0])
    message.header.stamp.sec = 40
    for _ in range(10):
        publisher.publish(message)
        probe.spin_for(0.05)
    answer = plan(probe, execute=True)
    assert answer.success, answer.message
    assert 'nobody offers /lqr_node/predict_state: the plan begins at the last state' in (
        answer.message)
    assert answer.message.endswith('nobody offers /lqr_node/follow_reference: the plan is '
                                   'published on /reference, and nobody has accepted it')
    assert nanoseconds(answer.trajectory) == 42 * 10**9


@pytest.mark.alone
def test_a_robot_in_motion_is_planned_for_again_at_the_first_call(spawn: Any, probe: Any) -> None:
    """The second plan begins on the path of the first one, at its speed, and ends at its goal."""
    spawn('plant_simulator', {'system': 'double_integrator', 'x0': [0.0, 0.0]})
    spawn('lqr_node', {'system': 'double_integrator', 'u_limits': [-4.0, 4.0],
                       'state_timeout': 5.0, 'stamp_timeout': 0.0})
    spawn('trajectory_server', {'workers': 1, 'state_timeout': 5.0, 'plan_lead': 4.0})
    log = probe.listen(Log, '/rosout', ROSOUT)
    states = probe.listen(State, 'state', 100)
    probe.wait_for(lambda: states, what='states')
    probe.wait_for_node('lqr_node')
    for name in ('predict_state', 'follow_reference'):
        client = probe.node.create_client(
            PredictState if name == 'predict_state' else FollowReference, f'/lqr_node/{name}')
        probe.wait_for(client.service_is_ready, what=name)
    before = plan(probe, 20.0, goal=[20.0, 0.0], execute=True)
    assert before.success, before.message
    assert 'then its end is held' in before.message
    probe.wait_for(lambda: states[-1].x[1] > 0.5, what='a plant that moves')
    after = plan(probe, 3.0, goal=[5.0, 0.0], execute=True)
    assert after.success, after.message
    begin = nanoseconds(after.trajectory)
    t = (begin - nanoseconds(before.trajectory)) * 1e-9
    path = np.reshape(before.trajectory.x, (-1, 2))
    expected = [np.interp(t, before.trajectory.t, path[:, i]) for i in range(2)]
    assert first(after) == pytest.approx(expected, abs=0.1)
    assert expected[1] > 0.5
    probe.wait_for(lambda: nanoseconds(states[-1]) > begin + 4 * 10**9, what='the end')
    at = min(states, key=lambda each: abs(nanoseconds(each) - begin))
    assert np.array(at.x) == pytest.approx(first(after), abs=0.1)
    assert np.array(states[-1].x) == pytest.approx([5.0, 0.0], abs=0.1)
    assert not [each.msg for each in log if 'rejected' in each.msg]
    stopped = probe.call(Trigger, '/lqr_node/stop', Trigger.Request())
    assert stopped.success
    refused = plan(probe, execute=True)
    assert (refused.success, refused.status) == (False, 'cancelled')
    assert refused.message.endswith('the loop is stopped: by ~/stop')
