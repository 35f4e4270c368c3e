# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
YAML files from untrusted users: limited in size, safe, and without duplicate keys.

The limit holds for the text in which each alias is replaced by what it stands for: 463 bytes can
stand for gigabytes.
"""

from collections.abc import Hashable
import csv
import itertools
from pathlib import Path
import re
from typing import Any

from obc_ros.core.text.errors import describe_type, quote, StatementError
import yaml

FileEntry = dict[str, Any] | StatementError

MAX_BYTES = 250_000
MAX_ENTRIES = 1_000  # of a list of mappings
MAX_BRACKETS = 50    # open at a time; the time that PyYAML needs grows with their square
# 1e-9 and 1.5e3, which YAML 1.1 reads as texts: a tag, a pattern, and what a number begins with.
EXPONENTS = ('tag:yaml.org,2002:float',
             re.compile(r'[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$'), list('-+.0123456789'))


class _Loader(yaml.SafeLoader):
    """
    PyYAML's safe loader without merge keys, which can expand a short text without bound.

    The loader based on libyaml is faster but crashes on deeply nested text.
    """

    def fetch_flow_collection_start(self, kind: type[yaml.Token]) -> None:
        if self.flow_level >= MAX_BRACKETS:
            raise RecursionError
        super().fetch_flow_collection_start(kind)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if key.tag == 'tag:yaml.org,2002:merge':
                raise yaml.constructor.ConstructorError(
                    None, None, "merge keys ('<<') are not supported", key.start_mark)
            if isinstance(key.value, str):
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key '{quote(key.value)}' occurs twice", key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)


class _ExponentLoader(_Loader):
    """A loader that reads ``1e-9`` as a number, as YAML 1.2 and ROS do."""


_ExponentLoader.add_implicit_resolver(*EXPONENTS)


def read_yaml(path: str | Path, *, exponents: bool = False) -> Any:
    """
    Return the contents of a YAML file.

    :param exponents: whether ``1e-9`` is a number, as in YAML 1.2; in YAML 1.1, only ``1.0e-9`` is
        one.
    :return: mappings, lists and scalars; None for an empty file.
    :raises StatementError: if the file cannot be read, is longer than ``MAX_BYTES`` (also with its
        aliases expanded), is not YAML, or has a key twice.
    """
    try:
        with open(path, 'rb') as file:
            text = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise StatementError(f'{path}: cannot be read: {error.strerror}') from None
    except ValueError as error:  # the path is not valid
        raise StatementError(f'{path}: cannot be read: {error}') from None
    return _load(text, str(path), _ExponentLoader if exponents else _Loader)


def _load(text: bytes, path: str, kind: type[_Loader] = _Loader) -> Any:
    """Return the contents of a YAML text; an error begins with `path`."""
    if len(text) > MAX_BYTES:
        raise StatementError(f'{path}: longer than {MAX_BYTES} bytes')
    try:
        loader = kind(text)
        node = loader.get_single_node()
        if node is None:
            return None
        if (length := _measure(node, {})) > MAX_BYTES:
            raise StatementError(f'{path}: its aliases expand it to {length:.3g} bytes; at most '
                                 f'{MAX_BYTES} are accepted')
        return loader.construct_document(node)
    except StatementError:   # a ValueError
        raise
    except RecursionError:
        raise StatementError(f'{path}: nested too deeply') from None
    except yaml.MarkedYAMLError as error:
        mark, what = error.problem_mark, ', '.join(filter(None, (error.context, error.problem)))
        where = f'line {mark.line + 1}, column {mark.column + 1}: ' if mark else ''
        raise StatementError(f'{path}: {where}{quote(what, 300)}') from None
    except yaml.reader.ReaderError as error:
        raise StatementError(f'{path}: the text is invalid at position {error.position}: '
                             f'{error.reason}') from None
    # ValueError: a scalar in the form of a date or a number that is not valid.
    except (yaml.YAMLError, ValueError) as error:
        raise StatementError(f'{path}: {quote(" ".join(str(error).split()), 300)}') from None


def _measure(node: yaml.Node, known: dict[int, int | None]) -> int:
    """Return the least bytes of a text without aliases; `known` has those of nodes seen so far."""
    key = id(node)
    if key in known:
        length = known[key]
        if length is None:
            raise yaml.composer.ComposerError(None, None, 'an alias contains itself',
                                              node.start_mark)
        return length
    if isinstance(node, yaml.ScalarNode):
        length = max(1, len(node.value))
    else:
        known[key] = None
        children = itertools.chain(*node.value) if isinstance(
            node, yaml.MappingNode) else node.value
        length = 1 + sum(_measure(child, known) for child in children)
    known[key] = length
    return length


def read_text(text: str, where: str) -> Any:
    """Return the contents of a YAML text, as `read_yaml` those of a file."""
    return _load(text.encode('utf-8', 'surrogatepass'), where)


def read_entries(path: str | Path) -> list[tuple[str, FileEntry]]:
    """
    Return the mappings of a YAML file, each with its place.

    :return: the place is the file, with the number of the entry in a list: ``several.yaml, entry
        2``. A mapping without `name` gets that of the file, with its number in a list. An entry
        that is not a mapping is returned as an error.
    """
    found = _list_entries(read_yaml(path), str(path), Path(path).stem)
    return [(where, _insert_data(entry, where, Path(path).parent)) for where, entry in found]


def _insert_data(entry: FileEntry, where: str, folder: Path) -> FileEntry:
    """Return an entry with the numbers of the CSV files that its tables name."""
    tables = entry.get('tables') if isinstance(entry, dict) else None
    if not isinstance(entry, dict) or not isinstance(tables, dict):
        return entry
    try:
        return {**entry, 'tables': {
            name: _read_columns(table, f'{where}: tables.{quote(str(name))}', folder)
            if isinstance(table, dict) and 'file' in table else table
            for name, table in tables.items()}}
    except StatementError as error:
        return error


def _read_columns(table: dict[str, Any], where: str, folder: Path) -> dict[str, Any]:
    """Return a table with two columns of a file, by default the first ones, in its place."""
    file = table['file']
    if not isinstance(file, str) or Path(file).is_absolute() or '..' in Path(file).parts:
        raise StatementError(f'{where}.file: wanted the name of a file beside this one, found '
                             f'{describe_type(file)}')
    try:
        with open(folder / file, encoding='utf-8-sig', newline='') as lines:
            text = lines.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:   # ValueError: it is no text
        words = error.strerror if isinstance(error, OSError) else 'it is no text'
        raise StatementError(f'{where}.file: {quote(file)} cannot be read: {words}') from None
    if len(text) > MAX_BYTES:
        raise StatementError(f'{where}.file: longer than {MAX_BYTES} bytes')
    rows = [row for row in csv.reader(text.splitlines()) if row]
    known = [name.strip() for name in rows[0]] if rows else []
    columns = table.get('columns', known[:2])
    if not isinstance(columns, list) or len(columns) != 2 or not all(
            name in known for name in columns):
        raise StatementError(f'{where}.columns: wanted two of {quote(", ".join(known), 200)}, '
                             f'found {quote(str(columns))}')
    try:
        numbers = [[float(row[known.index(name)]) for row in rows[1:]] for name in columns]
    except (ValueError, IndexError):
        raise StatementError(f'{where}.file: a row of {quote(file)} has no number for '
                             f'{" or ".join(columns)}') from None
    return {key: value for key, value in table.items() if key not in ('file', 'columns')} | {
        'argument': numbers[0], 'value': numbers[1]}


def read_text_entries(text: str) -> list[tuple[str, FileEntry]]:
    """Return the mappings of a YAML text, as `read_entries` those of a file."""
    if not isinstance(text, str):
        raise StatementError(f'text: wanted YAML, found {describe_type(text)}')
    return _list_entries(read_text(text, 'the text'), 'the text', 'problem')


def _list_entries(found: Any, where: str, stem: str) -> list[tuple[str, FileEntry]]:
    if not isinstance(found, list):
        return [_entry(found, where, stem)]
    if not found:
        raise StatementError(f'{where}: the list is empty')
    if len(found) > MAX_ENTRIES:
        raise StatementError(f'{where}: {len(found)} entries; at most {MAX_ENTRIES} are accepted')
    if len(found) == 1:
        return [_entry(found[0], where, stem)]
    return [_entry(entry, f'{where}, entry {index}', f'{stem}_{index}')
            for index, entry in enumerate(found, start=1)]


def _entry(entry: object, where: str, name: str) -> tuple[str, FileEntry]:
    if not isinstance(entry, dict):
        return where, StatementError(
            f'{where}: wanted a mapping of keys to values, found {describe_type(entry)}')
    return where, entry if entry.get('name') is not None else {**entry, 'name': name}
