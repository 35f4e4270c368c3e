# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conversions between messages and YAML."""

from array import array
from collections.abc import Mapping, Sized
from importlib import import_module
import re
from typing import Any

import numpy as np
from obc_ros.core.text.errors import ObcError, quote, StatementError
from obc_ros.core.text.yaml_files import read_text
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractString,
    AbstractWString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)
import yaml


class FieldError(ObcError):
    """A field of a message does not accept a value; the text names the field."""


def find_type(name: str, kind: str) -> Any:
    """Return the class of ``obc_ros/srv/DesignLqr`` or ``obc_ros/DesignLqr``, of kind ``srv``."""
    parts = name.split('/')
    if len(parts) == 2:
        parts.insert(1, kind)
    if len(parts) != 3 or parts[1] != kind or not all(part.isidentifier() for part in parts):
        raise ObcError(f"'{quote(name)}' is no name of a type; wanted PACKAGE/{kind}/NAME")
    try:
        module = import_module(f'{parts[0]}.{kind}')
    except ModuleNotFoundError as error:
        raise ObcError(f'{name}: there is no package {parts[0]} with a {kind}') from error
    names = sorted(each for each, value in vars(module).items() if isinstance(value, type))
    if parts[2] not in names:
        raise ObcError(f'{name}: {parts[0]} has no {kind} {parts[2]}; it has {", ".join(names)}')
    return getattr(module, parts[2])


def parse_values(text: str) -> dict[str, Any]:
    """Return the values by field of a text in YAML; FieldError if it is no mapping."""
    try:
        values = read_text(text, 'not YAML')
    except StatementError as error:
        raise FieldError(str(error)) from None
    if not isinstance(values, dict):
        raise FieldError(f"'{quote(text)}' is no mapping of fields; "
                         "wanted '{FIELD: VALUE, ...}'")
    return values


def fill(message: Any, values: Mapping[str, Any], *, now: Any = None, path: str = '') -> Any:
    """
    Set fields of a message, and return the message.

    :param now: value of ``stamp: now`` and ``header: auto``.
    :param path: prefix of the names of the fields in errors.
    """
    types = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))
    for name, value in values.items():
        where = f'{path}{quote(str(name))}'
        if name not in types:
            raise FieldError(f'{where}: there is no such field; there is '
                             + (', '.join(types) or 'none'))
        setattr(message, name, _converted(value, types[name], where, now))
    return message


def _converted(value: Any, kind: Any, where: str, now: Any) -> Any:
    if isinstance(kind, AbstractNestedType):
        return _sequence(value, kind, where, now)
    if isinstance(kind, NamespacedType):
        return _message(value, kind, where, now)
    if isinstance(kind, (AbstractString, AbstractWString)):
        return _text(value, kind, where)
    assert isinstance(kind, BasicType)
    return _basic(value, kind.typename, where)


def _sequence(value: Any, kind: Any, where: str, now: Any) -> Any:
    if not isinstance(value, list):
        raise FieldError(f'{where}: {quote(str(value))} is no list; wanted [...]')
    size = getattr(kind, 'size', None) if isinstance(kind, Array) else None
    most = kind.maximum_size if isinstance(kind, BoundedSequence) else len(value)
    if (size is not None and len(value) != size) or len(value) > most:
        raise FieldError(f'{where} has {len(value)} entries; wanted '
                         + (str(size) if size is not None else f'{most} at most'))
    items = [_converted(each, kind.value_type, f'{where}[{k}]', now)
             for k, each in enumerate(value)]
    if isinstance(kind, Array) and isinstance(kind.value_type, BasicType):
        return np.array(items) if kind.value_type.typename != 'octet' else items
    return items


def _message(value: Any, kind: NamespacedType, where: str, now: Any) -> Any:
    full = '/'.join(kind.namespaced_name())
    message = getattr(import_module('.'.join(kind.namespaces)), kind.name)()
    if now is not None and full == 'builtin_interfaces/msg/Time' and value == 'now':
        return now
    if now is not None and full == 'std_msgs/msg/Header' and value == 'auto':
        message.stamp = now
        return message
    if not isinstance(value, dict):
        raise FieldError(f'{where}: {quote(str(value))} is no mapping of the fields of {full}')
    return fill(message, value, now=now, path=f'{where}.')


