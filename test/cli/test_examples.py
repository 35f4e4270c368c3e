# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `obc examples`, and examples in place of files."""

import math

from obc_ros.cli import examples
from obc_ros.cli.obc import main
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.text.example_files import find_example, list_examples
import pytest
import yaml

CATEGORIES = {'time-optimal', 'singular', 'state-constraint', 'calculus-of-variations',
              'bang-bang', 'linear-quadratic', 'nonlinear'}


def test_every_example_says_what_it_is_and_where_it_is_from():
    known = [examples.read_example(name) for name in list_examples()]
    assert len(known) > 100
    for each in known:
        assert each.title
        assert len(each.source) > 9, each.name
        assert each.category in CATEGORIES, each.name
        assert math.isfinite(each.cost), each.name
        [statement] = load_file(find_example(each.name))
        assert statement['name'] == each.name
        assert build_problem(statement).states


def test_the_list_has_every_example(capsys):
    assert main(['examples']) == 0
    output = capsys.readouterr().out
    for name in list_examples():
        assert f'\n{name} ' in output
    assert all(f'{category}:\n' in output for category in CATEGORIES)


@pytest.mark.parametrize('words, found', [
    (['ZERMELO'], ['zermelo_constant', 'zermelo_shear']),
    (['brachi', 'wall'], ['brachistochrone_wall']), (['Dido'], ['dido'])], ids=str)
def test_words_choose_from_the_list(capsys, words, found):
    assert main(['examples', '--long', *(part for word in words for part in (
        '--match', word))]) == 0
    output = capsys.readouterr().out
    assert [name for name in list_examples() if f'\n{name} ' in output] == found
    assert f'\n{len(found)} examples' in output


def test_a_word_that_nothing_has_is_said(capsys):
    assert main(['examples', '--match', 'unicorn']) == 2
    assert capsys.readouterr().err == "obc examples: none has 'unicorn'\n"


def test_a_printed_example_is_its_file(capsys):
    assert main(['examples', 'dido']) == 0
    output = capsys.readouterr().out
    assert output == find_example('dido').read_text(encoding='utf-8')
    assert yaml.safe_load(output)['name'] == 'dido'


def test_examples_are_copied_and_nothing_is_overwritten(tmp_path, capsys):
    (tmp_path / 'dido.yaml').write_text('mine')
    assert main(['examples', 'dido', 'fuller', '--copy', str(tmp_path)]) == 1
    told = capsys.readouterr()
    assert told.out == f'1 files copied to {tmp_path}\n'
    assert told.err == 'obc examples: kept, as they exist: dido\n'
    assert (tmp_path / 'dido.yaml').read_text() == 'mine'
    assert (tmp_path / 'fuller.yaml').read_bytes() == find_example('fuller').read_bytes()


def test_a_folder_that_cannot_be_written_is_an_error_in_words(tmp_path, capsys):
    (tmp_path / 'file').write_text('')
    assert main(['examples', 'dido', '--copy', str(tmp_path / 'file')]) == 1
    assert 'cannot be written' in capsys.readouterr().err


@pytest.mark.parametrize('name', ['didoo', '../dido', 'a\x1bb', ''])
def test_an_unknown_example_is_refused(capsys, name):
    assert main(['examples', name]) == 2
    told = capsys.readouterr().err
    assert told.startswith("obc examples: no example '")
    assert told.strip().isprintable()
    assert ("(did you mean 'dido'?)" in told) == (name in ('didoo', '../dido'))


@pytest.mark.slow
def test_an_example_is_solved_by_its_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(['solve', 'di_mintime_rest', '--json', '.']) == 0
    assert (tmp_path / 'di_mintime_rest.json').exists()
    row = capsys.readouterr().out.splitlines()[2]
    assert row.split()[:3] == ['di_mintime_rest', 'solved', '2']


def test_a_file_has_precedence_over_an_example(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'dido').write_text('- 1')
    assert main(['solve', 'dido']) == 2
    assert 'wanted a mapping' in capsys.readouterr().out


@pytest.mark.parametrize('given, words', [
    ('didoo', "(did you mean 'dido'?)"), ('min.yaml', "(did you mean 'mine.yaml'?)"),
    ('sub/dido', "(did you mean 'dido'?)"), ('qqqqqq', 'No such file or directory\n')])
def test_a_misspelt_file_has_a_suggestion(tmp_path, monkeypatch, capsys, given, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'mine.yaml').write_text('- 1')
    assert main(['solve', given]) == 2
    assert words in capsys.readouterr().out
