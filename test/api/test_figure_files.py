# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Files of figures: formats, embedded fonts, the same bytes each time."""

from matplotlib import colors
import numpy as np
from obc_ros.api.figures.files import FORMATS, parse_formats, save_figure
from obc_ros.api.figures.style import get_line, label_unit, LINE_COLOURS, new_figure
from obc_ros.core.text.errors import ObcError
import pytest


def draw():
    figure = new_figure(2.0)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], label=r'$\theta$ and text', **get_line(3))
    axes.legend()
    return figure


@pytest.mark.parametrize('text, formats', [
    ('png', ('png',)), ('pdf,svg', ('pdf', 'svg')), (' PDF , .svg,pdf', ('pdf', 'svg'))])
def test_formats_are_names_with_commas(text, formats):
    assert parse_formats(text) == formats


@pytest.mark.parametrize('text', ['', 'jpg', 'pdf,', 'png;svg', 'pdf\x1b[31m'])
def test_an_unknown_format_is_answered_in_words(text):
    with pytest.raises(ObcError, match='no format .*: wanted one or several of png') as found:
        parse_formats(text)
    assert '\x1b' not in str(found.value)


@pytest.mark.slow
def test_files_have_their_formats_and_the_same_bytes(tmp_path):
    first, second = (save_figure(draw(), tmp_path / name / 'exercise-2.6', FORMATS)
                     for name in ('a', 'b'))
    assert [path.name for path in first] == [f'exercise-2.6.{name}' for name in FORMATS]
    starts = {'png': b'\x89PNG', 'pdf': b'%PDF', 'svg': b'<?xml'}
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes().startswith(starts[one.suffix[1:]])
        assert one.read_bytes() == other.read_bytes()
    pdf, svg = first[1].read_bytes(), first[2].read_text(encoding='utf-8')
    assert b'/FontFile2' in pdf   # TrueType
    assert b'/Type3' not in pdf and b'CreationDate' not in pdf
    assert '<dc:date>' not in svg and '<text' not in svg


def test_a_folder_that_cannot_be_written_is_answered_in_words(tmp_path):
    (tmp_path / 'file').write_text('', encoding='utf-8')
    with pytest.raises(ObcError, match='cannot be written'):
        save_figure(draw(), tmp_path / 'file' / 'figure')


def test_seven_lines_differ_in_colour_and_in_dashes():
    lines = [get_line(index) for index in range(49)]
    assert len({line['color'] for line in lines[:7]}) == 7
    assert len({str(line['linestyle']) for line in lines[:7]}) == 7
    assert len({(line['color'], str(line['linestyle'])) for line in lines}) == 49


def test_colours_have_different_lightness_or_hue_for_deuteranopes():
    """Machado et al. 2009, severity 1; distances in CIELAB exceed 10 (just noticeable: 2.3)."""
    deuteranopia = np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                             [-0.011820, 0.042940, 0.968881]])
    rgb = np.array([colors.to_rgb(each) for each in LINE_COLOURS])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055)**2.4)
    seen = np.clip(linear @ deuteranopia.T, 0.0, 1.0)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722],
                       [0.0193, 0.1192, 0.9505]])
    ratio = seen @ to_xyz.T / to_xyz.sum(axis=1)
    f = np.where(ratio > 216 / 24389, np.cbrt(ratio), (24389 / 27 * ratio + 16) / 116)
    lab = np.column_stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]),
                           200 * (f[:, 1] - f[:, 2])])
    apart = np.linalg.norm(lab[:, None] - lab, axis=2)
    assert apart[~np.eye(len(lab), dtype=bool)].min() > 10.0


@pytest.mark.parametrize('unit, label', [
    ('m', 'speed [m]'), ('', 'speed'), ('m/s^2', 'speed [m/s$^{2}$]'),
    ('N**-1', 'speed [N$^{-1}$]'), ('$', r'speed [\$]')])
def test_units_are_in_brackets(unit, label):
    assert label_unit('speed', unit) == label
