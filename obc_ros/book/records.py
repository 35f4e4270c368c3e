# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Run entries with the nodes, and write their results as page and numbers."""

from collections.abc import Sequence
from contextlib import ExitStack
import json
from pathlib import Path
import sys
import time
from typing import Any

from obc_ros.api.figures.files import FORMATS, save_figure
from obc_ros.api.figures.style import STYLE
from obc_ros.book.entry import GalleryEntry
from obc_ros.book.page import render_page, strip_markup
from obc_ros.book.runner import Desk
from obc_ros.cli.client import serve_client
from obc_ros.cli.processes import Children, isolate, reserve_domain
from obc_ros.cli.results import write as write_json
from obc_ros.cli.ros_graph import ServerLostError
from obc_ros.cli.terminal import InterruptedByUserError, print_table, show_progress
from obc_ros.core.text.errors import ObcError
from obc_ros.core.text.json_values import convert_to_json
from obc_ros.core.text.tables import format_residual, format_value

HEADER = ('entry', '', 'numbers', 'largest error: result', 'reference', 'error', 'time')
COLOURS = {'holds': 'green', 'does not hold': 'red'}


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
    write_record(out, records, order)
    _show(records)
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
        'message': '', 'holds': False}
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


def write_record(out: Path, records: Sequence[dict[str, Any]], order: Sequence[str]) -> None:
    """Write ``gallery.json`` and ``index.html``, keeping the records of other entries."""
    before = out / 'gallery.json'
    try:
        known = json.loads(before.read_text(encoding='utf-8'))['entries']
        found = {record['name']: record for record in known if record['name'] in order}
        render_page(known)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # none, or another format
        found = {}
    found |= {record['name']: convert_to_json(record) for record in records}
    entries = [found[name] for name in order if name in found]
    write_json(out, 'gallery', {'entries': entries})
    (out / 'index.html').write_text(render_page(entries), encoding='utf-8')


def _verdict(record: dict[str, Any]) -> str:
    return 'holds' if record['holds'] else 'does not hold'


def _show(records: Sequence[dict[str, Any]]) -> None:
    print_table(HEADER, [_row(record) for record in records], COLOURS)
    for record in records:
        if record['message']:
            print(f'{record["name"]}: {record["message"]}')
        for row in record['rows']:
            if not row['holds']:
                print(f'{record["name"]}: {strip_markup(row["what"])}: {row["measured"]:.10g}, '
                      f'reference {row["exact"]:.10g}, error {row["error"]:.1e}')


def _row(record: dict[str, Any]) -> tuple[str, ...]:
    rows = record['rows']
    took = f'{record["seconds"]:.1f} s'
    if not rows:
        return record['name'], _verdict(record), '', '', '', '', took
    worst = max(rows, key=lambda row: row['error'])
    return (record['name'], _verdict(record), str(sum(row['values'] for row in rows)),
            format_value(worst['measured']), format_value(worst['exact']),
            format_residual(worst['error']), took)
