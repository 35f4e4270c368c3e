# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Tables of data in the expressions of a statement: ``price(t)``, ``road(px)``.

A table is a piecewise polynomial y of its argument a. With s_k = (a - a_k)/(a_(k+1) - a_k),
limited to [0, 1], it is

    y = y_0 + sum of P_k(s_k),   P_k(0) = 0,   P_k(1) = y_(k+1) - y_k,

beyond its ends the first and the last polynomial; or a sum of steps. Where the argument is the
time, knots are mesh points. A kink or a jump lies in a mesh interval of its own, which is so short
that what happens in it does not count: rounding of the time then decides nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, optimize
from obc_ros.core.ocp.problem import FinalTime
from obc_ros.core.text.errors import (
    DependentError,
    describe_type,
    Faults,
    quote,
    StatementError,
    suggest_name,
)
from obc_ros.core.text.expressions import check_name, MAX_NUMBER
from obc_ros.core.text.fields import Given, list_of, read_mapping, read_section

METHODS = 'linear', 'cubic', 'steps'
# In the shortest piece: by how much a jump is late, so that one at T is not reached; and the ends
# of the interval of a kink or a jump, no part of which ends there.
_LATE, _AROUND = 1e-6, (-0.4e-6, 0.6e-6)
_FORM = '{t: [0, 1, 2], value: [3, 5, 4], method: linear}'
_SAMPLES = 2001   # at which changes of sign are looked for
_ROUNDING = 1e-9   # of the range of a table: so far outside of it counts as inside


@dataclass(frozen=True, eq=False)
class DataTable:
    """
    Values of a function at increasing arguments, and how they are interpolated.

    :ivar argument, value: (K,) each.
    :ivar method: `linear`; `cubic`, twice continuously differentiable; or `steps`, each value from
        its argument on.
    """

    name: str
    argument: Array
    value: Array
    method: str

    @property
    def shortest(self) -> float:
        """Return the length of the shortest piece."""
        return float(np.diff(self.argument).min())

    @property
    def edges(self) -> Array:
        """Return the arguments at which pieces meet."""
        return self.argument[1:] + _LATE * self.shortest if self.method == 'steps' else (
            self.argument[1:-1])

    @cached_property
    def _increments(self) -> Array:
        """Return the coefficients of s, s^2, .. of each P_k, (pieces, degree)."""
        if self.method != 'cubic':
            return np.diff(self.value)[:, None]
        from scipy.interpolate import CubicSpline
        spline = CubicSpline(self.argument, self.value)
        return np.asarray((spline.c[2::-1] * np.diff(self.argument) ** [[1], [2], [3]]).T)

    def evaluate(self, a: ca.SX) -> ca.SX:
        """Return the table as an expression."""
        y, last = ca.SX(self.value[0]), len(self._increments) - 1
        if self.method == 'steps':
            for at, step in zip(self.edges, np.diff(self.value), strict=True):
                y += step * (a >= at)
            return y
        for k, (start, end, coefficients) in enumerate(zip(
                self.argument[:-1], self.argument[1:], self._increments, strict=True)):
            s = (a - start) / (end - start)
            s = s if k == 0 else ca.fmax(s, 0)
            s = s if k == last else ca.fmin(s, 1)
            rising = ca.SX(0)
            for coefficient in coefficients[::-1]:
                rising = (rising + coefficient) * s
            y += rising
        return y


