# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A node loads the output of `ros2 param dump`, and starts with it, without a change."""

from pathlib import Path
from typing import Any

from launched import ROOT
import pytest
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
import yaml

NODES = ('plant_simulator', 'lqr_node', 'trajectory_server')
SCENARIOS = sorted(each.stem for each in (ROOT / 'config').glob('*.yaml'))


def dump(probe: Any, node: str, file: Path) -> dict[str, Any]:
    """Write the parameters of a node as `ros2 param dump` does, and return them."""
    names = sorted(probe.call(ListParameters, f'{node}/list_parameters').result.names)
    values = probe.call(
        GetParameters, f'{node}/get_parameters', GetParameters.Request(names=names)).values
    parameters: dict[str, Any] = {}
    for name, value in zip(names, map(parameter_value_to_python, values), strict=True):
        *above, last = name.split('.')
        inner = parameters
        for each in above:
            inner = inner.setdefault(each, {})
        inner[last] = value
    file.write_text(yaml.dump({node: {'ros__parameters': parameters}}, default_flow_style=False))
    return parameters


def load(probe: Any, node: str, file: Path) -> dict[str, str]:
    """Load a file as `ros2 param load` does; return the reason of each refusal."""
    names = list(parameter_dict_from_yaml_file(
        str(file), use_wildcard=True, target_nodes=[node]))
    client = AsyncParameterClient(probe.node, node)
    probe.wait_for(client.services_are_ready, what=f'parameter services of {node}')
    future = client.load_parameter_file(str(file), use_wildcard=True)
    results = probe.wait_for(future.done) and future.result().results
    return {name: each.reason for name, each in zip(names, results, strict=True)
            if not each.successful}


def cases() -> list[tuple[str, str]]:
    """Return each node without a scenario, and with each scenario of distinct parameters."""
    found: dict[str, tuple[str, str]] = {}
    for executable in NODES:
        found[executable] = (executable, '')
        for scenario in SCENARIOS:
            file = ROOT / 'config' / f'{scenario}.yaml'
            given = yaml.safe_load(file.read_text(encoding='utf-8'))[f'/**/{executable}']
            found.setdefault(f'{executable}{given}', (executable, scenario))
    return [*found.values()]


@pytest.mark.parametrize(('executable', 'scenario'), cases())
def test_dumped_parameters_load_without_a_change(spawn: Any, probe: Any, tmp_path: Path,
                                                 executable: str, scenario: str) -> None:
    """All parameters are accepted; a node started with them has the same values."""
    given = ['--ros-args', '--params-file', str(ROOT / 'config' / f'{scenario}.yaml'), '--']
    spawn(executable, arguments=given if scenario else (), namespace='/one')
    first, second = tmp_path / 'first.yaml', tmp_path / 'second.yaml'
    parameters = dump(probe, f'/one/{executable}', first)
    assert load(probe, f'/one/{executable}', first) == {}
    dump(probe, f'/one/{executable}', second)
    assert second.read_text() == first.read_text()
    other = tmp_path / 'other.yaml'
    other.write_text(first.read_text().replace('/one/', '/two/'))
    spawn(executable, arguments=['--ros-args', '--params-file', str(other), '--'],
          namespace='/two')
    again = dump(probe, f'/two/{executable}', second)
    for each in (parameters, again):  # their names contain the namespace
        each.pop('qos_overrides', None)
    assert again == parameters


def test_tuned_parameters_load_into_a_new_node(spawn: Any, probe: Any, tmp_path: Path) -> None:
    """Cases: numbers that YAML reads as text, text for a list, infinity, lists of integers."""
    tuned = {
        'integral': ['px'], 'Qi': [1e-9], 'Qx': [1e-9, 1.0, 1.0, 1.0, 1.0, 1.0],
        'Qu': [1, 2], 'rate': 100.0, 'delay': 1e-9, 'stability': 1e-9,
        'x_limits': [float('inf')] * 5 + [1e9], 'transition_time': 1e-9, 'frame_id': 'map'}
    words = {'hardware_id': '0042', 'frame_id': 'on'}
    spawn('lqr_node', name='tuned')
    results = probe.set_parameters('/tuned', **tuned)
    assert [each.reason for each in results] == [''] * len(tuned)
    file = tmp_path / 'tuned.yaml'
    parameters = dump(probe, '/tuned', file)
    assert {name: parameters[name] for name in tuned} == tuned
    for name, word in words.items():
        assert probe.set_parameters('/tuned', **{name: word})[0].successful
        assert load(probe, '/tuned', (dump(probe, '/tuned', file), file)[1]) == {}
        assert probe.get_parameters('/tuned', name) == {name: word}
    assert not probe.set_parameters('/tuned', hardware_id=43)[0].successful
    assert probe.set_parameters('/tuned', hardware_id='', frame_id='map')[0].successful
    assert dump(probe, '/tuned', file) == parameters
    spawn('lqr_node', name='fresh')
    # Kilted loads the section of this node only, Jazzy that of any node.
    file.write_text(file.read_text().replace('/tuned:', '/fresh:'))
    assert load(probe, '/fresh', file) == {}
    assert dump(probe, '/fresh', file) == parameters
    for line, kept in (('integral: py', ['py']), ('integral: []\n    Qi: []', []),
                       ('integral: [px]\n    Qi: 2', ['px'])):
        file.write_text(f'/fresh:\n  ros__parameters:\n    {line}\n')
        assert load(probe, '/fresh', file) == {}
        assert probe.get_parameters('/fresh', 'integral') == {'integral': kept}
    file.write_text('/fresh:\n  ros__parameters:\n    Qx: [1, 1, 1, 1, 1, 2]\n    rate: .nan\n')
    assert load(probe, '/fresh', file) == {'rate': 'rate = nan: wanted a finite number'}
    assert probe.get_parameters('/fresh', 'Qx') == {'Qx': [1.0, 1.0, 1.0, 1.0, 1.0, 2.0]}


