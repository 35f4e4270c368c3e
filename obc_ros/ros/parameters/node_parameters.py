# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameters of a node: declared from one table, judged together, adopted at once.

The table is a frozen dataclass whose fields are made by `declare_field` and `group`::

    @dataclass(frozen=True)
    class Settings:
        system_parameters: Mapping[str, Value] = group(list_system_parameters)
        rate: float = declare_field(0.0, 'commands per second; 0: one per state', 'Hz', lower=0.0)

A change has two steps. *Judge* builds the candidate from all proposed values and the present ones,
or raises ObcError; nothing has changed then. *Adopt* receives the candidate once every parameter
is set. The same *judge* checks the values at the start. docs/parameters.md has the rules.

A value that one parameter gives others at the start (`gives`), such as those of a file, takes the
place of their defaults. A value that the user gives explicitly overrides it.

The services that set parameters make no exceptions and needless rejections of rclpy:

- A value type that does not exist is rejected; rclpy raises an exception.
- A file with all parameters of a node, as ``ros2 param dump`` writes it, can be loaded again.
- Parameters that are acceptable together are set together, in any order of the request. Otherwise
  each is tried separately, after those that give it an effect.
- Each rejection is logged with its reason, including those by rclpy.
- A node may judge a change elsewhere, and serve other requests meanwhile.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields, MISSING, replace
import sys
from typing import Any, cast, Generic, TypeVar

from obc_ros.core.text.errors import ObcError, quote, restate, StatementError
from obc_ros.ros.execution.callback_guards import guard
from obc_ros.ros.execution.worker_thread import WorkerThread
from obc_ros.ros.parameters.files import check_files
from obc_ros.ros.parameters.table import (
    count_depth,
    declare_field,
    explain_idle,
    group,
    is_used,
    ParameterRow,
    StartValues,
    suggest_key,
    Value,
)
from obc_ros.ros.throttled_log import ThrottledLog
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import get_parameter_value, Parameter
from rclpy.service import Service
from yaml import YAMLError

__all__ = ['ParameterRow', 'declare_field', 'group', 'Parameters', 'StartValues', 'Value']

Settings = TypeVar('Settings')
Judged = TypeVar('Judged')
Callback = Callable[[Any, Any], Any]   # of a service
_TYPES = {each.value for each in Parameter.Type}