@dataclass
class DataTables:
    """
    The tables of a statement, and the uses of what is not smooth in the time.

    :ivar signals: symbols of the states, the inputs and the free parameters.
    :ivar functions: the tables, max, min, sign and if, with their numbers of arguments.
    """

    signals: ca.SX
    functions: dict[str, tuple[int, Callable[..., ca.SX]]] = field(init=False)
    _uses: list[tuple[DataTable, ca.SX]] = field(default_factory=list)
    _switches: list[ca.SX] = field(default_factory=list)
    _jumps: bool = False

    def __post_init__(self) -> None:
        self.functions = {'max': (2, self._larger), 'min': (2, lambda a, b: -self._larger(-a, -b)),
                          'sign': (1, lambda a: 2 * self._step(a) - 1),
                          'if_': (3, self._choose)}

    def _larger(self, a: ca.SX, b: ca.SX) -> ca.SX:
        if ca.depends_on(a - b, self.signals):
            return (a + b + ca.fabs(a - b)) / 2
        self._switches.append(a - b)
        return ca.fmax(a, b)

    def _choose(self, a: ca.SX, b: ca.SX, c: ca.SX) -> ca.SX:
        return c + self._step(a) * (b - c)

    def _step(self, a: ca.SX) -> ca.SX:
        if ca.depends_on(a, self.signals):
            raise StatementError(
                'sign and if may switch with the time only, not with states or inputs; write '
                'max(a, b) for a kink, state phases, or (1 + tanh(a/e))/2 with a small number e')
        self._switches.append(a)
        self._jumps = True
        return a >= 0

    def add(self, table: DataTable) -> None:
        """Add a table."""
        def use(argument: ca.SX) -> ca.SX:
            self._uses.append((table, argument))
            return table.evaluate(argument)

        self.functions[table.name] = 1, use

    def find_breaks(self, time: ca.SX | None, p: ca.SX, values: Array, final: FinalTime
                    ) -> tuple[Array, Array]:
        """
        Return the times in (0, T) of mesh points, and the spans of kinks and jumps, sorted.

        :param p, values: symbols of the parameters, and their values.
        :raises StatementError: if the time leaves a table before T, T is free and a table has
            steps, or the argument of a table that is not smooth is not affine in the time.
        """
        found, width = [np.zeros(0)], 0.0
        with Faults() as faults:
            for table, argument in self._uses:
                line = faults.attempt(_find_line, table, argument, ca.SX(
                    0, 1) if time is None else time, p, values, final)
                if line and line[1]:
                    t = np.sort((table.edges - line[0]) / line[1])
                    spans = t[:, None] + table.shortest / abs(line[1]) * np.array(_AROUND)
                    inside = (spans[:, 0] > 0) & (spans[:, 1] < final.latest)
                    found.append((t if table.method == 'cubic' else spans)[inside].ravel())
                    width = max(width, table.shortest / abs(line[1]) * _LATE)
        if self._jumps and final.free:
            raise StatementError('sign and if need a given final time; write final_time: 5')
        if self._switches:
            t = _find_roots(self._switches, time, p, values, final.latest)
            found.append((t[:, None] + final.latest / _SAMPLES * np.array(_AROUND)).ravel())
            width = max(width, final.latest / _SAMPLES * _LATE)
        # What is closer than the width of a span is one edge.
        times = np.unique(np.concatenate(found))
        groups = np.split(times, np.flatnonzero(np.diff(times) > 2 * width) + 1)
        edges = [group[[0, -1]] for group in groups if len(group) > 1]
        return np.concatenate([group[[0, -1]][:len(group)] for group in groups if group.size] or [
            times]), np.reshape(edges, (-1, 2))


def _find_roots(switches: list[ca.SX], time: ca.SX | None, p: ca.SX, values: Array,
                latest: float) -> Array:
    """Return where expressions of the time change their sign in (0, T), seen in `_SAMPLES`."""
    symbols = ca.vertcat(p) if time is None else ca.vertcat(time, p)
    known = {each.element_hash() for each in ca.vertsplit(symbols)}
    roots = []
    for each in switches:
        if time is None or any(s.element_hash() not in known for s in ca.symvar(each)):
            continue   # numbers that were replaced: it is seen twice
        value = ca.Function('switch', [time, p], [each])
        t = np.linspace(0.0, latest, _SAMPLES)
        y = value.map(len(t))(t[None], np.tile(values[:, None], len(t))).full()[0]
        roots += [optimize.brentq(lambda s, of=value: float(of(s, values)), t[k], t[k + 1],
                                  xtol=1e-15 * latest) for k in np.flatnonzero(y[:-1] * y[1:] < 0)]
        roots += t[1:-1][(y[1:-1] == 0) & (y[:-2] * y[2:] < 0)].tolist()
    return np.unique(roots)


