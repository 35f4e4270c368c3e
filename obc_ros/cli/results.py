# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Problems and cases of files, the JSON file of each result, and the exit status.

A file holds one entry or a list of entries. A malformed entry has a result, too.
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
from typing import Any, ClassVar, TypeVar

from obc_ros.api.figures.files import FORMATS, parse_formats
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import DynamicsError, ObcError, quote, StatementError
from obc_ros.core.text.example_files import suggest_file
from obc_ros.core.text.json_values import convert_to_json
from obc_ros.core.text.yaml_files import FileEntry, read_entries
from obc_ros.workers.wire import Packet

LONGEST = 200  # [bytes] of the name of a result's file, without its extension


@dataclass(eq=False)
class Asked(ABC):
    """
    An entry of a file, and its result.

    `where` is the file, and the position in a list, `file` the file alone; `file_name` is that of
    the result, without extension; `label` is the name, with `where` if the name is not unique;
    `renamed` is set if the file name was taken. `took` is the time [s] from the request to the
    result. `kind` is that of the request.
    """

    kind: ClassVar[str]
    examples: ClassVar[bool]   # whether the names of examples are accepted

    name: str
    where: str
    file_name: str
    label: str = ''
    renamed: bool = False
    file: Path = Path()
    status: str = ''
    message: str = ''
    took: float = math.nan

    @abstractmethod
    def take(self, entry: dict[str, Any]) -> None:
        """Check and keep an entry; raise StatementError or DynamicsError."""

    @abstractmethod
    def make_request(self) -> Packet:
        """Return the request to a worker."""

    @abstractmethod
    def take_response(self, response: Packet) -> None:
        """Keep the response of a worker, which has a status and a message at least."""

    @abstractmethod
    def as_json(self) -> dict[str, Any]:
        """Return the contents of ``NAME.json``."""

    def end(self, status: str, message: str) -> None:
        """Set status and message of the result."""
        self.status, self.message = status, message


Kind = TypeVar('Kind', bound=Asked)


def read_questions(kind: type[Kind], files: Iterable[Path]) -> list[Kind]:
    """Return the entries of all files, in order; what is malformed has this status."""
    asked: list[Kind] = []
    for file in files:
        for where, entry in _entries(file, kind.examples):
            alone = where == str(file)
            name = file.stem
            if not isinstance(entry, StatementError):
                name = str(entry['name'])
            elif not alone:
                name = f"{file.stem}_{where.rpartition(' ')[2]}"
            wanted = file.stem if alone else name
            unique = choose_file_name(wanted, (each.file_name for each in asked))
            asked.append(kind(name, where, unique, file=file,
                              renamed=unique != choose_file_name(wanted, ())))
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


def add_arguments(parser: Parser, what: str) -> None:
    """Declare the arguments for files of `what`, such as problems, and for folders of results."""
    parser.add_argument('files', nargs='+', metavar='FILE', type=Path,
                        help=f'YAML file with {what}: one, or a list')
    parser.add_argument('--json', metavar='DIR', type=Path,
                        help='write each result to DIR, as JSON')
    parser.add_argument('--plot', metavar='DIR', type=Path,
                        help='write a figure of each result to DIR')
    add_format(parser)
    parser.limit('--format', needs=['--plot'])
    parser.add_argument('--server', metavar='NAME', nargs='?', const='', type=_server_name,
                        help='ask a running trajectory_server over ROS: any, or that of a name '
                             '(default: processes of this command, without ROS)')


def add_format(parser: argparse.ArgumentParser) -> None:
    """Declare the argument `--format` of figures."""
    parser.add_argument('--format', metavar='NAMES', type=_formats, default=FORMATS[:1],
                        help=f'of the figures: {",".join(FORMATS)} (default: {FORMATS[0]})')


def _formats(text: str) -> tuple[str, ...]:
    try:
        return parse_formats(text)
    except ObcError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _server_name(text: str) -> str:
    """Return the full name of a server; empty: any."""
    if not re.fullmatch(r'|/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*', text, re.ASCII):
        raise argparse.ArgumentTypeError(
            f"wanted the name of a node, found '{quote(text)}'; write --server after the files")
    return f'/{text.removeprefix("/")}' if text else ''


def make_folders(args: argparse.Namespace) -> None:
    """Create the folders of the results, before the work begins."""
    for folder in filter(None, (args.json, args.plot)):
        folder.mkdir(parents=True, exist_ok=True)


def save_answers(asked: Sequence[Kind], args: argparse.Namespace,
                 draw: Callable[[Path, Kind, Sequence[str]], None]
                 ) -> None:
    """
    Write the files of all results, and report those that were renamed.

    :param draw: draws a result, if it can be drawn, into files: path without ending, formats.
    """
    for each in asked:
        if each.renamed and (args.json or args.plot):
            print(f'{each.label}: written as {each.file_name}; an earlier entry has its file name')
        if args.json:
            write(args.json, each.file_name, each.as_json())
    if args.plot:  # afterwards: it is slow, and the user may interrupt it
        for each in asked:
            draw(args.plot / each.file_name, each, args.format)


def _entries(file: Path, examples: bool) -> list[tuple[str, FileEntry]]:
    """Return the entries of a file and their places; for an unreadable file, its error."""
    try:
        return read_entries(file)
    except StatementError as error:
        hint = '' if file.exists() else suggest_file(file, examples)
        return [(str(file), StatementError(f'{error}{hint}'))]


def write(folder: Path, name: str, result: Mapping[str, Any]) -> None:
    """Write ``NAME.json``, with `convert_to_json`; the folder is created if it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f'{name}.json').write_text(
            json.dumps(convert_to_json(result), allow_nan=False) + '\n', encoding='utf-8')
    except OSError as error:
        raise ObcError(f'{folder / name}.json cannot be written: {error.strerror}') from error


def print_lines(label: str, message: str) -> None:
    """Print a message, each line with the name of the entry."""
    for line in message.split('\n'):
        print(quote(f'{label}: {line}', None))


def choose_file_name(name: str, taken: Iterable[str]) -> str:
    """Return `name` as a file name without extension, with a number appended if it is taken."""
    safe = re.sub(r'[^\w.+-]', '_', name).encode()[:LONGEST].decode(errors='ignore')
    safe = safe.lstrip('.') or 'problem'
    others, number, unique = set(taken), 1, safe
    while unique in others:
        number += 1
        unique = f'{safe}_{number}'
    return unique


def get_exit_status(statuses: Iterable[str]) -> int:
    """Return the exit status: 2 if an entry is malformed, 0 if all are solved, else 1."""
    found = set(statuses)
    return 2 if 'malformed' in found else int(found != {'solved'})
