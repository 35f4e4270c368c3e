# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: accepted values, and the reason for each refusal."""

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math
from typing import Any

from hypothesis import given, settings, strategies
from obc_ros.core.text.errors import JoinedStatementError, ObcError, StatementError
from obc_ros.ros.parameters.node_parameters import (
    declare_field,
    group,
    ParameterRow,
    Parameters,
    StartValues,
    Value,
)
from obc_ros.ros.parameters.system_parameters import list_system_parameters
import pytest
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter


@dataclass(frozen=True)
class Settings:
    """A table with every kind of parameter."""

    system: str = declare_field('aircraft', 'registered system', read_only=True)
    system_parameters: Mapping[str, Value] = group(list_system_parameters)
    Qx: tuple[float, ...] = declare_field((1.0, 1.0), 'state weight')
    Qu: tuple[float, ...] = declare_field((1.0,), 'input weight', lower=0.0)
    x_max: tuple[float, ...] = declare_field((), 'scales')
    u_max: tuple[float, ...] = declare_field((), 'limits', finite=False)
    rate: float = declare_field(0.0, 'commands a second', 'Hz', lower=0.0)
    delay: float = declare_field(0.0, 'input delay', 's', lower=0.0, upper=1.0)
    steps: int = declare_field(10, 'number of steps', lower=1)
    lockstep: bool = declare_field(False, 'wait for the command')
    on_stale: str = declare_field('hold', 'what to do', choices=('equilibrium', 'hold', 'silent'))
    integral: tuple[str, ...] = declare_field((), 'names of states', texts=True)
    gust: float = declare_field(0.0, 'gust', name='disturbance.gust')
    smooth: float = declare_field(0.0, 'time', default_given=('system', 1.0))


def give(text: str) -> StartValues:
    """Return the start values of a text such as ``rate=2.0 Qx=(3.0,)``."""
    if text == 'nothing':
        raise StatementError('nothing: it gives no value')
    if text == 'faults':
        raise JoinedStatementError('faults: one', 'two')
    return StartValues({name: ast.literal_eval(value) for name, value in (
        each.split('=') for each in text.split())}, 'values for a test')


@dataclass(frozen=True)
class StartSettings(Settings):
    """The table with a parameter that gives others."""

    start: str = declare_field('', 'start values of the others', read_only=True, gives=give)


class Target:
    """A node with the table; it refuses sum(Qx) + sum(Qu) > 100."""

    def __init__(self, context: Any, given: Mapping[str, Any] | None = None,
                 table: type[Settings] = Settings) -> None:
        self.node = Node(
            'lqr_node', context=context, allow_undeclared_parameters=True,
            parameter_overrides=[Parameter(name, value=value)
                                 for name, value in (given or {}).items()])
        self.adopted: list[Settings] = []
        self.refused: list[str] = []
        self.parameters = Parameters(
            self.node, table, self.judge, self.adopted.append, self.refused.append)

    def judge(self, settings: Settings) -> Settings:
        if sum(settings.Qx) + sum(settings.Qu) > 100.0:
            raise StatementError('Qx and Qu: too much together')
        return settings

    def set(self, **values: Any) -> Any:
        return self.node.set_parameters_atomically(
            [each if isinstance(each := value, Parameter) else Parameter(name, value=value)
             for name, value in values.items()])


@pytest.fixture
def target(probe: Any) -> Iterator[Target]:
    """Yield the node under test, spun by the executor of the probe."""
    target = Target(probe.context)
    probe.add(target.node)
    yield target
    target.node.destroy_node()


def test_a_node_starts_with_the_defaults(target: Target) -> None:
    """The settings are the table's defaults and include the parameters of the system."""
    settings = target.parameters.settings
    assert settings.Qx == (1.0, 1.0)
    assert settings.rate == 0.0
    assert settings.gust == 0.0
    assert settings.system_parameters == {'m': 4.0, 'J': 0.0475, 'r': 0.25, 'g': 9.8, 'c': 0.05}
    assert target.parameters.candidate == settings
    assert target.adopted == []
    descriptor = target.node.describe_parameter('delay')
    assert descriptor.description == 'input delay [s]'
    assert descriptor.floating_point_range[0].to_value == 1.0
    assert target.node.describe_parameter('system').read_only


