# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc param`: list, get, set, describe, dump and load the parameters of running nodes."""

import argparse
from array import array
from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path
import re
import sys
from typing import Any

from obc_ros.cli.ros2.verbs import add_node, add_verbs, run_verb
from obc_ros.cli.ros_graph import Graph, join_graph
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError, quote, StatementError
from obc_ros.core.text.yaml_files import EXPONENTS, read_yaml
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import get_parameter_value, parameter_value_to_python
import yaml

# Names of the types in `get` and `describe`.
TYPES = {
    ParameterType.PARAMETER_NOT_SET: ('', 'not set'),
    ParameterType.PARAMETER_BOOL: ('Boolean value is:', 'boolean'),
    ParameterType.PARAMETER_INTEGER: ('Integer value is:', 'integer'),
    ParameterType.PARAMETER_DOUBLE: ('Double value is:', 'double'),
    ParameterType.PARAMETER_STRING: ('String value is:', 'string'),
    ParameterType.PARAMETER_BYTE_ARRAY: ('Byte values are:', 'byte array'),
    ParameterType.PARAMETER_BOOL_ARRAY: ('Boolean values are:', 'boolean array'),
    ParameterType.PARAMETER_INTEGER_ARRAY: ('Integer values are:', 'integer array'),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ('Double values are:', 'double array'),
    ParameterType.PARAMETER_STRING_ARRAY: ('String values are:', 'string array'),
}
run = run_verb


class _Dumper(yaml.SafeDumper):
    """A dumper that quotes the text '1e-9', which ROS reads as a number without quotes."""


_Dumper.add_implicit_resolver(*EXPONENTS)


def add_arguments(parser: Parser) -> None:
    """Declare the verbs."""
    add_verbs(parser, {
        'list': ('list the parameters of a node, or of all', '/lqr_node --param-type',
                 _list_arguments, list_parameters),
        'get': ('get a parameter', '/lqr_node Qx', _get_arguments, get),
        'set': ('set a parameter; the node checks it before applying it',
                '/lqr_node Qu "[2.0, 0.5]"',
                _set_arguments, set_value),
        'describe': ('show type, unit and range of parameters', '/lqr_node Qx',
                     _describe_arguments, describe),
        'dump': ('print all parameters of a node as a parameter file', '/lqr_node', add_node,
                 dump),
        'load': ('set the parameters of a file', '/lqr_node lqr_node.yaml',
                 _load_arguments, load)})


def _list_arguments(parser: Parser) -> None:
    add_node(parser, optional=True)
    parser.add_argument('--filter', metavar='REGEX', help='only names that match')
    parser.add_argument('--param-prefixes', nargs='+', default=[], metavar='PREFIX',
                        help='only parameters of these groups')
    parser.add_argument('--param-type', action='store_true', help='print the types too')


def _get_arguments(parser: Parser) -> None:
    add_node(parser)
    parser.add_argument('parameter_name', help='name of the parameter')
    parser.add_argument('--hide-type', action='store_true', help='print the value only')


def _set_arguments(parser: Parser) -> None:
    add_node(parser)
    parser.add_argument('parameter_name', help='name of the parameter')
    parser.add_argument('value', help='in YAML: 0.5, "[1, 2, 3]", bryson')


def _describe_arguments(parser: Parser) -> None:
    add_node(parser)
    parser.add_argument('parameter_names', nargs='+', help='names of the parameters')


def _load_arguments(parser: Parser) -> None:
    add_node(parser)
    parser.add_argument('parameter_file', type=Path, help='as `dump` prints it')
    parser.add_argument('--no-use-wildcard', action='store_true',
                        help='ignore the parameters that the file has for all nodes (/**)')


