# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Each figure of the documentation names its benchmark, commit and day, and its age is known."""

from pathlib import Path
import subprocess
import sys

import figures  # of benchmarks/
import pytest

FILES = {
    'pyproject.toml': '[project.scripts]\nserve = "obc_ros.serve:main"\n',
    'README.md': '',
    'obc_ros/core/gain.py': 'import obc_ros.core.sums\n',
    'obc_ros/core/sums.py': '',
    'obc_ros/serve.py': "WORKER = 'obc_ros.worker'\n",
    'obc_ros/worker.py': '',
    'benchmarks/gain.py': 'import _help\n',
    'benchmarks/_help.py': 'def run():\n    from obc_ros.core import gain\n',
    'benchmarks/serve.py': "start('serve')\n"}


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """Return a small repository with two benchmarks, one of which starts a command."""
    monkeypatch.setattr(sys, 'argv', ['figures.py'])
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    git(tmp_path, 'init', '--quiet')
    commit(tmp_path, 'begin')
    return tmp_path


def git(root: Path, *words: str) -> str:
    """Return what a command of git prints."""
    return subprocess.check_output(
        ['git', '-c', 'user.name=test', '-c', 'user.email=test@localhost', *words],
        cwd=root, text=True).strip()


def commit(root: Path, message: str) -> str:
    """Commit all files, and return the commit."""
    git(root, 'add', '.')
    git(root, 'commit', '--quiet', '--allow-empty', '--message', message)
    return git(root, 'rev-parse', '--short=8', 'HEAD')


def write(root: Path, text: str) -> None:
    """Write the only page of the documentation."""
    (root / 'docs' / 'development').mkdir(parents=True, exist_ok=True)
    (root / 'docs' / 'development' / 'page.md').write_text(text)


def test_the_figures_of_the_documentation_name_benchmark_commit_and_day():
    assert not list(figures.find_faults())
    assert len(list(figures.read_figures())) > 30


@pytest.mark.parametrize(('text', 'fault'), [
    ('| 1 ms | `obc bench speed` at `0123abcd` of 2026-11-22 |\n',
     "development/page.md:1: no benchmark 'speed'"),
    ('Of\n\nwhat, at `0123abcd` of 2026-11-22?\n', "development/page.md:3: no benchmark ''"),
    ('| 1 ms | `obc bench gain` |\n', 'development/page.md:1: no commit and day of gain'),
    ('| 1 ms | `python benchmarks/gain.py --fast` | the same |\n',
     'development/page.md:1: no commit and day of gain'),
    ('Measure `obc bench gain` yourself.\n', None)])
def test_a_figure_without_benchmark_commit_or_day_is_named(clone, capsys, text, fault):
    write(clone, text)
    assert list(figures.find_faults(clone)) == [fault] * bool(fault)
    assert figures.main(clone) == bool(fault)
    assert capsys.readouterr().err == (f'{fault}\n' if fault else '')


def test_a_figure_is_old_once_what_its_benchmark_uses_has_changed(clone, capsys):
    begun = git(clone, 'rev-parse', '--short=8', 'HEAD')
    write(clone, f'We ran `obc bench gain\nserve --peers` at\n`{begun}` of 2026-11-22:\n\n'
          f'| a | 1 ms |\n| b, another day at `{begun}` of 2026-11-23 | 2 ms |\n')
    commit(clone, 'docs: measure')
    assert figures.main(clone) == 0
    assert '0 of 4 results are older' in capsys.readouterr().out
    for file, message in (('obc_ros/core/sums.py', 'sums: be fast'),
                          ('obc_ros/worker.py', 'worker: be fast')):
        (clone / file).write_text('A = 1\n')
        commit(clone, message)
        assert figures.main(clone) == 0
        said = capsys.readouterr().out
        for line, day in ((1, 22), (6, 23)):
            assert f'development/page.md:{line}' in said
            assert f'{begun} of 2026-11-{day}' in said
        assert message in said
    assert '4 of 4 results are older' in said
    assert said.count('worker: be fast') == 2


def test_a_commit_that_a_clone_lacks_is_said_so(clone, capsys):
    write(clone, '| 1 ms | `obc bench gain` at `0123abcd` of 2026-11-22 |\n')
    assert figures.main(clone) == 0
    assert 'unknown commit' in capsys.readouterr().out


def test_without_git_the_age_is_not_known(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['figures.py'])
    assert figures.main(tmp_path) == 0
    assert 'only in a clone of the repository' in capsys.readouterr().out
