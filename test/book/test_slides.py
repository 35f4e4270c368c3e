# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Slides of the figures of a gallery."""

from base64 import b64decode
from html.parser import HTMLParser
import json
import re

from obc_ros.cli.obc import main
import pytest

PIXEL = b64decode('iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwAD'
                  'hgGAWjR9awAAAABJRU5ErkJggg==')


class SlideReader(HTMLParser):
    """Collects images, links, headings and the tags that are open."""

    def __init__(self):
        super().__init__()
        self.images, self.links, self.open, self.titles = [], [], [], []

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.links += [given[key] for key in ('href', 'src') if key in given and tag != 'img']
        if tag == 'img':
            self.images.append(given)
        elif tag != 'meta':
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and 'h2' in self.open:
            self.titles.append(data)


@pytest.fixture
def gallery(tmp_path):
    """Return a folder as `obc gallery` writes it, with two entries and three figures."""
    entries = [
        {'name': 'example-2.3', 'label': 'Example 2.3', 'title': 'Bang <bang> $x_1$',
         'source': 'p. 5', 'statement': ['Minimise $T$ & more.', 'From $x_0$.'],
         'erratum': 'Printed: $u^2$.', 'notes': ['Above: <u>.'],
         'figures': ['2.3.png', '2.3-more.png']},
        {'name': 'example-2.5', 'label': 'Example 2.5', 'title': 'Aircraft', 'source': 'p. 9',
         'statement': ['Hover.'], 'erratum': '', 'notes': ['x' * 2000], 'figures': ['2.5.png']}]
    (tmp_path / 'gallery.json').write_text(json.dumps({'entries': entries}))
    for entry in entries:
        for figure in entry['figures']:
            (tmp_path / figure).write_bytes(PIXEL)
    return tmp_path


def read(folder):
    parsed = SlideReader()
    parsed.feed((folder / 'slides.html').read_text(encoding='utf-8'))
    assert not parsed.open
    return parsed


def test_each_figure_is_a_slide_without_external_resources(gallery, capsys):
    assert main(['gallery', '--slides', '--out', str(gallery)]) == 0
    assert capsys.readouterr().out == f'{gallery / "slides.html"}\n'
    parsed = read(gallery)
    assert len(parsed.images) == 3
    for image in parsed.images:
        head, _, data = image['src'].partition(',')
        assert head == 'data:image/png;base64'
        assert b64decode(data) == PIXEL
    assert parsed.images[0]['alt'] == 'Figure of Example 2.3: Bang <bang> x_1'
    assert ''.join(parsed.titles).startswith('Example 2.3: Bang <bang> x1')
    assert not parsed.links
    text = (gallery / 'slides.html').read_text(encoding='utf-8')
    assert not re.search(r'https?:|@import|url\(', text)
    for key in ('ArrowRight', 'PageDown', 'ArrowLeft', '@media print'):
        assert key in text


def test_a_slide_has_statement_erratum_and_caption(gallery):
    assert main(['gallery', '--slides', '--out', str(gallery)]) == 0
    first, second, third = (gallery / 'slides.html').read_text(encoding='utf-8').split(
        '<section>')[1:]
    for slide in (first, second):
        assert '<p>Minimise <i>T</i> &amp; more.</p>\n<p>From <i>x</i><sub>0</sub>.</p>' in slide
        assert '<b>Erratum.</b> Printed: <i>u</i><sup>2</sup>.' in slide
        assert '<p class="caption">Above: &lt;u&gt;.</p>' in slide
        assert 'class="words"' in slide
    assert 'Erratum' not in third
    assert 'class="words long"' in third


@pytest.mark.parametrize('name', ['example-2.5', '2.5'])
def test_entries_are_chosen_by_name(gallery, name):
    assert main(['gallery', name, '--slides', '--out', str(gallery)]) == 0
    assert [image['alt'] for image in read(gallery).images] == ['Figure of Example 2.5: Aircraft']


@pytest.mark.parametrize('content', ['', '[]', '{"entries": [{}]}', '{"entries": 3}', '{'])
def test_results_of_another_format_are_refused(tmp_path, capsys, content):
    (tmp_path / 'gallery.json').write_text(content)
    assert main(['gallery', '--slides', '--out', str(tmp_path)]) == 1
    assert 'gallery.json is not of obc gallery' in capsys.readouterr().err


def test_without_results_of_the_folder_those_of_the_package_are_shown(tmp_path):
    assert main(['gallery', 'example-2.5', '--slides', '--out', str(tmp_path / 'new')]) == 0
    assert len(read(tmp_path / 'new').images) == 3


def test_without_a_figure_the_way_to_it_is_said(capsys, gallery):
    assert main(['gallery', 'exercise-2.9', '--slides', '--out', str(gallery)]) == 1
    assert 'has no figures of these entries' in capsys.readouterr().err
    (gallery / '2.5.png').unlink()
    assert main(['gallery', '--slides', '--out', str(gallery)]) == 1
    assert '2.5.png: No such file' in capsys.readouterr().err
