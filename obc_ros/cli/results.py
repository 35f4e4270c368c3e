# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What is asked in files, the JSON file that a command writes for each answer, the exit status.

A file holds one question or a list of them; a malformed one has an answer like any other.
"""

from abc import ABC, abstractmethod
import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
import json
import math
from pathlib import Path
import re
from typing import Any, TypeVar

from obc_ros.core.text.errors import DynamicsError, ObcError, quote, StatementError
from obc_ros.core.text.yaml_files import read_entries

FileEntry = dict[str, Any] | StatementError

LONGEST = 200  # bytes of the name of an answer's file, without its ending


@dataclass(eq=False)
class Asked(ABC):
    """
    A question of a file, and what came of it.

    `where` is the file it was read from, and which entry of a list it is; `file_name` is that of
    its answers; `label` is the name, and where it was read from if others have that name;
    `renamed` tells that another has its file's name.
    """

    name: str
    where: str
    file_name: str
    label: str = ''
    renamed: bool = False
    status: str = ''
    message: str = ''

    @abstractmethod
    def take(self, entry: dict[str, Any]) -> None:
        """Check and keep what the file says; raise StatementError or DynamicsError."""

    @abstractmethod
    def as_json(self) -> dict[str, Any]:
        """Return what ``NAME.json`` holds."""

    def end(self, status: str, message: str) -> None:
        """Note what came of it."""
        self.status, self.message = status, message


Kind = TypeVar('Kind', bound=Asked)


def read_questions(kind: type[Kind], files: Iterable[Path]) -> list[Kind]:
    """Return the questions of all files, in order; those that are malformed have ended."""
    asked: list[Kind] = []
    for file in files:
        for where, entry in _entries(file):
            alone = where == str(file)
            name = file.stem
            if not isinstance(entry, StatementError):
                name = str(entry['name'])
            elif not alone:
                name = f"{file.stem}_{where.rpartition(' ')[2]}"
            wanted = file.stem if alone else name
            unique = choose_file_name(wanted, (each.file_name for each in asked))
            asked.append(kind(name, where, unique, renamed=unique != choose_file_name(wanted, ())))
            try:
                if isinstance(entry, StatementError):
                    raise entry
                asked[-1].take(entry)
            except (StatementError, DynamicsError) as error:
                asked[-1].end('malformed', str(error))
    count = Counter(each.name for each in asked)
    for each in asked:
        each.label = quote(each.name, 80)
        if count[each.name] > 1:
            each.label += f' ({quote(each.where, None)})'
    return asked


def add_arguments(parser: argparse.ArgumentParser, what: str) -> None:
    """Describe the files that `what` is asked in, and the folders of the answers."""
    parser.add_argument('files', nargs='+', metavar='FILE', type=Path,
                        help=f'YAML file with {what}: one, or a list')
    parser.add_argument('--json', metavar='DIR', type=Path,
                        help='write each result to DIR, as JSON')
    parser.add_argument('--plot', metavar='DIR', type=Path,
                        help='write a figure of each result to DIR')


def make_folders(args: argparse.Namespace) -> None:
    """
    Make the folders of the answers, before anybody waits for these.

    Raises
    ------
    OSError
        If one cannot be made.

    """
    for folder in filter(None, (args.json, args.plot)):
        folder.mkdir(parents=True, exist_ok=True)


def save_answers(asked: Sequence[Kind], args: argparse.Namespace,
                 draw: Callable[[Path, Kind], None]
                 ) -> None:
    """
    Write the files of all answers, and say which are not named as their questions.

    Parameters
    ----------
    asked : sequence of Asked
        The questions, answered.
    args : argparse.Namespace
        With the folders `json` and `plot`, or None.
    draw : callable
        Draws an answer into the file of a path, if there is something to draw.

    Raises
    ------
    ObcError
        If a file cannot be written.

    """
    for each in asked:
        if each.renamed and (args.json or args.plot):
            print(f'{each.label}: written as {each.file_name}; an earlier one has its name')
        if args.json:
            write(args.json, each.file_name, each.as_json())
    if args.plot:  # afterwards: it takes its time, in which the user may leave
        for each in asked:
            draw(args.plot / f'{each.file_name}.png', each)


def _entries(file: Path) -> list[tuple[str, FileEntry]]:
    """Return what a file holds and where it stands in it, or what is wrong instead."""
    try:
        return read_entries(file)
    except StatementError as error:
        return [(str(file), error)]


def convert_to_json(value: Any) -> Any:
    """Return a value as JSON has it: what is no finite number becomes null."""
    if isinstance(value, Mapping):
        return {key: convert_to_json(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [convert_to_json(each) for each in value]
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
            json.dumps(convert_to_json(result), allow_nan=False) + '\n', encoding='utf-8')
    except OSError as error:
        raise ObcError(f'{folder / name}.json cannot be written: {error.strerror}') from error


def choose_file_name(name: str, taken: Iterable[str]) -> str:
    """Return `name` as part of a file's name, with a number behind it if it is taken already."""
    safe = re.sub(r'[^\w.+-]', '_', name).encode()[:LONGEST].decode(errors='ignore')
    safe = safe.lstrip('.') or 'problem'
    others, number, unique = set(taken), 1, safe
    while unique in others:
        number += 1
        unique = f'{safe}_{number}'
    return unique


def get_exit_status(statuses: Iterable[str]) -> int:
    """Return 0 when all is solved, 2 when a question is malformed, else 1."""
    found = set(statuses)
    return 2 if 'malformed' in found else int(found != {'solved'})
