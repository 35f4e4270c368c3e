# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc service`, `topic`, `action`, `interface`, `lifecycle` and `node` print as `ros2` does."""

import re
import signal
import subprocess
from typing import Any

import _endless  # of benchmarks/
from obc_ros.book.runner import solve_request
from obc_ros.cli.ros2.yaml_messages import convert_to_yaml
from obc_ros.msg import Trajectory
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
import support
from words import Terminal

GOAL = ("{problem: {states: [p], inputs: [u], dynamics: [{name: p, expression: u}], running_cost: "
        "'u**2', initial_state: [{name: p, expression: '1'}], terminal_constraints: [p], "
        "final_time: {value: '1'}}}")


@pytest.fixture
def loop(spawn: Any) -> None:
    """Start a plant and its regulator."""
    spawn('plant_simulator', {'system': 'aircraft'})
    spawn('lqr_node', {**support.DEMO, 'system': 'aircraft'}).wait_for_output('revision 1')


def test_service_call_and_list(loop: None, terminal: Terminal) -> None:
    done = terminal.say_here('service', 'call', '/lqr_node/stop', 'std_srvs/srv/Trigger')
    assert done.status == 0
    assert 'requester: making request: std_srvs.srv.Trigger_Request()\n\nresponse:\n' in done.out
    assert "std_srvs.srv.Trigger_Response(success=True, message='stopped at" in done.out
    def listed() -> list[str]:
        return terminal.say_here('service', 'list', '-t').out.splitlines()

    support.wait_for(lambda: '/lqr_node/stop [std_srvs/srv/Trigger]' in (lines := listed())
                     and lines == sorted(lines), 60.0)
    done = terminal.say_here('service', 'call', '/lqr_node/try_design', 'obc_ros/srv/TryDesign',
                             '{weights: {nothing: 1}}')
    assert done.status == 1
    assert 'Failed to populate field' in done.err
    assert 'nothing' in done.err


def test_topic_list_echo_hz_and_info(loop: None, terminal: Terminal) -> None:
    wanted = {'/state', '/command', '/lqr_node/design'}
    support.wait_for(
        lambda: wanted < {*terminal.say_here('topic', 'list').out.splitlines()}, 60.0)
    design = terminal.say_here('topic', 'echo', '--once', '/lqr_node/design')  # a latched topic
    assert design.status == 0
    assert design.out.startswith('header:\n  stamp:\n')
    assert '\nrevision: 1\nsystem: aircraft\nstate_names:\n- px\n' in design.out
    assert design.out.endswith('\n---\n')
    sentence = terminal.say_here('topic', 'echo', '--once', '--field', 'sentence', '--full-length',
                                 '/lqr_node/design').out
    assert re.fullmatch(r'aircraft: spectral abscissa -.*\n---\n', sentence)
    short = terminal.say_here('topic', 'echo', '--once', '--no-arr', '/state').out
    assert "x: '<sequence type: double, length: 6>'\n" in short
    with subprocess.Popen(terminal.command('topic', 'hz', '/state'), text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                          env={**support.environment(terminal.domain)}) as timed:
        rates = ''.join(line for line, _ in zip(timed.stdout, range(2), strict=False))
        timed.send_signal(signal.SIGINT)
    assert re.search(r'average rate: \d+\.\d{3}\n\tmin: .*s max: .*s std dev: .*s window: \d+\n',
                     rates), rates
    ends = terminal.say_here('topic', 'info', '--verbose', '/reference').out
    assert ends.startswith('Type: obc_ros/msg/Trajectory\n\nPublisher count: 0\n\n')
    assert 'Node name: lqr_node' in ends
    assert 'TRANSIENT_LOCAL' in ends


