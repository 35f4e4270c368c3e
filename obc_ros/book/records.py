# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Run entries with the nodes, and write their results as page and numbers."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
import sys
import time
from typing import Any

from obc_ros.api.figures.files import FORMATS, save_figure
from obc_ros.api.figures.style import STYLE
from obc_ros.book.entry import GalleryEntry
from obc_ros.book.kept import print_records, read_program, write_records
from obc_ros.book.runner import Desk
from obc_ros.cli.client import serve_client
from obc_ros.cli.processes import Children, isolate, reserve_domain
from obc_ros.cli.ros_graph import ServerLostError
from obc_ros.cli.terminal import InterruptedByUserError, show_progress
from obc_ros.core.text.errors import ObcError


def work_and_write(chosen: Sequence[GalleryEntry], out: Path, order: Sequence[str],
                   formats: Sequence[str]) -> int:
    """Run entries, write and print their results; return the exit status."""
    begun = time.monotonic()
    records: list[dict[str, Any]] = []
    status = 0
    try:
        work_all(chosen, out, formats, records)
    except (ObcError, OSError) as error:  # interrupted, or a folder that cannot be written
        print(f'obc gallery: {error}', file=sys.stderr)
        status = 1
    if not records:
        return status
    write_records(out, records, order)
    print_records(records)
    print(f'{len(records)} entries in {time.monotonic() - begun:.1f} s: '
          f'{out / "index.html"}')
    return status or int(not all(record['holds'] for record in records))


def work_all(entries: Sequence[GalleryEntry], out: Path, formats: Sequence[str],
             records: list[dict[str, Any]]) -> None:
    """Append the records of entries, computed by nodes on a domain of their own."""
    with reserve_domain() as domain:
        isolate(domain)
        with (Children(out / 'log') as children, ExitStack() as stack, show_progress() as lines):
            # Entries ask one question at a time.
            desk = Desk(lambda: stack.enter_context(serve_client(children, 'workers:=1')),
                        out / 'recordings')
            for entry in entries:
                lines.update(entry.name, entry.title)
                records.append(work(entry, desk, out, formats))
                lines.end(entry.name)


def work(entry: GalleryEntry, desk: Desk, out: Path, formats: Sequence[str] = FORMATS[:1]
         ) -> dict[str, Any]:
    """Return the record of one entry and draw its figures; an error goes into the record."""
    import matplotlib
    begun = time.monotonic()
    desk.begin(entry.name)
    record: dict[str, Any] = {
        'name': entry.name, 'label': label(entry.name), 'title': entry.title,
        'source': entry.source, 'statement': list(entry.statement), 'erratum': entry.erratum,
        'in_book': entry.in_book, 'finding': '', 'notes': [], 'rows': [], 'figures': [],
        'message': '', 'holds': False, **read_program(entry.name)}
    try:
        with matplotlib.rc_context(STYLE):
            answer = entry.run(desk)
            figures = {entry.name: answer.figure} | {
                f'{entry.name}-{ending}': each for ending, each in answer.more.items()}
            for stem, figure in figures.items():
                save_figure(figure, out / stem, formats)
    except (InterruptedByUserError, ServerLostError):
        raise
    except ObcError as error:
        record['message'] = str(error)
    else:
        record |= {'finding': answer.finding, 'notes': list(answer.notes),
                   'rows': [row.as_json() for row in answer.rows],
                   'figures': [f'{stem}.png' for stem in figures]}
        record['holds'] = bool(record['rows']) and all(row['holds'] for row in record['rows'])
    return record | {'commands': desk.commands, 'seconds': time.monotonic() - begun}


def label(name: str) -> str:
    """Return the name of an entry as in the book, or as a heading."""
    kind, _, number = name.rpartition('-')
    return f'{(kind or "example").capitalize().replace("-", " ")} {number}'
