# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Fields of user input: lists, mappings, names and bounds, checked and of limited size.

Every function raises StatementError for an invalid field; the message begins with its key.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
import math
from typing import Any

from obc_ros.core.text.errors import (
    DependentError,
    describe_type,
    Faults,
    quote,
    StatementError,
    suggest_name,
)
from obc_ros.core.text.expressions import check_name, parse_number

MAX_COUNT = 1_000  # entries of a list or mapping
# Words of other tools and books, by the key that they mean here.
_OTHER_KEYS = {other: key for key, others in {
    'inputs': ('controls',),
    'dynamics': ('f', 'ode', 'equations'),
    'running_cost': ('L', 'cost', 'objective', 'integrand', 'lagrange'),
    'terminal_cost': ('V', 'final_cost', 'mayer'),
    'initial_state': ('x0', 'start', 'initial_conditions'),
    'terminal_constraints': ('xf', 'goal', 'target', 'end', 'final_state', 'terminal_state',
                             'final_constraints', 'final_conditions'),
    'input_bounds': ('u_bounds', 'input_limits', 'control_bounds'),
    'state_bounds': ('x_bounds', 'state_limits'),
    'path_constraints': ('constraints', 'obstacles'),
    'final_time': ('T', 'tf', 'horizon', 'duration')}.items() for other in others}

Given = Mapping[Any, Any]


class NamedValues(dict[str, float]):
    """Values of parameters by name; DependentError for one that is malformed."""

    def __init__(self, values: Mapping[str, float] | None = None) -> None:
        super().__init__(values or {})
        self._malformed: set[str] = set()

    def __getitem__(self, name: str) -> float:
        if name in self._malformed:
            raise DependentError(f"'{name}' is malformed")
        return super().__getitem__(name)

    def spoil(self, name: str) -> None:
        """Let a name have a malformed value."""
        self[name] = math.nan
        self._malformed.add(name)

    def is_malformed(self, name: str) -> bool:
        """Return whether a name has a malformed value."""
        return name in self._malformed

    def select(self, names: Iterable[str]) -> 'NamedValues':
        """Return the values of some names."""
        found = NamedValues({name: self.get(name, math.nan) for name in names})
        for name in self._malformed & set(found):
            found.spoil(name)
        return found

    def read(self, name: str, value: object, faults: Faults, unknown: Collection[str] = ()
             ) -> None:
        """Evaluate a parameter, an expression of the others, but for those that are unknown."""
        known = self.select(each for each in self if each not in unknown) if unknown else self
        found = faults.attempt(parse_number, value, known, f'parameters.{name}')
        if found is None:
            self.spoil(name)
        else:
            self[name] = found


class UnknownValues(NamedValues):
    """Values of any names, which all depend on something malformed."""

    def __contains__(self, name: object) -> bool:
        return True

    def __getitem__(self, name: str) -> float:
        raise DependentError(f"'{name}' is not known")


def read_mapping(value: object, where: str, wanted: str = 'a mapping of keys to values',
                 most: int = MAX_COUNT) -> Given:
    """Return a value that is a mapping of limited size."""
    if not isinstance(value, Mapping):
        raise StatementError(f'{where}: wanted {wanted}, found {describe_type(value)}')
    if len(value) > most:
        raise StatementError(f'{where}: {len(value)} entries; at most {most} are accepted')
    return value


def list_of(value: object, where: str, wanted: str = 'a list', most: int = MAX_COUNT
            ) -> list[Any]:
    """Return a list or tuple of limited size as a list."""
    if not isinstance(value, (list, tuple)):
        raise StatementError(f'{where}: wanted {wanted}, found {describe_type(value)}')
    if len(value) > most:
        raise StatementError(f'{where}: {len(value)} entries; at most {most} are accepted')
    return list(value)


def read_section(given: Given, key: str, most: int = MAX_COUNT, where: str = '') -> Given:
    """Return the mapping at a key; empty if the key is absent or its value is None."""
    value = given.get(key)
    return {} if value is None else read_mapping(value, where or key, most=most)


def read_list(given: Given, key: str, most: int = MAX_COUNT, where: str = '') -> list[Any]:
    """Return the list at a key; empty if the key is absent or its value is None."""
    value = given.get(key)
    return [] if value is None else list_of(value, where or key, most=most)


def check_keys(given: Given, known: Sequence[str], others: Sequence[str] = (), where: str = ''
               ) -> None:
    """Check that a mapping has only known keys, which a message lists, and others."""
    listed = f'; known keys: {", ".join(known)}'
    with Faults() as faults:
        for key in given:
            if key not in known and key not in others:
                place = f'{where}.{quote(str(key))}' if where else quote(str(key))
                meant = _OTHER_KEYS.get(str(key), '')
                hint = suggest_name(meant if meant in known else str(key), known)
                faults.note(StatementError(f'{place}: unknown key{hint or listed}'))
                listed = listed if hint else ''   # once is enough


def read_names(given: Given, key: str, most: int = MAX_COUNT) -> tuple[str, ...]:
    """Return the list of names at a key: one or more, all different."""
    if given.get(key) is None:
        raise StatementError(f'{key}: missing; wanted a list of names')
    names = tuple(check_name(name, key) for name in list_of(given[key], key, most=most))
    if not names:
        raise StatementError(f'{key}: the list is empty; wanted at least one name')
    check_unique(names, key)
    return names


def check_unique(names: Sequence[str], where: str) -> None:
    """Check that no name occurs twice."""
    for index, name in enumerate(names):
        if name in names[:index]:
            raise StatementError(f"{where}: '{name}' occurs twice")


def read_bounds(value: object, values: Mapping[str, float], where: str) -> tuple[float, float]:
    """Return the bounds of a list [lower, upper] as `evaluate_limits` does."""
    pair = list_of(value, where, '[lower, upper]')
    if len(pair) != 2:
        raise StatementError(f'{where}: wanted [lower, upper], found {len(pair)} entries')
    return evaluate_limits(pair[0], pair[1], values, where)


def evaluate_limits(lower: object, upper: object, values: Mapping[str, float], where: str
                    ) -> tuple[float, float]:
    """Return the values of two bounds, expressions of `values`; -inf and inf for None."""
    for bound, side in ((lower, 'lower'), (upper, 'upper')):
        if isinstance(bound, float) and math.isinf(bound):
            raise StatementError(f'{where}: {side} bound {bound}: write null for no bound')
    low = -math.inf if lower is None else parse_number(lower, values, f'{where} (lower)')
    high = math.inf if upper is None else parse_number(upper, values, f'{where} (upper)')
    if low > high:
        raise StatementError(f'{where}: the bounds cross: lower {low:g} > upper {high:g}')
    return low, high