def list_parameters(args: argparse.Namespace) -> int:
    """Print the names of parameters."""
    try:
        pattern = re.compile(args.filter or '')
    except re.error as error:
        raise ObcError(f'--filter {args.filter}: {error}') from error
    with join_graph() as graph:
        if args.node_name:
            nodes = [graph.find_node(args.node_name, args.timeout)]
        else:
            nodes = graph.settle(lambda: graph.nodes(args.include_hidden_nodes), args.spin_time)
        for node in nodes:
            if not graph.has_service(f'{node}/list_parameters', args.timeout):
                continue  # a node may have no parameter services
            names = [each for each in _names(graph, node, args.param_prefixes)
                     if pattern.match(each)]
            if names and not args.node_name:
                print(f'{node}:')
            types = {each.name: TYPES[each.type][1] for each in _descriptors(graph, node, names)
                     } if args.param_type else {}
            for name in names:
                print(f'  {name} (type: {types[name]})' if args.param_type else f'  {name}')
    return 0


def get(args: argparse.Namespace) -> int:
    """Print the value of a parameter."""
    with join_graph() as graph:
        node = graph.find_node(args.node_name, args.timeout)
        [value] = _values(graph, node, [args.parameter_name]) or [ParameterValue()]
        if value.type == ParameterType.PARAMETER_NOT_SET:
            print('None' if args.hide_type else 'Parameter not set.')
            return _unknown(graph, node, [args.parameter_name])
    plain = _plain(value)
    print(plain) if args.hide_type else print(TYPES[value.type][0], plain)
    return 0


def set_value(args: argparse.Namespace) -> int:
    """Set a parameter, and print the response of the node."""
    value = get_parameter_value(args.value)
    with join_graph() as graph:
        node = graph.find_node(args.node_name, args.timeout)
        [result] = graph.call(SetParameters, f'{node}/set_parameters', SetParameters.Request(
            parameters=[Parameter(name=args.parameter_name, value=value)])).results
    return _tell(result, 'Set parameter successful', 'Setting parameter failed')


def describe(args: argparse.Namespace) -> int:
    """Print the descriptors of parameters."""
    with join_graph() as graph:
        node = graph.find_node(args.node_name, args.timeout)
        found = [each for each in _descriptors(graph, node, args.parameter_names) if each.name]
        for each in found:
            _describe(each)
        missing = sorted({*args.parameter_names} - {each.name for each in found})
        return _unknown(graph, node, missing) if missing else 0


def dump(args: argparse.Namespace) -> int:
    """Print all parameters of a node in the format of `--params-file`."""
    with join_graph() as graph:
        node = graph.find_node(args.node_name, args.timeout)
        names = _names(graph, node)
        values = _values(graph, node, names)
    tree: dict[str, Any] = {}
    for name, value in zip(names, values, strict=True):
        *groups, last = name.split('.')
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[last] = _plain(value)
    print(yaml.dump({node: {'ros__parameters': tree}}, Dumper=_Dumper, default_flow_style=False))
    return 0


def load(args: argparse.Namespace) -> int:
    """Set all parameters of a file or none, and print the response of the node."""
    with join_graph() as graph:
        node = graph.find_node(args.node_name, args.timeout)
        wanted = _of_file(args.parameter_file, node, not args.no_use_wildcard)
        result = graph.call(
            SetParametersAtomically, f'{node}/set_parameters_atomically',
            SetParametersAtomically.Request(parameters=wanted)).result
    if not result.successful:
        return _tell(result, '', 'No parameter of the file is set')
    return max([_tell(result, f'Set parameter {each.name} successful', '') for each in wanted],
               default=0)


