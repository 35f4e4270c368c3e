# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Hypothesis strategies for messages of any type with invalid and extreme values."""

from array import array
from collections.abc import Callable
import copy
from importlib import import_module
from typing import Any

from hypothesis import strategies as st
from rosidl_parser import definition

NUMBERS = [0.0, -0.0, 1.0, -1.0, 0.5, 1e-300, 5e-324, 1e9, 1e300, 1.7976931348623157e308,
           float('nan'), float('inf'), float('-inf')]
# Names and words that have a meaning for some node, and similar ones.
TEXTS = [
    '', ' ', '0', '1', '-1', '1e400', 'nan', 'inf', 'x', 'v', 'p', 'u', 'theta', 'px', 'T',
    'aircraft', 'vehicle', 'scalar', 'linear', 'double_integrator', 'two_wheeled', 'brockett',
    'Qx', 'Qu', 'setpoint', 'weights', 'bryson', 'output', 'matrices', 'workers', 'time_limit',
    'system', 'speed', 'x0', 'rate', 'use_sim_time', 'noise.px', 'system_parameters.m', 'time',
    'effort', 'quadratic', 'linear', 'zoh', 'auto', 'u**2', 'p**2 + u**2', 'v', 'sin(x)',
    '1/0', '9**9**9**9', '(' * 20_000, 'x' + '+x' * 3000, '-' * 3000 + '1', '__import__("os")',
    'x.__class__', 'lambda: 1', '[1, [2', '[' * 3000, '{"a": 1}', '../../etc/passwd', '/dev/zero',
    '/proc/self/mem', 'NaN', 'é', '\u202e', '\U0001f600', 'a\nb', '%s%n', '$(touch x)',
    'x' * 5000]
numbers = st.sampled_from(NUMBERS) | st.floats(width=64)
texts = st.sampled_from(TEXTS) | st.text(
    st.characters(codec='utf-8', exclude_characters='\0'), max_size=20)
LENGTHS = (0, 1, 2, 3, 4, 6, 9, 12, 36, 37)

_BASIC: dict[str, Any] = {
    'boolean': st.booleans(),
    'float': st.sampled_from([0.0, 1.0, -1.0, 1e30]),
    'double': numbers,
    'octet': st.binary(min_size=1, max_size=1),
}


def messages(cls: Any, depth: int = 0) -> st.SearchStrategy[Any]:
    """Return messages of a class in which each field is any value of its type."""
    fields = {name: _values(kind, depth) for name, kind in zip(
        cls.get_fields_and_field_types(), cls.SLOT_TYPES, strict=True)}
    return st.fixed_dictionaries({}, optional=fields).map(lambda values: cls(**values))


@st.composite
def spoilt(draw: Any, whole: Any) -> Any:
    """Return copies of a valid message in which one to three fields are invalid."""
    message = copy.deepcopy(whole)
    for _ in range(draw(st.integers(1, 3))):
        _spoil(draw, message)
    return message


def _spoil(draw: Any, message: Any) -> None:
    kinds = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))
    name = draw(st.sampled_from(list(kinds)))
    value, kind = getattr(message, name), kinds[name]
    if hasattr(value, 'SLOT_TYPES'):
        _spoil(draw, value)
    elif isinstance(value, array) and len(value) and draw(st.booleans()):
        value[draw(st.integers(0, len(value) - 1))] = draw(numbers)
    elif isinstance(value, list) and value and hasattr(value[0], 'SLOT_TYPES') and (
            draw(st.integers(0, 4))):
        _spoil(draw, value[draw(st.integers(0, len(value) - 1))])
    else:
        setattr(message, name, draw(_values(kind, 0)))


def _values(kind: Any, depth: int) -> st.SearchStrategy[Any]:
    if isinstance(kind, definition.AbstractNestedType):
        return _lists(kind, depth)
    if isinstance(kind, definition.NamespacedType):
        return messages(_class(kind), depth + 1)
    if isinstance(kind, definition.AbstractGenericString):
        return texts
    return _basic(kind.typename)


def _basic(name: str) -> st.SearchStrategy[Any]:
    if name in _BASIC:
        return _BASIC[name]  # type: ignore[no-any-return] # a table of strategies
    bits = int(name.removeprefix('u').removeprefix('int'))
    low, high = (0, 2**bits - 1) if name.startswith('u') else (-2**(bits - 1), 2**(bits - 1) - 1)
    return st.sampled_from([0, 1, low, high]) | st.integers(low, high)


def _lists(kind: Any, depth: int) -> st.SearchStrategy[Any]:
    value = _values(kind.value_type, depth)
    if isinstance(kind, definition.Array):
        return st.lists(value, min_size=kind.size, max_size=kind.size).map(_packed(kind))
    most = 4 if isinstance(kind.value_type, definition.NamespacedType) else 8
    short = st.lists(value, max_size=most)
    if not isinstance(kind.value_type, definition.BasicType):
        return short
    even = st.builds(lambda each, count: [each] * count, value, st.sampled_from(LENGTHS))
    return (even | short).map(_packed(kind))


def _packed(kind: Any) -> Callable[[list[Any]], Any]:
    """Return the conversion of a list to the type that the generated setter expects."""
    name = getattr(kind.value_type, 'typename', '')
    if name == 'double' and not isinstance(kind, definition.Array):
        return lambda values: array('d', values)
    return list


def _class(kind: Any) -> Any:
    module = import_module('.'.join(kind.namespaces))
    name, _, part = kind.name.partition('_')  # the goal of an action, for example
    return getattr(getattr(module, name), part) if part else getattr(module, name)