def _find_line(table: DataTable, argument: ca.SX, time: ca.SX, p: ca.SX, values: Array,
               final: FinalTime) -> tuple[float, float] | None:
    """Return the argument of a table at t = 0 and its rate, None if it is another function."""
    smooth, symbols = table.method == 'cubic', ca.vertcat(time, p)
    known = {each.element_hash() for each in ca.vertsplit(symbols)}
    others = [each.name() for each in ca.symvar(argument) if each.element_hash() not in known]
    if any('#' in name for name in others):   # numbers that were replaced: it is seen twice
        return None
    slope = ca.jacobian(argument, time) if time.numel() else ca.SX(0)
    straight = not others and not ca.depends_on(slope, time)
    if not straight:
        if smooth:
            return None
        raise StatementError(
            f'tables.{table.name}: its argument, {quote(str(argument), 40)}, is not the time or '
            f'affine in it, and the table has {"jumps" if table.method == "steps" else "kinks"}; '
            'write method: cubic')
    if table.method == 'steps' and final.free:
        raise StatementError(f'tables.{table.name}: steps need a given final time; write '
                             'final_time: 5, or method: linear')
    latest = final.latest
    rate, start = (float(each) for each in ca.Function('line', [symbols], [
        slope, ca.substitute(argument, time, 0) if time.numel() else argument])(
            np.append(np.zeros(time.numel()), values)))
    reached, ends = sorted((start, start + rate * latest)), (
        table.argument[0], np.inf if table.method == 'steps' else table.argument[-1])
    margin = _ROUNDING * float(np.ptp(table.argument))
    if reached[0] < ends[0] - margin or reached[1] > ends[1] + margin:
        raise StatementError(
            f'tables.{table.name}: its argument goes from {reached[0]:g} to {reached[1]:g} until '
            f'T = {latest:g}, but the table from {ends[0]:g} to {ends[1]:g}')
    return start, rate


def read_tables(given: Given, names: Sequence[str], signals: ca.SX, faults: Faults) -> DataTables:
    """Return the tables of a statement, whose errors go to `faults`; `names`: of its symbols."""
    tables = DataTables(signals)
    for name, entry in (faults.attempt(read_section, given, 'tables') or {}).items():
        if table := faults.attempt(_read_table, name, entry, names):
            tables.add(table)
        else:
            tables.functions[str(name)] = 1, _refuse
    return tables


def _refuse(_: ca.SX) -> ca.SX:
    raise DependentError('a table is malformed')


def _read_table(name: object, entry: Any, names: Sequence[str]) -> DataTable:
    name = check_name(name, 'tables')
    where = f'tables.{name}'
    if name in names:
        raise StatementError(f'{where}: the name is one of a state, an input or a parameter, too')
    if isinstance(entry, (list, tuple)) and len(entry) in (2, 3):   # (t, values, method)
        entry = dict(zip(('argument', 'value', 'method'), entry, strict=False))
    entry = dict(read_mapping(entry, where, _FORM))
    if 'file' in entry:
        raise StatementError(f'{where}.file: files are read beside a problem file only; write '
                             f'{_FORM}')
    method, value = entry.pop('method', 'linear'), entry.pop('value', None)
    if method not in METHODS:
        raise StatementError(f'{where}.method: wanted {", ".join(METHODS)}, found '
                             f'{describe_type(method)}{suggest_name(str(method), METHODS)}')
    if value is None or len(entry) != 1:
        raise StatementError(f'{where}: wanted {_FORM}, found the keys '
                             f'{quote(", ".join(map(str, entry)))}')
    [(key, argument)] = entry.items()
    a, y = _read_numbers(argument, f'{where}.{key}'), _read_numbers(value, f'{where}.value')
    if len(a) != len(y):
        raise StatementError(f'{where}: {len(a)} arguments and {len(y)} values; wanted as many')
    wrong = np.flatnonzero(np.diff(a) <= 0)
    if wrong.size:
        k = int(wrong[0])
        raise StatementError(f'{where}.{key}: wanted increasing numbers, found {a[k + 1]:g} after '
                             f'{a[k]:g}')
    return DataTable(name, a, y, method)


def _read_numbers(value: object, where: str) -> Array:
    numbers = list_of(value, where, 'a list of numbers')
    if len(numbers) < 2:
        raise StatementError(f'{where}: wanted two numbers or more, found {len(numbers)}')
    for k, number in enumerate(numbers):
        if isinstance(number, bool) or not isinstance(number, (int, float)) or not (
                abs(number) <= MAX_NUMBER):
            raise StatementError(f'{where}[{k}]: wanted a finite number, up to {MAX_NUMBER:g}, '
                                 f'found {describe_type(number)}')
    return np.array(numbers, dtype=float)