def _of_file(path: Path, node: str, wildcard: bool) -> list[Parameter]:
    """Return the parameters of a file for a node, or those of the only other node in it."""
    try:
        sections = read_yaml(path, exponents=True)
        if not isinstance(sections, dict):
            raise StatementError('it is no mapping of nodes to parameters')
        name = node.rpartition('/')[2]
        own = [key for key in sections if key in (node, node[1:], name, f'/**/{name}')]
        others = [key for key in sections if key != '/**']
        if not own and len(others) > 1:
            raise ObcError(f'{path} has nothing for {node}, only for {", ".join(others)}')
        shared = ['/**'] if wildcard and '/**' in sections else []
        found: dict[str, Parameter] = {}
        for key in [*shared, *(own or others)]:
            section = sections[key]
            if not isinstance(section, dict) or 'ros__parameters' not in section:
                raise StatementError(f'{quote(str(key))} has no ros__parameters')
            found.update((each.name, each) for each in _flatten(section['ros__parameters']))
    except (StatementError, TypeError, AttributeError) as error:
        raise ObcError(f'{path} is no parameter file: {error}') from error
    return list(found.values())


def _flatten(values: dict[str, Any], group: str = '') -> Iterator[Parameter]:
    """Yield the parameters of a mapping and of the mappings in it."""
    for key, value in values.items():
        name = group + key
        if isinstance(value, dict):
            yield from _flatten(value, f'{name}.')
            continue
        numbers = value if isinstance(value, list) else [value]
        if any(type(each) is int and not -2**63 <= each < 2**63 for each in numbers):
            raise StatementError(f'{name}: {quote(str(value))} is too large for a parameter')
        yield Parameter(name=name, value=_message(value))


def _message(value: Any) -> ParameterValue:
    """Return a value of a file as ROS sends it; numbers of which one is a double are doubles."""
    numbers = value if isinstance(value, list) else [value]
    if {float} <= {*map(type, numbers)} <= {int, float}:
        if value is numbers:
            return ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY,
                                  double_array_value=[float(each) for each in numbers])
        return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    return get_parameter_value(str(value))


def _names(graph: Graph, node: str, prefixes: list[str] | None = None) -> list[str]:
    request = ListParameters.Request(prefixes=prefixes or [])
    return sorted(graph.call(ListParameters, f'{node}/list_parameters', request).result.names)


def _values(graph: Graph, node: str, names: list[str]) -> list[ParameterValue]:
    request = GetParameters.Request(names=names)
    return list(graph.call(GetParameters, f'{node}/get_parameters', request).values)


def _descriptors(graph: Graph, node: str, names: list[str]) -> list[Any]:
    request = DescribeParameters.Request(names=names)
    return list(graph.call(
        DescribeParameters, f'{node}/describe_parameters', request).descriptors)


def _plain(value: ParameterValue) -> Any:
    """Return a value as Python prints it."""
    plain = parameter_value_to_python(value)
    return list(plain) if isinstance(plain, (array, tuple)) else plain


def _tell(result: Any, done: str, failed: str) -> int:
    """Print the result of a change; return the exit status."""
    what, stream = (done, sys.stdout) if result.successful else (failed, sys.stderr)
    print(f'{what}: {result.reason}' if result.reason else what, file=stream)
    return 0 if result.successful else 1


def _describe(descriptor: Any) -> None:
    print('Parameter name:', descriptor.name)
    print('  Type:', TYPES[descriptor.type][1])
    if descriptor.description:
        print('  Description:', descriptor.description)
    print('  Constraints:')
    if descriptor.read_only:
        print('    Read only: true')
    for each in [*descriptor.floating_point_range, *descriptor.integer_range][:1]:
        print('    Min value:', each.from_value)
        print('    Max value:', each.to_value)
        if each.step:
            print('    Step:', each.step)
    if descriptor.additional_constraints:
        print('    Additional constraints:', descriptor.additional_constraints)


def _unknown(graph: Graph, node: str, names: list[str]) -> int:
    """Report unknown names with similar ones of the node; return the exit status."""
    known = _names(graph, node)
    for name in names:
        if name in known:
            print(f"'{name}' of {node} has no value", file=sys.stderr)
            continue
        near = ' or '.join(get_close_matches(name, known))
        print(f"{node} has no parameter '{quote(name)}'"
              + (f'; did you mean {near}?' if near else f': see obc param list {node}'),
              file=sys.stderr)
    return 1
