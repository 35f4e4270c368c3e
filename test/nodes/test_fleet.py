# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Launch files: nodes, parameters and arguments; vehicles in namespaces."""

from pathlib import Path
import signal
from typing import Any

from launched import nodes, RefusedError, ROOT
from lqr_bench import Heard
from obc_ros.cli.ros2.launch_file import LaunchFile
from obc_ros.nodes.control.command_sinks import SINKS
from obc_ros.ros.state_sources import SOURCES
import pytest
import yaml

VEHICLES = 10   # of fleet.launch.py without an argument
FILES = ('loop.launch.py', 'fleet.launch.py')


def choices_of(file: str) -> dict[str, list[str]]:
    """Return the allowed values of the arguments of a launch file that has a list of them."""
    return {each.name: list(each.choices) for each in LaunchFile(ROOT / 'launch' / file).arguments
            if each.choices is not None}


def test_the_loop_starts_its_nodes_with_the_scenario() -> None:
    """Three nodes start, or two on a robot."""
    loop = nodes('loop.launch.py', scenario='vehicle', namespace='robot1', speed='2.0')
    assert [each.executable for each in loop] == [
        'plant_simulator', 'lqr_node', 'trajectory_server']
    assert {each.namespace for each in loop} == {'robot1'}
    assert loop[0].values == {'use_sim_time': False, 'speed': 2.0, 'lockstep': False,
                              'publish_clock': False}
    assert [each.executable for each in nodes('loop.launch.py', plant='false')] == [
        'lqr_node', 'trajectory_server']
    assert [each.executable for each in nodes('loop.launch.py', server='false')] == [
        'plant_simulator', 'lqr_node']
    for scenario in ('aircraft', 'vehicle', 'vehicle_lateral'):
        for each in nodes('loop.launch.py', scenario=scenario):
            given = yaml.safe_load(each.files[0].read_text(encoding='utf-8'))
            assert given[f'/**/{each.name}']['ros__parameters']
            assert len(each.files) == 1


@pytest.mark.parametrize('file', FILES)
def test_a_parameter_file_overrides_the_scenario(file: str, tmp_path: Path) -> None:
    """The file comes after that of the scenario, and the last value of a parameter counts."""
    tuned = tmp_path / 'tuned.yaml'
    tuned.write_text('/**: {ros__parameters: {workers: 2}}')
    for each in nodes(file, params_file=str(tuned)):
        assert each.files[0].parent.name == 'config'
        assert each.files[1:] == (tuned,)


@pytest.mark.parametrize('file', FILES)
def test_a_node_gets_the_files_with_a_section_for_it(file: str, tmp_path: Path) -> None:
    """A file with a section for no node is refused: a name in it is misspelt."""
    tuned = tmp_path / 'tuned.yaml'
    tuned.write_text('/**/lqr_node: {ros__parameters: {Qx: [2.0, 1.0, 1.0]}}')
    for each in nodes(file, params_file=str(tuned)):
        assert (tuned in each.files) == (each.name == 'lqr_node')
    tuned.write_text('/**/lqr_nodes: {ros__parameters: {Qx: [2.0, 1.0, 1.0]}}')
    with pytest.raises(RefusedError, match='it has no section for a node of this'):
        nodes(file, params_file=str(tuned))


@pytest.mark.parametrize('file', FILES)
@pytest.mark.parametrize(('arguments', 'is_robot'), [
    ({}, False), ({'command_sink': 'command'}, False), ({'plant': 'false'}, True),
    ({'command_sink': 'cmd_vel'}, True), ({'command_sink': 'wrench'}, True)])
def test_only_a_simulated_plant_declines_the_protections(file: str, arguments: dict[str, str],
                                                         is_robot: bool) -> None:
    """The scenario declines them; the last file with a section counts."""
    for each in nodes(file, scenario='vehicle', **arguments):
        values: dict[str, Any] = {}
        for given in each.files:
            for section in yaml.safe_load(given.read_text(encoding='utf-8')).items():
                if section[0] == '/**/lqr_node':
                    values |= section[1]['ros__parameters']
        if each.name == 'lqr_node':
            assert (values['unlimited'], values['transition_time']) == (
                (False, 1.0) if is_robot else (True, 0.0))


@pytest.mark.parametrize('file', FILES)
@pytest.mark.parametrize(('arguments', 'sentence'), [
    ({'scenario': 'nonsense'},
     r'"scenario".* "nonsense".*\[\'aircraft\', \'aircraft_limits\', \'vehicle\', '
     r'\'vehicle_lateral\'\]'),
    ({'scenario': '../config/aircraft'},
     r'\[\'aircraft\', \'aircraft_limits\', \'vehicle\', \'vehicle_lateral\'\]'),
    ({'params_file': 'missing.yaml'}, 'params_file:=missing.yaml: there is no such file'),
    ({'params_file': '.'}, 'params_file:=.: there is no such file'),
    ({'plant': 'maybe'}, 'maybe'),
    ({'respawn': 'maybe'}, 'maybe'),
    ({'command_sink': 'cmd_val'}, "'command', 'cmd_vel', 'wrench'"),
    ({'state_source': 'imu'}, "'state', 'odom'"),
])
def test_wrong_arguments_are_refused_before_a_node_starts(file: str, arguments: dict[str, str],
                                                          sentence: str) -> None:
    """A misspelt argument does not start a plant with default values."""
    with pytest.raises(RefusedError, match=sentence):
        nodes(file, **arguments)


