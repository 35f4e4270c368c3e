# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Rows of a parameter table: meaning, type, allowed values and conditions of a parameter.

A condition says when a parameter has an effect: the name of another parameter and its allowed
values. ``NAME.*`` means any parameter of a group. Without values the other parameter has to be
set: neither 0, false nor empty.

==============================  =====================================================
('weights', 'matrices')         weights is matrices
('command_sink', 'a', 'b')      command_sink is a or b
('integral',)                   integral names a state
('noise.*',)                    one of noise.px, noise.py, ... is not 0
==============================  =====================================================
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
import difflib
import math
import re
from typing import Any, cast

from obc_ros.core.text.errors import quote, StatementError
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]
ParameterCondition = tuple[str | bool, ...]
UsedWhen = tuple[ParameterCondition, ...]

_WANTED = {
    Parameter.Type.BOOL: 'true or false',
    Parameter.Type.INTEGER: 'a whole number',
    Parameter.Type.DOUBLE: 'a number',
    Parameter.Type.DOUBLE_ARRAY: 'a list of numbers',
    Parameter.Type.STRING: 'a string',
    Parameter.Type.STRING_ARRAY: 'a list of strings',
}
_GOT = {
    **_WANTED,
    Parameter.Type.NOT_SET: 'nothing',
    Parameter.Type.BYTE_ARRAY: 'bytes',
    Parameter.Type.BOOL_ARRAY: 'a list of true and false',
    Parameter.Type.INTEGER_ARRAY: 'a list of whole numbers',
}
_SCALARS = (Parameter.Type.INTEGER, Parameter.Type.DOUBLE)
_LISTS = (Parameter.Type.INTEGER_ARRAY, Parameter.Type.DOUBLE_ARRAY)
_INTEGERS = -2**63, 2**63 - 1  # range of a ROS parameter
# A list that mixes 1 and 0.5, and a list of rows, reach a node as a string; so does 1e-09, which
# YAML 1.1 does not read as a number.
_ROWS = re.compile(r'\[(\[[^\[\]]*\],?)+\]|\[[^\[\]]*\]')


@dataclass(frozen=True)
class StartValues:
    """What one parameter gives others at the start, by name, and a note that tells the user."""

    values: Mapping[str, Value]
    note: str


