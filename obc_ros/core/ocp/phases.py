# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Problems with phases, stated as a problem with one.

Phase k, of duration d_k, runs over the normalised time s from 0 to 1 at the same time as all
others, with its own states and inputs: dx_k/ds = d_k f_k, running cost sum of d_k L_k. What links
two phases are conditions on x_(k+1)(0) and x_k(1); free durations are free parameters. The
conditions of the certificate are then those of the phases: for x_(k+1)(0) = g(x_k(1)),

    lam_k(end) = dV_k/dx + nu' dpsi_k/dx + (dg/dx)' lam_(k+1)(start),

and, for a free duration, the derivative of the cost by it vanishes.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
import re
from typing import Any

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import quote, StatementError, suggest_name
from obc_ros.core.text.fields import check_keys, list_of, read_mapping, read_names, read_section

MOST_PHASES = 20
# What a phase may have for itself; in its absence that of the file holds.
_SHARED = 'dynamics', 'running_cost', 'path_constraints', 'input_bounds', 'state_bounds'
_OWN = 'name', 'duration', 'link', 'terminal_cost', 'terminal_constraints', 'initial_guess'
_UNUSED = 'system', 'final_time', 'periodic', 'boundary_constraints', 'initial_guess'
_DURATION = 'duration'
_IDENTIFIER = re.compile(r'(?<![\w.])[A-Za-z_]\w*', re.ASCII)
_INDEXED = re.compile(r'\b([A-Za-z_]\w*?)__(\d+)(_0)?\b', re.ASCII)


@dataclass(frozen=True)
class PhaseLayout:
    """
    Names of the phases, the states and the inputs of a statement with phases.

    The states of the problem begin with those of the first phase, then those of the second one,
    and so on, and so do its inputs.
    """

    names: tuple[str, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...]

    @property
    def durations(self) -> tuple[str, ...]:
        """Return the names of the parameters that are the durations [s]."""
        return tuple(_indexed(_DURATION, k) for k in range(len(self.names)))

    def stack(self, times: Array, durations: Array, *columns: Array) -> tuple[Array, ...]:
        """
        Return samples of all phases, one phase after the other.

        Parameters
        ----------
        times : ndarray, shape (N,)
            Normalised times, from 0 to 1.
        durations : ndarray, shape (phases,)
            Of the phases [s].
        *columns : ndarray, shape (N, phases * m)
            Values of the phases side by side.

        Returns
        -------
        t : ndarray, shape (phases * N,)
            Times [s].
        *values : ndarray, shape (phases * N, m)

        """
        starts = np.append(0.0, np.cumsum(durations))[:-1]
        count = len(self.names)
        t = (starts[:, None] + durations[:, None] * times).ravel()
        return t, *(np.concatenate(np.split(each, count, axis=1)) for each in columns)


def state_as_one_phase(given: Mapping[Any, Any]) -> tuple[dict[str, Any], PhaseLayout]:
    """
    Return the statement with one phase that is equivalent to one with phases.

    Parameters
    ----------
    given : mapping
        With the key `phases`; see docs/problems.md.

    Returns
    -------
    statement : dict
        Without it.
    layout : PhaseLayout
        What its states and inputs are.

    Raises
    ------
    StatementError
        If the phases are invalid.

    """
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
    names = tuple(str(phase.get('name') or k + 1) for k, phase in enumerate(phases))
    return joined.statement(), PhaseLayout(names, states, inputs)


def name_phases(message: str) -> str:
    """Return a message about a joined statement in the names of its phases."""
    return _INDEXED.sub(lambda found: (
        f'{found[1]} of phase {found[2]}{" at its start" if found[3] else ""}'), message)


def _indexed(name: str, k: int) -> str:
    return f'{name}__{k + 1}'