class Parameters(Generic[Settings, Judged]):
    """
    The parameters of one node.

    :param node: created with ``allow_undeclared_parameters=True``: unknown names are rejected
        here.
    :param judge: returns the candidate for given settings or raises ObcError; has no side effects.
    :param adopt: puts a candidate into use. It runs inside the service call and must be short. It
        is not called for the values at the start: use `candidate`.
    :param refused: called with the reason of each rejection.
    :param opening: returns the first line of the log of the node, for the candidate at the start.
    :param former: returns advice for values that follow a former meaning of a parameter, or an
        empty text. Its arguments are the given values, including those of unknown names, and all
        values, both by name.
    :ivar settings: the values in use.
    :ivar candidate: what `judge` returned for the values at the start.
    :raises ObcError: if a value at the start is rejected.
    """

    def __init__(
        self,
        node: Node,
        table: type[Settings],
        judge: Callable[[Settings], Judged],
        adopt: Callable[[Judged], None],
        refused: Callable[[str], None] | None = None,
        opening: Callable[[Judged], str] | None = None,
        former: Callable[[Mapping[str, Any], Mapping[str, Value]], str] = lambda *_: '',
        desk: WorkerThread | None = None,
    ) -> None:
        self._node, self._table, self._former = node, table, former
        self._judge, self._adopt, self._refused = judge, adopt, refused
        self._entries: dict[str, ParameterRow] = {}
        self._values: dict[str, Value] = {}
        self._start: dict[str, tuple[Value, str]] = {}  # in place of a default, and what gives it
        self._pending: tuple[dict[str, Value], Settings, Judged] | None = None
        self._asked: list[Parameter] = []  # as given, before `_normalise`
        self._is_attempt = False  # whose rejection is not reported
        self._desk, self._log = desk, ThrottledLog(node)
        self._prepared: tuple[Settings, Judged | None, Exception | None] | None = None
        # rclpy has no public list of the values given by files and arguments
        self._overrides: dict[str, Parameter] = getattr(node, '_parameter_overrides', {})
        self._shared = check_files(sys.argv, node.get_fully_qualified_name())
        for entry in self._rows():
            self._declare(entry)
        try:
            self._check_start()
            self.settings = self._assembled(self._values)
            self.candidate = judge(self.settings)
            if opening is not None:
                node.get_logger().info(opening(self.candidate))
        finally:
            self._report_unknown()
        node.add_pre_set_parameters_callback(self._normalise)
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._post_set)
        for service in node.services:
            if service.srv_type in (SetParameters, SetParametersAtomically):
                self._serve(service)
        guard(node)

    def _rows(self) -> Iterable[ParameterRow]:
        rows = fields(self._table)  # type: ignore[arg-type] # a dataclass type
        # What gives start values is declared before the parameters that get them.
        for each in sorted(rows, key=lambda each: not getattr(
                each.metadata.get('entry'), 'gives', None)):
            if 'group' in each.metadata:
                for member in each.metadata['group'](self._values):
                    yield replace(member, name=f'{each.name}.{member.name}')
            else:
                entry = each.metadata['entry']
                yield replace(entry, name=entry.name or each.name)

    def _declare(self, entry: ParameterRow) -> None:
        if entry.default_given and entry.default_given[0] in {*self._overrides, *self._start}:
            entry = replace(entry, default=entry.default_given[1])
        if entry.name in self._start:
            entry = replace(entry, default=entry.value(entry.ros(self._start[entry.name][0])))
        name, value = entry.name, entry.default
        if name in self._overrides:
            value = entry.value(self._overrides[name])
        self._entries[name], self._values[name] = entry, value
        self._node.declare_parameter(name, value, entry.descriptor(), ignore_override=True)
        if value == () and not entry.read_only:
            self._node.set_parameters([entry.ros(value)])  # an empty list was declared as bytes
        if entry.gives and value:
            giver = f"{name} = '{quote(str(value))}'"
            try:
                found = entry.gives(str(value))
            except ObcError as error:   # of a file: it may begin with its path
                raise restate(error, lambda line: (
                    f'{giver}: {line.removeprefix(f"{value}: ")}')) from None
            self._start |= {each: (given, giver) for each, given in found.values.items()}
            self._node.get_logger().info(f'{giver}: {found.note}')

    def _check_start(self) -> None:
        """Reject values at the start that no parameter takes, or that would have no effect."""
        for name, (_, giver) in self._start.items():
            if name not in self._entries:
                raise StatementError(f'{giver} gives {name}, but there is no such parameter: '
                                     'another given value, such as system, does not fit')
        given = {name: each.value for name, each in self._overrides.items()}
        if advice := self._former(given, self._values):
            raise StatementError(advice)
        for name in self._unknown():
            if name not in self._shared:
                raise StatementError(f"no parameter '{quote(name)}'"
                                     f'{suggest_key(name, self._entries)}')
        for name in self._idle(self._values):
            raise StatementError(explain_idle(self._entries, name, self._values, is_start=True))

    def _idle(self, values: Mapping[str, Value]) -> Iterator[str]:
        """Yield the parameters that have no effect and are not at their defaults."""
        return (name for name, entry in self._entries.items()
                if values[name] != entry.default and not is_used(entry.used_when, values))

    def _unknown(self) -> list[str]:
        return [name for name in self._overrides
                if not (self._node.has_parameter(name) or name.startswith('qos_overrides.'))]

    def _report_unknown(self) -> None:
        """Log names that sections for all nodes give, and that are no parameters of this one."""
        others = [name for name in self._unknown() if name in self._shared]
        for name in others:
            if near := suggest_key(name, self._entries):
                self._node.get_logger().warning(
                    f"no parameter '{quote(name)}': it has no effect{near}")
        if others:
            self._node.get_logger().info(
                f'ignored, not parameters of this node: {quote(", ".join(sorted(others)), 300)}')

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
        Convert values to the types of their parameters.

        In place of an invalid value rclpy gets the present one: otherwise it would reject the
        change with a message of its own and without a callback. `_on_set` checks the given values.
        Parameters that lose their effect are reset to their defaults in the same change.
        """
        self._asked = [*changes, *self._lost(changes)]
        return [self._normal(change) for change in self._asked]

    def _lost(self, changes: list[Parameter]) -> list[Parameter]:
        lost: dict[str, Value] = {}
        try:
            ours = self._read(changes)
        except StatementError:
            return []
        while new := {name: self._entries[name].default
                      for name in self._idle({**self._values, **ours, **lost})
                      if name not in ours} if ours else {}:
            lost |= new
        return [self._entries[name].ros(value) for name, value in lost.items()]

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
            return SetParametersResult(successful=True)  # set by rclpy, such as a QoS override
        try:
            if ours := self._read(asked):
                self._pending = self._judged(ours)
        except (ObcError, ArithmeticError) as error:
            if self._refused is not None and not self._is_attempt:
                self._refused(str(error))
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _serve(self, service: Service) -> None:
        """Take the place of rclpy's callback of a service that sets parameters."""
        callback = service.callback

        async def answer(request: Any, response: Any) -> Any:
            names, given = [each.name for each in request.parameters], list(request.parameters)
            if service.srv_type is SetParameters:
                response.results = results = await self._set_each(callback, given)
            else:
                response.result = await self._set_together(callback, given)
                names, results = [', '.join(names)], [response.result]
            for name, result in zip(names, results, strict=True):
                if not result.successful:
                    self._log.warning(
                        'refused', f'a change of {quote(name, 100)} was rejected: '
                        f'{quote(result.reason, 500)}')
            return response

        service.callback = answer
        if self._desk is not None:
            self._desk.move(service, self._desk.changes)

    async def _set_each(self, callback: Callback, given: list[Any]) -> list[SetParametersResult]:
        if refusal := _find_unknown_type(given):
            return [refusal] * len(given)
        changes = list(map(Parameter.from_parameter_msg, given))
        results = [SetParametersResult(successful=True)] * len(given)
        left = [index for index, each in enumerate(changes) if not self._is_kept(each)]
        if len(left) > 1:
            wanted = [changes[index] for index in left]
            await self._prepare(wanted)
            if self._attempt(wanted).successful:
                return results
        for index in sorted(left, key=lambda index: count_depth(self._entries, given[index].name)):
            await self._prepare([changes[index]])
            request = SetParameters.Request(parameters=[given[index]])
            results[index] = callback(request, SetParameters.Response()).results[0]
        return results

    async def _set_together(self, callback: Callback, given: list[Any]) -> SetParametersResult:
        if refusal := _find_unknown_type(given):
            return refusal
        left = [each for each in given if not self._is_kept(Parameter.from_parameter_msg(each))]
        if given and not left:
            return SetParametersResult(successful=True)
        await self._prepare([Parameter.from_parameter_msg(each) for each in left])
        return callback(SetParametersAtomically.Request(parameters=left),
                        SetParametersAtomically.Response()).result

    async def _prepare(self, changes: list[Parameter]) -> None:
        """Judge changes at the desk, so that they are set without delay afterwards."""
        self._prepared = None
        if self._desk is None:
            return
        try:
            ours = self._read([*changes, *self._lost(changes)])
            settings = self._propose(ours)[1] if ours else self.settings
        except ObcError:   # the change itself is rejected with this reason
            return
        try:
            judged = await self._desk.run(lambda: self._judge(settings), is_change=True)
            self._prepared = settings, judged, None
        except (ObcError, ArithmeticError) as error:
            self._prepared = settings, None, error

    def _attempt(self, changes: list[Parameter]) -> SetParametersResult:
        self._is_attempt = True
        try:
            return self._node.set_parameters_atomically(changes)
        finally:
            self._is_attempt = False

    def _is_kept(self, given: Parameter) -> bool:
        """
        Return whether a parameter has the given value already and would reject it as given.

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

    def _judged(self, ours: Mapping[str, Value]) -> tuple[dict[str, Value], Settings, Judged]:
        """Return the values, settings and candidate after changes, or raise ObcError."""
        values, settings = self._propose(ours)
        prepared, self._prepared = self._prepared, None
        if prepared is None or prepared[0] != settings:
            return values, settings, self._judge(settings)
        _, judged, error = prepared
        if error is not None:
            raise error
        return values, settings, cast(Judged, judged)

    def _propose(self, ours: Mapping[str, Value]) -> tuple[dict[str, Value], Settings]:
        values = {**self._values, **ours}
        for name in self._idle(values):
            raise StatementError(explain_idle(self._entries, name, values) + self._advise(
                {name: values[name]}, values))
        return values, self._assembled(values)

    def _advise(self, given: Mapping[str, Any], values: Mapping[str, Value]) -> str:
        advice = self._former(given, values)
        return advice and f'; {advice}'

    def _post_set(self, changes: list[Parameter]) -> None:
        if self._pending is not None:
            before = self._values
            (self._values, self.settings, candidate), self._pending = self._pending, None
            self._adopt(candidate)
            lost = [name for name, entry in self._entries.items()
                    if self._values[name] == entry.default != before[name]
                    and not is_used(entry.used_when, self._values)]
            if lost:
                self._node.get_logger().info(
                    f'{", ".join(lost)}: not used any more, back at the default')

    def _read(self, changes: list[Parameter]) -> dict[str, Value]:
        values: dict[str, Value] = {}
        for change in changes:
            entry = self._entries.get(change.name)
            if entry is None:
                if not self._node.has_parameter(change.name):
                    advice = self._advise({change.name: change.value}, self._values)
                    raise StatementError(
                        f"no parameter '{quote(change.name)}'"
                        f'{advice or suggest_key(change.name, self._entries)}')
            elif change.type_ is Parameter.Type.NOT_SET:
                raise StatementError(f'{quote(change.name)} cannot be deleted, only set')
            else:
                values[change.name] = entry.value(change)
        return values


def _find_unknown_type(given: list[Any]) -> SetParametersResult | None:
    for each in given:
        if each.value.type not in _TYPES:
            return SetParametersResult(
                reason=f'{quote(each.name)}: there is no parameter type {each.value.type}')
    return None


def _reads_as(text: str, given: Parameter) -> bool:
    """Return whether ``ros2`` converts a text to the given value."""
    try:
        return bool(get_parameter_value(text) == given.get_parameter_value())
    except YAMLError:
        return False
