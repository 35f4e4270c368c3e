# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The end of a node: no traceback, and an exit status that tells its cause."""

from array import array
from contextlib import suppress
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

import pytest
from rcl_interfaces.srv import ListParameters
import support

NODES = ('lqr_node', 'plant_simulator', 'trajectory_server')


@pytest.mark.parametrize('node', NODES)
def test_sigterm_ends_a_node_with_status_0(spawn: Any, probe: Any, node: str) -> None:
    """
    The exit status is 0, the output has no traceback, and the graph lists the node no more.

    An observer that processes a node's last announcement after its disposal lists the node for
    ever (docs/development/reliability.md). On an overloaded machine this happens to one observer
    in a hundred.
    A defect of our nodes would show in every attempt, so one of three attempts must succeed.
    """
    for name in (node, f'{node}_again', f'{node}_once_more'):
        process = spawn(node, name=name)
        probe.wait_for_node(name)
        process.popen.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 0, process.output()
        assert 'Traceback' not in process.output()
        assert 'Error' not in process.output()
        with suppress(AssertionError):
            probe.wait_for(lambda name=name: name not in probe.node.get_node_names(), 10.0)
            return
    pytest.fail(f'{node} was listed after its end, three times in a row')


STUCK = """
import ctypes
from obc_ros.ros.execution import executor
from rclpy.node import Node
class Stuck(Node):
    def destroy_node(self):
        ctypes.PyDLL(None).sleep(60)  # in C, holds the GIL
executor.PATIENCE = 0.5
executor.run(lambda: Stuck('stuck'))
"""


def test_a_node_that_hangs_at_shutdown_is_ended(probe: Any, domain: int) -> None:
    """The exit status is 1, and a traceback shows where the node hangs."""
    process = subprocess.Popen([sys.executable, '-c', STUCK], stderr=subprocess.PIPE,
                               env=support.environment(domain))
    try:
        probe.wait_for_node('stuck')
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20.0)
    finally:
        process.kill()
    assert process.returncode == 1
    assert b'in destroy_node' in errors


STUCK_CLIENT = """
import ctypes
from obc_ros.cli.client import Client
from obc_ros.cli.ros_graph import join_graph
from obc_ros.ros.execution import executor
executor.PATIENCE = 0.5
with join_graph(lambda: None, Client) as client:
    client.node.destroy_node = lambda: ctypes.PyDLL(None).sleep(60)
"""


def test_a_client_that_hangs_at_shutdown_is_ended(domain: int) -> None:
    ended = subprocess.run([sys.executable, '-c', STUCK_CLIENT], stderr=subprocess.PIPE,
                           env=support.environment(domain), timeout=20.0)
    assert ended.returncode == 1
    assert b'in close' in ended.stderr


def test_bad_start_arguments_end_a_node_with_one_sentence(spawn: Any, tmp_path: Any) -> None:
    """The sentence for a mixed list says how to write a list of numbers."""
    missing = spawn('lqr_node', remappings={'1bad': '2bad'})
    assert missing.wait() == 1
    assert 'Traceback' not in missing.output()
    mixed = spawn('lqr_node', {'Qu': [1, 0.5]})
    assert mixed.wait() == 1
    assert 'write the numbers of a list all with a point, or none' in mixed.output()


@pytest.mark.parametrize(('node', 'tuned'), [
    ('lqr_node', {'Qx': [100.0, 1.0, 1.0, 0.0, 0.0, 0.0], 'integral': ['px'], 'Qi': []}),
    ('plant_simulator', {'noise.px': 0.1, 'x0': [1.0] * 6}),
    ('trajectory_server', {'workers': 1})])
def test_dumped_parameters_override_those_of_a_scenario(spawn: Any, probe: Any, node: str,
                                                        tuned: dict[str, Any]) -> None:
    """A node started with the dumped parameters of another node has the same values."""
    spawn(node, tuned)
    request = ListParameters.Request()
    names = [name for name in probe.call(
        ListParameters, f'/{node}/list_parameters', request).result.names
             if not name.startswith('qos_overrides.')]  # their names contain the namespace
    values = {name: list(value) if isinstance(value, (tuple, array)) else value
              for name, value in probe.get_parameters(f'/{node}', *names).items()}
    assert tuned.items() <= values.items()
    scenario = Path(__file__).resolve().parents[2] / 'config' / 'aircraft.yaml'
    again = ['--ros-args', '--params-file', str(scenario), '--']
    spawn(node, values, arguments=again, name=node, namespace='/again')
    assert probe.get_parameters(f'/again/{node}', *names) == probe.get_parameters(
        f'/{node}', *names)


@pytest.mark.parametrize(('node', 'number'), [
    *((node, signal.SIGTERM) for node in ('lqr_node', 'trajectory_server')),
    *((node, signal.SIGINT) for node in NODES)])
def test_a_signal_during_loading_ends_a_node_silently(spawn: Any, probe: Any, node: str,
                                                      number: int) -> None:
    process = spawn(node)
    probe.wait_for(lambda: 'numpy' in Path(f'/proc/{process.pid}/maps').read_text())
    process.popen.send_signal(number)
    assert process.wait(10.0) == 0, process.output()
    assert not process.output()


@pytest.mark.slow
@pytest.mark.parametrize(('node', 'words'), [
    ('lqr_node', ['--help']), ('lqr_node', ['flight']),
    *((node, ['-p', 'system:=vehicle']) for node in NODES)], ids=str)
def test_an_argument_outside_ros_args_is_refused(node: str, words: list[str]) -> None:
    """A node does not start without a parameter that was given without --ros-args."""
    ended = subprocess.run([sys.executable, '-P', '-m', f'obc_ros.nodes.{node}', *words],
                           capture_output=True, text=True, timeout=60.0)
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1] == (
        f"{node}: '{words[0]}' is not understood; parameters are given as in: "
        '--ros-args -p system:=aircraft --params-file FILE')


@pytest.mark.parametrize('gap', [0.0, 0.05, 0.1, 0.15])
def test_a_second_sigint_does_not_change_the_exit_status(spawn: Any, probe: Any, gap: float
                                                         ) -> None:
    """Ctrl-C at a launch file signals each node twice: the terminal does, then the launch file."""
    process = spawn('lqr_node')
    probe.wait_for_node('lqr_node')
    process.popen.send_signal(signal.SIGINT)
    time.sleep(gap)  # the second signal arrives in different phases of the shutdown
    process.popen.send_signal(signal.SIGINT)
    assert process.wait() == 0, process.output()