class _Joined:
    """The parts of a joined statement."""

    def __init__(self, given: Mapping[Any, Any], phases: list[Mapping[Any, Any]],
                 states: tuple[str, ...], inputs: tuple[str, ...], own: Collection[Any]) -> None:
        self._given, self._phases, self._states, self._inputs = given, phases, states, inputs
        self._timed = 't' not in {*states, *inputs, *own}
        self._parameters = dict(read_section(given, 'parameters'))
        self._free = dict(read_section(given, 'free_parameters'))
        self._guess: dict[str, dict[str, Any]] = {'states': {}, 'inputs': {}, 'parameters': {}}

    def statement(self) -> dict[str, Any]:
        """Return the joined statement."""
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
            'dynamics': {name: rate for k in count for name, rate in self._dynamics(k)},
            'running_cost': ' + '.join(
                f'{_indexed(_DURATION, k)}*({self._text(cost, k)})'
                for k, cost in costs if cost is not None) or 0,
            'terminal_cost': ' + '.join(
                f'({self._text(cost, k)})' for k, cost in ends if cost is not None) or 0,
            'initial_cost': self._text(self._given.get('initial_cost') or 0, 0, timed=False),
            'initial_constraints': self._list(self._given, 'initial_constraints', 0, timed=False),
            'terminal_constraints': [
                *(row for k in count for row in self._list(
                    self._phases[k], 'terminal_constraints', k)),
                *self._list(self._given, 'terminal_constraints', len(self._phases) - 1)],
            'boundary_constraints': [row for k in count[1:] for row in self._links(k)],
            'initial_state': self._initial_state(),
            'path_constraints': [row for k in count for row in self._path(k)],
            'input_bounds': {name: pair for k in count
                             for name, pair in self._bounds(k, 'input_bounds', self._inputs)},
            'state_bounds': {name: pair for k in count
                             for name, pair in self._bounds(k, 'state_bounds', self._states)},
            'final_time': {'free': False, 'value': 1},
            'initial_guess': {key: value for key, value in self._guess.items() if value}}

    def _get(self, k: int, key: str) -> Any:
        value = self._phases[k].get(key)
        return self._given.get(key) if value is None else value

    def _section(self, k: int, key: str) -> Mapping[Any, Any]:
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
            return _indexed(name, k) if name in names else name

        return _IDENTIFIER.sub(rename, text)

    def _list(self, of: Mapping[Any, Any], key: str, k: int, *, timed: bool = True) -> list[Any]:
        value = of.get(key)
        return [self._text(each, k, timed=timed)
                for each in ([] if value is None else list_of(value, key))]

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
        """Add the duration of a phase to the parameters."""
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
        guess = self._phases[k].get('initial_guess')
        guess = {} if guess is None else read_mapping(guess, where)
        check_keys(guess, ('states', 'inputs', 'parameters'), where=where)
        for key, names in (('states', self._states), ('inputs', self._inputs)):
            for name, value in read_section(guess, key).items():
                self._guess[key][_indexed(self._known(name, names, f'{where}.{key}'), k)] = value
        self._guess['parameters'] |= read_section(guess, 'parameters')
        start = self._given.get('initial_state')
        for name, value in (start if k and isinstance(start, Mapping) else {}).items():
            if name in self._states and isinstance(value, (int, float, str)):
                self._guess['states'].setdefault(_indexed(name, k), value)

    def _links(self, k: int) -> list[str]:
        """Return what the states at the start of a phase are."""
        where = f'phases[{k}].link'
        link = self._phases[k].get('link')
        link = {} if link is None else read_mapping(link, where)
        for name in link:
            self._known(name, self._states, where)
        rows = {name: link.get(name, name) for name in self._states}
        return [f'{_indexed(name, k)}_0 - ({self._text(text, k - 1)})'
                for name, text in rows.items() if text is not None]

    def _initial_state(self) -> dict[str, Any]:
        """Return the initial states: those of the first phase are given."""
        start = self._given.get('initial_state')
        start = {} if start is None else read_mapping(start, 'initial_state')
        first = {_indexed(name, 0) if name in self._states else name: value
                 for name, value in start.items()}
        return first | {_indexed(name, k): None for k in range(1, len(self._phases))
                        for name in self._states}

    def _path(self, k: int) -> list[Any]:
        value = self._get(k, 'path_constraints')
        rows = [] if value is None else list_of(value, f'phases[{k}].path_constraints')
        return [row if not isinstance(row, Mapping) else
                {**row, 'expr': self._text(row.get('expr'), k)} for row in rows]

    def _bounds(self, k: int, key: str, names: tuple[str, ...]) -> list[tuple[str, Any]]:
        return [(_indexed(self._known(name, names, f'phases[{k}].{key}'), k), pair)
                for name, pair in self._section(k, key).items()]
