# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc param`: what `ros2 param` does, with its words and its output, over DDS."""

import re
import subprocess
import sys
import time
from typing import Any

import pytest
import support
from words import Terminal
import yaml


@pytest.fixture
def lqr(spawn: Any) -> Any:
    """Start a regulator and wait for its design."""
    node = spawn('lqr_node', {'system': 'aircraft'})
    node.wait_for_output('revision 1')
    return node


def test_a_parameter_is_read_set_and_refused(lqr: Any, probe: Any, terminal: Terminal) -> None:
    """The issue's own line, with either word; what is refused is told and changes nothing."""
    said = terminal.say_here('param', 'get', '/lqr_node', 'Qx')
    assert (said.status, said.out) == (0, 'Double values are: []\n'), said
    said = terminal.say_here('param', 'set', '/lqr_node', 'Qx', '[100, 1, 0.698, 0, 0, 0]')
    assert (said.status, said.out) == (0, 'Set parameter successful\n'), said
    weights = [100.0, 1.0, 0.698, 0.0, 0.0, 0.0]
    assert list(probe.get_parameters('/lqr_node', 'Qx')['Qx']) == weights
    said = terminal.say_here('param', 'get', '--hide-type', 'lqr_node', 'Qx')
    assert said.out == f'{weights}\n'
    said = terminal.say_here('param', 'set', '/lqr_node', 'Qu', '[-0.1, 0.1]')
    assert said.err == ('Setting parameter failed: Qu[0] = -0.1: '
                        'Qu must be positive definite\n')
    assert said.status == (terminal.word == 'obc')  # `ros2` says 0 of what is refused
    assert list(probe.get_parameters('/lqr_node', 'Qu')['Qu']) == []
    said = terminal.say_here('param', 'set', '/lqr_node', 'delay', '-0.05')
    assert 'Setting parameter failed' in said.err


def test_parameters_are_listed_and_described(lqr: Any, terminal: Terminal) -> None:
    listed = terminal.say_here('param', 'list', '/lqr_node')
    names = [line.removeprefix('  ') for line in listed.out.splitlines()]
    assert listed.status == 0
    assert names == sorted(names)
    assert {'Qx', 'Qu', 'setpoint'} < {*names}
    support.wait_for(lambda: re.match(
        r'/lqr_node:\n(  .*\n)*  Qx \(type: double array\)\n',
        terminal.say_here('param', 'list', '--param-type').out), 60.0)
    listed = terminal.say_here('param', 'list', '/lqr_node', '--filter', 'Q[xu]$')
    assert listed.out == '  Qu\n  Qx\n'
    described = terminal.say_here(
        'param', 'describe', '/lqr_node', 'Qx', 'system').out.splitlines()
    assert described[:2] == ['Parameter name: Qx', '  Type: double array']
    assert described[2].startswith('  Description: state weight')
    assert '    Read only: true' in described[described.index('Parameter name: system'):]


def test_what_is_dumped_is_loaded(lqr: Any, probe: Any, terminal: Terminal) -> None:
    """In the form that `--params-file` takes."""
    assert probe.set_parameters('/lqr_node', Qx=[2.0] * 6)[0].successful
    dumped = terminal.say_here('param', 'dump', '/lqr_node')
    tree = yaml.safe_load(dumped.out)
    assert dumped.status == 0
    assert dumped.out.startswith('/lqr_node:\n  ros__parameters:\n')
    assert tree['/lqr_node']['ros__parameters']['Qx'] == [2.0] * 6
    assert tree['/lqr_node']['ros__parameters']['qos_overrides']['/command']['publisher']
    (terminal.folder / 'tuned.yaml').write_text(
        '/lqr_node:\n  ros__parameters:\n    Qx: [3.0, 3.0, 3.0, 3.0, 3.0, 3.0]\n    Qu: [-1.0]\n')
    said = terminal.say_here('param', 'load', '/lqr_node', 'tuned.yaml')
    assert said.out == 'Set parameter Qx successful\n'
    assert said.err.startswith('Set parameter Qu failed: Qu ')
    assert list(probe.get_parameters('/lqr_node', 'Qx')['Qx']) == [3.0] * 6


def test_what_is_not_there_is_said(lqr: Any, domain: int, tmp_path: Any) -> None:
    """With what to do: the nodes that run, the parameter that was meant, the nodes of a file."""
    obc = Terminal('obc', domain, tmp_path)
    said = obc.say_here('param', 'get', '/lqr', 'Qx', '--timeout', '2')
    assert (said.status, said.out) == (1, '')
    assert said.err == ('obc param: Node not found: no node /lqr within 2 s; '
                        'running: /lqr_node\n')
    said = obc.say_here('param', 'get', '/lqr_node', 'setpoints')
    assert (said.status, said.out) == (1, 'Parameter not set.\n')
    assert said.err.startswith("/lqr_node has no parameter 'setpoints'; did you mean setpoint")
    said = obc.say_here('param', 'describe', '/lqr_node', 'zzz')
    assert said.status == 1
    assert said.err.endswith('see obc param list /lqr_node\n')
    (tmp_path / 'others.yaml').write_text('/a: {ros__parameters: {Qx: [1.0]}}\n'
                                          '/b: {ros__parameters: {Qx: [1.0]}}\n')
    said = obc.say_here('param', 'load', '/lqr_node', 'others.yaml')
    assert said.status == 1
    assert 'has nothing for /lqr_node, only for /a, /b' in said.err
    for wrong in ('[', '- 1', 'text'):
        (tmp_path / 'wrong.yaml').write_text(wrong)
        said = obc.say_here('param', 'load', '/lqr_node', 'wrong.yaml')
        assert said.status == 1
        assert 'is no parameter file' in said.err
    said = obc.say_here('param', 'set', '/lqr_node', 'Qx', '[1, ')
    assert said.status == 1
    assert 'wanted a list of numbers' in said.err
    said = obc.say_here('param', 'list', '/bad name', '--timeout', '0.5')
    assert said.status == 1
    assert 'Traceback' not in said.err


def test_where_nobody_runs_the_domain_is_told(domain: int, tmp_path: Any) -> None:
    said = Terminal('obc', domain, tmp_path).say(
        'param', 'get', '/lqr_node', 'Qx', '--timeout', '0.5')
    assert said.status == 1
    assert f'no node runs on ROS_DOMAIN_ID={domain}: start one' in said.err


def test_it_answers_soon(lqr: Any, domain: int, tmp_path: Any, clock: Any) -> None:
    """Nothing heavy is loaded, and no longer waited than the node takes to be found."""
    obc = Terminal('obc', domain, tmp_path)
    times = []
    for _ in range(3):
        begun = time.monotonic()
        assert obc.say('param', 'get', '/lqr_node', 'Qx').status == 0
        times.append(clock.since(begun))
    assert min(times) < 2.0
    loaded = subprocess.run(
        [sys.executable, '-c', 'import sys; from obc_ros.cli.ros2 import param; '
         'print(*sorted({"casadi", "scipy", "control", "matplotlib", "rich"} & {*sys.modules}))'],
        capture_output=True, text=True, env=support.environment(domain), check=True)
    assert loaded.stdout == '\n'
