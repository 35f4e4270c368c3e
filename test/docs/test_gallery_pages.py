# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The committed pages of the gallery: one for each entry, the book's in its order."""

from pathlib import Path
import re
import shlex
import subprocess

from obc_ros.book import records
from obc_ros.book.chapter.all import ENTRIES
from obc_ros.book.entry import GalleryEntry, TOLERANCE
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
ROW = re.compile(r'^\| (.*) \| (\S+) \| (\S+) \| (\S+)( \(relative\))? \| (.*) \|$', re.MULTILINE)


def read(entry: GalleryEntry) -> str:
    """Return the text of the page of an entry."""
    return (PAGES / f'{entry.name}.md').read_text(encoding='utf-8')


def test_each_entry_has_exactly_one_page_and_the_figures_on_it() -> None:
    figures = [name for entry in ENTRIES for name in find_figures(entry)]
    assert {path.name for path in PAGES.iterdir()} == {
        *(f'{name}.md' for name in NAMES), *figures}
    assert len(figures) == len(set(figures)) >= len(ENTRIES)


def find_figures(entry: GalleryEntry) -> list[str]:
    """Return the files of the figures on the page of an entry."""
    return re.findall(r'^!\[Figure of .*\]\((.*)\)$', read(entry), re.MULTILINE)


def test_the_index_has_the_order_of_the_book() -> None:
    text = (DOCS / 'gallery.md').read_text(encoding='utf-8')
    assert re.findall(r'\]\(gallery/(.*)\.md\)', text) == NAMES
    found = re.findall(r'^(\d+)\. \[(.*)\]', text, re.MULTILINE)
    assert found == [(str(number), records.label(name))
                     for number, name in enumerate(NAMES, start=1)]


@EACH_ENTRY
def test_a_page_has_the_title_and_figure_of_its_entry(entry: GalleryEntry) -> None:
    text = read(entry)
    name = f'{records.label(entry.name)}: {strip_markup(entry.title)}'
    assert text.startswith(f'# {name}\n')
    assert f'![Figure of {name}]({entry.name}.png)' in text
    assert f'`obc gallery {entry.name}`' in text
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
    """The error is recomputed from the ten digits that the page shows."""
    text = read(entry)
    heading, *rows = ROW.findall(text)
    assert heading[:2] == ('quantity', 'result')
    assert 1 + len(rows) == len(re.findall(r'^\| ', text, re.MULTILINE)) > 1
    for what, answer, reference, error, relative, source in rows:
        assert what
        assert source
        measured, exact = float(answer), float(reference)
        scale = abs(exact) if relative else max(1.0, abs(exact))
        assert abs(measured - exact) <= (float(error) + 1e-9) * 1.05 * scale, what
        assert float(error) <= TOLERANCE, what


@EACH_ENTRY
def test_the_commands_fit_the_interfaces(entry: GalleryEntry) -> None:
    block, = re.findall(r'^```text\n(.*?)^```$', read(entry), re.MULTILINE | re.DOTALL)
    commands = [shlex.split(line) for line in block.splitlines() if not line.startswith('#')]
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
