# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""lqr_node in its own process: safety, dry runs, references, lifecycle and messages."""

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped, WrenchStamped
from lifecycle_msgs.srv import ChangeState, GetState
from lqr_bench import Bench, BEST_EFFORT, HOVER, LATCHED, matrix, nanoseconds, reference
from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.core.systems import registry
from obc_ros.msg import Command, LqrWeights, State, Trajectory
from obc_ros.nodes.lqr_node import LqrNode
from obc_ros.ros.conversions import make_body_reader
from obc_ros.ros.state_sources import FrameError
from obc_ros.srv import SuggestWeights, TryDesign
import pytest
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

pytestmark = pytest.mark.nodes

X = [0.3, -0.2, 0.1, 0.05, -0.04, 0.02]
ACTIVE, UNCONFIGURED = 'active', 'unconfigured'


def test_late_repeated_and_reset_stamps_are_counted(spawn: Any, probe: Any) -> None:
    """Late states are dropped, repeated ones answered; `rate` drops states between periods."""
    bench = Bench(spawn, probe, **{'qos_overrides./state.subscription.depth': 10})
    first = bench.answer(X, 10.0)
    assert (bench.answer(X, 10.0) == first).all()  # a repeated state
    bench.answer(X, 10.1)
    bench.send(X, 10.05)  # a late state
    bench.answer(X, 10.2)
    assert nanoseconds(bench.commands[-2]) == 10_100_000_000
    bench.answer(X, 0.0)  # the plant was reset
    bench.process.wait_for_output('time went back by 10.2 s')
    bench.report('states', lambda _, values: (
        values['dropped out of order'], values['repeated'], values['restarted'])
        == ('1', '1', '1'))
    assert bench.set(rate=20.0).successful
    bench.answer(X, 1.0)
    bench.send(X, 1.01)
    bench.answer(X, 1.05)
    assert nanoseconds(bench.commands[-2]) == 1_000_000_000


def test_bytes_that_are_no_state_are_counted(spawn: Any, probe: Any) -> None:
    """The node lives, and the next state is answered as before."""
    bench = Bench(spawn, probe, state_source='state')
    first = bench.answer(X)
    for k, data in enumerate((bytes(4), b'\x00\x01\x00\x00' + b'\xff' * 40)):
        bench.publisher.publish(data)
        bench.report('states', lambda status, values, most=k: (
            values['dropped that cannot be read'] == str(most + 1)))
    bench.process.wait_for_output('a message on /state that is no State was dropped')
    assert (bench.answer(X) == first).all()


def test_outside_x_limits_the_loop_stops_or_holds(spawn: Any, probe: Any) -> None:
    """By default the node stops until ~/start; on_envelope chooses otherwise."""
    bench = Bench(spawn, probe, x_limits=[5.0, 5.0, 0.5, 9.0, 9.0, 9.0])
    good, tilted = bench.answer(X), [0.0, 0.0, 0.6, 0.0, 0.0, 0.0]
    assert (bench.answer(tilted) == HOVER).all()
    assert (bench.answer(X) == HOVER).all()
    bench.report('commands', lambda status, _: 'stopped: the error of theta is 0.6, outside '
                 '[-0.5, 0.5]' in status.message)
    assert bench.probe.call(Trigger, '/lqr_node/start').success
    assert (bench.answer(X) == good).all()
    assert bench.set(on_envelope='hold').successful
    assert (bench.answer(tilted) == good).all()
    assert bench.set(x_limits=[-1.0, 1.0] * 2 + [-0.5, 0.7] + [-9.0, 9.0] * 3).successful
    assert not (bench.answer(tilted) == good).all()


def test_transition_time_removes_the_predicted_jump(spawn: Any, probe: Any) -> None:
    """A dry run predicts the jump; with transition_time the command is continuous."""
    bench = Bench(spawn, probe, transition_time=1.0)
    assert (bench.answer(X, 0.5) == HOVER).all()   # from rest
    before = bench.answer(X, 2.0)
    tried = probe.call(TryDesign, '/lqr_node/try_design', TryDesign.Request(
        weights=LqrWeights(qx=[100.0] * 6)))
    assert tried.success
    assert tried.design.revision == 0
    assert bench.set(Qx=[100.0] * 6).successful
    start = bench.answer(X, 2.01)
    assert np.abs(start - before).max() < 1e-9
    end = bench.answer(X, 4.0)
    assert np.abs(end - before).max() == pytest.approx(tried.design.input_jump, rel=1e-9)
    assert bench.design(2).input_jump == pytest.approx(tried.design.input_jump, rel=1e-9)


