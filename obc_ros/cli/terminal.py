# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the commands share on a terminal: arguments, streams, signals, progress, tables."""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
import io
import os
import shutil
import signal
import sys
from types import FrameType, TracebackType
from typing import Any, ClassVar

from obc_ros.core.text.errors import ObcError, quote, suggest_name
from obc_ros.core.text.tables import format_table

NARROW = 60   # characters: below, progress has only name and text
WRAPPED, LEAST = 20, 12   # characters: cells that are longer take several lines of so many
GAP = 2                   # between two columns


class Parser(argparse.ArgumentParser):
    """
    An argument parser whose errors suggest commands, verbs and options.

    It refuses arguments that would have no effect, see `limit`. `effects`: by the name of an
    argument, those of which it needs one, and those that it must be without. `example`: a line
    that ends the help.
    """

    def __init__(self, *words: Any, **settings: Any) -> None:
        super().__init__(*words, **settings)
        self.effects: dict[str, tuple[Sequence[str], Sequence[str]]] = {}
        self.example = ''
        self._given: list[str] = []

    def format_help(self) -> str:
        """Return the help, with the example at the end."""
        return super().format_help() + (f'\nexample: {self.example}\n' if self.example else '')

    def limit(self, *names: str, needs: Sequence[str] = (), without: Sequence[str] = ()) -> None:
        """
        Declare when arguments have an effect.

        :param names: as the user writes them: ``--plot``, ``NAME``; declared before.
        :param needs: arguments of which one has to be given.
        :param without: arguments of which none may be given.
        """
        known = set(map(name_argument, self._actions))
        assert known.issuperset((*names, *needs, *without)), (names, needs, without)
        self.effects |= dict.fromkeys(names, (needs, without))

    def parse_known_args(self, args: Sequence[str] | None = None,  # type: ignore[override]
                         namespace: Any = None) -> tuple[argparse.Namespace, list[str]]:
        """Parse a command line; exit with status 2 if an argument would have no effect."""
        self._given = []
        found, unknown = super().parse_known_args(args, namespace)
        if not unknown:
            self._check_effects()
        return found, unknown

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        if action.option_strings or arg_strings:   # without words, a positional is absent
            self._given.append(name_argument(action))
        return super()._get_values(action, arg_strings)

    def _check_effects(self) -> None:
        for name in self._given:
            needs, without = self.effects.get(name, ((), ()))
            if needs and not set(needs) & set(self._given):
                self.error(f'{name} has no effect without {" or ".join(needs)}')
            for other in without:
                if other in self._given:
                    self.error(f'{name} has no effect with {other}')

    def parse_args(self, args: Sequence[str] | None = None,  # type: ignore[override]
                   namespace: Any = None) -> argparse.Namespace:
        """Parse a command line; exit with status 2 and a suggestion if a word is unknown."""
        found: argparse.Namespace
        found, unknown = self.parse_known_args(args, namespace)
        if not unknown:
            return found
        option = next((word for word in unknown if word.startswith('-')), '')
        if not option:
            self.error(f"not expected: {quote(' '.join(unknown))}")
        name = option.partition('=')[0]
        parser = self._find_parser(args or ())
        parser.error(f"unknown option '{quote(name)}'"
                     f'{suggest_name(name, parser.list_options())}')

    def list_options(self) -> list[str]:
        """Return the long options."""
        return [name for action in self._actions for name in action.option_strings
                if name.startswith('--')]

    def _find_parser(self, words: Sequence[str]) -> 'Parser':
        """Return the parser of the subcommand that a command line names."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                for index, word in enumerate(words):
                    if word in action.choices:
                        found: Parser = action.choices[word]._find_parser(words[index + 1:])
                        return found
        return self

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        known = [str(each) for each in action.choices]
        raise argparse.ArgumentError(action, (
            f"there is no '{quote(str(value))}'{suggest_name(str(value), known)}; "
            f'wanted one of {", ".join(known)}'))


def name_argument(action: argparse.Action) -> str:
    """Return the name of an argument in messages: its long option, or its place in the usage."""
    long = [name for name in action.option_strings if name.startswith('--')]
    return (long or action.option_strings or [
        action.metavar if isinstance(action.metavar, str) else action.dest])[0]


def open_streams() -> None:
    """
    Make the standard streams accept any text.

    Closed streams are connected to the null device: otherwise the next opened file gets their
    number, and their text. Characters that an encoding lacks are written as escape sequences.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    sys.stdout = sys.stdout or os.fdopen(1, 'w')
    sys.stderr = sys.stderr or os.fdopen(2, 'w')
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')


