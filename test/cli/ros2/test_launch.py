# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc launch` and `obc run`: the nodes of a launch file as processes, over DDS."""

import os
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any

from launched import nodes, RefusedError
from obc_ros.cli.obc import main
from obc_ros.cli.ros2.launch_file import LaunchFile
from obc_ros.core.text.errors import ObcError
import pytest
import support
from support import alive, children, Process, wait_for
from words import Terminal, WORDS

NODES = ('plant_simulator', 'lqr_node', 'trajectory_server')


@pytest.fixture(params=WORDS)
def start(request: pytest.FixtureRequest, domain: int, tmp_path: Path) -> Any:
    """Yield a function that starts a command line; the command ends with the test."""
    begun: list[Process] = []

    def begin(*line: str) -> Process:
        command = Terminal(request.param, domain, tmp_path).command(*line)
        begun.append(Process(command, tmp_path / f'{len(begun)}.log', domain))
        return begun[-1]

    yield begin
    for each in begun:
        each.end()


@pytest.mark.parametrize(('words', 'wanted'), [
    ({}, None), ({'publish_tf': 'false'}, False), ({'publish_tf': 'true'}, True)])
def test_publish_tf_is_that_of_the_parameter_files_unless_it_is_given(words: dict[str, str],
                                                                      wanted: bool | None) -> None:
    started = {each.executable: each for each in nodes('loop.launch.py', **words)}
    assert started['plant_simulator'].values.get('publish_tf') == wanted
    assert not any('publish_tf' in started[each].values
                   for each in ('lqr_node', 'trajectory_server'))


def test_a_problem_takes_the_place_of_the_scenario(tmp_path: Path) -> None:
    """Its plant and its controller get the file, and only parameter files that are given."""
    started = {each.executable: each for each in nodes(
        'loop.launch.py', problem='boat.yaml', controller='mpc')}
    assert {name: each.values.get('problem') for name, each in started.items()} == {
        'plant_simulator': 'boat.yaml', 'mpc_node': 'boat.yaml', 'trajectory_server': None}
    assert not any(each.files for each in started.values())
    given = tmp_path / 'given.yaml'
    given.write_text('/**/mpc_node: {ros__parameters: {rate: 20.0}}')
    for each in nodes('loop.launch.py', problem='boat.yaml', controller='mpc',
                      params_file=str(given)):
        assert each.files == ((given,) if each.name == 'mpc_node' else ())


@pytest.mark.parametrize('words', [{}, {'controller': 'mpc', 'estimator': 'true'}])
def test_a_problem_is_for_mpc_node_without_an_estimator(words: dict[str, str]) -> None:
    with pytest.raises(RefusedError, match='problem:=boat.yaml: wanted controller:=mpc'):
        nodes('loop.launch.py', problem='boat.yaml', **words)


def test_a_loop_is_launched_with_parameters_and_ended(start: Any, probe: Any, tmp_path: Path
                                                      ) -> None:
    """Arguments and a parameter file take effect; Ctrl-C ends all nodes cleanly."""
    (tmp_path / 'tuned.yaml').write_text(
        '/**/lqr_node: {ros__parameters: {x_max: [2.0, 1.0, 1.0]}}')
    loop = start('launch', 'obc_ros', 'loop.launch.py', 'scenario:=vehicle', 'namespace:=car1',
                 f'params_file:={tmp_path / "tuned.yaml"}', 'speed:=2.0')
    for name in NODES:
        probe.wait_for_node(name)
    loop.wait_for_output('car1.lqr_node]: revision 1: vehicle')
    assert list(probe.get_parameters('/car1/lqr_node', 'x_max')['x_max']) == [2.0, 1.0, 1.0]
    assert probe.get_parameters('/car1/plant_simulator', 'speed', 'lockstep', 'publish_clock') == {
        'speed': 2.0, 'lockstep': False, 'publish_clock': False}
    text = loop.output()
    for k, name in enumerate(NODES, start=1):
        assert f'[INFO] [{name}-{k}]: process started with pid [' in text
    assert '[lqr_node-2] [INFO] ' in text
    nodes = [pid for child in [loop.pid, *children(loop.pid)] for pid in children(child)]
    os.kill(loop.pid, signal.SIGINT)
    assert loop.wait(20.0) in (0, 1)
    assert loop.output().count('process has finished cleanly') == len(NODES)
    assert not any(map(alive, nodes))


def test_run_starts_a_node_with_its_parameters(start: Any, probe: Any) -> None:
    node = start('run', 'obc_ros', 'lqr_node', '--ros-args', '-p', 'system:=aircraft',
                 '-p', 'Qx:=[2.0, 1.0, 1.0, 1.0, 1.0, 1.0]', '-p', 'unlimited:=true')
    node.wait_for_output('revision 1: aircraft')
    assert probe.get_parameters('/lqr_node', 'Qx')['Qx'][0] == 2.0