def test_a_dry_run_reports_the_design_and_changes_nothing(spawn: Any, probe: Any) -> None:
    """A dry run reports the design of a change, or the reason of its refusal."""
    bench = Bench(spawn, probe)
    before = bench.answer(X)

    def attempt(**weights: Any) -> Any:
        return probe.call(TryDesign, '/lqr_node/try_design', TryDesign.Request(
            weights=LqrWeights(**weights)))

    answer = attempt(qx=[100.0, 1.0, 1.0, 0.0, 0.0, 0.0], qu=[0.1, 0.1])
    assert answer.success
    assert answer.message == answer.design.sentence
    design = answer.design
    A, B, K = matrix(design.a, 6), matrix(design.b, 6), matrix(design.k, 2)
    poles = np.sort_complex(np.linalg.eigvals(A - B @ K))
    np.testing.assert_allclose(np.sort_complex(
        np.array(design.poles_real) + 1j * np.array(design.poles_imag)), poles, atol=1e-9)
    assert min(design.phase_margin) > math.radians(30)
    assert min(design.disk_margin) > 0.5
    assert design.rise_time[0] > 0.0
    assert math.isnan(design.rise_time[3])
    assert design.peak_input[0] == pytest.approx(np.abs(K[0, 0]), rel=0.5)
    assert attempt(weights='bryson', x_max=[1.0] * 6, u_max=[1.0, 2.0]).success
    assert attempt(weights='output', h=[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0, 0, 0, 0]
                   ).success
    assert attempt(stability=0.5).design.poles_real[-1] < -0.5
    for refused, sentence in (
            ({'qu': [1.0, -1.0]}, 'Qu[1] = -1'), ({'qx': [math.nan] * 6}, 'Qx[0] = nan'),
            ({'weights': 'best'}, 'best'),
            ({'rho': math.nan, 'weights': 'output'}, 'rho[0] = nan'),
            ({'cross': [1e9] * 12}, 'cross'), ({'stability': -1.0}, 'stability = -1')):
        answer = attempt(**refused)
        assert not answer.success, (refused, answer.message)
        assert sentence in answer.message, (refused, answer.message)
    assert (bench.answer(X) == before).all()
    assert len(bench.designs) == 1


def test_the_integral_of_the_error_is_fed_back(spawn: Any, probe: Any) -> None:
    """The command grows while the error lasts; a stop clears the integral."""
    bench = Bench(spawn, probe, system='double_integrator', integral=['x1'], Qi=[1.0])
    x = [0.1, 0.0]
    first = bench.answer(x, 0.0)
    for k in range(1, 11):
        last = bench.answer(x, 0.1 * k)
    assert last[0] < first[0] - 0.05
    assert len(bench.design(1).poles_real) == 3
    assert bench.set(Qi=[4.0]).successful  # the integral is kept
    assert bench.answer(x, 1.0)[0] < last[0]
    assert bench.probe.call(Trigger, '/lqr_node/stop').success
    bench.answer(x, 1.1)
    assert bench.probe.call(Trigger, '/lqr_node/start').success
    assert bench.answer([0.0, 0.0], 1.2)[0] == pytest.approx(0.0, abs=1e-15)


def test_suggested_weights_meet_the_specifications(spawn: Any, probe: Any) -> None:
    """The response has a table of the trade-off; the running loop is unchanged."""
    bench = Bench(spawn, probe, system='double_integrator')
    before = bench.answer([0.1, 0.0])

    def specify(**fields: Any) -> Any:
        return probe.call(SuggestWeights, '/lqr_node/suggest_weights',
                          SuggestWeights.Request(**fields))

    answer = specify(rise_time=0.5, overshoot=0.1)
    assert answer.success, answer.message
    assert answer.design.rise_time[0] <= 0.5
    assert answer.design.overshoot[0] <= 0.1
    rise, peak = answer.table_rise_time, answer.table_peak_input  # from small inputs to large
    assert rise[0] > 10 * rise[-1]
    assert peak[0] < 0.1 * peak[-1]
    assert len(answer.table_peak_input) == len(answer.table_scale) > 3
    assert not specify(rise_time=1e-3, peak_input=[1e-3]).success
    assert 'rise_time' in specify(rise_time=-1.0).message
    assert specify(x_max=[1.0]).message
    assert (bench.answer([0.1, 0.0]) == before).all()
    assert len(bench.designs) == 1
    assert bench.set(Qx=list(answer.qx), Qu=list(answer.qu)).successful
    assert bench.design(2).rise_time[0] == pytest.approx(answer.design.rise_time[0])


