# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The notebooks: they run, each checks its closed forms, and no result is kept in the files."""

from importlib import util
from pathlib import Path
import re

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / 'notebooks').glob('*.ipynb'))
CHECK = 'np.testing.assert_allclose('


def load_runner():
    """Return the module that `make docs` runs the notebooks with."""
    spec = util.spec_from_file_location('run_notebooks', ROOT / 'docs' / 'run_notebooks.py')
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read(path):
    return nbformat.read(path, as_version=4)


def test_the_notebooks_follow_the_chapter():
    assert [path.stem[:3] for path in NOTEBOOKS] == [f'{k:02}_' for k in range(1, 13)]


@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_keeps_no_result(path):
    notebook = read(path)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == 'code']
    assert not any(cell.outputs or cell.execution_count for cell in code)
    assert notebook.metadata.keys() == {'kernelspec', 'language_info'}


@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_has_an_exercise_with_a_checked_answer(path):
    cells = read(path).cells
    exercise = next(k for k, cell in enumerate(cells) if '## Exercise' in cell.source)
    before, after = cells[:exercise], cells[exercise:]
    for part in (before, after):
        assert any(CHECK in cell.source for cell in part if cell.cell_type == 'code')


@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.stem)
def test_the_solutions_are_folded(path):
    cells = read(path).cells
    exercise = next(k for k, cell in enumerate(cells) if '## Exercise' in cell.source)
    for cell in cells[:exercise]:
        assert not cell.metadata and '<details>' not in cell.source
    solved = 0
    for cell in cells[exercise:]:
        if cell.cell_type == 'markdown':
            answer = cell.source.startswith('<details><summary>Answer</summary>\n\n')
            assert answer == cell.source.endswith('\n\n</details>')
            assert answer != cell.source.startswith(('## Exercise', '(b) ', 'Plot '))
            solved += answer
        elif CHECK in cell.source:
            assert cell.metadata == {'jupyter': {'source_hidden': True}, 'tags': ['hide-input']}
    assert solved >= 1


def test_every_exercise_of_the_chapter_has_a_notebook():
    titles = ' '.join(cell.source for path in NOTEBOOKS for cell in read(path).cells
                      if cell.cell_type == 'markdown')
    for number in range(1, 11):
        assert re.search(rf'Exercises?( 2\.\d+,)* (2\.\d+ and )?2\.{number}\b', titles)


@pytest.mark.notebook
@pytest.mark.slow
@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path):
    cells = load_runner().run_notebook(path).cells
    shown = [output for cell in cells if cell.cell_type == 'code' for output in cell.outputs]
    assert any('image/png' in output.get('data', {}) for output in shown), 'there is a figure'
    assert not any(output.get('name') == 'stderr' for output in shown), 'there is no warning'


@pytest.mark.slow
def test_a_closed_form_that_does_not_hold_ends_the_run(tmp_path):
    notebook = read(NOTEBOOKS[2])
    cell = next(cell for cell in notebook.cells if 'answer.objective, 2.0' in cell.source)
    cell.source = cell.source.replace('answer.objective, 2.0', 'answer.objective, 2.1')
    nbformat.write(notebook, tmp_path / 'wrong.ipynb')
    with pytest.raises(Exception, match='AssertionError'):
        load_runner().run_notebook(tmp_path / 'wrong.ipynb')