def test_topic_pub_publishes_a_latched_message(terminal: Terminal, probe: Any) -> None:
    """The pages of the gallery publish their references in this way."""
    received = probe.listen(Trajectory, '/reference', QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    with subprocess.Popen(
            terminal.command('topic', 'pub', '--once', '--keep-alive', '2', '--qos-durability',
                             'transient_local', '/reference', 'obc_ros/msg/Trajectory',
                             '{t: [0, 1], state_names: [px]}'),
            text=True, stdout=subprocess.PIPE, env=support.environment(terminal.domain)) as ended:
        probe.wait_for(lambda: received, what='the message')
        text, _ = ended.communicate(timeout=60.0)
    assert ended.returncode == 0
    assert list(received[0].t) == [0.0, 1.0]
    assert 'publisher: beginning loop\npublishing #1: obc_ros.msg.Trajectory(' in text


def test_action_send_goal_prints_feedback_and_result(spawn: Any, terminal: Terminal) -> None:
    spawn('trajectory_server', {'workers': 1}).wait_for_output('ready')
    done = terminal.say('action', 'send_goal', '--feedback',
                        '/trajectory_server/solve_optimal_control',
                        'obc_ros/action/SolveOptimalControl', GOAL)
    assert done.status == 0, done
    assert done.out.startswith('Waiting for an action server to become available...\n'
                               'Sending goal:\n     problem:\n')
    assert '\nFeedback:\n    phase: ' in done.out
    assert re.search(r'\nGoal accepted with ID: [0-9a-f]{32}\n\n', done.out)
    assert '\nResult:\n    ' in done.out
    assert 'objective: 1.0' in done.out
    assert done.out.endswith('\nGoal finished with status: SUCCEEDED\n')


def test_lifecycle_get_and_set(loop: None, terminal: Terminal) -> None:
    support.wait_for(
        lambda: terminal.say_here('lifecycle', 'get', '/lqr_node').out == 'active [3]\n', 60.0)
    done = terminal.say_here('lifecycle', 'set', '/lqr_node', 'deactivate')
    assert (done.status, done.out) == (0, 'Transitioning successful\n')
    support.wait_for(lambda: terminal.say_here('lifecycle', 'get').out
                     == '/lqr_node: inactive [2]\n', 60.0)
    done = terminal.say_here('lifecycle', 'set', '/lqr_node', 'deactivate')
    assert done.status == 1
    assert 'Unknown transition requested, available ones are:' in done.err
    support.wait_for(lambda: terminal.say_here('node', 'list').out
                     == '/lqr_node\n/plant_simulator\n', 60.0)


def test_interface_show_prints_nested_fields(terminal: Terminal) -> None:
    """Nested fields are indented; a service has its request and its response."""
    done = terminal.say('interface', 'show', 'obc_ros/srv/PlanMotion')
    assert done.status == 0
    assert '\n---\n' in done.out
    assert re.search(r'^string system\s+# ', done.out, re.MULTILINE)
    shown = terminal.say('interface', 'show', 'obc_ros/msg/State').out
    assert re.search(r'^std_msgs/Header header.*\n\tbuiltin_interfaces/Time stamp\n\t\tint32 sec\n'
                     r'\t\tuint32 nanosec\n\tstring frame_id\n', shown, re.MULTILINE)
    wrong = terminal.say('interface', 'show', 'obc_ros/msg')
    assert wrong.status == 1
    assert 'Expected three parts' in wrong.err


def test_errors_are_one_sentence_with_status_1(loop: None, domain: int, tmp_path: Any) -> None:
    """Commands with a time limit end within it."""
    obc = Terminal('obc', domain, tmp_path)
    for line, wanted in (
            ('service call /nobody std_srvs/srv/Trigger --timeout 1',
             'no service /nobody within 1 s'),
            ('service call /lqr_node/stop std_srvs/srv/SetBool',
             '/lqr_node/stop is of the type std_srvs/srv/Trigger, not std_srvs/srv/SetBool'),
            ('service call /lqr_node/stop std_srvs/srv/Trigge', 'std_srvs has no srv Trigge'),
            ('topic echo --once /nothing', 'no /nothing within 5 s; there is /command'),
            ('topic echo --once --field k.l /lqr_node/design', "Invalid field 'k.l': no 'l'"),
            ('action send_goal /nobody obc_ros/action/SolveOptimalControl --timeout 1',
             'no action /nobody'),
            ('lifecycle get /plant_simulator --timeout 5', 'it is no lifecycle node'),
            ('interface show obc_ros/msg/Nothing', 'obc_ros has no msg Nothing; it has'),
            ('interface show nowhere/msg/Nothing', "package 'nowhere' is not installed")):
        done = obc.say_here(*line.split())
        assert (done.status, 'Traceback' in done.err) == (1, False), done
        assert wanted in done.err, done


def test_ctrl_c_cancels_a_goal(spawn: Any, domain: int, tmp_path: Any) -> None:
    server = spawn('trajectory_server', {'workers': 1})
    server.wait_for_output('ready')
    endless = convert_to_yaml(solve_request(_endless.endless(12), ''))
    with subprocess.Popen(
            Terminal('obc', domain, tmp_path).command(
                'action', 'send_goal', '/trajectory_server/solve_optimal_control',
                'obc_ros/action/SolveOptimalControl', endless),
            text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            env=support.environment(domain)) as asking:
        text = ''
        while 'Goal accepted' not in text:
            line = asking.stdout.readline()
            assert line, text
            text += line
        asking.send_signal(signal.SIGINT)
        rest, error = asking.communicate(timeout=60.0)
    assert asking.returncode == 130
    assert error == ''
    assert rest.endswith('Canceling goal...\nGoal canceled.\n'), rest