@pytest.mark.parametrize(('name', 'value', 'kept'), [
    ('Qx', [1, 2], (1.0, 2.0)),
    ('Qx', 3, (3.0,)),
    ('Qx', 3.5, (3.5,)),
    ('Qx', '[1, 0.5]', (1.0, 0.5)),
    ('Qx', '[[1, 0.5], [0.5, 2]]', (1.0, 0.5, 0.5, 2.0)),
    ('Qx', '1e-09', (1e-9,)),
    ('Qx', ['1e-09', '2'], (1e-9, 2.0)),
    ('Qx', '[1e-09, 1.0]', (1e-9, 1.0)),
    ('Qx', ' [ [1, 0.5] , [0.5, 2] ] ', (1.0, 0.5, 0.5, 2.0)),
    ('u_max', ['inf', 'inf'], (math.inf, math.inf)),
    ('rate', '1e-09', 1e-9),
    ('steps', '3', 3),
    ('integral', 'px', ('px',)),
    ('integral', ['px', 'py'], ('px', 'py')),
    ('integral', [], ()),
    ('x_max', [], ()),
    ('u_max', [math.inf, 1.0], (math.inf, 1.0)),
    ('rate', 200, 200.0),
    ('steps', 3, 3),
    ('lockstep', True, True),
    ('on_stale', 'silent', 'silent'),
    ('disturbance.gust', 2, 2.0),
    ('system_parameters.m', 5, 5.0),
])
def test_valid_values_are_accepted(target: Target, name: str, value: Any, kept: Any) -> None:
    """A value is converted to the type of its field and adopted once."""
    assert target.set(**{name: value}).successful
    field = {'disturbance.gust': 'gust'}.get(name, name)
    settings = target.adopted.pop()
    assert not target.adopted
    assert settings is target.parameters.settings
    present = (settings.system_parameters['m'] if field == 'system_parameters.m'
               else getattr(settings, field))
    assert present == kept
    assert type(present) is type(kept)
    shown = target.node.get_parameter(name)
    assert shown.value == (list(kept) if isinstance(kept, tuple) else kept) or (
        list(shown.value) == list(kept))
    if isinstance(kept, tuple):
        assert shown.type_ is (Parameter.Type.STRING_ARRAY if name == 'integral' else
                               Parameter.Type.DOUBLE_ARRAY)


@pytest.mark.parametrize(('name', 'value', 'sentence'), [
    ('Qx', 'heavy', 'Qx: wanted a list of numbers, got a string'),
    ('Qx', '[1, x]', 'Qx: wanted a list of numbers, got a string'),
    ('Qx', '[[1, 2], [3]]', 'Qx: wanted a list of numbers, got a string'),
    ('Qx', [True, False], 'Qx: wanted a list of numbers, got a list of true and false'),
    ('Qx', [1.0, math.nan], 'Qx[1] = nan: wanted a finite number'),
    ('Qx', [-math.inf, 1.0], 'Qx[0] = -inf: wanted a finite number'),
    ('u_max', [math.nan], 'u_max[0] = nan: wanted a finite number'),
    ('Qu', [1.0, -0.1], 'Qu[1] = -0.1: wanted at least 0'),
    ('rate', -1, 'rate = -1: wanted at least 0 Hz'),
    ('rate', 'fast', 'rate: wanted a number, got a string'),
    ('rate', '-1e-09', 'rate = -1e-09: wanted at least 0 Hz'),
    ('rate', 'nan', 'rate = nan: wanted a finite number'),
    ('delay', 1.5, 'delay = 1.5: wanted between 0 and 1 s'),
    ('delay', '-inf', 'delay = -inf: wanted a finite number'),
    ('Qx', ['1', 'x'], 'Qx: wanted a list of numbers, got a list of strings'),
    ('Qx', '[1 2, 3]', 'Qx: wanted a list of numbers, got a string'),
    ('Qx', '1 2', 'Qx: wanted a list of numbers, got a string'),
    ('steps', '3.5', 'steps: wanted a whole number, got a string'),
    ('steps', '0', 'steps = 0: wanted at least 1'),
    ('steps', '9' * 30, 'steps: wanted a whole number of 64 bits'),
    ('lockstep', 'maybe', 'lockstep: wanted true or false, got a string'),
    ('on_stale', 1, 'on_stale: wanted a string, got a whole number'),
    ('rate', [1.0], 'rate: wanted a number, got a list of numbers'),
    ('steps', 1.5, 'steps: wanted a whole number, got a number'),
    ('steps', 0, 'steps = 0: wanted at least 1'),
    ('lockstep', 1, 'lockstep: wanted true or false, got a whole number'),
    ('on_stale', 'holdd',
     "on_stale = 'holdd': wanted 'equilibrium' or 'hold' or 'silent'; did you mean 'hold'?"),
    ('on_stale', 'h\x1b[31m' + 'x' * 9999, "on_stale = 'h\\x1b[31m" + 51 * 'x' + "...': wanted"),
    ('Qz', [1.0], "no parameter 'Qz'; did you mean 'Qx'?"),
    ('qx', [1.0], "no parameter 'qx'; did you mean 'Qx'?"),
    ('wholly_other', 1, "no parameter 'wholly_other'"),
    ('system_parameters.mass', 1, "no parameter 'system_parameters.mass'; "
     "did you mean 'system_parameters.m'?"),
    ('system_parameters.m', -1.0, 'system_parameters.m = -1: wanted'),
    ('Qx', [99.0, 2.0], 'Qx and Qu: too much together'),
    ('Qx', None, 'Qx cannot be deleted, only set'),
    ('Qz', None, "no parameter 'Qz'; did you mean 'Qx'?"),
])
def test_invalid_values_are_refused(target: Target, name: str, value: Any, sentence: str) -> None:
    """A refusal has a printable reason and changes nothing."""
    before, value_before = target.parameters.settings, target.node.get_parameter('Qx').value
    result = target.set(**{name: value})
    assert not result.successful
    assert result.reason.startswith(sentence)
    assert len(result.reason) < 300
    assert result.reason.isprintable()
    assert target.refused == [result.reason]
    assert target.parameters.settings is before
    assert target.node.get_parameter('Qx').value == value_before
    assert not target.adopted
    assert not target.node.has_parameter('Qz')


