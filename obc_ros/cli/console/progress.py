# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Progress on a terminal: one line for each task under way, none elsewhere."""

from collections.abc import Iterator
from contextlib import contextmanager
import sys
from typing import Protocol

NARROW = 60   # characters: below, only name and text are shown


class Lines(Protocol):
    """A display of progress, with one line for each task."""

    def update(self, name: str, text: str) -> None:
        """Show the progress of the task `name`."""

    def end(self, name: str) -> None:
        """Remove the line of the task `name`."""


class HiddenLines:
    """Nothing: the results say it once, and a file or a pipe has no use for progress."""

    def update(self, name: str, text: str) -> None:
        """Print nothing."""

    def end(self, name: str) -> None:
        """Print nothing."""


@contextmanager
def show_progress(hidden: bool = False) -> Iterator[Lines]:
    """Yield a display of progress, on standard error; hidden without a terminal."""
    if hidden or not sys.stderr.isatty():
        yield HiddenLines()
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

        class LiveLines:
            def update(self, name: str, text: str) -> None:
                if name not in tasks:
                    tasks[name] = bars.add_task(name, total=1, text=text)
                bars.update(tasks[name], text=text)

            def end(self, name: str) -> None:
                if name in tasks:
                    bars.update(tasks[name], completed=1, visible=False)

        yield LiveLines()