def _text(value: Any, kind: Any, where: str) -> str:
    """Return a text that can be sent; a number or truth value is converted."""
    if not isinstance(value, (str, bool, int, float)):
        raise FieldError(f'{where}: {quote(str(value))} is no text')
    text = str(value)
    if len(text) > getattr(kind, 'maximum_size', len(text)):
        raise FieldError(f'{where} has {len(text)} characters; '
                         f'wanted {kind.maximum_size} at most')
    try:
        text.encode()
    except UnicodeError as error:
        raise FieldError(f'{where}: {quote(text)} cannot be sent') from error
    return text


def _basic(value: Any, typename: str, where: str) -> Any:
    """Return a number, a truth value or a byte; YAML 1.1 reads 1e-9 as a text."""
    if typename == 'boolean':
        if isinstance(value, bool):
            return value
        raise FieldError(f'{where}: {quote(str(value))} is neither true nor false')
    wanted = float if typename in ('float', 'double', 'long double') else int
    try:
        if isinstance(value, bool):
            raise ValueError
        number = wanted(value)
        if wanted is int and isinstance(value, float) and number != value:
            raise ValueError
    except (TypeError, ValueError, OverflowError) as error:
        raise FieldError(f'{where}: {quote(str(value))} is no '
                         + ('number' if wanted is float else 'integer')) from error
    if wanted is int and not (limits := _limits(typename))[0] <= number <= limits[1]:
        raise FieldError(f'{where}: {number} is not from {limits[0]} to {limits[1]}')
    return bytes([int(number)]) if typename == 'octet' else number


def _limits(typename: str) -> tuple[int, int]:
    """Return the smallest and largest integer of a type: int8 to uint64, octet, char, wchar."""
    found = re.fullmatch(r'(u?)int(\d+)', typename)
    bits = int(found[2]) if found else {'octet': 8, 'char': 8, 'wchar': 16}[typename]
    low = 0 if not found or found[1] else -2 ** (bits - 1)
    return low, low + 2 ** bits - 1


def convert_to_plain(value: Any, *, truncate: int | None = None, no_arr: bool = False,
                     no_str: bool = False, kind: Any = None) -> Any:
    """
    Return a message, or a value of a field, as plain values for YAML.

    :param truncate: number of entries of sequences and characters of texts that are kept; None:
        all.
    :param no_arr, no_str: whether sequences and texts are replaced by their lengths.
    :param kind: type of the field, for `no_arr`.
    """
    options: dict[str, Any] = {'truncate': truncate, 'no_arr': no_arr, 'no_str': no_str}
    if hasattr(value, 'get_fields_and_field_types'):
        return {name: convert_to_plain(getattr(value, name), **options, kind=of) for name,
                of in zip(
            value.get_fields_and_field_types(), value.SLOT_TYPES, strict=True)}
    if isinstance(value, (bytes, str)):
        text = value.decode('latin-1') if isinstance(value, bytes) else value
        if no_str and isinstance(value, str):
            return f'<string length: <{len(text)}>>'
        return text if truncate is None or len(text) <= truncate else f'{text[:truncate]}...'
    if isinstance(value, (list, tuple, array, np.ndarray)):
        if no_arr and kind is not None:
            return _abbreviated(value, kind)
        items = [convert_to_plain(each, **options) for each in value[:truncate]]
        return items + ['...'] * (truncate is not None and len(value) > truncate)
    return value.item() if isinstance(value, np.generic) else value


def _abbreviated(value: Sized, kind: Any) -> str:
    of = kind.value_type
    if isinstance(of, NamespacedType):
        name = '/'.join(of.namespaced_name())
    elif isinstance(of, BasicType):
        name = of.typename
    else:
        name = 'string' if isinstance(of, AbstractString) else 'wstring'
    if isinstance(kind, Array):
        return f'<array type: {name}[{kind.size}]>'
    most = f'[{kind.maximum_size}]' if isinstance(kind, BoundedSequence) else ''
    return f'<sequence type: {name}{most}, length: {len(value)}>'


def convert_to_yaml(value: Any, **options: Any) -> str:
    """Return a message as text in YAML; the options are those of `convert_to_plain`."""
    return yaml.safe_dump(convert_to_plain(value, **options), allow_unicode=True,
                          width=float('inf'), default_flow_style=False, sort_keys=False)