@dataclass(frozen=True)
class ParameterRow:
    """
    A row of the table: one parameter.

    :ivar default: its type is that of the parameter; a tuple has numbers. For numbers, integers,
        strings with numbers, a single number in place of a list, and a list of rows are accepted;
        for a list of strings, a single string.
    :ivar description, unit: meaning, and the unit that is appended to it.
    :ivar lower, upper: bounds of the number, or of each number of a list.
    :ivar choices: accepted strings; empty: all.
    :ivar read_only: whether the value is fixed once the node has started.
    :ivar finite: whether infinity is rejected; NaN always is.
    :ivar texts: whether a tuple has strings.
    :ivar used_when: conditions; the parameter has an effect if one holds; empty: always.
    :ivar default_given: name of a parameter declared before, and the default if that is given at
        the start.
    :ivar gives: returns the `StartValues` of a text that is not empty. They become the defaults
        of the other parameters. Raises ObcError for a text that gives none.
    """

    name: str
    default: Value
    description: str
    unit: str = ''
    lower: float = -math.inf
    upper: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False
    finite: bool = True
    texts: bool = False
    used_when: UsedWhen = ()
    default_given: tuple[str, Value] | None = None
    gives: Callable[[str], StartValues] | None = None

    @property
    def type(self) -> Parameter.Type:
        """Return the ROS type of the value."""
        if isinstance(self.default, tuple):
            return Parameter.Type.STRING_ARRAY if self.texts else Parameter.Type.DOUBLE_ARRAY
        return Parameter.Type.from_parameter_value(self.default)

    def descriptor(self) -> ParameterDescriptor:
        """Return the descriptor of this parameter."""
        descriptor = ParameterDescriptor(
            description=f'{self.description} [{self.unit}]' if self.unit else self.description,
            additional_constraints=self._constraint(), read_only=self.read_only,
            dynamic_typing=True)  # so that rclpy accepts integers; the type is checked here
        if self.lower == -math.inf and self.upper == math.inf:
            return descriptor
        if self.type is Parameter.Type.DOUBLE:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.lower, to_value=self.upper)]
        elif self.type is Parameter.Type.INTEGER:
            least, most = _INTEGERS
            descriptor.integer_range = [IntegerRange(
                from_value=math.ceil(max(self.lower, least)),
                to_value=math.floor(min(self.upper, most)))]
        return descriptor

    def value(self, given: Parameter) -> Value:
        """Return the value of a ROS parameter; StatementError: wrong type or range."""
        value = self._converted(given)
        if isinstance(value, str):
            self._check_choice(value)
        elif self.type is Parameter.Type.DOUBLE_ARRAY:
            for index, number in enumerate(cast(tuple[float, ...], value)):
                self._check_number(f'{self.name}[{index}]', number)
        elif not isinstance(value, (bool, tuple)):
            self._check_number(self.name, value)
        return value

    def ros(self, value: Value) -> Parameter:
        """Return a value as a ROS parameter of the type of this row."""
        return Parameter(
            self.name, self.type, list(value) if isinstance(value, tuple) else value)

    def _converted(self, given: Parameter) -> Value:
        wanted, got, value = self.type, given.type_, given.value
        empty = not isinstance(value, str) and hasattr(value, '__len__') and len(value) == 0
        if isinstance(self.default, tuple) and (empty or got is Parameter.Type.NOT_SET):
            return ()  # an empty list carries no type
        if wanted is Parameter.Type.DOUBLE_ARRAY:
            if got in _LISTS:
                return tuple(map(float, value))
            if got in _SCALARS:
                return (float(value),)
            if (numbers := _numbers(got, value)) is not None:
                return numbers
        elif wanted is Parameter.Type.STRING_ARRAY:
            if got is Parameter.Type.STRING_ARRAY:
                return tuple(value)
            if got is Parameter.Type.STRING:
                return (value,)
        elif wanted is Parameter.Type.DOUBLE and got in _SCALARS:
            return float(value)
        elif wanted in _SCALARS and got is Parameter.Type.STRING:
            if (number := _number(value, wanted is Parameter.Type.INTEGER)) is not None:
                return number
        elif wanted is got:
            return cast(Value, value)
        raise StatementError(f'{self.name}: wanted {_WANTED[wanted]}, got {_GOT[got]}')

    def _constraint(self) -> str:
        if self.choices:
            return _listed(self.choices)
        if self.lower == -math.inf and self.upper == math.inf:
            return ''
        if self.upper == math.inf:
            return f'at least {self.lower:g}'
        if self.lower == -math.inf:
            return f'at most {self.upper:g}'
        return f'between {self.lower:g} and {self.upper:g}'

    def _check_choice(self, value: str) -> None:
        if self.choices and value not in self.choices:
            raise StatementError(
                f"{self.name} = '{quote(value)}': wanted {_listed(self.choices)}"
                f'{suggest_key(value, self.choices)}')

    def _check_number(self, name: str, value: float) -> None:
        if math.isnan(value) or (self.finite and math.isinf(value)):
            raise StatementError(f'{name} = {value}: wanted a finite number')
        if isinstance(value, int) and not _INTEGERS[0] <= value <= _INTEGERS[1]:
            raise StatementError(f'{name}: wanted a whole number of 64 bits')
        if not self.lower <= value <= self.upper:
            raise StatementError(f'{name} = {value:g}: wanted {self._constraint()} {self.unit}'
                                 .rstrip())


def declare_field(default: Value, description: str, unit: str = '', *, name: str = '',
                  **options: Any) -> Any:
    """
    Return a field of a table that is one ROS parameter.

    :param name: name of the parameter if it differs from that of the field, such as
        ``noise.position``.
    :param options: further attributes of its `ParameterRow`, which is in the metadata.
    """
    return field(default=default, metadata={
        'entry': ParameterRow(name, default, description, unit, **options)})


