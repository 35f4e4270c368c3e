# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The entries that `obc gallery` has computed, as sections of a page.

One directive, with the path of ``gallery.json`` from the root of the package::

    ```{gallery} out/gallery/gallery.json
    ```
"""

from collections.abc import Iterator, Mapping, Sequence
import json
import os
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from obc_ros.cli.gallery_entries.page import error, markup, number, plain_text  # knows no ROS
from reference import table

Record = Mapping[str, Any]


class Gallery(Directive):
    """The entries of a file, or how to make it."""

    required_arguments = 1
    root = Path()

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        env = self.state.document.settings.env
        env.note_reread()
        file = self.root / self.arguments[0]
        if not file.is_file():
            return [nodes.paragraph('', 'Not built yet: run `obc gallery`, then `make docs`.')]
        records = json.loads(file.read_text(encoding='utf-8'))['entries']
        figures = os.path.relpath(file.parent, env.srcdir)
        return [_summary(records), *(_section(record, figures) for record in records)]


def _summary(records: Sequence[Record]) -> nodes.paragraph:
    held = sum(record['holds'] for record in records)
    rows = sum(row['values'] for record in records for row in record['rows'])
    return nodes.paragraph(
        '', f'{rows} numbers are compared. All of them are within their tolerances in {held} of '
        f'{len(records)} entries.')


def _section(record: Record, figures: str) -> nodes.section:
    section = nodes.section(ids=[nodes.make_id(f'entry-{record["name"]}')],
                            names=[f'entry {record["name"]}'])
    section += nodes.title('', f'{record["label"]}: {plain_text(record["title"])}')
    section += list(_body(record, figures))
    return section


def _body(record: Record, figures: str) -> Iterator[nodes.Node]:
    yield nodes.paragraph('', '', nodes.emphasis('', '', _html(markup(record['source']))))
    yield from map(_paragraph, record['statement'])
    if record['erratum']:
        yield nodes.admonition(
            '', nodes.title('', 'Erratum'),
            *map(_paragraph, filter(None, (record['erratum'], record['finding']))))
    if record['message']:
        yield nodes.paragraph('', record['message'])
    if record['figure']:
        yield nodes.image(uri=f'{figures}/{record["figure"]}', classes=['figure'],
                          alt=f'Figure of {record["label"]}: {plain_text(record["title"])}')
    yield from map(_paragraph, record['notes'])
    if record['rows']:
        yield table(
            ('quantity', 'result', 'reference', 'error', 'source of the reference'),
            (34, 17, 17, 10, 22), [tuple(map(_html, _cells(row))) for row in record['rows']])
    for command in record['commands']:
        yield nodes.literal_block('', command, language='text')


def _cells(row: Record) -> tuple[str, ...]:
    many = f' ({row["values"]} values)' if row['values'] > 1 else ''
    relative = ' (relative)' if row.get('relative') else ''
    numbers = (number(row['measured']), number(row['exact']), error(row['error']) + relative)
    return (markup(row['what'] + many), *(f'<span class="number">{each}</span>'
                                          for each in numbers), markup(row['by']))


def _paragraph(text: str) -> nodes.paragraph:
    return nodes.paragraph('', '', _html(markup(text)))


def _html(text: str) -> nodes.raw:
    return nodes.raw('', text, format='html')


def setup(app: Any, root: Path) -> None:
    """Add the directive; it reads below `root`."""
    app.add_directive('gallery', type('Gallery', (Gallery,), {'root': root}))
