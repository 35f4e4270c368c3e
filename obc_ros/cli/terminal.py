# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tables and progress lines: coloured on a terminal, plain text elsewhere."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
import io
import os
import sys
from typing import Protocol

from obc_ros.core.text.errors import quote


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


class Lines(Protocol):
    """A display of progress, with one line for each task."""

    def update(self, name: str, text: str) -> None:
        """Show the progress of the task `name`."""

    def end(self, name: str, text: str) -> None:
        """Show the result of the task `name`."""


class PlainLines:
    """One line for each task that has ended, on standard error."""

    def update(self, name: str, text: str) -> None:
        """Print nothing."""

    def end(self, name: str, text: str) -> None:
        """Print the result of the task `name`."""
        print(quote(f'{name}: {text}', None), file=sys.stderr, flush=True)


class HiddenLines:
    """Nothing, for tasks that take milliseconds."""

    def update(self, name: str, text: str) -> None:
        """Print nothing."""

    def end(self, name: str, text: str) -> None:
        """Print nothing."""


@contextmanager
def show_progress(hidden: bool = False) -> Iterator[Lines]:
    """Yield a display of progress; on a terminal its lines are updated."""
    if hidden:
        yield HiddenLines()
        return
    if not sys.stderr.isatty():
        yield PlainLines()
        return
    from rich.console import Console  # not needed without a terminal
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    columns = (SpinnerColumn(finished_text='-'), TextColumn('{task.description}', markup=False),
               TimeElapsedColumn(), TextColumn('{task.fields[text]}', markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, object] = {}

        class LiveLines:
            def update(self, name: str, text: str) -> None:
                if name not in tasks:
                    tasks[name] = bars.add_task(name, total=1, text=text)
                bars.update(tasks[name], text=text)

            def end(self, name: str, text: str) -> None:
                self.update(name, text)
                bars.update(tasks[name], completed=1, visible=False)

        yield LiveLines()


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]],
                colours: Mapping[str, str] | None = None) -> None:
    """
    Print a table.

    Parameters
    ----------
    header : sequence of str
        Titles of the columns.
    rows : sequence of sequence of str
        Each as long as the header.
    colours : mapping, optional
        From the text of a cell to its colour on a terminal.

    """
    if not sys.stdout.isatty():
        widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
        for row in (header, ['-' * width for width in widths], *rows):
            cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
            print('  '.join(cells).rstrip())
        return
    from rich.console import Console  # not needed without a terminal
    from rich.table import Table
    from rich.text import Text
    shown = Table(*header)
    for row in rows:
        shown.add_row(*(Text(cell, style=(colours or {}).get(cell, '')) for cell in row))
    Console().print(shown)
