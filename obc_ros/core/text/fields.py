# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Fields of user input: lists, mappings, names and bounds, checked and of limited size.

Every function raises StatementError for an invalid field; the message begins with its key.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
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
import yaml

MAX_COUNT = 1_000  # entries of a list or mapping
# Words of other tools and books, by the key that they mean here.
_OTHER_KEYS = {other: key for key, others in {
    'inputs': ('controls',),
    'dynamics': ('f', 'ode', 'equations'),
    'running_cost': ('L', 'cost', 'objective', 'integrand', 'lagrange'),
    'terminal_cost': ('V', 'final_cost', 'mayer'),
    'initial_state': ('x0', 'x_0', 'start', 'initial_conditions'),
    'terminal_constraints': ('xf', 'goal', 'target', 'end', 'final_state', 'terminal_state',
                             'final_constraints', 'final_conditions'),
    'input_bounds': ('u_bounds', 'input_limits', 'control_bounds'),
    'state_bounds': ('x_bounds', 'state_limits'),
    'path_constraints': ('constraints', 'obstacles'),
    'final_time': ('T', 'tf', 'horizon', 'duration')}.items() for other in others}

# What a key wants: names, equations, constants, bounds of names, or rows.
_FORMS = {
    **dict.fromkeys(('states', 'inputs', 'periodic', 'variables', 'angles'), 'names'),
    'dynamics': 'equations', 'parameters': 'constants',
    **dict.fromkeys(('input_bounds', 'state_bounds', 'parameter_bounds', 'bounds'), 'bounds'),
    **dict.fromkeys(('terminal_constraints', 'initial_constraints', 'boundary_constraints'),
                    'rows'), 'path_constraints': 'comparisons', 'final_time': 'final time'}
_SIDES = ('lower', 'upper'), ('min', 'max')
_NO_BOUND = 'inf', 'infinity', '.inf', 'oo', 'none', '~'
LONGEST_LINE = 100   # characters of a suggestion

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


def suggest_line(value: object, where: str, names: Sequence[str] = ()) -> str:
    """
    Return ``; write LINE`` with the form that a key has in place of another one.

    :param where: the key, with the name of an entry or without.
    :param names: of the states or inputs, where they are known.
    :return: empty if it is not clear what is meant.
    """
    parts = [part for part in where.split('.') if not part.startswith('phases[')]
    form = _FORMS.get(parts[0] if parts else '', '')
    try:
        made = (_REFORM[f'{form} of one' if len(parts) > 1 else form])(value, names)
    except (KeyError, TypeError, ValueError):   # it has a form of its own
        return ''
    line = yaml.safe_dump(made, default_flow_style=True, sort_keys=False, width=1000).strip()
    return f'; write {line}' if made and len(line) <= LONGEST_LINE else ''


def _list_names(value: Any, names: Sequence[str]) -> list[str]:
    found = value.replace(',', ' ').split() if isinstance(value, str) else list(
        value if isinstance(value, Mapping) else ())
    return [check_name(name, '') for name in found]


def _assign(value: Any, names: Sequence[str]) -> dict[str, Any]:
    """Return a list as a mapping of names to its entries."""
    if not isinstance(value, (list, tuple)):
        return {}
    entries = [_unwrap_entry(entry) for entry in value]
    return dict(zip(names, entries, strict=True))


def _unwrap_entry(entry: Any) -> Any:
    if not isinstance(entry, (int, float, str)):
        raise TypeError
    return entry


def _give_values(value: Any, names: Sequence[str]) -> dict[str, int]:
    return {check_name(name, ''): 1 for name in value} if isinstance(value, list) else {}


def _bound_each(value: Any, names: Sequence[str]) -> dict[str, Any]:
    """Return bounds that stand without a name as those of the only name, or of each."""
    if not isinstance(value, (list, tuple)) or not names:
        return {}
    if len(value) == 2 and not any(isinstance(each, (list, tuple)) for each in value):
        value = [value] * len(names)
    return {name: [_unwrap_bound(each) for each in pair]
            for name, pair in zip(names, value, strict=True)}


def _bound_one(value: Any, names: Sequence[str]) -> list[Any]:
    """Return the bounds of [-inf, 3], {lower: 0, upper: 3}, or of a largest absolute value."""
    if isinstance(value, Mapping):
        pair = next([value.get(low), value.get(high)] for low, high in _SIDES
                    if value and set(value) <= {low, high})
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        pair = [-value, value] if value > 0 else []
    else:
        pair = list(value) if isinstance(value, (list, tuple)) and len(value) == 2 else []
    return [_unwrap_bound(bound) for bound in pair]


def _unwrap_bound(bound: Any) -> Any:
    return None if bound is None or _is_no_bound(bound) else _unwrap_entry(bound)


