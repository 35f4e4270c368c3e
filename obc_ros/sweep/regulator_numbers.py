# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a linear quadratic regulator that a sweep can vary: see docs/sweeps.md."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

from obc_ros.core.systems.file import build_plant, FOR_PEOPLE
from obc_ros.core.systems.registry import find_registered
from obc_ros.core.systems.system import Signal, System
from obc_ros.core.text.errors import describe_type, StatementError
from obc_ros.core.text.expressions import parse_number
from obc_ros.core.text.fields import check_keys, read_section
from obc_ros.sweep.dataset import REGULATOR_QUANTITIES
from obc_ros.sweep.problem_numbers import check_number_key, Place, replace_number

LISTS = ('Qx', 'Qu', 'cross', 'x_max', 'u_max', 'H', 'A', 'B', 'setpoint', 'setpoint_input')
NUMBERS = ('rho', 'stability')
KEYS = ('name', 'system', 'parameters', 'weights', *LISTS, *NUMBERS)
DEVIATION = 0.1   # of each state from the set point, in its unit


class RegulatorNumbers:
    """
    A case of `obc lqr` whose numbers vary, and whose closed loop is simulated.

    :param case: as in a file of `obc lqr`, without sampling and delay.
    :param plant: of a file, as `take_plant` returns it; None: that of the case.
    :ivar dimensions: names of the states and of the inputs.
    :raises ObcError: if the case is malformed.
    """

    kind = 'regulator'
    quantities = REGULATOR_QUANTITIES

    def __init__(self, case: Mapping[str, Any], plant: Mapping[str, Any] | None = None) -> None:
        for key in ('sample_time', 'delay'):
            if case.get(key):
                raise StatementError(f'{key}: a sweep simulates regulators in continuous time')
        check_keys({key: value for key, value in case.items()
                    if key not in ('sample_time', 'delay')}, KEYS, FOR_PEOPLE)
        self.statement = dict(case)
        for key in (*LISTS, *NUMBERS):
            if self.statement.get(key) not in (None, []):
                read_numbers(self.statement[key], key)
        if plant is not None:
            self.statement['plant'] = dict(plant)
        self._system = self._find_system()
        states, inputs = self._signals()
        self.dimensions = {'state': tuple(signal.name for signal in states),
                           'input': tuple(signal.name for signal in inputs)}
        self._units = {signal.name: signal.unit for signal in (*states, *inputs)}

    @cached_property
    def places(self) -> dict[str, Place]:
        """Return where the number of each key stands in the request."""
        found: dict[str, Place] = {f'x0.{name}': ('x0', name) for name in self.dimensions['state']}
        found['T'] = ('T',)
        found |= {key: ('case', key) for key in NUMBERS}
        for key in LISTS:
            found |= {'.'.join(map(str, (key, *place))): ('case', key, *place)
                      for place in _positions(self.statement.get(key))}
        parameters = self._system.parameters if self._system else ()
        for name in (parameter.name for parameter in parameters):
            found.setdefault(name, ('case', 'parameters', name))
            found[f'parameters.{name}'] = ('case', 'parameters', name)
            found[f'plant.{name}'] = ('plant', 'parameters', name)
        for key in ('A', 'B') if not self._system else ():
            found |= {'.'.join(map(str, ('plant', key, *place))): ('plant', key, *place)
                      for place in _positions(self.statement.get(key))}
        return found

    def check_key(self, key: str) -> None:
        """Raise StatementError if there is no number with this key."""
        check_number_key(key, self.places, (
            "weights are 'Qx.0', parameters 'NAME', those of the plant alone 'plant.NAME'"))

    def vary(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Return a request with other numbers; those of the design hold for the plant, too."""
        start = 0.0 if any(key.startswith('x0.') for key in values) else DEVIATION
        found: dict[str, Any] = {
            'case': self.statement, 'T': 0.0,
            'x0': dict.fromkeys(self.dimensions['state'], start)}
        chosen = {self.places[key]: value for key, value in values.items()}
        for place, value in chosen.items():
            if place[0] != 'plant':
                found = replace_number(found, place, value)
        found['plant'] = {key: found['case'].get(key) for key in ('parameters', 'A', 'B')}
        for place, value in chosen.items():
            if place[0] == 'plant':
                found = replace_number(found, place, value)
        return found

    def unit(self, key: str) -> str:
        """Return the unit of a number; empty if it is not known."""
        if key == 'T':
            return 's'
        if self.places[key][0] == 'x0':
            return self._units[str(self.places[key][1])]
        if 'parameters' in self.places[key] and self._system:
            return {each.name: each.unit for each in self._system.parameters}[
                str(self.places[key][-1])]
        return ''

    def long_key(self, key: str) -> str:
        """Return the key that begins with the section of the case."""
        return 'duration' if key == 'T' else '.'.join(map(str, self.places[key])).removeprefix(
            'case.')

    def _find_system(self) -> System | None:
        case = self.statement
        if case.get('plant') is not None:
            return build_plant(case['plant'], read_section(case, 'parameters'))
        if case.get('system') is None:
            return None
        for key in ('A', 'B'):
            if case.get(key) is not None:
                raise StatementError(f"{key}: give either 'system' or 'A' and 'B'")
        parameters = case.get('parameters') or {}
        if not isinstance(case['system'], str) or not isinstance(parameters, Mapping):
            raise StatementError("system: wanted a name, and 'parameters' a mapping")
        return find_registered(case['system'], parameters)

    def _signals(self) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
        """Return states and inputs; those of given matrices are numbered."""
        if self._system:
            return self._system.states, self._system.inputs
        sizes = []
        for key in ('A', 'B'):
            rows = self.statement.get(key)
            if not isinstance(rows, list) or not rows or not all(
                    isinstance(row, list) and len(row) == len(rows[0]) > 0 for row in rows):
                raise StatementError(f'{key}: wanted rows of equal length, or a system')
            sizes.append((len(rows), len(rows[0])))
        (n, width), (height, m) = sizes
        if not n == width == height:
            raise StatementError(f'A is {n} by {width} and B is {height} by {m}: wanted as many '
                                 'rows of B as A has rows and columns')
        return (tuple(Signal(f'x{i + 1}') for i in range(n)),
                tuple(Signal(f'u{j + 1}') for j in range(m)))


def read_numbers(value: Any, where: str) -> Any:
    """Return nested lists, or one entry, as numbers; StatementError, at `where`: they are none."""
    if isinstance(value, (list, tuple)):
        lengths = {len(each) if isinstance(each, (list, tuple)) else -1 for each in value}
        if len(lengths) > 1 or not value:
            raise StatementError(f'{where}: wanted numbers, or rows of equal length')
        return [read_numbers(each, f'{where}[{index}]') for index, each in enumerate(value)]
    if isinstance(value, Mapping) or value is None:
        raise StatementError(f'{where}: wanted a number, found {describe_type(value)}')
    return parse_number(value, {}, where)


def _positions(value: Any) -> Iterator[tuple[int, ...]]:
    for index, each in enumerate(value if isinstance(value, (list, tuple)) else ()):
        if isinstance(each, (list, tuple)):
            yield from ((index, *rest) for rest in _positions(each))
        else:
            yield (index,)