def group(members: Callable[[Mapping[str, Value]], Iterable[ParameterRow]]) -> Any:
    """
    Return a field of a table that holds all parameters ``FIELD.*`` by their last name.

    :param members: gets the values declared so far by name, and yields a row for each member,
        named without the prefix. Each row is declared before the next one is requested.
    """
    return field(default_factory=dict, metadata={'group': members})


def _listed(choices: tuple[str, ...]) -> str:
    return ' or '.join(f"'{choice}'" for choice in choices)


def suggest_key(name: str, known: Iterable[str]) -> str:
    """Return a suggestion of the known name that is closest to one, or an empty text."""
    # a short name needs fewer letters in common
    cutoff = 0.5 if len(name) <= 3 else 0.65
    close = difflib.get_close_matches(name[:100], known, n=1, cutoff=cutoff)
    if not close:
        folded = {each.lower(): each for each in known}
        close = [folded[name.lower()]] if name.lower() in folded else []
    return f"; did you mean '{close[0]}'?" if close else ''


def _number(text: str, is_whole: bool) -> float | None:
    try:
        return int(text) if is_whole else float(text)
    except ValueError:
        return None


def _numbers(got: Parameter.Type, value: Any) -> tuple[float, ...] | None:
    """Return the numbers of '[1, 0.5]', '[[1, 0], [0, 1]]', '1e-9' or ['1e-9', '2'], or None."""
    if got is Parameter.Type.STRING:
        text, rows = ' '.join(value.split()), [[value]]
        if text.startswith('['):
            for mark in '[],':
                text = text.replace(f' {mark}', mark).replace(f'{mark} ', mark)
            if not _ROWS.fullmatch(text):
                return None
            rows = [row.split(',') for row in re.findall(r'\[([^\[\]]*)\]', text)]
    elif got is Parameter.Type.STRING_ARRAY:
        rows = [value]
    else:
        return None
    if len({len(row) for row in rows}) != 1:
        return None
    try:
        return tuple(float(number) for row in rows for number in row)
    except ValueError:
        return None


def is_used(used_when: UsedWhen, values: Mapping[str, Value]) -> bool:
    """Return whether a parameter has an effect, for the values of all parameters by name."""
    return not used_when or any(
        values[other] in wanted if wanted else bool(values[other])
        for name, *wanted in used_when for other in _names(str(name), values))


def explain_idle(rows: Mapping[str, ParameterRow], name: str, values: Mapping[str, Value], *,
                 is_start: bool = False) -> str:
    """
    Return why a parameter has no effect, and the remedy.

    :param rows: rows of the table by name.
    :param name: the parameter, none of whose conditions holds.
    :param values: of all parameters by name.
    :param is_start: whether the node is starting; otherwise a value is being changed.
    """
    conditions = rows[name].used_when
    others = [_names(str(each[0]), values) for each in conditions]
    now = ' and '.join(f'{each[0]} = {_word(values[names[0]])}'
                       for each, names in zip(conditions, others, strict=True))
    unused = f'{name} is not used with {now}; '
    if is_start:
        return unused + f'write {_wanted(conditions, ": ")} as well, or leave {name} out'
    if all(rows[other].read_only for names in others for other in names):
        return unused + f'start the node with {_wanted(conditions, ": ")} for it'
    return unused + (f'set {_wanted(conditions, " to ")} first, or both with '
                     'set_parameters_atomically')


def count_depth(rows: Mapping[str, ParameterRow], name: str) -> int:
    """Return the number of parameters that have to be set in turn before one is used."""
    if name not in rows or not rows[name].used_when:
        return 0
    return 1 + max(count_depth(rows, str(each[0])) for each in rows[name].used_when)


def _names(name: str, values: Mapping[str, Value]) -> list[str]:
    if not name.endswith('*'):
        return [name]
    return [each for each in values if each.startswith(name[:-1])]


def _wanted(conditions: UsedWhen, equals: str) -> str:
    return ' or '.join(
        str(name) + (equals + ' or '.join(map(_word, wanted)) if wanted else '')
        for name, *wanted in conditions)


def _word(value: Value) -> str:
    if isinstance(value, float):
        return f'{value:g}'
    if value in ((), ''):
        return 'empty'
    return str(value).lower() if isinstance(value, bool) else str(value)