def _is_no_bound(bound: object) -> bool:
    """Return whether a bound is infinite, as a number or in words."""
    return isinstance(bound, float) and math.isinf(bound) or (
        isinstance(bound, str) and bound.strip(' +-').lower() in _NO_BOUND)


def _state_rows(value: Any, names: Sequence[str]) -> list[str]:
    """Return the rows of one expression, or of values of states at the end."""
    if isinstance(value, str):
        return [value]
    return [str(name) if _unwrap_entry(goal) == 0 else f'{name} - {goal}' if str(goal)[0] != '-'
            else f'{name} + {str(goal)[1:]}' for name, goal in (
                value.items() if isinstance(value, Mapping) else ())]


def _state_final_time(value: Any, names: Sequence[str]) -> dict[str, Any]:
    """Return a final time that is a number, the word free, or bounds, one of them or none."""
    if isinstance(value, Mapping):
        if not set(value) <= {'free', 'lower', 'upper', 'guess'} or value.get('free') is False:
            return {}
        return {'free': True, 'lower': 0, 'upper': 20} | {
            key: bound for key, bound in value.items() if bound is not None}
    if isinstance(value, str) and value.strip() == 'free':
        return {'free': True, 'lower': 0, 'upper': 20}
    return {'free': False, 'value': _unwrap_entry(value)} if not isinstance(value, bool) else {}


_REFORM: dict[str, Callable[[Any, Sequence[str]], Any]] = {
    'names': _list_names, 'equations': _assign, 'constants': _give_values,
    'bounds': _bound_each, 'bounds of one': _bound_one, 'rows': _state_rows,
    'comparisons': lambda value, _: [value] if isinstance(value, str) or 'expr' in value else [],
    'final time': _state_final_time}


def read_mapping(value: object, where: str, wanted: str = 'a mapping of keys to values',
                 most: int = MAX_COUNT, names: Sequence[str] = ()) -> Given:
    """Return a mapping of limited size; `names`: of its keys, where they are known."""
    if not isinstance(value, Mapping):
        raise StatementError(f'{where}: wanted {wanted}, found {describe_type(value)}'
                             f'{suggest_line(value, where, names)}')
    if len(value) > most:
        raise StatementError(f'{where}: {len(value)} entries; at most {most} are accepted')
    return value


def list_of(value: object, where: str, wanted: str = 'a list', most: int = MAX_COUNT
            ) -> list[Any]:
    """Return a list or tuple of limited size as a list."""
    if not isinstance(value, (list, tuple)):
        raise StatementError(f'{where}: wanted {wanted}, found {describe_type(value)}'
                             f'{suggest_line(value, where)}')
    if len(value) > most:
        raise StatementError(f'{where}: {len(value)} entries; at most {most} are accepted')
    return list(value)


def read_section(given: Given, key: str, most: int = MAX_COUNT, where: str = '',
                 names: Sequence[str] = ()) -> Given:
    """Return the mapping at a key; empty if the key is absent or its value is None."""
    value = given.get(key)
    return {} if value is None else read_mapping(value, where or key, most=most, names=names)


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
                sign = {'minimize': '{}', 'maximize': '-({})'}.get(str(key), '')
                if sign and 'running_cost' in known and isinstance(given[key], (str, int, float)):
                    hint = f'; write running_cost: {quote(sign.format(given[key]))}'
                faults.note(StatementError(f'{place}: unknown key{hint or listed}'))
                listed = listed if hint else ''   # once is enough


def read_names(given: Given, key: str, most: int = MAX_COUNT) -> tuple[str, ...]:
    """Return the list of names at a key: one or more, all different."""
    if given.get(key) is None:
        raise StatementError(f'{key}: missing; wanted a list of names')
    found = list_of(given[key], key, most=most)
    if any(isinstance(name, bool) for name in found):
        raise StatementError(f'{key}: a name is text, not a YAML truth value (on, off, yes, no): '
                             'write it in quotes')
    names = tuple(check_name(name, key) for name in found)
    if not names:
        hint = '; only a problem without phases may have none' if key == 'inputs' else ''
        raise StatementError(f'{key}: the list is empty; wanted at least one name{hint}')
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
        if _is_no_bound(bound) and bound not in values:
            raise StatementError(f'{where}: {side} bound {bound}: write null for no bound'
                                 f'{suggest_line([lower, upper], where)}')
    low = -math.inf if lower is None else parse_number(lower, values, f'{where} (lower)')
    high = math.inf if upper is None else parse_number(upper, values, f'{where} (upper)')
    if low > high:
        raise StatementError(f'{where}: the bounds cross: lower {low:g} > upper {high:g}')
    return low, high