def test_a_read_only_parameter_is_refused(target: Target) -> None:
    result = target.set(system='vehicle')
    assert not result.successful
    assert 'system' in result.reason
    assert target.parameters.settings.system == 'aircraft'


def test_values_of_one_request_are_checked_together(target: Target) -> None:
    """Proposed and present values are checked together; all or none are adopted."""
    assert target.set(Qx=[98.0, 1.0]).successful
    assert not target.set(Qu=[2.0]).successful
    assert target.set(Qu=[2.0], Qx=[50.0, 1.0], rate=10).successful
    assert len(target.adopted) == 2
    assert target.adopted[-1].Qu == (2.0,)
    assert target.adopted[-1].rate == 10.0
    assert not target.set(rate=20.0, Qu=['a']).successful
    assert target.parameters.settings.rate == 10.0


def test_parameters_of_rclpy_are_accepted(target: Target) -> None:
    """The table does not check them; rclpy does."""
    assert target.set(use_sim_time=True).successful
    assert not target.set(use_sim_time='yes').successful
    assert not target.adopted


def test_services_set_one_by_one_or_atomically(target: Target, probe: Any) -> None:
    """set_parameters sets one by one, set_parameters_atomically all or none."""
    results = probe.set_parameters('/lqr_node', Qx=[2, 3], Qu=[-1.0], rate=5)
    assert [each.successful for each in results] == [True, False, True]
    assert target.parameters.settings.Qx == (2.0, 3.0)
    assert probe.get_parameters('/lqr_node', 'Qx', 'Qu') == {'Qx': [2.0, 3.0], 'Qu': [1.0]}
    assert not probe.set_parameters_atomically('/lqr_node', Qx=[4, 3], Qu=[-1.0]).successful
    assert probe.get_parameters('/lqr_node', 'Qx') == {'Qx': [2.0, 3.0]}


