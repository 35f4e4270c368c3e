# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Messages in YAML: filling, refusals that name the field, and conversion back."""

from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovariance
from obc_ros.cli.ros2.yaml_messages import (
    convert_to_plain,
    convert_to_yaml,
    FieldError,
    fill,
    find_type,
    parse_values,
)
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import LqrDesign, State
from obc_ros.srv import DesignLqr, SolveOptimalControl
import pytest
from rcl_interfaces.msg import ParameterDescriptor, ParameterValue
import yaml


def test_yaml_fills_a_request() -> None:
    request = fill(DesignLqr.Request(), parse_values(
        '{system: aircraft, weights: {qx: [1, 2.5, 1e-9], rho: 3}}'))
    assert request.system == 'aircraft'
    assert list(request.weights.qx) == [1.0, 2.5, 1e-9]
    assert request.weights.rho == 3.0
    problem = fill(SolveOptimalControl.Request(), parse_values(
        '{problem: {states: [p], dynamics: [{name: p, expression: u}], running_cost: 1, '
        'final_time: {free: true}}}')).problem
    assert problem.dynamics[0].name == 'p'
    assert problem.dynamics[0].expression == 'u'
    assert problem.running_cost == '1'
    assert problem.final_time.free is True


@pytest.mark.parametrize(('text', 'words'), [
    ('{weights: {q: [1]}}', 'weights.q: there is no such field; there is weights, qx'),
    ('{weights: {qx: [1, a]}}', 'weights.qx[1]: a is no number'),
    ('{weights: {qx: 1}}', 'weights.qx: 1 is no list'),
    ('{weights: 1}', 'weights: 1 is no mapping of the fields of obc_ros/msg/LqrWeights'),
    ('{weights: {rho: true}}', 'weights.rho: True is no number'),
    ('{system: [a]}', "system: ['a'] is no text"),
    ('{system: null}', 'system: None is no text'),
    ('{"\\e[2J": 1}', '\\x1b[2J: there is no such field'),
    ('[1, 2]', 'is no mapping of fields'), ('1', 'is no mapping'), ('', 'is no mapping'),
    ('{a: [}', 'not YAML')])
def test_a_value_of_the_wrong_type_names_its_field(text: str, words: str) -> None:
    with pytest.raises(FieldError) as error:
        fill(DesignLqr.Request(), parse_values(text))
    assert words in str(error.value)


@pytest.mark.parametrize(('message', 'values', 'words'), [
    (ParameterValue(), {'type': 300}, 'type: 300 is not from 0 to 255'),
    (ParameterValue(), {'type': -1}, 'type: -1 is not from 0 to 255'),
    (ParameterValue(), {'integer_value': 0.5}, 'integer_value: 0.5 is no integer'),
    (ParameterValue(), {'bool_value': 1}, 'bool_value: 1 is neither true nor false'),
    (ParameterValue(), {'integer_value': float('inf')}, 'integer_value: inf is no integer'),
    (Time(), {'sec': 2 ** 31}, 'sec: 2147483648 is not from -2147483648 to 2147483647'),
    (ParameterValue(), {'byte_array_value': [1, 256]}, 'byte_array_value[1]: 256 is not from 0'),
    (ParameterValue(), {'string_value': '\ud800'}, 'string_value: \\ud800 cannot be sent'),
    (ParameterDescriptor(), {'integer_range': [{}, {}]},
     'integer_range has 2 entries; wanted 1 at most'),
    (PoseWithCovariance(), {'covariance': [1.0]}, 'covariance has 1 entries; wanted 36')])
def test_a_value_out_of_range_names_its_field(message: Any, values: Any, words: str) -> None:
    with pytest.raises(FieldError) as error:
        fill(message, values)
    assert words in str(error.value)


def test_yaml_fills_arrays_bytes_and_times() -> None:
    value = fill(ParameterValue(), {'type': 5, 'byte_array_value': [1, 2]})
    assert value.byte_array_value == [b'\x01', b'\x02']
    pose = fill(PoseWithCovariance(), {'covariance': list(range(36))})
    assert list(pose.covariance) == list(map(float, range(36)))
    now = Time(sec=3)
    assert fill(State(), {'header': 'auto'}, now=now).header.stamp == now
    assert fill(State(), {'header': {'stamp': 'now'}}, now=now).header.stamp == now
    with pytest.raises(FieldError, match='header: auto is no mapping'):
        fill(State(), {'header': 'auto'})


def test_a_message_is_unchanged_by_yaml_and_back() -> None:
    design = LqrDesign(revision=3, system='ü', k=[1.0, float('inf')], state_names=['a'])
    text = convert_to_yaml(design)
    assert 'system: ü\n' in text
    assert '- .inf\n' in text
    assert text.startswith('header:\n  stamp:\n')
    assert fill(LqrDesign(), yaml.safe_load(text)) == design
    short = convert_to_plain(design, no_arr=True, no_str=True)
    assert short['k'] == '<sequence type: double, length: 2>'
    assert short['state_names'] == '<sequence type: string, length: 1>'
    assert short['system'] == '<string length: <1>>'
    assert convert_to_plain(LqrDesign(k=[1.0] * 5, system='abcd'), truncate=2)['k'] == [1.0, 1.0,
                                                                                        '...']
    assert convert_to_plain(LqrDesign(system='abcd'), truncate=2)['system'] == 'ab...'


@pytest.mark.parametrize('name', [
    'obc_ros/srv/Nothing', 'nowhere/srv/A', 'obc_ros', 'os/path', 'obc_ros/msg/State', 'a/b/c/d',
    'obc_ros/srv/os', '', '../srv/A'])
def test_an_unknown_type_is_refused(name: str) -> None:
    with pytest.raises(ObcError):
        find_type(name, 'srv')
    assert find_type('obc_ros/DesignLqr', 'srv') is find_type('obc_ros/srv/DesignLqr', 'srv')
