# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
When a parameter has an effect, as conditions on other parameters.

A condition is the name of another parameter and its allowed values. ``NAME.*`` means any parameter
of a group. Without values the other parameter has to be set: neither 0, false nor empty.

==============================  =====================================================
('weights', 'matrices')         weights is matrices
('command_sink', 'a', 'b')      command_sink is a or b
('integral',)                   integral names a state
('noise.*',)                    one of noise.px, noise.py, ... is not 0
==============================  =====================================================
"""

from collections.abc import Iterator, Mapping
from typing import Protocol

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]
ParameterCondition = tuple[str | bool, ...]
UsedWhen = tuple[ParameterCondition, ...]


class ParameterLike(Protocol):
    """The attributes of a row of a parameter table that conditions need."""

    @property
    def used_when(self) -> UsedWhen:
        """Return the conditions under which it has an effect."""

    @property
    def read_only(self) -> bool:
        """Return whether it cannot be changed while the node runs."""


def condition_holds(condition: ParameterCondition, values: Mapping[str, Value]) -> bool:
    """Return whether a condition holds for the values of all parameters by name."""
    others = [values[name] for name in _names(condition, values)]
    wanted = condition[1:]
    return any(other in wanted if wanted else bool(other) for other in others)


def is_used(used_when: UsedWhen, values: Mapping[str, Value]) -> bool:
    """
    Return whether a parameter has an effect.

    :param used_when: its conditions; one of them is enough. Empty: it always has an effect.
    :param values: of all parameters by name.
    :return: whether one of the conditions holds.
    """
    return not used_when or any(condition_holds(each, values) for each in used_when)


def explain_idle(rows: Mapping[str, ParameterLike], name: str, values: Mapping[str, Value], *,
                 is_start: bool = False) -> str:
    """
    Return the sentence on a parameter that has no effect.

    :param rows: rows of the table by name.
    :param name: the parameter, none of whose conditions holds.
    :param values: of all parameters by name.
    :param is_start: whether the node is starting; otherwise a value is being changed.
    :return: the reason and the remedy.
    """
    conditions = rows[name].used_when
    now = ' and '.join(f'{each[0]} = {_present(each, values)}' for each in conditions)
    unused = f'{name} is not used with {now}; '
    if is_start:
        return unused + f'write {_wanted(conditions, ": ")} as well, or leave {name} out'
    if all(rows[other].read_only for each in conditions for other in _names(each, values)):
        return unused + f'start the node with {_wanted(conditions, ": ")} for it'
    return unused + (f'set {_wanted(conditions, " to ")} first, or both with '
                     'set_parameters_atomically')


def count_depth(rows: Mapping[str, ParameterLike], name: str) -> int:
    """Return the number of parameters that have to be set in turn before one is used."""
    if name not in rows or not rows[name].used_when:
        return 0
    return 1 + max(count_depth(rows, str(each[0])) for each in rows[name].used_when)


def _names(condition: ParameterCondition, values: Mapping[str, Value]) -> Iterator[str]:
    name = str(condition[0])
    if not name.endswith('*'):
        yield name
        return
    yield from (each for each in values if each.startswith(name[:-1]))


def _present(condition: ParameterCondition, values: Mapping[str, Value]) -> str:
    """Return the value, in words, of a parameter that does not satisfy a condition."""
    value = values[next(_names(condition, values))]
    return 'empty' if value in ((), '') else _word(value)


def _wanted(conditions: UsedWhen, equals: str) -> str:
    return ' or '.join(
        str(name) + (equals + ' or '.join(map(_word, wanted)) if wanted else '')
        for name, *wanted in conditions)


def _word(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else (
        f'{value:g}' if isinstance(value, float) else str(value))
