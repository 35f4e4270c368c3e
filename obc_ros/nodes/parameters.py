# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameters of a node: declared from one table, judged together, adopted at once.

The table is a frozen dataclass whose fields are made by `parameter` and `group`::

    @dataclass(frozen=True)
    class Settings:
        system: str = parameter('aircraft', 'registered system', read_only=True)
        system_parameters: Mapping[str, Value] = group(system_parameters)
        rate: float = parameter(0.0, 'commands a second; 0: answer every state', 'Hz', lower=0.0)
        Qx: tuple[float, ...] = parameter((), 'state weight; empty: identity')

A change has two moments. *Judge* builds the candidate from all proposed values together with the
present ones, or raises ObcError; nothing has changed then. *Adopt* receives the candidate that
was judged, once every parameter is set. The same judge looks at the values a node starts with.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, MISSING
import difflib
import math
import re
from typing import Any, Generic, TypeVar

from obc_ros.core.errors import ObcError, shown, StatementError
from obc_ros.nodes.guards import guard
from obc_ros.nodes.parameter_services import serve
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import get_parameter_value, Parameter
from yaml import YAMLError

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]
Settings = TypeVar('Settings')
Candidate = TypeVar('Candidate')

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
_INTEGERS = -2**63, 2**63 - 1  # what a ROS parameter holds
# A list that mixes 1 and 0.5, or a list of rows, reaches a node as a string; so does 1e-09, which
# is no number in YAML 1.1.
_ROWS = re.compile(r'\[(\[[^\[\]]*\],?)+\]|\[[^\[\]]*\]')


@dataclass(frozen=True)
class Entry:
    """One row of the table: a parameter, what it means and what it may be."""

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

    @property
    def type(self) -> Parameter.Type:
        """Return the ROS type that values are kept as."""
        if isinstance(self.default, tuple):
            return Parameter.Type.STRING_ARRAY if self.texts else Parameter.Type.DOUBLE_ARRAY
        return Parameter.Type.from_parameter_value(self.default)

    def descriptor(self) -> ParameterDescriptor:
        """Return what tools show of this parameter."""
        descriptor = ParameterDescriptor(
            description=f'{self.description} [{self.unit}]' if self.unit else self.description,
            additional_constraints=self._constraint(), read_only=self.read_only,
            dynamic_typing=True)  # so that integers pass; the type is checked here, in words
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
        """
        Return the value of a ROS parameter.

        Raises
        ------
        StatementError
            If its type, its range or one of its numbers is not what is wanted.

        """
        value = self._converted(given)
        if isinstance(value, str):
            self._check_choice(value)
        elif self.type is Parameter.Type.DOUBLE_ARRAY:
            for index, number in enumerate(value):
                self._check_number(f'{self.name}[{index}]', number)
        elif not isinstance(value, (bool, tuple)):
            self._check_number(self.name, value)
        return value

    def ros(self, value: Value) -> Parameter:
        """Return a value as a ROS parameter of this entry's type."""
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
            return value
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
                f"{self.name} = '{shown(value)}': wanted {_listed(self.choices)}"
                f'{_hint(value, self.choices)}')

    def _check_number(self, name: str, value: float) -> None:
        if math.isnan(value) or (self.finite and math.isinf(value)):
            raise StatementError(f'{name} = {value}: wanted a finite number')
        if isinstance(value, int) and not _INTEGERS[0] <= value <= _INTEGERS[1]:
            raise StatementError(f'{name}: wanted a whole number of 64 bits')
        if not self.lower <= value <= self.upper:
            raise StatementError(f'{name} = {value:g}: wanted {self._constraint()} {self.unit}'
                                 .rstrip())


def parameter(
    default: Value,
    description: str,
    unit: str = '',
    *,
    name: str = '',
    lower: float = -math.inf,
    upper: float = math.inf,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
    finite: bool = True,
    texts: bool = False,
) -> Any:
    """
    Return a field of a table that is one ROS parameter.

    Parameters
    ----------
    default : bool, int, float, str or tuple
        Its type is the parameter's; a tuple is one of numbers. Integers, numbers written as
        strings, a single number for a list, and a list of rows are accepted where numbers are
        wanted, a single string for a list of strings.
    description, unit : str
        What it means, and the unit that is appended to it.
    name : str
        The parameter's name where it is not the field's, such as ``noise.position``.
    lower, upper : float
        Bounds of the number, or of each number of a list.
    choices : tuple of str
        The only strings that are accepted.
    read_only : bool
        Whether it is fixed once the node has started.
    finite : bool
        Whether infinity is refused; NaN always is.
    texts : bool
        Whether a tuple is one of strings.

    """
    entry = Entry(name, default, description, unit, lower, upper, choices, read_only, finite,
                  texts)
    return field(default=default, metadata={'entry': entry})