def test_a_killed_launch_leaves_no_node(domain: int, tmp_path: Path) -> None:
    loop = Process([support.find('obc'), 'launch', 'obc_ros', 'loop.launch.py', 'server:=false'],
                   tmp_path / 'log', domain)
    try:
        loop.wait_for_output('revision 1')
        nodes = children(loop.pid)
        assert len(nodes) == 2
        os.kill(loop.pid, signal.SIGKILL)
        wait_for(lambda: not any(map(alive, nodes)))
    finally:
        loop.end()


def test_a_dead_node_is_reported_and_respawned(domain: int, tmp_path: Path) -> None:
    limits = tmp_path / 'limits.yaml'   # without the simulated plant they are needed
    limits.write_text('/**/lqr_node: {ros__parameters: {u_limits: [9.0, 60.0]}}')
    loop = Process([support.find('obc'), 'launch', 'obc_ros', 'loop.launch.py', 'server:=false',
                    'plant:=false', 'respawn:=true', f'params_file:={limits}'],
                   tmp_path / 'log', domain)
    try:
        loop.wait_for_output('revision 1')
        [node] = children(loop.pid)
        os.kill(node, signal.SIGKILL)
        loop.wait_for_output(f'[ERROR] [lqr_node-1]: process has died [pid {node}, exit code -9')
        wait_for(lambda: loop.output().count('revision 1') == 2, 60.0)
        assert children(loop.pid) != [node]
        os.kill(loop.pid, signal.SIGTERM)
        assert loop.wait(20.0) == 0, loop.output()
    finally:
        loop.end()
    assert '[INFO] [lqr_node-1]: process has finished cleanly' in loop.output()


def test_a_launch_ends_with_1_after_a_failed_node(domain: int, tmp_path: Path) -> None:
    """The output contains the error message of the node."""
    (tmp_path / 'bad.yaml').write_text('/**/lqr_node: {ros__parameters: {system: nothing}}')
    done = Terminal('obc', domain, tmp_path).say(
        'launch', 'obc_ros', 'loop.launch.py', 'server:=false', 'plant:=false',
        'params_file:=bad.yaml')
    assert done.status == 1
    assert '[lqr_node-1] lqr_node: ' in done.out
    assert 'process has died' in done.out


@pytest.mark.parametrize(('line', 'wanted'), [
    ('launch obc_ros loop.launch.py scenario:=nonsense',
     "Valid options are: ['aircraft', 'aircraft_limits', 'vehicle', 'vehicle_lateral']"),
    ('launch obc_ros loop.launch.py scenaro:=vehicle', "no argument 'scenaro'; it has scenario"),
    ('launch obc_ros loop.launch.py vehicle', "malformed launch argument 'vehicle'"),
    ('launch obc_ros loop.launch.py plant:=maybe', "wanted 'true' or 'false', got 'maybe'"),
    ('launch obc_ros loop.launch.py speed:=fast', 'could not convert'),
    ('launch obc_ros fleet.launch.py vehicles:=0', 'wanted a number from 1 to 100'),
    ('launch obc_ros nothing.launch.py', 'it has fleet.launch.py, loop.launch.py'),
    ('launch obc_ros', 'which launch file?'),
    ('launch loop scenario:=nonsense',
     "Valid options are: ['aircraft', 'aircraft_limits', 'vehicle', 'vehicle_lateral']"),
    ('launch fleet vehicles:=0', 'wanted a number from 1 to 100'),
    ('launch nowhere loop.launch.py', "package 'nowhere' is not installed"),
    ('run obc_ros nothing', "'obc_ros' has no 'nothing'; it has estimator_node, lqr_node"),
    ('run nowhere lqr_node', "'nowhere' has no 'lqr_node'; it has none")])
def test_a_wrong_command_line_starts_no_node(line: str, wanted: str,
                                             capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 1
    done = capsys.readouterr()
    assert done.out == ''
    assert wanted in done.err


def test_show_args_lists_the_launch_arguments(tmp_path: Path) -> None:
    done = Terminal('obc', 1, tmp_path).say('launch', '--show-args', 'obc_ros', 'loop.launch.py')
    assert done.status == 0
    assert done.out.startswith(
        "Arguments (pass arguments as '<name>:=<value>'):\n\n    'scenario':\n")
    assert "        (default: 'aircraft')\n" in done.out


def test_an_unsupported_launch_file_refers_to_ros2(tmp_path: Path) -> None:
    file = tmp_path / 'x.launch.py'
    file.write_text('from launch.actions import TimerAction\n')
    with pytest.raises(ObcError, match='is for `ros2 launch`: cannot import name'):
        LaunchFile(file)
    with pytest.raises(ObcError, match='there is no launch file'):
        LaunchFile(tmp_path / 'nothing.launch.py')


def test_launch_has_no_heavy_imports(domain: int) -> None:
    loaded = subprocess.run(
        [sys.executable, '-c',
         'import sys; from obc_ros.cli.ros2 import launch, topic, service, action; '
         'print(*sorted({"casadi", "scipy", "control", "matplotlib", "rich"} & {*sys.modules}))'],
        capture_output=True, text=True, env=support.environment(domain), check=True)
    assert loaded.stdout == '\n'