def get_width() -> int | None:
    """Return the characters of a line of the terminal; None if the output is not a terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


class InterruptedByUserError(ObcError):
    """The user or the system asked the command to end."""


class EndSignals:
    """
    Signals that ask a command to end: they are noted, and `check` raises.

    A context manager. A signal reaches all nested instances.
    """

    _open: ClassVar[int] = 0
    _number: ClassVar[int] = 0

    def __enter__(self) -> 'EndSignals':
        if not EndSignals._open:
            EndSignals._number = 0
        EndSignals._open += 1
        self._previous = {
            number: signal.signal(number, self._note)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        EndSignals._open -= 1

    @staticmethod
    def _note(number: int, frame: FrameType | None) -> None:
        EndSignals._number = number  # nothing is torn down inside a handler

    @staticmethod
    def check() -> None:
        """Raise InterruptedByUserError if this command was asked to end."""
        if EndSignals._number:
            name = signal.Signals(EndSignals._number).name
            raise InterruptedByUserError(f'ended by {name}')


class Lines:
    """Progress of tasks, which a file or a pipe has no use for: nothing is shown."""

    def update(self, name: str, text: str) -> None:
        """Show the progress of the task `name`."""

    def end(self, name: str) -> None:
        """Remove the line of the task `name`."""


@contextmanager
def show_progress(hidden: bool = False) -> Iterator[Lines]:
    """Yield a display of progress, on standard error; hidden without a terminal."""
    if hidden or not sys.stderr.isatty():
        yield Lines()
        return
    from rich.console import Console  # not needed without a terminal
    from rich.progress import (
        Progress,
        ProgressColumn,
        SpinnerColumn,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
    )
    console = Console(stderr=True)
    columns: list[ProgressColumn] = [TextColumn('{task.description}', markup=False),
                                     TextColumn('{task.fields[text]}', markup=False)]
    if console.width >= NARROW:
        spinner = 'line' if console.options.ascii_only else 'dots'
        columns = [SpinnerColumn(spinner), columns[0], TimeElapsedColumn(), columns[1]]
    with Progress(*columns, console=console, transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        class LiveLines(Lines):
            def update(self, name: str, text: str) -> None:
                if name not in tasks:
                    tasks[name] = bars.add_task(name, total=1, text=text)
                bars.update(tasks[name], text=text)

            def end(self, name: str) -> None:
                if name in tasks:
                    bars.update(tasks[name], completed=1, visible=False)

        yield LiveLines()


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]],
                colours: Mapping[str, str] | None = None) -> None:
    """
    Print a table; nothing without rows.

    Columns without text are left out. On a terminal that is too narrow for the table, each row is
    a list of keys and values.

    :param colours: from the text of a cell to its colour on a terminal.
    """
    kept = [index for index in range(len(header)) if any(row[index] for row in rows)]
    titles = [header[index] for index in kept]
    cells = [[row[index] for index in kept] for row in rows]
    if not kept:
        return
    if get_width() is None:
        print(format_table(titles, cells))
    else:
        _print_on_terminal(titles, cells, colours or {})


def _print_on_terminal(header: Sequence[str], rows: Sequence[Sequence[str]],
                       colours: Mapping[str, str]) -> None:
    from rich.console import Console  # not needed without a terminal
    from rich.table import Table
    from rich.text import Text

    def colour(cell: str) -> Text:
        return Text(cell, style=colours.get(cell, ''))

    console = Console(highlight=False)
    table = Table(box=None, padding=(0, GAP, 0, 0), pad_edge=False)
    needed = GAP * (len(header) - 1)
    for number, (title, *column) in enumerate(zip(header, *rows, strict=True)):
        longest = max(map(len, (title, *column)))
        # The first column has names, which are not broken.
        least = longest if number == 0 or longest <= WRAPPED else LEAST
        table.add_column(title, min_width=least, no_wrap=least == longest, overflow='fold')
        needed += least
    if needed <= console.width:
        for row in rows:
            table.add_row(*map(colour, row))
        console.print(table)
        return
    for number, row in enumerate(rows):
        pairs = Table.grid('', '', padding=(0, GAP, 0, 0))
        pairs.columns[1].overflow = 'fold'
        for title, cell in zip(header, row, strict=True):
            if cell:
                pairs.add_row(Text(title, style='bold'), colour(cell))
        if number:
            console.print()
        console.print(pairs)