def test_dry_runs_and_suggestions_work_beside_brysons_rule(spawn: Any, probe: Any) -> None:
    """With Bryson's rule u_max does not limit suggestions and dry runs."""
    bench = Bench(spawn, probe, weights='bryson', x_max=[0.1] * 6, u_max=[5.0, 5.0])
    answer = probe.call(SuggestWeights, '/lqr_node/suggest_weights',
                        SuggestWeights.Request(rise_time=1.5, peak_input=[10.0, 10.0]))
    assert answer.success, answer.message

    def attempt(**fields: Any) -> Any:
        return probe.call(TryDesign, '/lqr_node/try_design',
                          TryDesign.Request(weights=LqrWeights(**fields)))

    np.testing.assert_allclose(matrix(attempt(u_max=[2.0, 5.0]).design.qu, 2),
                               np.diag([0.25, 0.04]))
    assert attempt(weights='matrices', qx=[1.0] * 6, qu=[1.0, 1.0]).success
    assert len(bench.designs) <= 1


def test_a_sampled_design_uses_period_and_delay(spawn: Any, probe: Any) -> None:
    """The gain differs from the continuous one; without a rate the design is refused."""
    bench = Bench(spawn, probe)
    assert 'needs the period' in bench.set(design='sampled').reason
    assert 'needs the period' in bench.set(delay=0.05).reason
    assert bench.set(design='sampled', rate=20.0, delay=0.05).successful
    design = bench.design(2)
    assert (design.design, design.sample_time, design.delay) == ('sampled', 0.05, 0.05)
    assert design.max_gain_change > 0.01
    assert max(design.poles_real) < 0.0
    u = [bench.answer(X, 1.0 + 0.05 * k) for k in range(3)]
    # the state is the same, but the pending command differs each time
    assert np.abs(u[1] - u[0]).max() > 1e-3
    assert np.abs(u[2] - u[1]).max() > 1e-3


# References


def test_references_are_joined_replaced_and_held(spawn: Any, probe: Any) -> None:
    """A reference may be joined in the middle; its end is held; a set point ends it."""
    bench = Bench(spawn, probe, system='double_integrator', Qx=[4, 0], Qu=[1],
                  start_tolerance=[3.0, 2.0])  # the states of this test jump
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    K = matrix(bench.design(1).k, 1)
    t, dt = np.linspace(0.0, 10.0, 101), 1e-9

    def follow(message: Trajectory, words: str) -> None:
        publisher.publish(message)
        probe.wait_for(lambda: words in bench.process.output(), what=words)

    assert bench.answer([0.0, 0.0], 99.0) == pytest.approx(0.0)
    follow(reference(t, np.stack([t, np.ones(101)], axis=1), 0 * t, 97.0), 'of 10 s')
    # x1 = t, x2 = 1; long before the end the gain is the steady-state gain
    assert bench.answer([2.5, 1.0], 99.5) == pytest.approx(0.0, abs=1e-9)
    assert bench.answer([2.9, 1.2], 99.9) == pytest.approx(-K @ [0.0, 0.2], rel=1e-4)
    follow(reference(t[:51], np.stack([t[:51] * 0 + 3.0, t[:51] * 0], axis=1), 0 * t[:51], 100.5,
                     state_names=['x1', 'x2'], input_names=['u'], interpolation='zoh',
                     system='double_integrator'), 'of 5 s')
    assert bench.answer([3.4, 1.0], 100.4) == pytest.approx(0.0, abs=1e-9)  # still the first one
    assert bench.answer([3.1, 0.0], 100.5) == pytest.approx(-K @ [0.1, 0.0], rel=1e-3)
    assert bench.set(Qx=[9, 0]).successful  # also while a reference is followed
    K = matrix(bench.design(2).k, 1)
    for stamp in (105.5 - dt, 105.5, 105.5 + dt, 200.0):
        assert bench.answer([3.1, 0.0], stamp) == pytest.approx(-K @ [0.1, 0.0], rel=1e-6)
    for message, words in (
            (reference(t, t, 0 * t), 'a reference was rejected: x has 101 numbers; wanted '),
            (reference(t, np.zeros((101, 2)), t, system='aircraft'), "system = 'aircraft': wan"),
            (reference(t[::-1], np.zeros((101, 2)), t), 't: wanted finite times'),
            (reference(t, np.zeros((101, 2)), t * math.nan), 'u: wanted finite numbers')):
        follow(message, words)
        assert bench.answer([3.1, 0.0]) == pytest.approx(-K @ [0.1, 0.0], rel=1e-6)
    assert bench.set(setpoint=[1.0, 0.0]).successful
    assert bench.answer([1.1, 0.0]) == pytest.approx(-K @ [0.1, 0.0], rel=1e-9)


