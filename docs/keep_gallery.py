# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Run the gallery and keep a page and a figure of each entry in ``docs/gallery``.

The pages are plain Markdown. They name the commit they were computed at, so the sources of the
package must be committed. Called by ``make gallery``::

    $ python docs/keep_gallery.py              # all entries
    $ python docs/keep_gallery.py example-2.5  # one of them
"""

from collections.abc import Iterator, Mapping
import json
from pathlib import Path
import re
import subprocess
import sys
import textwrap
from typing import Any

from obc_ros.book.chapter.all import ENTRIES
from obc_ros.book.page import ERRORS, format_markup, strip_markup
from PIL import Image

Record = Mapping[str, Any]

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / 'docs' / 'gallery'
DERIVATIONS = ROOT / 'docs' / 'derivations'
OUT = ROOT / 'out' / 'gallery'
SOURCES = ('obc_ros', 'msg', 'srv', 'action')
WIDTH = 118  # of a line of Markdown
BOOK = ' of R. M. Murray, Optimization-Based Control, chapter 2'
COLOURS = 128  # of a figure; the files are a third of those in full colour
SERVER = 'In a first terminal, start the server with `ros2 run obc_ros trajectory_server`.'
NODES = 'Each `ros2 run` needs a terminal of its own.'
FILES = '`recordings` is in the folder that `obc gallery` writes, `out/gallery`.'


def main(names: list[str]) -> int:
    """Run the entries `names` (default: all), and write their pages and figures."""
    if changed := _git('status', '--porcelain', '--', *SOURCES):
        print(f'keep_gallery: commit these changes first:\n{changed}', file=sys.stderr)
        return 2
    commit = _git('rev-parse', '--short=10', 'HEAD')
    obc = Path(sys.executable).with_name('obc')
    if status := subprocess.call([obc, 'gallery', *names, '--out', OUT]):
        return status
    records = {each['name']: each for each in json.loads(
        (OUT / 'gallery.json').read_text(encoding='utf-8'))['entries']}
    PAGES.mkdir(exist_ok=True)
    for entry in ENTRIES:
        if not names or entry.name in names:
            text = '\n\n'.join(sections(records[entry.name], commit)) + '\n'
            (PAGES / f'{entry.name}.md').write_text(text, encoding='utf-8')
            for stale in PAGES.glob(f'{entry.name}-*.png'):
                stale.unlink()
            for figure in records[entry.name]['figures']:
                keep_figure(OUT / figure, PAGES / figure)
    return 0


def _git(*words: str) -> str:
    return subprocess.check_output(['git', *words], cwd=ROOT, text=True).strip()


def keep_figure(source: Path, target: Path) -> None:
    """Write a figure with a palette in place of full colour."""
    with Image.open(source) as figure:
        figure.convert('RGB').quantize(COLOURS, dither=Image.Dither.NONE).save(
            target, optimize=True)


def sections(record: Record, commit: str) -> Iterator[str]:
    """Yield the parts of the page of an entry."""
    name = f'{record["label"]}: {strip_markup(record["title"])}'
    yield f'# {name}'
    yield paragraph(record['source'] + (f'{BOOK}.' if record['in_book'] else '.'))
    yield from map(paragraph, record['statement'])
    for figure in record['figures']:
        yield f'![Figure of {name}]({figure})'
    yield from map(paragraph, record['notes'])
    if page := find_derivation(record['label']):
        place = f'{page.name}#{anchor(record["label"])}'
        yield f'[Derivation](../derivations/{place}) of the formulas.'
    if record['erratum']:
        yield '## Errata of the book'
        yield from map(paragraph, filter(None, (record['erratum'], record['finding'])))
        yield 'All [errata of the book](../errata.md) are on one page.'
    yield '## Numbers'
    yield paragraph(f'{ERRORS} Computed at commit `{commit}`.')
    yield '\n'.join(['| quantity | result | reference | error | source of the reference |',
                     '|---|---:|---:|---:|---|', *map(_row, record['rows'])])
    yield '## Commands'
    yield f'`obc gallery {record["name"]}` computes this page. The same requests with `ros2`:'
    yield '\n'.join(['```text', *record['commands'], '```'])
    text = '\n'.join(record['commands'])
    notes = ((SERVER, '/trajectory_server/' in text), (NODES, 'ros2 run ' in text),
             (FILES, '$(cat recordings/' in text))
    yield paragraph(' '.join([
        *(note for note, wanted in notes if wanted),
        'Without a ROS 2 installation, write `obc` in place of `ros2`.']))
    yield 'The [gallery](../gallery.md) lists all entries.'


def find_derivation(heading: str) -> Path | None:
    """Return the page of the derivations that has a section of this name."""
    return next((page for page in DERIVATIONS.glob('*.md')
                 if f'\n## {heading}\n' in page.read_text(encoding='utf-8')), None)


def anchor(heading: str) -> str:
    """Return the address of a heading within its page, as GitHub and MyST make it."""
    return re.sub(r'[^\w -]', '', heading.lower()).replace(' ', '-')


def _row(row: Record) -> str:
    what = row['what'] + (f' ({row["values"]} values)' if row['values'] > 1 else '')
    error = (f'{row["error"]:.1e}' if row['error'] else '0') + (
        ' (relative)' if row['relative'] else '')
    return (f'| {markdown(what)} | {row["measured"]:.10g} | {row["exact"]:.10g} | {error} '
            f'| {markdown(row["by"])} |')


def paragraph(text: str) -> str:
    """Return a text as a paragraph of Markdown; no line of it begins a list or a heading."""
    lines = textwrap.wrap(markdown(text), WIDTH, break_long_words=False, break_on_hyphens=False)
    return '\n'.join(re.sub(r'^([-+#>=])', r'\\\1', re.sub(r'^(\d+)([.)] )', r'\1\\\2', line))
                     for line in lines)


def markdown(text: str) -> str:
    """Return a text in the markup of the gallery as Markdown, with its mathematics as HTML."""
    return ''.join(part if re.fullmatch('`[^`]*`', part) else
                   re.sub(r'([\\*_|\[\]~`])', r'\\\1', format_markup(part))
                   for part in re.split(r'(`[^`]*`)', text))


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
