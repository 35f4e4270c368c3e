# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Options of the search: how they are read, and that the search follows them."""

from dataclasses import replace
from pathlib import Path

from obc_ros.core.solver.options import DEFAULTS, list_options, Options, read_options
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import StatementError
import problems
import pytest

TEST = Path(__file__).resolve().parents[2]


def write(value):
    """Return a value as a user writes it."""
    return ','.join(map(repr, value)) if isinstance(value, tuple) else repr(value)


def test_every_option_has_its_own_name_and_a_meaning_in_one_sentence():
    listed = list(list_options())
    for each in ('name', 'meaning'):
        assert len({getattr(option, each) for option in listed}) == len(listed)
    assert all(each.name.count('.') == 1 for each in listed)
    for meaning in (each.meaning for each in listed):
        assert meaning[0].isupper() and meaning.endswith('.') and ';' not in meaning, meaning
        assert '. ' not in meaning, meaning


def test_the_provenance_of_an_option_is_a_problem_or_a_test():
    folders = TEST.parent / 'obc_ros' / 'examples', TEST / 'collections'
    known = {path.stem for folder in folders for path in folder.rglob('*.yaml')} | {
        path.name for path in (TEST / 'core').rglob('test_*.py')}
    assert [each.name for each in list_options() if each.needed_by not in known] == []


def test_defaults_read_back_are_the_defaults():
    assert read_options(f'{each.name}={write(each.value)}' for each in list_options()) == DEFAULTS


@pytest.mark.parametrize(('given', 'group', 'field', 'value'), [
    ('multistart.most=20', 'multistart', 'most', 20),
    (' coarse.rough = 1e-3 ', 'coarse', 'rough', 1e-3),
    ('boundary.gaps=0.1, 0.02', 'boundary', 'gaps', (0.1, 0.02)),
    ('boundary.finer=3', 'boundary', 'finer', (3,))])
def test_one_option_changes(given, group, field, value):
    changed = read_options([given])
    assert getattr(getattr(changed, group), field) == value
    restored = replace(changed, **{group: getattr(DEFAULTS, group)})
    assert restored == DEFAULTS


@pytest.mark.parametrize(('given', 'words'), [
    ('multistart.most', 'wanted NAME=VALUE'),
    ('multistart.mots=3', "did you mean 'multistart.most'"),
    ('multistart=3', 'is unknown'),
    ('', 'wanted NAME=VALUE'),
    ('multistart.most=many', 'wanted a whole number'),
    ('multistart.most=2.5', 'wanted a whole number'),
    ('multistart.most=-1', 'not negative'),
    ('coarse.rough=nan', 'not negative'),
    ('coarse.intervals=0', 'wanted a whole number of at least 1'),
    ('rollouts.pieces=0', 'wanted a whole number of at least 1'),
    ('windows.ratio=0.5', 'wanted a number from 1.01 to 100'),
    ('bangs.vanishing=2', 'wanted a number from 0 to 1'),
    ('boundary.gaps=0.1,2', 'wanted a number from 0 to 1'),
    ('coarse.rough=inf', 'not negative'),
    ('boundary.gaps=0.1,', 'wanted a number'),
    ('__class__.x=1', 'is unknown'),
    ('coarse.rough=\x1b[31m', r'\x1b')])
def test_a_wrong_option_is_refused_in_words(given, words):
    with pytest.raises(StatementError) as refused:
        read_options([given])
    assert str(refused.value).startswith('option: ')
    assert words in str(refused.value)


@pytest.mark.slow
def test_multistart_obeys_its_maximum():
    """Without further starts the descent from a hump ends in the nearer, higher minimum."""
    problem = problems.build('downhill_from_a_hump')
    few = solve(problem, options=read_options(['multistart.most=0']))
    assert 'multistart' in {attempt.method for attempt in few.attempts}
    assert few.objective > solve(problem).objective + 0.1


@pytest.mark.slow
def test_programs_are_not_shared_between_options():
    cache, problem = Cache(), problems.build('brachistochrone')
    first = solve(problem, cache=cache)
    coarse = solve(problem, cache=cache, options=read_options(['coarse.intervals=8']))
    assert coarse.certified
    assert coarse.objective == pytest.approx(first.objective, rel=1e-5)
    meshes = [{attempt.what for attempt in found.attempts if attempt.method == 'collocation'}
              for found in (first, coarse)]
    assert any(mesh.startswith('8 intervals') for mesh in meshes[1])
    assert not any(mesh.startswith('8 intervals') for mesh in meshes[0])


def test_options_are_compared_by_value():
    assert Options() == DEFAULTS
    assert read_options(['coarse.starts=2']) != DEFAULTS
