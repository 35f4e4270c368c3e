# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The JSON file that a command writes for each question, and the exit status of all together."""

from collections.abc import Iterable, Mapping
import json
import math
from pathlib import Path
import re
from typing import Any

from obc_ros.core.errors import ObcError


def plain(value: Any) -> Any:
    """Return a value as JSON has it: what is no finite number becomes null."""
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write(folder: Path, name: str, result: Mapping[str, Any]) -> None:
    """
    Write ``NAME.json``.

    Raises
    ------
    ObcError
        If the file cannot be written.

    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f'{name}.json').write_text(
            json.dumps(plain(result), allow_nan=False) + '\n', encoding='utf-8')
    except OSError as error:
        raise ObcError(f'{folder / name}.json cannot be written: {error.strerror}') from error


def file_name(name: str, taken: Iterable[str]) -> str:
    """Return `name` as part of a file's name, with a number behind it if it is taken already."""
    safe = re.sub(r'[^\w.+-]', '_', name)[:100].lstrip('.') or 'problem'
    others, number, unique = set(taken), 1, safe
    while unique in others:
        number += 1
        unique = f'{safe}_{number}'
    return unique


def exit_status(statuses: Iterable[str]) -> int:
    """Return 0 when all is solved, 2 when a question is malformed, else 1."""
    found = set(statuses)
    return 2 if 'malformed' in found else int(found != {'solved'})
