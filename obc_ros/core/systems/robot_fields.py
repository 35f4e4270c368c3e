# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fields of the messages of robots as states and inputs of a system: see docs/systems.md."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.expressions import parse_expression
from obc_ros.core.text.fields import check_keys, read_mapping

Symbols = Mapping[str, ca.SX]

COMMANDS = {
    'cmd_vel': tuple(f'{part}.{axis}' for part in ('linear', 'angular') for axis in 'xyz'),
    'wrench': tuple(f'{part}.{axis}' for part in ('force', 'torque') for axis in 'xyz')}
ODOMETRY = {
    'horizontal': ('x', 'y', 'yaw', 'vx', 'vy', 'linear.x', 'linear.y', 'angular.z'),
    'vertical': ('x', 'z', 'pitch', 'vx', 'vz', 'linear.x', 'linear.z', 'angular.y')}
HEADINGS = ('yaw', 'pitch')

# Without `ros`, these names of a system in a plane are its odometry, in these units.
_NAMED = {
    'horizontal': {'x': 'px', 'y': 'py', 'yaw': 'theta', 'vx': 'vx', 'vy': 'vy',
                   'angular.z': 'omega'},
    'vertical': {'x': 'px', 'z': 'py', 'pitch': '-theta', 'vx': 'vx', 'vz': 'vy',
                 'angular.y': '-omega'}}
_UNITS = {'px': 'm', 'py': 'm', 'theta': 'rad', 'vx': 'm/s', 'vy': 'm/s', 'omega': 'rad/s'}
# Without `ros`, inputs of these names and units are a twist.
_TWIST = {'linear.x': ('v', 'm/s'), 'angular.z': ('omega', 'rad/s')}


@dataclass(frozen=True, eq=False)
class RobotFields:
    """
    Fields of messages.

    :ivar commands: of each message in `COMMANDS` that carries the inputs: expression by field.
    :ivar odometry: index of the state and sign, by field.
    """

    commands: Mapping[str, Mapping[str, ca.SX]] = field(default_factory=dict)
    odometry: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    plane: str = ''

    @property
    def heading(self) -> int | None:
        """Return the index of the state that is yaw or pitch; None: none is."""
        return next((self.odometry[name][0] for name in HEADINGS if name in self.odometry), None)


def read_robot_fields(given: Mapping[str, Any], plane: str, states: Symbols, inputs: Symbols,
                      parameters: Symbols, units: Mapping[str, str]) -> RobotFields:
    """
    Return the fields of messages that a system states, or that its names and units tell.

    :param given: ``cmd_vel``, ``wrench`` and ``odom``, each a mapping of fields to texts or
        expressions.
    :param plane: as in `System`; empty: the plane of the fields of ``odom``.
    :raises StatementError: if a message, a field or an expression is unknown; the message begins
        with ``ros``.
    """
    check_keys(given, (*COMMANDS, 'odom'), where='ros')
    sections = {name: read_mapping(given[name], f'ros.{name}') for name in given}
    commands = {}
    for name in sections.keys() & COMMANDS.keys():
        check_keys(sections[name], COMMANDS[name], where=f'ros.{name}')
        commands[name] = {key: parse_expression(text, {**inputs, **parameters},
                                                f'ros.{name}.{key}')
                          for key, text in sections[name].items()}
    if 'cmd_vel' not in given and {
            (name, units.get(name)) for name in inputs} == set(_TWIST.values()):
        commands['cmd_vel'] = {key: inputs[name] for key, (name, _) in _TWIST.items()}
    if 'odom' not in given:
        return RobotFields(commands, _read_names(plane, states, units), plane)
    plane = plane or _find_plane(sections['odom'])
    check_keys(sections['odom'], ODOMETRY[plane], where='ros.odom')
    return RobotFields(commands, _read_odometry(sections['odom'], states), plane)


def suggest_command_line(message: str, inputs: Sequence[tuple[str, str]]) -> str:
    """Return the line of a system file that says which inputs, (name, unit), a message carries."""
    wanted = {'linear.x': 'm/s', 'angular.z': 'rad/s'} if message == 'cmd_vel' else {
        'force.x': 'N', 'torque.z': 'N m'}
    fields = {key: next((name for name, of in inputs if of == unit), 'EXPRESSION')
              for key, unit in wanted.items()}
    words = ', '.join(f'{key}: {text}' for key, text in fields.items())
    return (f'ros: {{{message}: {{{words}}}}}, with expressions of '
            f'{", ".join(name for name, _ in inputs)} and of parameters')


def _find_plane(section: Mapping[str, Any]) -> str:
    """Return the one plane that has all fields of odometry."""
    fitting = [plane for plane, known in ODOMETRY.items() if set(section) <= set(known)]
    if len(fitting) != 1:
        raise StatementError('ros.odom: these fields do not tell the plane: wanted plane: '
                             'horizontal or plane: vertical')
    return fitting[0]


def _read_names(plane: str, states: Symbols, units: Mapping[str, str]
                ) -> dict[str, tuple[int, float]]:
    """Return the odometry that the names of states in a plane tell."""
    fitting = {key: text for key, text in _NAMED.get(plane, {}).items()
               if (name := text.removeprefix('-')) in states
               and units.get(name, _UNITS[name]) == _UNITS[name]}
    return _read_odometry(fitting, states)


def _read_odometry(section: Mapping[str, Any], states: Symbols) -> dict[str, tuple[int, float]]:
    fields: dict[str, tuple[int, float]] = {}
    for key, text in section.items():
        place = f'ros.odom.{key}'
        found = parse_expression(text, states, place)
        signs = {index: sign for index, symbol in enumerate(states.values())
                 for sign in (1.0, -1.0) if ca.is_equal(found, sign * symbol, 1)}
        if not signs:
            raise StatementError(f'{place}: wanted one of the states {", ".join(states)}, or the '
                                 'negative of one')
        fields[key], = signs.items()
    if len({index for index, _ in fields.values()}) < len(fields):
        raise StatementError('ros.odom: two fields are the same state')
    return fields
