# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc param` has the options and the output of `ros2 param`, over DDS."""

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
    node = spawn('lqr_node', {**support.DEMO, 'system': 'aircraft'})
    node.wait_for_output('revision 1')
    return node


def test_get_and_set_print_the_value_or_the_refusal(lqr: Any, probe: Any, terminal: Terminal
                                                    ) -> None:
    """The lines work with `obc` and with `ros2`; a refused value changes nothing."""
    done = terminal.say_here('param', 'get', '/lqr_node', 'Qx')
    assert (done.status, done.out) == (0, 'Double values are: []\n'), done
    done = terminal.say_here('param', 'set', '/lqr_node', 'Qx', '[100, 1, 0.698, 0, 0, 0]')
    assert (done.status, done.out) == (0, 'Set parameter successful\n'), done
    weights = [100.0, 1.0, 0.698, 0.0, 0.0, 0.0]
    assert list(probe.get_parameters('/lqr_node', 'Qx')['Qx']) == weights
    done = terminal.say_here('param', 'get', '--hide-type', 'lqr_node', 'Qx')
    assert done.out == f'{weights}\n'
    done = terminal.say_here('param', 'set', '/lqr_node', 'Qu', '[-0.1, 0.1]')
    assert done.err == ('Setting parameter failed: Qu[0] = -0.1: '
                        'Qu must be positive definite\n')
    assert done.status == (terminal.word == 'obc')  # `ros2` returns 0 after a refusal
    assert list(probe.get_parameters('/lqr_node', 'Qu')['Qu']) == []
    done = terminal.say_here('param', 'set', '/lqr_node', 'delay', '-0.05')
    assert 'Setting parameter failed' in done.err


def test_list_and_describe_show_the_parameters(lqr: Any, terminal: Terminal) -> None:
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


def test_dump_and_load_use_the_parameter_file_format(lqr: Any, probe: Any, terminal: Terminal
                                                     ) -> None:
    """The format is that of `--params-file`."""
    assert probe.set_parameters('/lqr_node', Qx=[2.0] * 6)[0].successful
    dumped = terminal.say_here('param', 'dump', '/lqr_node')
    tree = yaml.safe_load(dumped.out)
    assert dumped.status == 0
    assert dumped.out.startswith('/lqr_node:\n  ros__parameters:\n')
    assert tree['/lqr_node']['ros__parameters']['Qx'] == [2.0] * 6
    assert tree['/lqr_node']['ros__parameters']['qos_overrides']['/command']['publisher']
    (terminal.folder / 'tuned.yaml').write_text(
        '/lqr_node:\n  ros__parameters:\n    Qx: [3.0, 3.0, 3.0, 3.0, 3.0, 3.0]\n')
    done = terminal.say_here('param', 'load', '/lqr_node', 'tuned.yaml')
    assert done.out == 'Set parameter Qx successful\n'
    assert list(probe.get_parameters('/lqr_node', 'Qx')['Qx']) == [3.0] * 6


def test_load_sets_all_parameters_of_a_file_or_none(lqr: Any, probe: Any, domain: int,
                                                    tmp_path: Any) -> None:
    obc = Terminal('obc', domain, tmp_path)
    before = list(probe.get_parameters('/lqr_node', 'Qx')['Qx'])
    (tmp_path / 'half.yaml').write_text(
        '/lqr_node: {ros__parameters: {Qx: [3.0, 3.0, 3.0, 3.0, 3.0, 3.0], Qu: [-1.0]}}\n')
    done = obc.say_here('param', 'load', '/lqr_node', 'half.yaml')
    assert (done.status, done.out) == (1, '')
    assert done.err.startswith('No parameter of the file is set: Qu')
    assert list(probe.get_parameters('/lqr_node', 'Qx')['Qx']) == before


def test_load_reads_numbers_as_ros_reads_them(lqr: Any, probe: Any, domain: int, tmp_path: Any
                                              ) -> None:
    """YAML 1.1 takes 1e-9 for a text, and a list with 1 and 0.5 has two types."""
    obc, file = Terminal('obc', domain, tmp_path), tmp_path / 'tuned.yaml'
    for numbers in ('[1e-9, 1.0, 1.0, 1.0, 1.0, 1.0]', '[1, 1, 1, 1, 1, 1e-9]',
                    '[1E-9, +1e0, .5e1, 1.e+0, 1.5, 1]', '[1.0e-9, 1, 1, 1, 1, 1]'):
        file.write_text(f'/lqr_node: {{ros__parameters: {{Qx: {numbers}}}}}\n')
        done = obc.say_here('param', 'load', '/lqr_node', 'tuned.yaml')
        assert (done.status, done.out) == (0, 'Set parameter Qx successful\n'), done
        assert list(probe.get_parameters('/lqr_node', 'Qx')['Qx']) == [
            float(number) for number in numbers[1:-1].split(',')]
    file.write_text('/lqr_node: {ros__parameters: {Qx: [1e-9, 1, 1, 1, 1, 1], Qu: [-1e-9, 1]}}\n')
    done = obc.say_here('param', 'load', '/lqr_node', 'tuned.yaml')
    assert (done.status, done.out) == (1, '')
    assert done.err.startswith('No parameter of the file is set: Qu')
    assert list(probe.get_parameters('/lqr_node', 'Qx')['Qx']) == [1e-9, 1, 1, 1, 1, 1]


