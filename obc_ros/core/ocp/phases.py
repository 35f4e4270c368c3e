# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Problems with phases, stated as a problem with one: see docs/certificate.md.

Phase k, of duration d_k, runs over the normalised time s from 0 to 1 at the same time as all
others, with its own states and inputs: dx_k/ds = d_k f_k, running cost sum of d_k L_k. What links
two phases are conditions on x_(k+1)(0) and x_k(1); free durations are free parameters.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
import re
from typing import Any

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import quote, StatementError, suggest_name
from obc_ros.core.text.fields import (
    check_keys,
    Given,
    list_of,
    read_list,
    read_mapping,
    read_names,
    read_section,
)

MOST_PHASES = 20
Rename = Callable[[str], str]
# What a phase may have for itself; in its absence that of the file holds.
_SHARED = 'dynamics', 'running_cost', 'path_constraints', 'input_bounds', 'state_bounds'
_OWN = 'name', 'duration', 'link', 'terminal_cost', 'terminal_constraints', 'initial_guess'
_UNUSED = ('system', 'final_time', 'periodic', 'boundary_constraints', 'initial_guess',
           'starts')
_DURATION = 'duration'
_IDENTIFIER = re.compile(r'(?<![\w.])[A-Za-z_]\w*', re.ASCII)
_INDEXED = re.compile(r'\b([A-Za-z_]\w*?)__(\d+)(_0\b|\(0\)|\b)', re.ASCII)
_ROW = re.compile(r'\b(?:(?:terminal|path|boundary)_constraints\[\d+\]|'
                  r'(?:free_)?parameters\.duration__\d+)', re.ASCII)
# Times of the joined statement, of which T = 1 is given: all phases run at the same time.
_MOMENT = re.compile(r'\bt = (\d[\d.e+-]*)')
_LENGTH = re.compile(r'\bT = (\d[\d.e+-]*\d|\d)')
_CLOCK = re.compile(r' \(t stays between 0 and 1\)|\bt stays between 0 and 1, |'
                    r', t stays between 0 and 1\b')


