# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""YAML files from anyone: bounded, safe, and a key that stands twice is an error."""

from collections.abc import Hashable
from pathlib import Path
from typing import Any

from obc_ros.core.errors import StatementError
import yaml

MAX_BYTES = 250_000


class _Loader(yaml.SafeLoader):
    """
    PyYAML's safe loader without merge keys, which can grow a short text without bound.

    The one on libyaml would be faster but ends the process on deeply nested text.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if key.tag == 'tag:yaml.org,2002:merge':
                raise yaml.constructor.ConstructorError(
                    None, None, "merge keys ('<<') are not read", key.start_mark)
            if isinstance(key.value, str):
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key '{key.value[:60]}' stands twice", key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def read_yaml(path: str | Path) -> Any:
    """
    Return what a YAML file holds.

    Raises
    ------
    StatementError
        If the file cannot be read, is longer than ``MAX_BYTES``, is not YAML, or has a key twice.

    """
    try:
        with open(path, 'rb') as file:
            text = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise StatementError(f'{path}: cannot be read: {error}') from None
    if len(text) > MAX_BYTES:
        raise StatementError(f'{path}: longer than {MAX_BYTES} bytes')
    try:
        return _Loader(text).get_single_data()
    except RecursionError:
        raise StatementError(f'{path}: nested too deeply') from None
    # ValueError: a scalar that looks like a date or a number but is none.
    except (yaml.YAMLError, ValueError) as error:
        raise StatementError(f'{path}: {" ".join(str(error).split())[:300]}') from None
