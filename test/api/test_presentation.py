# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures for users: pyplot has them, they are shown once, and axes of the user are drawn into."""

import io
import subprocess
import sys

from matplotlib import pyplot as plt
from matplotlib.backends.backend_agg import FigureCanvasAgg
import nbclient
import nbformat
import numpy as np
import obc_ros as obc
from obc_ros.api.answer import draw_answer, draw_answer_search
from obc_ros.core.text.errors import ObcError
import pytest

MASS = obc.System(name='mass', states=['p', 'v'], inputs=['F'], dynamics={'p': 'v', 'v': 'F'})
T = np.linspace(0, 3, 31)


@pytest.fixture(name='found')
def _found():
    yield obc.simulate(MASS, [1.0], [0, 0], T)
    plt.close('all')


@pytest.fixture(name='shown')
def _shown(monkeypatch):
    """Let matplotlib believe that it has windows, and count how often they are shown."""
    shown = []
    plt.close('all')   # figures of other tests
    plt.switch_backend('agg')
    monkeypatch.setattr(FigureCanvasAgg, 'required_interactive_framework', 'tk')
    monkeypatch.setattr(plt, 'show', lambda: shown.append(plt.get_fignums()))
    return shown


@pytest.fixture(name='answer')
def _answer():
    yield obc.solve(states=['p', 'v'], inputs=['u'], dynamics={'p': 'v', 'v': 'u'},
                    running_cost='u**2', initial_state={'p': 0, 'v': 0},
                    terminal_constraints=['p - 1', 'v'], final_time={'free': False, 'value': 1})
    plt.close('all')


def test_a_script_shows_a_new_figure(found, shown):
    figure = found.plot()
    assert shown == [[figure.number]]


def test_a_figure_is_shown_or_not_on_demand(found, shown):
    figure = found.plot(show=False)
    figure.savefig(io.BytesIO())
    assert not plt.get_fignums() and not shown
    found.plot(show=True)
    assert len(shown) == 1


def test_without_windows_pyplot_has_the_figure_and_nothing_is_shown(found, recwarn):
    figure = found.plot()
    assert plt.gcf() is figure
    assert not recwarn.list   # pyplot.show would warn


def test_commands_draw_without_pyplot(answer):
    before = plt.get_fignums()
    assert draw_answer(answer).axes and draw_answer_search(answer).axes
    assert plt.get_fignums() == before
    code = ('import sys, matplotlib.figure, obc_ros.api.figures.path as path\n'
            'path.new_figure(2.0).subplots().plot([0, 1])\n'
            'assert "matplotlib.pyplot" not in sys.modules')
    assert subprocess.run([sys.executable, '-c', code], timeout=60).returncode == 0


@pytest.mark.slow
def test_axes_of_the_user_take_the_first_panels(found, answer, shown):
    figure, axes = plt.subplots(2)
    assert found.plot(ax=axes) is figure
    assert answer.plot(ax=list(axes)) is figure   # both in the same panels
    assert [place.get_ylabel() for place in axes] == ['states', 'inputs']
    assert [len(place.lines) >= 2 for place in axes] == [True, True]
    assert figure.axes == list(axes) and figure.get_suptitle() == ''
    assert not shown   # the user may draw more
    answer.plot(ax=axes[0], show=True)
    assert len(shown) == 1


@pytest.mark.slow
def test_a_part_of_a_figure_takes_all_panels(answer):
    whole = plt.figure(layout='constrained')
    left, right = whole.subfigures(1, 2)
    assert answer.plot(ax=left) is whole and answer.plot_search(ax=right) is whole
    alone = answer.plot(show=False)
    assert [place.get_ylabel() for place in left.axes] == [
        place.get_ylabel() for place in alone.axes]
    assert left.get_suptitle() == alone.get_suptitle()
    assert [place.get_ylabel() for place in right.axes] == ['cost']
    whole.savefig(io.BytesIO())


@pytest.mark.parametrize(('ax', 'said'), [
    (3, "ax: wanted Axes of matplotlib, .* found int '3'"), ([], 'found an empty list')])
def test_other_places_are_refused_in_words(found, ax, said):
    with pytest.raises(ObcError, match=said):
        found.plot(ax=ax)


def test_more_axes_than_panels_are_refused_in_words(found):
    _, axes = plt.subplots(3)
    with pytest.raises(ObcError, match='ax: 3 Axes, but the figure has 2 panels'):
        found.plot(ax=axes)


@pytest.mark.notebook
@pytest.mark.slow
@pytest.mark.parametrize(('lines', 'figures'), [
    ('found.plot()', 1), ('found.plot(); print()', 1), ('found.plot(show=True)', 1),
    ('found.plot(show=False); print()', 0), ('found.plot(show=False)', 1)])
def test_a_notebook_shows_a_figure_once(lines, figures):
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(
        'import numpy as np\nimport obc_ros as obc\n'
        "mass = obc.System(states=['p'], inputs=['F'], dynamics={'p': 'F'})\n"
        f'found = obc.simulate(mass, [1.0], [0], [0, 1])\n{lines}')])
    nbclient.NotebookClient(book, kernel_name='python3', timeout=120).execute()
    outputs = book.cells[0].outputs
    assert sum('image/png' in each.get('data', {}) for each in outputs) == figures