def test_a_reference_with_stamp_0_begins_at_once(spawn: Any, probe: Any) -> None:
    """~/stop discards the reference."""
    bench = Bench(spawn, probe, system='double_integrator')
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    bench.answer([0.0, 1.0], 50.0)
    publisher.publish(reference([0.0, 10.0], [[0.0, 1.0], [10.0, 1.0]], [0.0, 0.0]))
    bench.process.wait_for_output('a reference of 10 s')
    assert bench.answer([2.0, 1.0], 52.0) == pytest.approx(0.0, abs=1e-9)
    assert 'stopped at [0.0]' in probe.call(Trigger, '/lqr_node/stop').message
    assert bench.answer([3.0, 1.0], 53.0) == 0.0
    assert probe.call(Trigger, '/lqr_node/start').success
    K = matrix(bench.design(1).k, 1)
    assert bench.answer([4.0, 1.0], 54.0) == pytest.approx(-K @ [4.0, 1.0])


# Lifecycle


def test_lifecycle_transitions_start_and_silence_the_loop(spawn: Any, probe: Any) -> None:
    """Without autostart the node waits; deactivation commands the equilibrium input once."""
    bench = Bench(spawn, probe, autostart=False)

    def change(label: str) -> bool:
        request = ChangeState.Request()
        request.transition.label = label
        return bool(probe.call(ChangeState, '/lqr_node/change_state', request).success)

    def state() -> str:
        return str(probe.call(GetState, '/lqr_node/get_state').current_state.label)

    def is_silent() -> bool:
        seen = len(bench.commands)
        for _ in range(5):
            bench.send(X)
            probe.spin_for(0.02)
        return len(bench.commands) == seen

    assert state() == UNCONFIGURED
    assert is_silent()
    assert bench.set(Qx=[2.0] * 6).successful  # parameters can be set in every lifecycle state
    assert not change('activate')
    assert change('configure')
    assert is_silent()
    assert change('activate')
    assert state() == ACTIVE
    np.testing.assert_allclose(bench.ask(X), HOVER - matrix(bench.design(2).k, 2) @ X, rtol=1e-9)
    assert not change('configure')
    assert not change('no_such_transition')
    assert state() == ACTIVE
    request = ChangeState.Request()
    request.transition.id = 77
    assert not probe.call(ChangeState, '/lqr_node/change_state', request).success
    seen = len(bench.commands)
    assert change('deactivate')
    probe.wait_for(lambda: len(bench.commands) > seen)
    assert (np.array(bench.commands[-1].u) == HOVER).all()
    assert is_silent()
    assert change('activate')
    assert bench.ask(X).size == 2
    assert change('deactivate')
    assert change('cleanup')
    assert state() == UNCONFIGURED
    assert change('shutdown')


# Other publishers


def test_a_second_publisher_is_reported(spawn: Any, probe: Any) -> None:
    """Diagnostics name two sources of states, and two controllers of one plant."""
    bench = Bench(spawn, probe)
    other = probe.node.create_publisher(State, 'state', 10)
    bench.report('states', lambda status, _: status.level == b'\x01'
                 and '2 publishers on /state: /probe, /probe' in status.message)
    probe.node.destroy_publisher(other)
    bench.report('states', lambda status, _: 'publishers' not in status.message)
    spawn('lqr_node', {}, name='second')
    bench.report('states', lambda status, _: '2 publishers on /command: /lqr_node, /second'
                 in status.message)


