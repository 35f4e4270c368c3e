# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parts of what someone wrote: lists, mappings, names and bounds, checked and of bounded size.

Each raises StatementError where a part is another one; `where` is the key at fault, with which
the message begins.
"""

from collections.abc import Mapping, Sequence
import math
from typing import Any

from obc_ros.core.text.errors import quote, StatementError
from obc_ros.core.text.expressions import check_name, describe_type, parse_number, suggest_name

MAX_COUNT = 1_000  # entries of a list or mapping

Given = Mapping[Any, Any]


def read_mapping(value: object, where: str, wanted: str = 'a mapping of keys to values',
                 most: int = MAX_COUNT) -> Given:
    """Return a mapping of at most `most` entries."""
    if not isinstance(value, Mapping):
        raise StatementError(f'{where}: wanted {wanted}, found {describe_type(value)}')
    if len(value) > most:
        raise StatementError(f'{where}: {len(value)} entries; at most {most} are read')
    return value


def list_of(value: object, where: str, wanted: str = 'a list', most: int = MAX_COUNT
            ) -> list[Any]:
    """Return a list of at most `most` entries."""
    if not isinstance(value, (list, tuple)):
        raise StatementError(f'{where}: wanted {wanted}, found {describe_type(value)}')
    if len(value) > most:
        raise StatementError(f'{where}: {len(value)} entries; at most {most} are read')
    return list(value)


def read_section(given: Given, key: str, most: int = MAX_COUNT) -> Given:
    """Return a mapping that may be left out or left empty."""
    value = given.get(key)
    return {} if value is None else read_mapping(value, key, most=most)


def check_keys(given: Given, known: Sequence[str], others: Sequence[str] = (), where: str = ''
               ) -> None:
    """Refuse a key that is neither `known`, which the message lists, nor one of the `others`."""
    for key in given:
        if key not in known and key not in others:
            place = f'{where}.{quote(str(key))}' if where else quote(str(key))
            raise StatementError(f'{place}: unknown key{suggest_name(str(key), known)}; there are '
                                 f'{", ".join(known)}')


def read_names(given: Given, key: str, most: int = MAX_COUNT) -> tuple[str, ...]:
    """Return the names that a list holds: one or more, each once."""
    if given.get(key) is None:
        raise StatementError(f'{key}: missing; wanted a list of names')
    names = tuple(check_name(name, key) for name in list_of(given[key], key, most=most))
    if not names:
        raise StatementError(f'{key}: the list is empty; wanted at least one name')
    check_unique(names, key)
    return names


def check_unique(names: Sequence[str], where: str) -> None:
    """Refuse a name that stands twice."""
    for index, name in enumerate(names):
        if name in names[:index]:
            raise StatementError(f"{where}: '{name}' stands twice")


def read_bounds(value: object, values: Mapping[str, float], where: str) -> tuple[float, float]:
    """Return [lower, upper], which may be expressions of `values`; -inf and inf for null."""
    pair = list_of(value, where, '[lower, upper]')
    if len(pair) != 2:
        raise StatementError(f'{where}: wanted [lower, upper], found {len(pair)} entries')
    return evaluate_limits(pair[0], pair[1], values, where)


def evaluate_limits(lower: object, upper: object, values: Mapping[str, float], where: str
                    ) -> tuple[float, float]:
    """Return two bounds, which may be expressions of `values`; -inf and inf for None."""
    for bound, side in ((lower, 'lower'), (upper, 'upper')):
        if isinstance(bound, float) and math.isinf(bound):
            raise StatementError(f'{where}: {side} bound {bound}: write null for no bound')
    low = -math.inf if lower is None else parse_number(lower, values, f'{where} (lower)')
    high = math.inf if upper is None else parse_number(upper, values, f'{where} (upper)')
    if low > high:
        raise StatementError(f'{where}: the bounds cross: lower {low:g} > upper {high:g}')
    return low, high