@dataclass(frozen=True)
class PhaseLayout:
    """
    Names of the phases, the states and the inputs of a statement with phases.

    The states of the problem begin with those of the first phase, then those of the second one,
    and so on, and so do its inputs. `rows`: what the statement has for keys of constraints of the
    problem.
    """

    names: tuple[str, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    rows: Mapping[str, str]

    @property
    def durations(self) -> tuple[str, ...]:
        """Return the names of the parameters that are the durations [s]."""
        return tuple(_indexed(_DURATION, k) for k in range(len(self.names)))

    def stack(self, times: Array, durations: Array, *columns: Array) -> tuple[Array, ...]:
        """
        Return samples of all phases, one phase after the other.

        :param *columns: (N, phases * m), values of the phases side by side.
        :return: t: (phases * N,), times [s]; *values: (phases * N, m).
        """
        starts = np.append(0.0, np.cumsum(durations))[:-1]
        count = len(self.names)
        t = (starts[:, None] + durations[:, None] * times).ravel()
        return t, *(np.concatenate(np.split(each, count, axis=1)) for each in columns)

    def name_phases(self, message: str) -> str:
        """Return a message about the problem in the words of the statement."""
        message = _CLOCK.sub('', message)
        message = _ROW.sub(lambda found: self.rows.get(found[0], found[0]), message)
        message = _MOMENT.sub(r'\1 of each phase', message)
        message = _LENGTH.sub(lambda found: (
            'the end' if float(found[1]) == 1 else f'{found[1]} times the durations'), message)
        return _INDEXED.sub(lambda found: f'{found[1]} of phase {self._label(int(found[2]))}' + (
            ' at its start' if found[3] else ''), message)

    def _label(self, number: int) -> str:
        return self.names[number - 1] if 0 < number <= len(self.names) else str(number)


def state_as_one_phase(given: Given) -> tuple[dict[str, Any], PhaseLayout]:
    """Return the statement with one phase that is equivalent to one with phases."""
    for key in _UNUSED:
        if given.get(key) is not None:
            raise StatementError(f'{key}: not for a problem with phases; ' + (
                'each phase has its duration' if key == 'final_time' else
                'each phase may have its own' if key == 'initial_guess' else 'leave it out'))
    phases = [read_mapping(each, f'phases[{k}]')
              for k, each in enumerate(list_of(given['phases'], 'phases', most=MOST_PHASES))]
    if len(phases) < 2:
        raise StatementError(f'phases: wanted two or more, found {len(phases)}')
    for k, phase in enumerate(phases):
        check_keys(phase, _OWN + _SHARED, where=f'phases[{k}]')
    states, inputs = read_names(given, 'states'), read_names(given, 'inputs')
    own = {key for name in ('parameters', 'free_parameters') for key in read_section(given, name)}
    for name in (*states, *inputs, *map(str, own)):
        if '__' in name:
            raise StatementError(f"phases: '{quote(name)}' contains __, which stands between a "
                                 'name and the number of a phase; choose another name')
    joined = _Joined(given, phases, states, inputs, own)
    names = tuple(quote(str(phase.get('name') or k + 1)) for k, phase in enumerate(phases))
    for name in (*states, *inputs):
        if name in own:
            raise StatementError(f"phases: '{name}' is both a parameter and a state or an input")
    return joined.statement(), PhaseLayout(names, states, inputs, joined.name_rows(names))


def state_each_phase(given: Given) -> Iterator[tuple[dict[str, Any], Rename]]:
    """
    Yield the parts of a statement with phases as statements of their own.

    An error in one of them is an error of the statement, in its own names and texts.

    :yield: statement: without it: a phase, a link, or the end of the last phase; rename: returns a
        message about this part as one about the whole statement.
    """
    phases = given['phases']
    for k, phase in enumerate(phases):
        part = _state_phase(given, k)
        own = part | {key: phase.get(key) for key in ('terminal_cost', 'terminal_constraints')}
        yield own, partial(_rename_phase, k, phase)
        for name, text in (phases[k + 1].get('link') or {} if k + 1 < len(phases) else {}).items():
            yield part | {'terminal_cost': text}, partial(
                _replace_key, 'terminal_cost', f'phases[{k + 1}].link.{name}')
    yield part | {key: given.get(key) for key in (
        'terminal_cost', 'terminal_constraints')}, str


def _state_phase(given: Given, k: int) -> dict[str, Any]:
    """Return a phase as a statement without costs and constraints at its end."""
    phase, states = given['phases'][k], read_names(given, 'states')
    duration, guess = phase['duration'], dict(phase.get('initial_guess') or {})
    start = given.get('initial_state')
    if k:
        known = start if isinstance(start, Mapping) else {}
        guess['states'] = {name: value for name, value in known.items() if name in states
                           and isinstance(value, (int, float, str))} | (guess.get('states') or {})
        start = dict.fromkeys(states)
    part = {key: given[key] for key in (
        'states', 'inputs', 'parameters', 'free_parameters') if key in given} | {
        key: given.get(key) if phase.get(key) is None else phase[key] for key in _SHARED} | {
        'initial_state': start, 'initial_guess': guess,
        'final_time': duration if isinstance(duration, Mapping) else {
            'free': False, 'value': duration}}
    if not k:
        part |= {key: given.get(key) for key in ('initial_cost', 'initial_constraints')}
    names = {*states, *read_names(given, 'inputs'), *read_section(given, 'parameters')}
    if 't' not in names and any(isinstance(each['duration'], Mapping)
                                for each in given['phases'][:k + 1]):
        # at the end of the phase it is as free as a state
        part |= {'states': [*states, 't'], 'dynamics': {**part['dynamics'], 't': '1'},
                 'initial_state': {**start, 't': 0} if isinstance(start, Mapping) else start}
    return part


def _rename_phase(k: int, phase: Given, message: str) -> str:
    key = re.split(r'\W', message, maxsplit=1)[0]
    if key == 'final_time':
        of = 'final_time' if isinstance(phase['duration'], Mapping) else 'final_time.value'
        return _replace_key(of, f'phases[{k}].duration', message)
    message = message.replace('in initial_guess', f'in phases[{k}].initial_guess')
    return message if phase.get(key) is None else f'phases[{k}].{message}'


def _replace_key(key: str, by: str, message: str) -> str:
    return by + message.removeprefix(key) if message.startswith(key) else message


def _indexed(name: str, k: int) -> str:
    return f'{name}__{k + 1}'


class _Joined:
    """The parts of a joined statement."""

    def __init__(self, given: Given, phases: list[Given],
                 states: tuple[str, ...], inputs: tuple[str, ...], own: Collection[Any]) -> None:
        self._given, self._phases, self._states, self._inputs = given, phases, states, inputs
        self._timed, self._ended = (each not in {*states, *inputs, *own} for each in 'tT')
        self._parameters = dict(read_section(given, 'parameters'))
        self._free = dict(read_section(given, 'free_parameters'))
        self._guess: dict[str, dict[str, Any]] = {'states': {}, 'inputs': {}, 'parameters': {}}

    def statement(self) -> dict[str, Any]:
        count = range(len(self._phases))
        for k in count:
            self._add_duration(k)
            self._add_guess(k)
        costs = [(k, self._get(k, 'running_cost')) for k in count]
        ends = [(k, self._phases[k].get('terminal_cost')) for k in count]
        ends.append((len(self._phases) - 1, self._given.get('terminal_cost')))
        return {key: value for key, value in self._given.items()
                if key not in ('phases', *_SHARED)} | {
            'states': [_indexed(x, k) for k in count for x in self._states],
            'inputs': [_indexed(u, k) for k in count for u in self._inputs],
            'parameters': self._parameters, 'free_parameters': self._free,
            'dynamics': dict(pair for k in count for pair in self._dynamics(k)),
            'running_cost': ' + '.join(
                f'{_indexed(_DURATION, k)}*({self._text(cost, k)})'
                for k, cost in costs if cost is not None) or 0,
            'terminal_cost': ' + '.join(
                f'({self._text(cost, k)})' for k, cost in ends if cost is not None) or 0,
            'initial_cost': self._text(self._given.get('initial_cost') or 0, 0, timed=False),
            'initial_constraints': [self._row(row, 0, timed=False) for row in read_list(
                self._given, 'initial_constraints')],
            'terminal_constraints': [
                self._row(row, k) for _, k, row in self._rows('terminal_constraints')],
            'boundary_constraints': [row for k in count[1:] for _, row in self._links(k)],
            'initial_state': self._initial_state(),
            'path_constraints': [
                self._row(row, k) for _, k, row in self._rows('path_constraints')],
            'input_bounds': dict(pair for k in count for pair in self._bounds(
                k, 'input_bounds', self._inputs)),
            'state_bounds': dict(pair for k in count for pair in self._bounds(
                k, 'state_bounds', self._states)),
            'final_time': {'free': False, 'value': 1},
            'initial_guess': {key: value for key, value in self._guess.items() if value}}

    def name_rows(self, labels: Sequence[str]) -> dict[str, str]:
        """Return keys of the statement by those of the joined one, where they differ."""
        found = {f'{key}[{row}]': name for key in ('terminal_constraints', 'path_constraints')
                 for row, (name, _, _) in enumerate(self._rows(key))}
        found |= {f'path_constraints[{row}]': f'{name} of phase {labels[k]}' for row, (
            name, k, _) in enumerate(self._rows('path_constraints'))
            if name.startswith('path_constraints')}
        found |= {f'{key}.{_indexed(_DURATION, k)}': f'phases[{k}].{_DURATION}'
                  for key in ('parameters', 'free_parameters') for k in range(len(labels))}
        links = [f'phases[{k}].link.{name}' for k in range(1, len(self._phases))
                 for name, _ in self._links(k)]
        return found | {f'boundary_constraints[{row}]': name for row, name in enumerate(links)}

    def _rows(self, key: str) -> list[tuple[str, int, Any]]:
        """Return the key, the phase and the text of each row of a list."""
        lists = [(f'phases[{k}].{key}', k, phase.get(key))
                 for k, phase in enumerate(self._phases)]
        shared, last = self._given.get(key), len(self._phases) - 1
        if key in _SHARED:   # it holds where a phase has none of its own
            lists = [(key, k, shared) if value is None else (name, k, value)
                     for name, k, value in lists]
        else:
            lists.append((key, last, shared))
        return [(f'{name}[{row}]', k, each) for name, k, value in lists if value is not None
                for row, each in enumerate(list_of(value, name))]

    def _get(self, k: int, key: str) -> Any:
        value = self._phases[k].get(key)
        return self._given.get(key) if value is None else value

    def _section(self, k: int, key: str) -> Given:
        value = self._get(k, key)
        return {} if value is None else read_mapping(value, f'phases[{k}].{key}')

    def _text(self, text: object, k: int, *, timed: bool = True) -> object:
        """Return an expression of a phase in the names of the joined statement."""
        if not isinstance(text, str):
            return text
        names = {*self._states, *self._inputs}
        before = ' + '.join(_indexed(_DURATION, j) for j in range(k))
        time = f"({before + ' + ' if before else ''}{_indexed(_DURATION, k)}*t)"

        def rename(found: re.Match[str]) -> str:
            name = found[0]
            if name == 't' and timed and self._timed:
                return time
            if name == 'T' and timed and self._ended:
                return f"({' + '.join(_indexed(_DURATION, j) for j in range(len(self._phases)))})"
            return _indexed(name, k) if name in names else name

        return _IDENTIFIER.sub(rename, text)

    def _row(self, row: object, k: int, *, timed: bool = True) -> object:
        """Return a constraint of a phase, with bounds or without, as `_text` an expression."""
        return {**row, 'expr': self._text(row.get('expr'), k, timed=timed)} if isinstance(
            row, Mapping) else self._text(row, k, timed=timed)

    def _known(self, name: object, names: tuple[str, ...], where: str) -> str:
        if name not in names:
            raise StatementError(f"{where}: '{quote(str(name))}' is not known"
                                 f'{suggest_name(str(name), names)}; there is '
                                 f"{', '.join(names)}")
        return str(name)

    def _dynamics(self, k: int) -> list[tuple[str, str]]:
        rates = self._section(k, 'dynamics')
        for name in rates:
            self._known(name, self._states, f'phases[{k}].dynamics')
        for name in self._states:
            if rates.get(name) is None:
                raise StatementError(f"phases[{k}].dynamics: no equation for the state '{name}'")
        return [(_indexed(name, k), f'{_indexed(_DURATION, k)}*({self._text(rates[name], k)})')
                for name in self._states]

    def _add_duration(self, k: int) -> None:
        value, name = self._phases[k].get('duration'), _indexed(_DURATION, k)
        if value is None:
            raise StatementError(f'phases[{k}].duration: missing; wanted a number or '
                                 '{free: true, lower: 0.1, upper: 20}')
        if not isinstance(value, Mapping) or not value.get('free'):
            self._parameters[name] = value.get('value') if isinstance(value, Mapping) else value
            return
        self._free[name] = [value.get('lower'), value.get('upper')]
        if value.get('guess') is not None:
            self._guess['parameters'][name] = value['guess']

    def _add_guess(self, k: int) -> None:
        where = f'phases[{k}].initial_guess'
        guess = read_section(self._phases[k], 'initial_guess', where=where)
        check_keys(guess, ('states', 'inputs', 'parameters'), where=where)
        for key, names in (('states', self._states), ('inputs', self._inputs)):
            for name, value in read_section(guess, key).items():
                self._guess[key][_indexed(self._known(name, names, f'{where}.{key}'), k)] = value
        self._guess['parameters'] |= read_section(guess, 'parameters')
        start = self._given.get('initial_state')
        for name, value in (start if k and isinstance(start, Mapping) else {}).items():
            if name in self._states and isinstance(value, (int, float, str)):
                self._guess['states'].setdefault(_indexed(name, k), value)

    def _links(self, k: int) -> list[tuple[str, str]]:
        """Return the names and the constraints of the states at the start of a phase."""
        where = f'phases[{k}].link'
        link = read_section(self._phases[k], 'link', where=where)
        for name in link:
            self._known(name, self._states, where)
        rows = {name: link.get(name, name) for name in self._states}
        return [(name, f'{_indexed(name, k)}_0 - ({self._text(text, k - 1)})')
                for name, text in rows.items() if text is not None]

    def _initial_state(self) -> dict[str, Any]:
        """Return the initial states: those of the first phase are given."""
        first = {_indexed(name, 0) if name in self._states else name: value
                 for name, value in read_section(self._given, 'initial_state').items()}
        return first | {_indexed(name, k): None for k in range(1, len(self._phases))
                        for name in self._states}

    def _bounds(self, k: int, key: str, names: tuple[str, ...]) -> list[tuple[str, Any]]:
        return [(_indexed(self._known(name, names, f'phases[{k}].{key}'), k), pair)
                for name, pair in self._section(k, key).items()]
