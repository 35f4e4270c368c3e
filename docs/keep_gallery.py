# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Run the gallery, and keep the results in ``docs/gallery``, which the wheels have, too.

That is ``gallery.json`` and, of each entry, the figures, a thumbnail, a page in Markdown, and its
program as a notebook. The pages name the commit they were computed at, so the sources of the
package must be committed. Called by ``make gallery``::

    $ python docs/keep_gallery.py              # all entries
    $ python docs/keep_gallery.py example-2.5  # one of them
"""

from collections.abc import Iterable, Iterator, Mapping
import json
from pathlib import Path
import re
import subprocess
import sys
import textwrap
from typing import Any

from gallery_answers import evaluate, read_program, run_program
import numpy as np
from obc_ros.book.chapter.all import ENTRIES
from obc_ros.book.kept import OF_PROGRAM
from obc_ros.book.page import (
    ASKED,
    ERRORS,
    format_markup,
    list_asked,
    list_verified,
    strip_markup,
    summarize,
    VERIFIED,
)
from obc_ros.book.records import work_and_write
from PIL import Image

Record = Mapping[str, Any]

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / 'docs' / 'gallery'
DERIVATIONS = ROOT / 'docs' / 'derivations'
OUT = ROOT / 'out' / 'gallery'
SOURCES = ('obc_ros', 'msg', 'srv', 'action')
WIDTH = 118  # of a line of Markdown
BOOK = ' of R. M. Murray, Optimization-Based Control, chapter 2'
THUMBNAIL = 200   # [px] wide
COLOURS = 128  # of a figure; the files are a third of those in full colour
SERVER = 'In a first terminal, start the server with `ros2 run obc_ros trajectory_server`.'
NODES = 'Each `ros2 run` needs a terminal of its own.'
FILES = '`recordings` is in the folder that `obc gallery` writes, `out/gallery`.'


def main(names: list[str]) -> int:
    """Run the entries `names` (default: all), and keep their results."""
    if changed := _git('status', '--porcelain', '--', *SOURCES):
        print(f'keep_gallery: commit these changes first:\n{changed}', file=sys.stderr)
        return 2
    chosen = [entry for entry in ENTRIES if not names or entry.name in names]
    order = [entry.name for entry in ENTRIES]
    if status := work_and_write(chosen, OUT, order, ('png',)):
        return status
    computed = read(OUT / 'gallery.json')
    commit = _git('rev-parse', '--short=10', 'HEAD')
    keep({entry.name: {**computed[entry.name], 'commit': commit} for entry in chosen}, order)
    return 0


def read(path: Path) -> dict[str, dict[str, Any]]:
    """Return the records of a ``gallery.json`` by name."""
    return {each['name']: each for each in json.loads(path.read_text('utf-8'))['entries']}


def keep(computed: Mapping[str, Record], order: list[str]) -> None:
    """Write what is kept of the entries that were computed; keep the others."""
    (PAGES / 'small').mkdir(exist_ok=True)
    path = PAGES / 'gallery.json'
    kept = read(path) if path.exists() else {}
    for name, record in computed.items():
        kept[name] = {**record, 'seconds': round(record['seconds'], 1), **ask_program(name)}
        for stale in PAGES.glob(f'{name}-*.png'):
            stale.unlink()
        for figure in record['figures']:
            keep_figure(OUT / figure, PAGES / figure)
        keep_thumbnail(OUT / record['figures'][0], PAGES / 'small' / f'{name}.png')
        page = '\n\n'.join(sections(kept[name])) + '\n'
        (PAGES / f'{name}.md').write_text(page, encoding='utf-8')
        notebook = json.dumps(build_notebook(kept[name]), ensure_ascii=False, indent=1) + '\n'
        (PAGES / f'{name}.ipynb').write_text(notebook, encoding='utf-8')
    entries = [kept[name] for name in order if name in kept]
    path.write_text(json.dumps({'entries': entries}, ensure_ascii=False, indent=1) + '\n',
                    encoding='utf-8')


def ask_program(name: str) -> dict[str, Any]:
    """Return the program of an entry, what it prints, and what is asked, with references."""
    names, printed = run_program(name)
    asked = [{'what': each.what, 'value': value.tolist(),
              'exact': np.asarray(each.exact, dtype=float).tolist(), 'by': each.by}
             for each, value in evaluate(name, names)]
    return dict(zip(OF_PROGRAM, (read_program(name), printed, asked), strict=True))


def build_notebook(record: Record) -> dict[str, Any]:
    """Return the program of an entry as a notebook (nbformat 4.5)."""
    heading = f'# {record["label"]}: {strip_markup(record["title"])}'
    cells = [('markdown', '\n\n'.join([heading, *map(format_markup, record['statement'])]), {}),
             ('code', record['program'].rstrip(), {'execution_count': None, 'outputs': []})]
    return {'cells': [{'cell_type': kind, 'id': kind, 'metadata': {},
                       'source': text.splitlines(keepends=True), **more}
                      for kind, text, more in cells],
            'metadata': {'language_info': {'name': 'python'}}, 'nbformat': 4, 'nbformat_minor': 5}


def _git(*words: str) -> str:
    return subprocess.check_output(['git', *words], cwd=ROOT, text=True).strip()


def keep_figure(source: Path, target: Path) -> None:
    """Write a figure with a palette in place of full colour."""
    with Image.open(source) as figure:
        figure.convert('RGB').quantize(COLOURS, dither=Image.Dither.NONE).save(
            target, optimize=True)


def keep_thumbnail(source: Path, target: Path) -> None:
    """Write a figure in the width of a thumbnail."""
    with Image.open(source) as figure:
        height = round(figure.height * THUMBNAIL / figure.width)
        figure.convert('RGB').resize((THUMBNAIL, height), Image.Resampling.LANCZOS).quantize(
            COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)


def sections(record: Record) -> Iterator[str]:
    """Yield the parts of the page of an entry."""
    name = f'{record["label"]}: {strip_markup(record["title"])}'
    yield f'# {name}'
    yield paragraph(record['source'] + (f'{BOOK}.' if record['in_book'] else '.'))
    yield from map(paragraph, record['statement'])
    stem = record['name']
    yield f'```python\n{record["program"]}```'
    yield f'It prints:\n\n```text\n{record["output"]}```'
    yield f'Download: [Python]({stem}.py), [notebook]({stem}.ipynb). It needs the library only.'
    yield table(ASKED, map(list_asked, record['asked']))
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
    yield '## Verification'
    yield from fold(summarize(record), paragraph(ERRORS),
                    table(VERIFIED, map(list_verified, record['rows'])))
    yield from fold('Commands of ROS 2', *_list_commands(record))
    yield (f'Computed at commit `{record["commit"]}`. The [gallery](../gallery.md) lists all '
           'entries.')


def _list_commands(record: Record) -> Iterator[str]:
    yield (f'With ROS 2, `obc gallery {record["name"]}` computes this page anew. The same '
           'requests with `ros2`:')
    text = '\n'.join(record['commands'])
    yield f'```text\n{text}\n```'
    notes = ((SERVER, '/trajectory_server/' in text), (NODES, 'ros2 run ' in text),
             (FILES, '$(cat recordings/' in text))
    yield paragraph(' '.join([
        *(note for note, wanted in notes if wanted),
        'Without a ROS 2 installation, write `obc` in place of `ros2`.']))


def fold(heading: str, *parts: str) -> Iterator[str]:
    """Yield parts that open with a click on their heading."""
    yield f'<details><summary>{heading}</summary>'
    yield from parts
    yield '</details>'


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table of Markdown; the cells are in the markup of the gallery."""
    lines = [list(head), ['---'] * len(list(head)), *(map(markdown, row) for row in rows)]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def find_derivation(heading: str) -> Path | None:
    """Return the page of the derivations that has a section of this name."""
    return next((page for page in DERIVATIONS.glob('*.md')
                 if f'\n## {heading}\n' in page.read_text(encoding='utf-8')), None)


def anchor(heading: str) -> str:
    """Return the address of a heading within its page, as GitHub and MyST make it."""
    return re.sub(r'[^\w -]', '', heading.lower()).replace(' ', '-')


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