def test_a_text_that_looks_like_a_number_is_dumped_and_loaded_as_a_text(
        lqr: Any, probe: Any, domain: int, tmp_path: Any) -> None:
    obc = Terminal('obc', domain, tmp_path)
    assert probe.set_parameters('/lqr_node', hardware_id='1e-9')[0].successful
    dumped = obc.say_here('param', 'dump', '/lqr_node')
    assert "hardware_id: '1e-9'\n" in dumped.out
    (tmp_path / 'all.yaml').write_text(dumped.out)
    assert probe.set_parameters('/lqr_node', hardware_id='other')[0].successful
    done = obc.say_here('param', 'load', '/lqr_node', 'all.yaml')
    assert (done.status, done.err) == (0, '')
    assert probe.get_parameters('/lqr_node', 'hardware_id') == {'hardware_id': '1e-9'}


def test_a_number_that_no_parameter_can_hold_is_named(lqr: Any, domain: int, tmp_path: Any
                                                      ) -> None:
    obc = Terminal('obc', domain, tmp_path)
    for number in ('9' * 400, f'[0.5, {"9" * 400}]'):
        (tmp_path / 'wrong.yaml').write_text(f'/lqr_node: {{ros__parameters: {{Qx: {number}}}}}')
        done = obc.say_here('param', 'load', '/lqr_node', 'wrong.yaml')
        assert (done.status, done.out) == (1, '')
        assert 'is no parameter file: Qx' in done.err


def test_errors_name_the_cause_and_the_choices(lqr: Any, domain: int, tmp_path: Any) -> None:
    """The choices are running nodes, similar parameters, and the nodes of a file."""
    obc = Terminal('obc', domain, tmp_path)
    done = obc.say_here('param', 'get', '/lqr', 'Qx', '--timeout', '2')
    assert (done.status, done.out) == (1, '')
    assert done.err == ('obc param: Node not found: no node /lqr within 2 s; '
                        'running: /lqr_node\n')
    done = obc.say_here('param', 'get', '/lqr_node', 'setpoints')
    assert (done.status, done.out) == (1, 'Parameter not set.\n')
    assert done.err.startswith("/lqr_node has no parameter 'setpoints'; did you mean setpoint")
    done = obc.say_here('param', 'describe', '/lqr_node', 'zzz')
    assert done.status == 1
    assert done.err.endswith('see obc param list /lqr_node\n')
    (tmp_path / 'others.yaml').write_text('/a: {ros__parameters: {Qx: [1.0]}}\n'
                                          '/b: {ros__parameters: {Qx: [1.0]}}\n')
    done = obc.say_here('param', 'load', '/lqr_node', 'others.yaml')
    assert done.status == 1
    assert 'has nothing for /lqr_node, only for /a, /b' in done.err
    for wrong in ('[', '- 1', 'text'):
        (tmp_path / 'wrong.yaml').write_text(wrong)
        done = obc.say_here('param', 'load', '/lqr_node', 'wrong.yaml')
        assert done.status == 1
        assert 'is no parameter file' in done.err
    done = obc.say_here('param', 'set', '/lqr_node', 'Qx', '[1, ')
    assert done.status == 1
    assert 'wanted a list of numbers' in done.err
    done = obc.say_here('param', 'list', '/bad name', '--timeout', '0.5')
    assert done.status == 1
    assert 'Traceback' not in done.err


def test_without_nodes_the_error_names_the_domain(domain: int, tmp_path: Any) -> None:
    done = Terminal('obc', domain, tmp_path).say(
        'param', 'get', '/lqr_node', 'Qx', '--timeout', '0.5')
    assert done.status == 1
    assert f'no node runs on ROS_DOMAIN_ID={domain}: start one' in done.err


def test_get_takes_less_than_2_s(lqr: Any, domain: int, tmp_path: Any, clock: Any) -> None:
    """It imports no heavy package, and waits only until the node is discovered."""
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