def test_qos_overrides_apply_and_mismatches_are_reported(spawn: Any, probe: Any) -> None:
    """Diagnostics name a publisher of incompatible QoS, and missed deadlines."""
    parameters = {'qos_overrides./state.subscription.reliability': 'reliable',
                  'qos_overrides./state.subscription.deadline': 200_000_000,
                  'stamp_timeout': 0.0}
    process = spawn('lqr_node', parameters, name='careful')
    unfit = probe.node.create_publisher(State, 'state', BEST_EFFORT)
    reports = probe.listen(DiagnosticArray, '/diagnostics')
    assert probe.get_parameters('/careful', 'qos_overrides./state.subscription.reliability') == {
        'qos_overrides./state.subscription.reliability': 'reliable'}

    def reported(words: str) -> bool:
        return any(words in status.message for array in reports for status in array.status)

    probe.wait_for(lambda: reported(
        '/careful receives nothing from /probe on /state: incompatible QoS (best effort'))
    probe.node.destroy_publisher(unfit)
    good = probe.publisher(State, 'state', QoSProfile(
        depth=1, deadline=Duration(seconds=0.2)))
    commands = probe.listen(Command, 'command')
    probe.wait_for(lambda: good.publish(State(x=X)) or commands)
    probe.wait_for(lambda: reported('deadlines missed on /state') or reported('no valid state'))
    probe.wait_for(lambda: any(
        each.key == 'deadline' and int(each.value) for array in reports
        for status in array.status for each in status.values))
    process.wait_for_output('a state on /state missed its deadline of 0.2 s')


# Messages of robots


def odometry(px: float, py: float, yaw: float, frame: str = 'odom', child: str = 'base_link',
             stamp: int = 1) -> Odometry:
    """Return a pose in the plane."""
    message = Odometry(child_frame_id=child)
    message.header.frame_id, message.header.stamp.sec = frame, stamp
    message.pose.pose.position.x, message.pose.pose.position.y = px, py
    message.pose.pose.orientation.z = math.sin(yaw / 2)
    message.pose.pose.orientation.w = math.cos(yaw / 2)
    return message


def test_odometry_is_read_and_twist_is_published(spawn: Any, probe: Any) -> None:
    """The vehicle is controlled by odometry and cmd_vel; wrong frames are dropped."""
    bench = Bench(spawn, probe, message=Odometry, topic='odom', sink=TwistStamped,
                  commands='cmd_vel', system='vehicle', state_source='odom',
                  command_sink='cmd_vel', setpoint_input=[10.0, 0.0], transition_time=0.0,
                  u_limits=[0.0, 20.0, -0.6, 0.6])
    K = matrix(bench.design(1).k, 2)
    stamp = 0

    def drive(*pose: Any, **options: Any) -> TwistStamped | None:
        nonlocal stamp
        stamp, seen = stamp + 1, len(bench.commands)
        bench.publisher.publish(odometry(*pose, stamp=stamp, **options))
        if options:
            probe.spin_for(0.1)
            return None
        return probe.wait_for(lambda: bench.commands[seen:] or None)[-1]  # type: ignore[no-any-return]

    for k, yaw in enumerate((0.1, -0.1, 0.1 + 2 * math.pi)):
        twist = drive(10.0 * k, 0.2, yaw)
        assert twist is not None
        assert twist.header.frame_id == 'base_link'
        v, phi = np.array([10.0, 0.0]) - K @ [0.0, 0.2, math.remainder(yaw, math.tau)]
        assert twist.twist.linear.x == pytest.approx(v, rel=1e-9)
        assert twist.twist.angular.z == pytest.approx(v / 2.0 * math.tan(np.clip(
            phi, -0.6, 0.6)), rel=1e-9)
    seen = len(bench.commands)
    drive(30.0, 0.2, 0.1, frame='map')
    drive(30.0, 0.2, 0.1, child='odom')
    drive(30.0, 0.2, math.nan, frame='odom')
    assert len(bench.commands) == seen
    bench.process.wait_for_output("a state in the frame 'map' was dropped: wanted 'odom'")
    bench.report('states', lambda _, values: values['dropped in another frame'] == '2'
                 and values['dropped not finite'] == '1')


