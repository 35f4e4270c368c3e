# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The problem files of the package by their names, which a user may write in place of a file."""

from functools import cache
from pathlib import Path
from typing import Any

from obc_ros.core.text.errors import suggest_name
import yaml

FOLDER = Path(__file__).resolve().parents[2] / 'examples'


def list_examples() -> list[str]:
    """Return the names of the examples."""
    return sorted(path.stem for path in FOLDER.glob('*.yaml'))


def find_example(name: str) -> Path:
    """Return the file of an example."""
    return FOLDER / f'{name}.yaml'


def load_example(name: str) -> dict[str, Any]:
    """Return the contents of an example; the files of the package are trusted."""
    text = find_example(name).read_text(encoding='utf-8')
    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)(text)   # the fast one, if there is one
    try:
        found: dict[str, Any] = loader.get_single_data()
    finally:
        loader.dispose()
    return found


@cache
def list_titles() -> dict[str, str]:
    """Return the titles of the examples by their names."""
    return {name: ' '.join(load_example(name)['title'].split()) for name in list_examples()}


def choose_file(given: Path) -> Path:
    """Return a file that a user named: of that path, else the example of that name."""
    is_name = given.name == str(given) and not given.suffix
    if is_name and not given.exists() and find_example(given.name).is_file():
        return find_example(given.name)
    return given


def suggest_file(given: Path, examples: bool = True) -> str:
    """
    Return a suggestion for a file that does not exist; empty if nothing is similar.

    :param examples: whether the names of examples, which are problems, are accepted in its place.
    """
    if not examples and given.name == str(given) and find_example(given.name).is_file():
        return f'; the example of this name is a problem: obc solve {given}'
    beside = given.parent if given.parent.is_dir() else Path()
    # Equal suffixes alone do not make two names similar.
    names = [path.name for path in beside.glob('*.y*ml')
             if suggest_name(given.stem, [path.stem])] if given.name else []
    return suggest_name(given.name, [
        *names, *(list_examples() if examples and not given.suffix else ())])
