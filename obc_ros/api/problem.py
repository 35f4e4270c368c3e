# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""An optimal control problem as a user states it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from obc_ros.api.answer import Answer, PathPoint
from obc_ros.api.given import (
    choose_given,
    convert_numbers,
    Expression,
    Expressions,
    KeysOfPlant,
    NAMED_AT_MOST,
    StatedFunction,
    StateLike,
    UNSET,
)
from obc_ros.api.plants import as_system, SystemLike
from obc_ros.core.ocp import problem as ocp
from obc_ros.core.ocp.statement import build_problem, FOR_THE_SOLVER
from obc_ros.core.systems.registry import is_file
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import describe_type, quote, StatementError, suggest_name
from obc_ros.core.text.recorded_functions import RecordedFunction
from obc_ros.core.text.tables import format_entry, Tabulated
from obc_ros.core.text.yaml_files import FileEntry, read_entries, read_text_entries

_GUESSED = 201   # values of an initial guess that is the path of an answer


class Problem(Tabulated):
    """
    An optimal control problem: minimise a cost subject to dynamics, bounds and constraints.

    ``Problem(states=['p', 'v'], inputs=['u'], dynamics={'p': 'v', 'v': 'u'}, ...)`` has the keys
    of a problem file (docs/problems.md). Dynamics, costs and constraints may be texts, or Python
    functions of named CasADi symbols: ``dynamics=lambda x, u: {'p': x.v, 'v': u.u}``.

    Parameters
    ----------
    problem : Problem, Answer, mapping, Path or str, optional
        A problem of which some keys are replaced; see `solve`.
    name, system, states, inputs, parameters, free_parameters, tables, dynamics, running_cost, \
    terminal_cost, initial_cost, initial_state, initial_constraints, terminal_constraints, \
    boundary_constraints, periodic, input_bounds, state_bounds, path_constraints, final_time, \
    phases, initial_guess, starts, method, accept
        The keys of a problem file. `dynamics`, `running_cost` and `path_constraints` may be
        functions of (x, u) or (x, u, p), `terminal_cost` and `terminal_constraints` of (x) or
        (x, p); each returns what the key has in a file, with expressions in place of texts.
        `system` may be a name, a `System`, a file, the keys of one, or a system of python-control;
        `initial_state` also a list in the order of the states, or a point of `Answer.at`;
        `initial_guess` also an answer. `starts` is a list of further initial guesses, which the
        search tries besides its own, before it compares the minima.
    **others
        Other keys that a file may have, such as `title` and `units`.

    Raises
    ------
    StatementError
        If the statement is invalid; the message begins with the key at fault.

    Attributes
    ----------
    statement : dict
        What was given, with numbers of Python, and what functions returned in their place.
    built : obc_ros.core.ocp.problem.Problem
        The checked problem with symbols, expressions and numbers.

    """

    def __init__(
            self, problem: ProblemLike | None = None, /, *, name: str = UNSET,
            system: SystemLike = UNSET, states: Sequence[str] = UNSET,
            inputs: Sequence[str] = UNSET, parameters: Mapping[str, Any] = UNSET,
            free_parameters: Mapping[str, Any] = UNSET,
            tables: Mapping[str, Any] = UNSET,
            dynamics: Mapping[str, Expression] | StatedFunction = UNSET,
            running_cost: Expression | StatedFunction = UNSET,
            terminal_cost: Expression | StatedFunction = UNSET,
            initial_cost: Expression | StatedFunction = UNSET,
            initial_state: StateLike | Sequence[Any] = UNSET,
            initial_constraints: Expressions | StatedFunction = UNSET,
            terminal_constraints: Expressions | StatedFunction = UNSET,
            boundary_constraints: Expressions = UNSET, periodic: Sequence[str] = UNSET,
            input_bounds: Mapping[str, Any] = UNSET, state_bounds: Mapping[str, Any] = UNSET,
            path_constraints: Sequence[Mapping[str, Any] | Expression] | StatedFunction = UNSET,
            final_time: Mapping[str, Any] | Expression = UNSET,
            phases: Sequence[Mapping[str, Any]] = UNSET,
            initial_guess: Mapping[str, Any] | Answer = UNSET,
            starts: Sequence[Mapping[str, Any] | Answer] = UNSET, method: str = UNSET,
            accept: str = UNSET, **others: Unpack[KeysOfPlant]) -> None:
        keys = choose_given(locals(), FOR_THE_SOLVER)
        self._set(as_statement(problem, {**keys, **others}))

    def _set(self, statement: object) -> None:
        self.statement: dict[str, Any] = convert_numbers(statement)
        if isinstance(statement, Mapping):
            self.statement = convert_numbers(_read_answers(statement))
            if not isinstance(system := statement.get('system'), str | None):
                self.statement['system'] = as_system(system)
        self.built: ocp.Problem = build_problem(self.statement)
        self.statement |= {key: value for key, value in self.built.statement.items()
                           if isinstance(value, RecordedFunction) or key == 'final_time'}

    @classmethod
    def from_dict(cls, statement: Mapping[str, Any]) -> Problem:
        """Return the problem of a mapping with the keys of a problem file, as `Problem`."""
        problem = cls.__new__(cls)
        problem._set(statement)
        return problem

    @classmethod
    def from_file(cls, path: str | Path, name: str | None = None) -> Problem:
        """
        Return a problem of a YAML file.

        Parameters
        ----------
        path : str or Path
            A file with one problem, or with a list of them.
        name : str, optional
            Name of the problem in a list.

        Raises
        ------
        StatementError
            If the file cannot be read, is not YAML, has no problem or several of this name, or
            the statement is invalid.

        """
        return cls.from_dict(choose_entry(read_entries(path), str(path), name))

    @classmethod
    def from_text(cls, text: str, name: str | None = None) -> Problem:
        """Return a problem of a YAML text, as `from_file`."""
        return cls.from_dict(choose_entry(read_text_entries(text), 'the text', name))

    def replace(self, **keys: Any) -> Problem:
        """Return this problem with other values of some keys, checked as by `Problem`."""
        return Problem.from_dict({**self.statement, **_read_keys(keys)})

    @property
    def name(self) -> str:
        """Return the name of the problem."""
        return self.built.name

    @property
    def states(self) -> tuple[str, ...]:
        """Return the names of the states, in order."""
        return self.built.shown_states

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs, in order."""
        return self.built.shown_inputs

    @cached_property
    def model(self) -> System:
        """Return the plant with its CasADi expressions, and the bounds of the inputs."""
        return as_system(self.built).model

    def __repr__(self) -> str:
        """Return name, states, inputs and final time."""
        final = self.built.final_time
        time = (f'free final time in [{final.lower:g}, {final.upper:g}] s' if final.free
                else f'final time {final.value:g} s')
        states, inputs = (quote(', '.join(names), NAMED_AT_MOST)
                          for names in (self.states, self.inputs))
        return f'<Problem {quote(self.name)}: states {states}; inputs {inputs}; {time}>'

    __str__ = __repr__

    def _title(self) -> str:
        return f'Problem {self.name}'

    def _rows(self) -> list[tuple[str, ...]]:
        """Return what the statement says of each key."""
        return [(key, 'a function' if isinstance(value, RecordedFunction) else format_entry(value))
                for key, value in self.statement.items() if key != 'name' and value is not None]

    def __reduce__(self) -> tuple[Callable[..., Problem], tuple[dict[str, Any]]]:
        """Return how another process makes the problem: from its statement."""
        return Problem.from_dict, (self.statement,)


ProblemLike = Problem | ocp.Problem | Answer | Mapping[str, Any] | str | Path


def as_problem(value: object, keys: Mapping[str, Any]) -> Problem:
    """Return the problem that a function was called with, with other values of some keys."""
    if isinstance(value, Problem) and not keys:
        return value
    return Problem.from_dict(as_statement(value, keys))


def as_statement(value: object, keys: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return the statement that a function was called with, unchecked, as `as_problem`.

    :param value: a Problem, an answer, a mapping, a file, a YAML text; None: the keys alone.
    """
    if isinstance(value, Answer):
        value = value.problem or value.statement or value
    if isinstance(value, Problem | ocp.Problem):
        value = value.statement
    elif isinstance(value, Path) or isinstance(value, str) and _is_path(value):
        value = choose_entry(read_entries(value), str(value), None)
    elif isinstance(value, str):
        value = choose_entry(read_text_entries(value), 'problem', None)
    if value is None or isinstance(value, Mapping):
        return _read_answers({**(value or {}), **_read_keys(keys)})
    raise StatementError('problem: wanted a Problem, an answer, a mapping, a file, YAML or the '
                         f'keys of a statement, found {describe_type(value)}')