def test_descriptors_have_the_ranges(target: Target, probe: Any) -> None:
    """Tools make sliders of the ranges; a number bounded on one side has one too."""
    def described(name: str) -> Any:
        request = DescribeParameters.Request(names=[name])
        return probe.call(
            DescribeParameters, '/lqr_node/describe_parameters', request).descriptors[0]

    for name, lower, upper in (('delay', 0.0, 1.0), ('rate', 0.0, math.inf)):
        between, = described(name).floating_point_range
        assert (between.from_value, between.to_value, between.step) == (lower, upper, 0.0)
    between, = described('steps').integer_range
    assert (between.from_value, between.to_value, between.step) == (1, 2**63 - 1, 0)
    for name in ('disturbance.gust', 'Qu', 'lockstep', 'on_stale'):
        assert not described(name).floating_point_range
        assert not described(name).integer_range
    for value in (0.0, 1.0, 1, '0.5'):
        assert probe.set_parameters('/lqr_node', delay=value)[0].successful
    for value in (1.0000001, -1e-300, 'x'):
        result, = probe.set_parameters('/lqr_node', delay=value)
        assert not result.successful
        assert 'delay' in result.reason
        assert 'wanted' in result.reason
        assert target.refused.pop() == result.reason
    assert described('delay').type == ParameterType.PARAMETER_DOUBLE  # it stays


def test_read_only_accepts_its_present_value(target: Target, probe: Any) -> None:
    """A file with all parameters can be loaded; another value is refused."""
    for name, value in (('system', 'aircraft'), ('start_type_description_service', True)):
        assert probe.set_parameters('/lqr_node', **{name: value})[0].successful
        assert probe.set_parameters_atomically('/lqr_node', **{name: value}).successful
    assert not target.adopted
    results = probe.set_parameters('/lqr_node', system='vehicle', rate=5.0)
    assert [each.successful for each in results] == [False, True]
    assert 'system' in results[0].reason
    assert probe.set_parameters_atomically('/lqr_node', system='aircraft', rate=6.0).successful
    assert not probe.set_parameters_atomically('/lqr_node', system='vehicle', rate=7.0).successful
    assert target.parameters.settings.rate == 6.0


def test_set_parameters_accepts_values_valid_only_together(target: Target, probe: Any) -> None:
    """The order does not matter; values are adopted once, and a refusal is reported once."""
    assert probe.set_parameters('/lqr_node', Qx=[98.0, 1.0])[0].successful
    results = probe.set_parameters('/lqr_node', Qu=[50.0], Qx=[1.0, 1.0])
    assert [each.successful for each in results] == [True, True]
    assert len(target.adopted) == 2
    assert target.adopted[-1].Qu == (50.0,)
    results = probe.set_parameters('/lqr_node', Qu=[-1.0], rate=5.0)
    assert [each.successful for each in results] == [False, True]
    assert target.refused == [results[0].reason]
    assert len(target.adopted) == 3


@pytest.mark.parametrize('service', [SetParameters, SetParametersAtomically])
def test_an_unknown_parameter_type_is_refused(target: Target, probe: Any, service: Any) -> None:
    """The node continues after a value type that rclpy does not know."""
    name = ('/lqr_node/set_parameters' if service is SetParameters
            else '/lqr_node/set_parameters_atomically')
    bad = ParameterMsg(name='Qx', value=ParameterValue(type=200))
    response = probe.call(service, name, service.Request(parameters=[bad]))
    result = response.results[0] if service is SetParameters else response.result
    assert not result.successful
    assert result.reason == 'Qx: there is no parameter type 200'
    assert target.set(Qx=[1, 1]).successful


def test_initial_values_are_checked(probe: Any) -> None:
    """Values of files and arguments get the same checks; a bad one ends the node."""
    target = Target(probe.context, {'Qx': [5, 6], 'rate': 100, 'system': 'vehicle',
                                    'system_parameters.l': 3})
    settings = target.parameters.settings
    assert settings.Qx == (5.0, 6.0)
    assert settings.system_parameters == {'l': 3.0}
    target.node.destroy_node()
    with pytest.raises(ObcError, match=r'Qu\[0\] = -1: wanted at least 0'):
        Target(probe.context, {'Qu': [-1]})
    with pytest.raises(ObcError, match='too much together'):
        Target(probe.context, {'Qx': [99, 99]})
    with pytest.raises(ObcError, match="did you mean 'aircraft'"):
        Target(probe.context, {'system': 'aircaft'})
    with pytest.raises(ObcError, match="no parameter 'Qz'; did you mean 'Qx'"):
        Target(probe.context, {'Qz': 1.0})