def test_no_scenario_disturbs_its_plant() -> None:
    """A loop that somebody tunes has no gust that he did not ask for."""
    for file in (ROOT / 'config').glob('*.yaml'):
        given = yaml.safe_load(file.read_text(encoding='utf-8'))
        assert 'disturbance' not in given['/**/plant_simulator']['ros__parameters'], file


def test_scenarios_are_the_files_of_config() -> None:
    """A new file in config is a scenario without further changes."""
    for file in FILES:
        listed = choices_of(file)['scenario']
        assert listed == sorted(each.stem for each in (ROOT / 'config').glob('*.yaml'))


@pytest.mark.parametrize('file', FILES)
def test_sink_and_source_are_passed_to_the_nodes(file: str) -> None:
    """They are set only when given, as a parameter file may contain other values."""
    asked = {'command_sink': 'cmd_vel', 'state_source': 'odom'}
    expected = {'lqr_node': asked, 'trajectory_server': {'state_source': 'odom'}}
    for each in nodes(file, **asked):
        found = {name: each.values[name] for name in asked if name in each.values}
        assert found == expected.get(each.executable, {})
    for each in nodes(file):
        assert not asked.keys() & each.values.keys()
    choices = choices_of(file)
    assert choices['command_sink'] == ['', *SINKS]
    assert choices['state_source'] == ['', *SOURCES]


@pytest.mark.parametrize(('file', 'extra'), [*zip(FILES, ({}, {'vehicles': '2'}), strict=True)])
def test_all_nodes_respawn_on_request(file: str, extra: dict[str, str]) -> None:
    """By default none does."""
    assert all(each.respawn for each in nodes(file, respawn='true', **extra))
    assert not any(each.respawn for each in nodes(file, **extra))


def test_a_fleet_starts_a_loop_for_each_vehicle() -> None:
    """Each loop is in the namespace of its vehicle; an invalid number is refused."""
    fleet = nodes('fleet.launch.py', vehicles='3', prefix='robot')
    assert [(each.namespace, each.executable) for each in fleet] == [
        (f'robot{k}', name) for k in (1, 2, 3) for name in ('plant_simulator', 'lqr_node')]
    there = nodes('fleet.launch.py', namespace='yard', use_sim_time='true', vehicles='1')
    assert {each.namespace for each in there} == {'yard/vehicle1'}
    assert [each.values['use_sim_time'] for each in (fleet[0], *there)] == [False, True, True]
    assert len(nodes('fleet.launch.py')) == 2 * VEHICLES
    assert len(nodes('fleet.launch.py', plant='false')) == VEHICLES
    for wrong in ('0', '-1', 'many', '101'):
        with pytest.raises(RefusedError, match='wanted a number from 1 to 100'):
            nodes('fleet.launch.py', vehicles=wrong)


@pytest.mark.parametrize('file', FILES)
def test_discovery_is_restricted_to_this_machine_by_default(
        file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other machines of the network do not discover the nodes."""
    monkeypatch.delenv('ROS_AUTOMATIC_DISCOVERY_RANGE')
    for options, wanted in (({}, 'LOCALHOST'), ({'discovery_range': 'SUBNET'}, 'SUBNET')):
        for each in nodes(file, **options):
            assert each.environment == {'ROS_AUTOMATIC_DISCOVERY_RANGE': wanted}


def test_vehicles_follow_their_own_set_points(spawn: Any, probe: Any) -> None:
    """Each loop controls its own plant, and receives no message of another loop."""
    count = 4
    names = [f'/vehicle{k}' for k in range(1, count + 1)]
    received = {name: Heard(probe, name) for name in names}
    for each in nodes('fleet.launch.py', vehicles=str(count)):
        spawn(each.executable, each.values, name=each.name, namespace=f'/{each.namespace}',
              arguments=['--ros-args', '--params-file', str(each.files[0]), '--'])
    probe.wait_for(lambda: all(each.answers for each in received.values()),
                   what='a command of each')
    lanes = {name: -2.0 + 0.1 * k for k, name in enumerate(names)}
    for name, lane in lanes.items():
        assert probe.set_parameters(f'{name}/lqr_node', setpoint=[0.0, lane, 0.0])[0].successful
    for name in names:  # one publisher, and one subscriber besides the probe
        for topic in ('state', 'command'):
            assert probe.node.count_publishers(f'{name}/{topic}') == 1
            assert probe.node.count_subscribers(f'{name}/{topic}') == 2
    probe.wait_for(lambda: all(abs(received[name].x[1] - lanes[name]) < 5e-3 for name in names),
                   what='each in its lane')
    probe.wait_for(lambda: all(each.answers > 20 for each in received.values()),
                   what='commands that answer the states of their own plant')
    for name in names:
        elsewhere = set().union(*(received[other].commands for other in names if other != name))
        assert len(elsewhere & received[name].states) < 0.01 * len(elsewhere)
    for process in spawn.processes:  # all at once, since one at a time expected seconds
        process.popen.send_signal(signal.SIGINT)
    assert [process.wait() for process in spawn.processes] == [0] * 2 * count