# Sections and names at the start


@pytest.mark.parametrize(('text', 'sentence'), [
    ('lqr_nodes: {ros__parameters: {Qx: [1.0]}}', '{} has no section for /lqr_node; it has '
     '/lqr_nodes'),
    ('/robot/lqr_node: {ros__parameters: {rate: 1.0}}\nplant_simulator: {ros__parameters: {}}',
     '{} has no section for /lqr_node; it has /robot/lqr_node, /plant_simulator'),
    ('{}', '{} has no section for /lqr_node; it has no section'),
    ('lqr_node: {ros__parameters: {u_limit: [9.0, 60.0]}}',
     "no parameter 'u_limit'; did you mean 'u_limits'?"),
    ('/**/lqr_node: {ros__parameters: {system_parameters: {mass: 1.0}}}',
     "no parameter 'system_parameters.mass'; did you mean 'system_parameters.m'?"),
    ('/**: {ros__parameters: {speed: 2.0}}\nlqr_node: {ros__parameters: {speed: 2.0}}',
     "no parameter 'speed'")])
def test_a_file_or_a_name_that_does_not_fit_refuses_the_start(spawn: Any, tmp_path: Path,
                                                              text: str, sentence: str) -> None:
    """Row 18: no regulator of another plant, and none without limits, starts by a typo."""
    file = tmp_path / 'given.yaml'
    file.write_text(text)
    process = spawn('lqr_node', arguments=['--ros-args', '--params-file', str(file), '--'])
    assert process.wait() == 1
    assert process.output().splitlines()[-1] == 'lqr_node: ' + sentence.replace('{}', str(file))


def test_an_unknown_argument_refuses_the_start(spawn: Any) -> None:
    process = spawn('lqr_node', arguments=['--ros-args', '-p', 'u_limit:=[9.0, 60.0]', '--'])
    assert process.wait() == 1
    assert process.output().splitlines()[-1] == (
        "lqr_node: no parameter 'u_limit'; did you mean 'u_limits'?")


@pytest.mark.parametrize('section', [
    '/**', '/*', '/b/lqr_node', 'lqr_node', '/*/lqr_node', '/**/lqr_node', '/a/lqr_node',
    'a/lqr_node'])
def test_sections_are_those_that_ros_uses(spawn: Any, probe: Any, tmp_path: Path, section: str
                                          ) -> None:
    """The node starts if and only if rcl gives it the values; /** may have those of others."""
    file, other = tmp_path / 'given.yaml', ', speed: 2.0' if section == '/**' else ''
    file.write_text(f'{section}: {{ros__parameters: {{rate: 33.0, use_sim_time: true{other}}}}}')
    process = spawn('lqr_node', arguments=['--ros-args', '--params-file', str(file), '--'],
                    namespace='/a')
    if section in ('/*', '/b/lqr_node', 'lqr_node'):
        assert process.wait() == 1
        assert f'{file} has no section for /a/lqr_node' in process.output()
        return
    assert probe.get_parameters('/a/lqr_node', 'rate') == {'rate': 33.0}
    if other:
        process.wait_for_output('ignored, not parameters of this node: speed')


def test_a_section_in_a_section_is_that_of_a_namespace(spawn: Any, probe: Any, tmp_path: Path
                                                       ) -> None:
    file = tmp_path / 'given.yaml'
    file.write_text('a: {lqr_node: {ros__parameters: {rate: 33.0}}}')
    spawn('lqr_node', arguments=['--ros-args', '--params-file', str(file), '--'], namespace='/a')
    assert probe.get_parameters('/a/lqr_node', 'rate') == {'rate': 33.0}
