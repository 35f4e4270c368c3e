# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""An optimal control problem as a user states it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from obc_ros.core.ocp import problem as ocp
from obc_ros.core.ocp.statement import build_problem, replace_functions
from obc_ros.core.text.errors import quote, StatementError, suggest_name
from obc_ros.core.text.tables import format_entry, Tabulated
from obc_ros.core.text.yaml_files import FileEntry, read_entries, read_text_entries

NAMED_AT_MOST = 60   # characters of a list of names in a text


class Problem(Tabulated):
    """
    An optimal control problem: minimise a cost subject to dynamics, bounds and constraints.

    ``Problem(states=['p', 'v'], inputs=['u'], dynamics={'p': 'v', 'v': 'u'}, ...)`` has the keys
    of a problem file (docs/problems.md). Dynamics, costs and constraints may be texts, or Python
    functions of named CasADi symbols: ``dynamics=lambda x, u: {'p': x.v, 'v': u.u}``.

    Parameters
    ----------
    **statement
        The keys of a problem file. `dynamics`, `running_cost` and `path_constraints` may be
        functions of (x, u) or (x, u, p), `terminal_cost` and `terminal_constraints` of (x) or
        (x, p); each returns what the key has in a file, with expressions in place of texts.
        `system` may be a name or a `System`.

    Raises
    ------
    StatementError
        If the statement is invalid; the message begins with the key at fault.

    Attributes
    ----------
    statement : dict
        What was given, with numbers of Python.
    built : obc_ros.core.ocp.problem.Problem
        The checked problem with symbols, expressions and numbers.

    """

    def __init__(self, **statement: Any) -> None:
        self._set(statement)

    def _set(self, statement: object) -> None:
        self.statement: dict[str, Any] = convert_numbers(statement)
        self.built: ocp.Problem = build_problem(self.statement)

    @classmethod
    def from_dict(cls, statement: Mapping[str, Any]) -> 'Problem':
        """Return the problem of a mapping with the keys of a problem file, as `Problem`."""
        problem = cls.__new__(cls)
        problem._set(statement)
        return problem

    @classmethod
    def from_file(cls, path: str | Path, name: str | None = None) -> 'Problem':
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
    def from_text(cls, text: str, name: str | None = None) -> 'Problem':
        """Return a problem of a YAML text, as `from_file`."""
        return cls.from_dict(choose_entry(read_text_entries(text), 'the text', name))

    def replace(self, **keys: Any) -> 'Problem':
        """Return this problem with other values of some keys, checked as by `Problem`."""
        return Problem.from_dict({**self.statement, **keys})

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
        return [(key, 'a function' if callable(value) else format_entry(value))
                for key, value in self.statement.items() if key != 'name' and value is not None]

    def __reduce__(self) -> tuple[Callable[..., 'Problem'], tuple[dict[str, Any]]]:
        """Return how another process makes the problem: from its statement."""
        return Problem.from_dict, (replace_functions(self.statement),)


def require_problem(problem: object, keys: Mapping[str, Any]) -> Problem:
    """Return the problem that a function was called with: a Problem, a statement, or keys."""
    if isinstance(problem, Problem) and not keys:
        return problem
    return Problem.from_dict(combine_statement(problem, keys))


def combine_statement(problem: object, keys: Mapping[str, Any]) -> dict[str, Any]:
    """Return the statement that a function was called with, unchecked; see `require_problem`."""
    if problem is None:
        return dict(keys)
    if isinstance(problem, Problem):
        return {**problem.statement, **keys}
    if isinstance(problem, Mapping):
        return {**problem, **keys}
    raise StatementError('problem: wanted a Problem, a mapping or the keys of a statement, found '
                         f'a {type(problem).__name__}; Problem.from_file reads a file')


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
        raise StatementError(f'{where}: {len(names)} entries; give the name of one: {listed}')
    raise StatementError(f"{where}: {len(named) or 'no'} entries have the name '{quote(name)}'"
                         f'{suggest_name(name, names)}; there are {listed}')


def convert_numbers(value: Any) -> Any:
    """Return a statement with lists and numbers of Python in place of those of NumPy."""
    if isinstance(value, Mapping):
        return {key: convert_numbers(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [convert_numbers(each) for each in value]
    if isinstance(value, np.ndarray):
        return convert_numbers(value.tolist())
    return value.item() if isinstance(value, np.generic) else value