def _read_answers(statement: Mapping[str, Any]) -> dict[str, Any]:
    """Return a statement with numbers in place of an answer and of a point of one."""
    found = dict(statement)
    start, guess, starts = map(found.get, ('initial_state', 'initial_guess', 'starts'))
    if isinstance(start, PathPoint):
        if np.ndim(start.t):
            raise StatementError('initial_state: wanted a point at one time, found one at '
                                 f'{np.size(start.t)} times')
        found['initial_state'] = start.x
    if isinstance(guess, Answer):
        found['initial_guess'] = _make_guess(guess, 'initial_guess')
    if isinstance(starts, (list, tuple)):
        found['starts'] = [_make_guess(each, f'starts[{k}]') if isinstance(each, Answer) else each
                           for k, each in enumerate(starts)]
    return found


def _make_guess(answer: Answer, key: str) -> dict[str, Any]:
    """Return the path of an answer as an initial guess."""
    if not answer.has_path or answer.problem is not None and answer.problem.phases is not None:
        raise StatementError(f'{key}: wanted an answer with a path, without phases')
    t = answer.t
    times = np.linspace(t[0], t[-1], _GUESSED)
    return {key: {name: np.interp(times, t, values).tolist() for name, values in columns.items()}
            for key, columns in (('states', answer.x), ('inputs', answer.u))} | {
        'parameters': dict(answer.free_parameters), 'final_time': float(t[-1])}


def _is_path(text: str) -> bool:
    return '\n' not in text and is_file(text)


def _read_keys(keys: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return keywords with the system of a file; that of a text or a file is none."""
    system = keys.get('system')
    named = isinstance(system, str) and is_file(system)
    return {**keys, 'system': as_system(system)} if named else keys


def choose_entry(entries: list[tuple[str, FileEntry]], where: str, name: str | None) -> Any:
    """Return the entry of a file, `where`, with a name, or its only one."""
    found = []
    for _, entry in entries:
        if isinstance(entry, StatementError):
            raise entry
        found.append(entry)
    named = [entry for entry in found if name is None or entry['name'] == name]
    names = [str(entry['name']) for entry in found]
    if len(named) == 1:
        return named[0]
    listed = quote(', '.join(names), 200)
    if name is None:
        raise StatementError(f'{where}: {len(names)} entries, wanted one: {listed}')
    raise StatementError(f"{where}: {len(named) or 'no'} entries have the name '{quote(name)}'"
                         f'{suggest_name(name, names)}; there are {listed}')