def group(members: Callable[[Mapping[str, Value]], Iterable[Entry]]) -> Any:
    """
    Return a field of a table that holds all parameters ``FIELD.*`` by their last name.

    `members` gets the values declared so far by parameter name, and yields an entry for each
    member, named without the prefix; what it has yielded is declared before it goes on.
    """
    return field(default_factory=dict, metadata={'group': members})


class Parameters(Generic[Settings, Candidate]):
    """
    The parameters of one node.

    Parameters
    ----------
    node : rclpy.node.Node
        Created with ``allow_undeclared_parameters=True``, so that a wrong name is answered here.
    table : type
        The frozen dataclass made of `parameter` and `group`.
    judge : callable
        Returns the candidate for given settings or raises ObcError; has no side effects.
    adopt : callable
        Takes over a candidate. It runs inside the service call: keep it short. It is not called
        for the values at the start: use `candidate`.
    refused : callable, optional
        Told the sentence of each refusal.

    Attributes
    ----------
    settings : instance of table
        The values in use.
    candidate
        What `judge` returned for the values at the start.

    Raises
    ------
    ObcError
        If a value at the start is refused.

    """

    def __init__(
        self,
        node: Node,
        table: type[Settings],
        judge: Callable[[Settings], Candidate],
        adopt: Callable[[Candidate], None],
        refused: Callable[[str], None] | None = None,
    ) -> None:
        self._node, self._table = node, table
        self._judge, self._adopt, self._refused = judge, adopt, refused
        self._entries: dict[str, Entry] = {}
        self._values: dict[str, Value] = {}
        self._pending: tuple[dict[str, Value], Settings, Candidate] | None = None
        self._asked: list[Parameter] = []  # as they came, before `_normalise`
        self._is_attempt = False  # whose refusal is not reported
        # rclpy has no public list of the values given by files and arguments
        self._overrides: dict[str, Parameter] = getattr(node, '_parameter_overrides', {})
        for entry in self._rows():
            self._declare(entry)
        self._report_unknown()
        self.settings = self._assembled(self._values)
        self.candidate = judge(self.settings)
        node.add_pre_set_parameters_callback(self._normalise)
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._post_set)
        serve(node, self._is_kept, self._attempt)
        guard(node)

    def _rows(self) -> Iterable[Entry]:
        for each in fields(self._table):  # type: ignore[arg-type] # a dataclass type
            if 'group' in each.metadata:
                for member in each.metadata['group'](self._values):
                    yield _renamed(member, f'{each.name}.{member.name}')
            else:
                entry = each.metadata['entry']
                yield entry if entry.name else _renamed(entry, each.name)

    def _declare(self, entry: Entry) -> None:
        name, value = entry.name, entry.default
        if name in self._overrides:
            value = entry.value(self._overrides[name])
        self._entries[name], self._values[name] = entry, value
        self._node.declare_parameter(name, value, entry.descriptor(), ignore_override=True)
        if value == () and not entry.read_only:
            self._node.set_parameters([entry.ros(value)])  # an empty list was declared as bytes

    def _report_unknown(self) -> None:
        """Name what was given at the start and is nobody's parameter; files are often shared."""
        others = [name for name in self._overrides
                  if not (self._node.has_parameter(name) or name.startswith('qos_overrides.'))]
        for name in others:
            if hint := _hint(name, self._entries):
                self._node.get_logger().warning(
                    f"no parameter '{shown(name)}': it has no effect{hint}")
        if others:
            self._node.get_logger().info(
                f'given but not parameters of this node: {shown(", ".join(sorted(others)), 300)}')

    def _assembled(self, values: Mapping[str, Value]) -> Settings:
        arguments: dict[str, Any] = {}
        for each in fields(self._table):  # type: ignore[arg-type] # a dataclass type
            if each.default is MISSING:
                prefix = f'{each.name}.'
                arguments[each.name] = {name[len(prefix):]: value for name, value in values.items()
                                        if name.startswith(prefix)}
            else:
                arguments[each.name] = values[each.metadata['entry'].name or each.name]
        return self._table(**arguments)

    def _normalise(self, changes: list[Parameter]) -> list[Parameter]:
        """
        Keep numbers as doubles, whatever type they came as.

        In place of what cannot be, rclpy is given the present value: it would refuse others in
        words of its own, and unheard. `_on_set` looks at what was asked.
        """
        self._asked = changes
        return [self._normal(change) for change in changes]

    def _normal(self, change: Parameter) -> Parameter:
        entry = self._entries.get(change.name)
        if entry is None:
            return change
        try:
            if change.type_ is not Parameter.Type.NOT_SET:
                return entry.ros(entry.value(change))
        except StatementError:
            pass
        return entry.ros(self._values[change.name])

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        asked, self._asked, self._pending = self._asked, [], None
        if [each.name for each in asked] != [each.name for each in changes]:
            return SetParametersResult(successful=True)  # by rclpy: a QoS override, say
        try:
            if ours := self._read(asked):
                values = {**self._values, **ours}
                settings = self._assembled(values)
                self._pending = values, settings, self._judge(settings)
        except (ObcError, ArithmeticError) as error:
            if self._refused is not None and not self._is_attempt:
                self._refused(str(error))
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _attempt(self, changes: list[Parameter]) -> SetParametersResult:
        """Set all or none; a refusal is in the result only."""
        self._is_attempt = True
        try:
            return self._node.set_parameters_atomically(changes)
        finally:
            self._is_attempt = False

    def _is_kept(self, given: Parameter) -> bool:
        """
        Return whether a parameter has the given value already and does not take it as it came.

        It is read-only, or a string such as '0042' that ``ros2 param load`` reads as a number.
        """
        name, node = given.name, self._node
        if not node.has_parameter(name):
            return False
        present, entry = node.get_parameter(name), self._entries.get(name)
        if present.type_ is Parameter.Type.STRING and given.type_ is not Parameter.Type.STRING:
            return _reads_as(present.value, given)
        if not node.describe_parameter(name).read_only:
            return False
        if entry is None:
            return bool(given.value == present.value)
        try:
            return entry.value(given) == self._values[name]
        except StatementError:
            return False

    def _post_set(self, changes: list[Parameter]) -> None:
        if self._pending is not None:
            (self._values, self.settings, candidate), self._pending = self._pending, None
            self._adopt(candidate)

    def _read(self, changes: list[Parameter]) -> dict[str, Value]:
        values: dict[str, Value] = {}
        for change in changes:
            entry = self._entries.get(change.name)
            if entry is None:
                if not self._node.has_parameter(change.name):
                    raise StatementError(
                        f"no parameter '{shown(change.name)}'{_hint(change.name, self._entries)}")
            elif change.type_ is Parameter.Type.NOT_SET:
                raise StatementError(f'{shown(change.name)} cannot be deleted, only set')
            else:
                values[change.name] = entry.value(change)
        return values


def _renamed(entry: Entry, name: str) -> Entry:
    return Entry(**{**vars(entry), 'name': name})


def _listed(choices: tuple[str, ...]) -> str:
    return ' or '.join(f"'{choice}'" for choice in choices)


def _hint(name: str, known: Iterable[str]) -> str:
    # two of three letters say more than half of eight
    cutoff = 0.5 if len(name) <= 3 else 0.65
    close = difflib.get_close_matches(name[:100], known, n=1, cutoff=cutoff)
    if not close:
        folded = {each.lower(): each for each in known}
        close = [folded[name.lower()]] if name.lower() in folded else []
    return f"; did you mean '{close[0]}'?" if close else ''


def _reads_as(text: str, given: Parameter) -> bool:
    """Return whether ``ros2`` makes the given value of a text."""
    try:
        return bool(get_parameter_value(text) == given.get_parameter_value())
    except YAMLError:
        return False


def _number(text: str, is_whole: bool) -> float | None:
    """Return the number that a text is, or None."""
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
