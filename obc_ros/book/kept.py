# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The results that the package has with it, for a gallery without ROS 2, and those of a folder."""

from collections.abc import Mapping, Sequence
import json
from pathlib import Path
import shutil
from typing import Any

from obc_ros.book.page import render_page, strip_markup
from obc_ros.cli.results import write as write_json
from obc_ros.cli.share_folders import share_directory
from obc_ros.cli.terminal import print_table
from obc_ros.core.text.errors import ObcError
from obc_ros.core.text.json_values import convert_to_json
from obc_ros.core.text.tables import format_residual

HEADER = ('entry', '', 'numbers', 'largest error', 'time')
COLOURS = {'holds': 'green', 'does not hold': 'red'}
OF_PROGRAM = {'program': '', 'output': '', 'asked': []}   # of an entry that has no program yet


def find_kept() -> Path:
    """Return the folder of the kept results; ObcError if they are not installed."""
    folder = share_directory('obc_ros') / 'docs' / 'gallery'
    if not (folder / 'gallery.json').is_file():
        raise ObcError(f'no results of the gallery in {folder}')
    return folder


def read_kept() -> dict[str, dict[str, Any]]:
    """Return the kept records by name, in the order of the gallery."""
    text = (find_kept() / 'gallery.json').read_text(encoding='utf-8')
    return {each['name']: each for each in json.loads(text)['entries']}


def read_program(name: str) -> dict[str, Any]:
    """Return program, output and what is asked of an entry."""
    kept = read_kept().get(name, OF_PROGRAM)
    return {key: kept[key] for key in OF_PROGRAM}


def show_kept(records: Sequence[dict[str, Any]], out: Path) -> int:
    """Write and print kept results as if they had been computed; return the exit status 0."""
    for figure in (figure for record in records for figure in record['figures']):
        shutil.copy(find_kept() / figure, out / figure)
    write_records(out, records, list(read_kept()))
    print_records(records)
    commits = sorted({record['commit'] for record in records})
    print(f'{len(records)} entries, computed before at commit {", ".join(commits)}; with ROS 2, '
          f'obc gallery computes them anew: {out / "index.html"}')
    return 0


def write_records(out: Path, records: Sequence[dict[str, Any]], order: Sequence[str]) -> None:
    """Write ``gallery.json``, ``index.html`` and the programs; keep the records of others."""
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
    for name in (f'{record["name"]}.{ending}' for record in records if record['program']
                 for ending in ('py', 'ipynb')):
        shutil.copy(find_kept() / name, out / name)


def print_records(records: Sequence[dict[str, Any]]) -> None:
    """Print a table of entries, and each row that is out of its tolerance."""
    print_table(HEADER, [_row(record) for record in records], COLOURS)
    for record in records:
        if record['message']:
            print(f'{record["name"]}: {record["message"]}')
        for row in record['rows']:
            if not row['holds']:
                print(f'{record["name"]}: {strip_markup(row["what"])}: {row["measured"]:.10g}, '
                      f'reference {row["exact"]:.10g}, error {row["error"]:.1e}')


def _row(record: Mapping[str, Any]) -> tuple[str, ...]:
    rows = record['rows']
    error = format_residual(max(row['error'] for row in rows)) if rows else ''
    return (record['name'], 'holds' if record['holds'] else 'does not hold',
            str(sum(row['values'] for row in rows) or ''), error, f'{record["seconds"]:.1f} s')
