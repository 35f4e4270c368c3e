# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arguments of `obc gallery`: none is accepted without an effect."""

from obc_ros.cli.obc import main
import pytest

FILE = 'answers.yaml'


@pytest.mark.parametrize('arguments, words', [
    (['2.3', '--sheet', FILE], 'NAME has no effect with --sheet'),
    (['2.3', '2.5', '--check', FILE], 'NAME has no effect with --check'),
    *(([f'--{name}', *file, *more], f'{more[0]} has no effect with --{name}')
      for name, file in (('sheet', [FILE]), ('check', [FILE]), ('list', []))
      for more in (['--out', 'a'], ['--format', 'svg'])),
    (['--slides', '--format', 'svg'], '--format has no effect with --slides'),
    *((given, '--csv has no effect without --check')
      for given in (['--csv', 'a'], ['--slides', '--csv', 'a'], ['--sheet', FILE, '--csv', 'a']))],
    ids=str)
def test_an_argument_without_effect_is_refused(tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(['gallery', *arguments])
    assert left.value.code == 2
    told = capsys.readouterr()
    assert words in told.err
    assert told.out == ''
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('first', [['--list'], ['--sheet', FILE], ['--check', FILE],
                                   ['--slides']], ids=str)
@pytest.mark.parametrize('second', [['--list'], ['--sheet', FILE], ['--check', FILE],
                                    ['--slides']], ids=str)
def test_the_gallery_does_one_thing_at_a_time(tmp_path, monkeypatch, capsys, first, second):
    if first == second:
        return
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(['gallery', *first, *second])
    assert left.value.code == 2
    assert 'not allowed with' in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_names_choose_what_is_listed(capsys):
    assert main(['gallery', 'exercise-2.10', '2.3', '--list']) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        'example-2.3', 'exercise-2.10']
    assert main(['gallery', '--list']) == 0
    assert len(capsys.readouterr().out.splitlines()) > 20
