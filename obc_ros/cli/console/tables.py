# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tables: coloured on a terminal, key and value on a narrow one, plain text elsewhere."""

from collections.abc import Mapping, Sequence

from obc_ros.cli.console.streams import get_width
from obc_ros.core.text.tables import format_table

WRAPPED, LEAST = 20, 12   # characters: cells that are longer take several lines of so many
GAP = 2                   # between two columns


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