@pytest.mark.parametrize(('system', 'inputs'), [
    ('vehicle', lambda v, phi: (v, v / 2.0 * math.tan(phi))),
    ('two_wheeled', lambda v, omega: (v, omega)),
])
def test_an_unstamped_twist_is_published(spawn: Any, probe: Any, system: str, inputs: Any) -> None:
    """Many mobile bases subscribe to Twist; it has the values of the command."""
    at_rest = {'system': system, 'setpoint': [0.0, 0.0, 0.0], 'setpoint_input': [1.0, 0.0]}
    bench = Bench(spawn, probe, sink=Twist, commands='cmd_vel', command_sink='cmd_vel',
                  cmd_vel_stamped=False, unlimited=True, transition_time=0.0, **at_rest)
    assert dict(probe.node.get_topic_names_and_types())['/cmd_vel'] == ['geometry_msgs/msg/Twist']
    K = matrix(bench.design(1).k, 2)
    x = np.array([0.0, 0.01, 0.02])
    bench.send(x)
    twist = probe.wait_for(lambda: bench.commands or None)[-1]
    assert (twist.linear.x, twist.angular.z) == pytest.approx(
        inputs(*(np.array([1.0, 0.0]) - K @ x)), rel=1e-9)
    assert probe.get_parameters('/lqr_node', 'cmd_vel_stamped') == {'cmd_vel_stamped': False}


def test_odometry_of_another_body_is_refused() -> None:
    """The child frame must differ from the fixed frame and must not change."""
    read = make_body_reader('odom', registry.get_system('vehicle'))
    with pytest.raises(FrameError, match="child_frame_id = header.frame_id = 'odom': the twist"):
        read(odometry(0.0, 0.0, 0.0, child='odom'))
    assert read(odometry(1.0, 2.0, 0.5)) == pytest.approx([1.0, 2.0, 0.5])
    with pytest.raises(FrameError, match="odometry of 'robot2', after that of 'base_link'"):
        read(odometry(1.0, 2.0, 0.5, child='robot2'))
    assert read(odometry(1.0, 2.0, 0.5)) == pytest.approx([1.0, 2.0, 0.5])


def test_the_forces_are_published_as_a_wrench(spawn: Any, probe: Any) -> None:
    """The wrench of the aircraft is in the frame of its body."""
    bench = Bench(spawn, probe, sink=WrenchStamped, commands='wrench', command_sink='wrench',
                  frame_id='map', u_limits=[20.0, 60.0], transition_time=0.0,
                  **{'qos_overrides./state.subscription.depth': 10})
    K = matrix(bench.design(1).k, 2)

    def answered() -> list[Any] | None:
        """Send states in a wrong and in the right frame until one is answered."""
        if not bench.commands:   # the node may not have discovered the publisher yet
            bench.send(X, frame='odom')
            bench.send(X, 2.0, frame='map')
        return bench.commands or None

    wrench = probe.wait_for(answered)[0]
    f1, f2 = HOVER - K @ X
    assert wrench.header.frame_id == 'base_link'
    assert wrench.header.stamp.sec == 2
    assert (wrench.wrench.force.x, wrench.wrench.force.z, wrench.wrench.torque.y) == (
        pytest.approx(f1, rel=1e-9), pytest.approx(f2, rel=1e-9), pytest.approx(-0.25 * f1))


@pytest.mark.parametrize(('parameters', 'sentence'), [
    ({'system': 'double_integrator', 'state_source': 'odom'},
     'do not determine the state of double'),
    ({'system': 'aircraft', 'command_sink': 'cmd_vel'},
     'add to its file: ros: {cmd_vel: {linear.x: EXPRESSION, angular.z: EXPRESSION}}, with'),
    ({'system': 'vehicle', 'command_sink': 'wrench'},
     'it is not known how this message carries the inputs of vehicle'),
])
def test_messages_unfit_for_the_system_are_refused(probe: Any, parameters: Any, sentence: str
                                                   ) -> None:
    """The node does not start without a pose, or with inputs that the message lacks."""
    assert sentence in probe.refusal(LqrNode, parameters)