def test_start_values_take_the_place_of_defaults(probe: Any) -> None:
    """Also those of parameters that are declared before; given values override them."""
    target = Target(probe.context, {
        'start': "system='vehicle' system_parameters.l=3.0 Qx=(3.0,) rate=2.0 delay=0.5",
        'rate': 4.0}, StartSettings)
    settings = target.parameters.settings
    assert (settings.system, settings.system_parameters) == ('vehicle', {'l': 3.0})
    assert (settings.Qx, settings.rate, settings.delay) == ((3.0,), 4.0, 0.5)
    assert target.set(Qx=[5.0], delay=0.0).successful
    assert target.parameters.settings.Qx == (5.0,)
    target.node.destroy_node()


def test_a_default_may_depend_on_what_is_given(probe: Any) -> None:
    """By the user or by a file; the value itself does not matter, and a given one overrides."""
    for values, table, wanted in (
            ({}, Settings, 0.0), ({'rate': 1.0}, Settings, 0.0),
            ({'system': 'aircraft'}, Settings, 1.0),
            ({'start': "system='aircraft'"}, StartSettings, 1.0),
            ({'system': 'aircraft', 'smooth': 0.0}, Settings, 0.0)):
        target = Target(probe.context, values, table)
        assert target.parameters.settings.smooth == wanted, values
        target.node.destroy_node()


@pytest.mark.parametrize(('text', 'words'), [
    ('nothing', "^start = 'nothing': it gives no value"),
    ('faults', "^start = 'faults': one\nstart = 'faults': two$"),
    ('delay=5.0', 'delay = 5: wanted between 0 and 1'), ('rate=1e999', 'rate = inf'),
    ('system_parameters.l=3.0', '^start = .* gives system_parameters.l, but there is no such'),
    ("system='no_such'", 'no_such')])
def test_start_values_are_checked(probe: Any, text: str, words: str) -> None:
    with pytest.raises(ObcError, match=words):
        Target(probe.context, {'start': text}, StartSettings)


def test_options_of_a_system_are_parameters(probe: Any) -> None:
    """A and B, of which the linear system is built, are parameters too."""
    target = Target(probe.context, {
        'system': 'linear', 'system_parameters.A': [0, 1, 0, 0], 'system_parameters.B': [0, 1]})
    assert target.parameters.settings.system_parameters == {
        'A': (0.0, 1.0, 0.0, 0.0), 'B': (0.0, 1.0), 'states': '', 'inputs': ''}
    target.node.destroy_node()


VALUES = strategies.one_of(
    strategies.none(), strategies.booleans(), strategies.integers(-2**63, 2**63 - 1),
    strategies.floats(), strategies.text(max_size=20),
    strategies.lists(strategies.floats(), max_size=4),
    strategies.lists(strategies.integers(-2**63, 2**63 - 1), max_size=4),
    strategies.lists(strategies.text(max_size=5), max_size=3),
    strategies.lists(strategies.booleans(), max_size=3),
    strategies.text('[],. 0123456789e-', max_size=30).map(lambda text: f'[{text}]'))
ENTRIES = [
    ParameterRow('a', (1.0,), '', lower=0.0), ParameterRow('b', (), '', finite=False),
    ParameterRow('c', 1.0, ''),
    ParameterRow('d', 1, '', lower=-5, upper=5), ParameterRow('e', False, ''),
    ParameterRow('f', 'x', '', choices=('x', 'y')), ParameterRow('g', (), '', texts=True)]


@settings(max_examples=300, deadline=None)
@given(entry=strategies.sampled_from(ENTRIES), value=VALUES)
def test_any_value_is_converted_or_refused(entry: ParameterRow, value: Any) -> None:
    """The result has the type and bounds of the row, or StatementError is raised."""
    try:
        kept = entry.value(Parameter(entry.name, value=value))
    except StatementError as error:
        assert entry.name in str(error)
        return
    assert type(kept) is type(entry.default)
    numbers = kept if isinstance(kept, tuple) else (kept,)
    for number in numbers:
        if isinstance(number, float):
            assert entry.lower <= number <= entry.upper
            assert math.isfinite(number) or not entry.finite
    assert entry.value(entry.ros(kept)) == kept


def test_deeply_nested_text_is_refused() -> None:
    """Neither depth nor length of a hostile text leads to a crash."""
    for text in ('[' * 100_000, '[' + '[],' * 100_000, '[' + '[1] ' * 50_000 + 'x'):
        with pytest.raises(StatementError):
            ENTRIES[0].value(Parameter('a', value=text))
