# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The committed pages of the gallery: one for each entry, in the order of the book."""

import importlib
import json
from pathlib import Path
import re
import shlex
import subprocess

from obc_ros.book import records
from obc_ros.book.chapter.all import ENTRIES
from obc_ros.book.entry import GalleryEntry, TOLERANCE
from obc_ros.book.kept import read_kept
from obc_ros.book.page import strip_markup
from obc_ros.cli.obc import parse
from obc_ros.cli.ros2.yaml_messages import fill, find_type
from obc_ros.cli.ros2.yaml_messages import parse_values as parse_yaml
from PIL import Image
import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / 'docs'
PAGES = DOCS / 'gallery'
NAMES = [entry.name for entry in ENTRIES]
EACH_ENTRY = pytest.mark.parametrize('entry', ENTRIES, ids=lambda entry: entry.name)
KEPT = read_kept()


@pytest.fixture(scope='module')
def keeper():
    """Return the module docs/keep_gallery.py, which writes the pages."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS))
        yield importlib.import_module('keep_gallery')


def read(entry: GalleryEntry) -> str:
    """Return the text of the page of an entry."""
    return (PAGES / f'{entry.name}.md').read_text(encoding='utf-8')


def test_each_entry_has_exactly_one_page_and_the_figures_on_it() -> None:
    figures = [name for entry in ENTRIES for name in find_figures(entry)]
    assert {path.name for path in PAGES.iterdir()} == {'gallery.json', 'small', *figures, *(
        f'{name}.{ending}' for name in NAMES for ending in ('md', 'py', 'ipynb'))}
    assert {path.name for path in (PAGES / 'small').iterdir()} == {f'{name}.png' for name in NAMES}
    assert len(figures) == len(set(figures)) >= len(ENTRIES)


@EACH_ENTRY
def test_the_kept_results_are_those_of_the_entry(entry: GalleryEntry, keeper) -> None:
    """The texts of the source are those of the page and of the wheels."""
    kept = KEPT[entry.name]
    assert kept['statement'] == list(entry.statement)
    assert (kept['title'], kept['source'], kept['erratum']) == (
        entry.title, entry.source, entry.erratum)
    assert read(entry) == '\n\n'.join(keeper.sections(kept)) + '\n'
    notebook = json.loads((PAGES / f'{entry.name}.ipynb').read_text(encoding='utf-8'))
    assert notebook == keeper.build_notebook(kept)


def test_the_kept_results_are_in_the_order_of_the_book() -> None:
    assert list(KEPT) == NAMES


def find_figures(entry: GalleryEntry) -> list[str]:
    """Return the files of the figures on the page of an entry."""
    return re.findall(r'^!\[Figure of .*\]\((.*)\)$', read(entry), re.MULTILINE)


def test_the_index_has_the_order_of_the_book() -> None:
    text = (DOCS / 'gallery.md').read_text(encoding='utf-8')
    found = re.findall(r'^\| \[!\[(.*?)\]\(gallery/small/(.*?)\.png\)\]\(gallery/(.*?)\.md\) '
                       r'\| \[(.*?)\]\(gallery/(.*?)\.md\) ', text, re.MULTILINE)
    labels = [records.label(name) for name in NAMES]
    assert found == [(label, name, name, label, name)
                     for label, name in zip(labels, NAMES, strict=True)]


@EACH_ENTRY
def test_a_page_has_the_title_and_figure_of_its_entry(entry: GalleryEntry) -> None:
    text = read(entry)
    name = f'{records.label(entry.name)}: {strip_markup(entry.title)}'
    assert text.startswith(f'# {name}\n')
    assert f'![Figure of {name}]({entry.name}.png)' in text
    assert f'`obc gallery {entry.name}`' in text
    assert text.count('<details>') == text.count('</details>') == 2
    assert text.index('```python') < text.index('| asked |') < text.index('![Figure')
    assert ('## Errata of the book' in text) == bool(entry.erratum)


@EACH_ENTRY
def test_a_page_names_a_commit_of_this_repository(entry: GalleryEntry) -> None:
    commit, = re.findall(r'Computed at commit\s`([0-9a-f]{10})`', read(entry))
    shallow = subprocess.run(['git', 'rev-parse', '--is-shallow-repository'], cwd=ROOT,
                             capture_output=True, text=True, check=False).stdout.strip()
    if shallow == 'false':  # an archive or a shallow clone lacks the commit
        subprocess.run(['git', 'merge-base', '--is-ancestor', commit, 'HEAD'], cwd=ROOT,
                       check=True)


@EACH_ENTRY
def test_the_numbers_agree_with_their_references(entry: GalleryEntry) -> None:
    """The error is recomputed from the value that has the largest one."""
    rows = KEPT[entry.name]['rows']
    assert rows
    for row in rows:
        assert row['what']
        assert row['by']
        scale = abs(row['exact']) if row['relative'] else max(1.0, abs(row['exact']))
        assert abs(row['measured'] - row['exact']) / scale == pytest.approx(row['error'])
        assert row['error'] <= TOLERANCE, row['what']


@EACH_ENTRY
def test_the_commands_fit_the_interfaces(entry: GalleryEntry) -> None:
    commands = [shlex.split(line) for line in KEPT[entry.name]['commands']
                if not line.startswith('#')]
    assert commands
    for first, *words in commands:
        assert first == 'ros2'
        args = parse(words)
        if args.command == 'service':
            request = find_type(args.service_type, 'srv').Request()
            fill(request, parse_yaml(args.values))


@EACH_ENTRY
def test_a_figure_has_high_resolution_and_a_small_file(entry: GalleryEntry) -> None:
    for path in map(PAGES.joinpath, find_figures(entry)):
        with Image.open(path) as figure:
            assert figure.width >= 1600
        assert path.stat().st_size < 200_000
    with Image.open(PAGES / 'small' / f'{entry.name}.png') as thumbnail:
        assert thumbnail.width == 200


def test_each_derivation_is_linked_from_the_page_of_its_entry() -> None:
    order = re.findall(r'\]\(derivations/(.*)\.md\)', (DOCS / 'derivations.md').read_text('utf-8'))
    texts = {f'{stem}.md': (DOCS / 'derivations' / f'{stem}.md').read_text('utf-8')
             for stem in order}
    assert {path.name for path in (DOCS / 'derivations').iterdir()} == texts.keys()
    places = {heading: page for page, text in texts.items()
              for heading in re.findall(r'^## (.*)$', text, re.MULTILINE)}
    entries = {records.label(entry.name): entry for entry in ENTRIES}
    assert list(places) == [label for label in entries if label in places]  # in the same order
    assert set(entries) - places.keys() == {'Example 2.5'}  # flown, nothing to derive
    targets = {heading: f'{page}#{heading.lower().replace(".", "").replace(" ", "-")}'
               for heading, page in places.items()}
    assert {target for text in texts.values()
            for target in re.findall(r'\]\((\w+\.md#.*?)\)', text)} <= {*targets.values()}
    for heading, target in targets.items():
        assert re.findall(r'\]\(\.\./derivations/(\S+)\)', read(entries[heading])) == [target]
