# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Launch files: what they start, and ten vehicles in namespaces of one machine."""

from pathlib import Path
import signal
from typing import Any

from launch_stand_in import nodes
from lqr_bench import Heard
import pytest
import yaml

VEHICLES = 10


def test_what_a_loop_starts() -> None:
    """Three nodes, or two on a robot, with the parameters of the scenario."""
    loop = nodes('loop.launch.py', scenario='vehicle', namespace='robot1', speed='2.0')
    assert [each.executable for each in loop] == [
        'plant_simulator', 'lqr_node', 'trajectory_server']
    assert {each.namespace for each in loop} == {'robot1'}
    assert loop[0].values == {'use_sim_time': False, 'speed': 2.0, 'lockstep': False,
                              'publish_clock': False}
    assert len(nodes('loop.launch.py', plant='false')) == 2
    for scenario in ('aircraft', 'vehicle', 'vehicle_lateral'):
        for each in nodes('loop.launch.py', scenario=scenario):
            given = yaml.safe_load(each.files[0].read_text(encoding='utf-8'))
            assert given[f'/**/{each.name}']['ros__parameters']
            assert each.files == (each.files[0],) * 2
    for file in ('loop.launch.py', 'fleet.launch.py'):
        for each in nodes(file, params_file='tuned.yaml'):
            assert each.files[0].parent.name == 'config'
            assert each.files[1:] == (Path('tuned.yaml'),)


def test_what_a_fleet_starts() -> None:
    """A loop for each vehicle, in its namespace; a number that is none is answered."""
    fleet = nodes('fleet.launch.py', vehicles='3', prefix='robot')
    assert [(each.namespace, each.executable) for each in fleet] == [
        (f'robot{k}', name) for k in (1, 2, 3) for name in ('plant_simulator', 'lqr_node')]
    there = nodes('fleet.launch.py', namespace='yard', use_sim_time='true', vehicles='1')
    assert {each.namespace for each in there} == {'yard/vehicle1'}
    assert [each.values['use_sim_time'] for each in (fleet[0], *there)] == [False, True, True]
    assert len(nodes('fleet.launch.py')) == 2 * VEHICLES
    assert len(nodes('fleet.launch.py', plant='false')) == VEHICLES
    for wrong in ('0', '-1', 'many', '101'):
        with pytest.raises(ValueError, match='wanted a number from 1 to 100'):
            nodes('fleet.launch.py', vehicles=wrong)


@pytest.mark.parametrize('file', ['loop.launch.py', 'fleet.launch.py'])
def test_it_keeps_to_this_machine_unless_told_otherwise(file: str) -> None:
    """Nobody else on the network finds the nodes."""
    for told, wanted in (({}, 'LOCALHOST'), ({'discovery_range': 'SUBNET'}, 'SUBNET')):
        for each in nodes(file, **told):
            assert each.environment == {'ROS_AUTOMATIC_DISCOVERY_RANGE': wanted}


def test_ten_vehicles_on_one_machine(spawn: Any, probe: Any) -> None:
    """Each loop follows its own plant to its own lane, and none hears another."""
    names = [f'/vehicle{k}' for k in range(1, VEHICLES + 1)]
    heard = {name: Heard(probe, name) for name in names}
    for each in nodes('fleet.launch.py', vehicles=str(VEHICLES)):
        spawn(each.executable, each.values, name=each.name, namespace=f'/{each.namespace}',
              arguments=['--ros-args', '--params-file', str(each.files[0]), '--'])
    probe.wait_for(lambda: all(each.answers for each in heard.values()),
                   what='a command of each')
    lanes = {name: -2.0 + 0.1 * k for k, name in enumerate(names)}
    for name, lane in lanes.items():
        assert probe.set_parameters(f'{name}/lqr_node', setpoint=[0.0, lane, 0.0])[0].successful
    for name in names:  # besides the probe one writes and one reads
        for topic in ('state', 'command'):
            assert probe.node.count_publishers(f'{name}/{topic}') == 1
            assert probe.node.count_subscribers(f'{name}/{topic}') == 2
    probe.wait_for(lambda: all(abs(heard[name].x[1] - lanes[name]) < 5e-3 for name in names),
                   what='each in its lane')
    probe.wait_for(lambda: all(each.answers > 20 for each in heard.values()),
                   what='commands that answer the states of their own plant')
    for name in names:
        elsewhere = set().union(*(heard[other].commands for other in names if other != name))
        assert len(elsewhere & heard[name].states) < 0.01 * len(elsewhere)
    for process in spawn.processes:  # all at once: one after the other takes seconds
        process.popen.send_signal(signal.SIGINT)
    assert [process.wait() for process in spawn.processes] == [0] * 2 * VEHICLES
