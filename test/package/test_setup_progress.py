# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What `make setup` shows while it installs."""

from importlib import util
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRESS = [sys.executable, str(ROOT / 'requirements' / 'progress.py'), 'packages']


@pytest.mark.slow
def test_it_tells_what_goes_on_and_how_long_it_took(
        monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """A line every two seconds here, in place of every ten."""
    spec = util.spec_from_file_location('progress', PROGRESS[1])
    progress = util.module_from_spec(spec)
    spec.loader.exec_module(progress)
    assert progress.PLAIN == 10.0
    monkeypatch.setattr(progress, 'PLAIN', 2.0)
    assert progress.run('packages', ['sh', '-c', 'echo one; echo two; sleep 2.6; echo three']) == 0
    told = capsys.readouterr()
    assert re.fullmatch(r'obc_ros: packages\nobc_ros:    [23] s  two\n'
                        r'obc_ros: packages: done after \d s\n', told.out)
    assert told.err == ''


def test_a_failure_is_shown_whole() -> None:
    failed = subprocess.run([*PROGRESS, 'sh', '-c', 'echo one; echo two >&2; exit 3'],
                            capture_output=True, text=True, check=False)
    assert failed.returncode == 3
    assert failed.stderr == 'one\ntwo\n\n'
    assert failed.stdout.endswith('obc_ros: packages: failed after 0 s\n')


def test_every_long_stage_of_the_set_up_is_shown() -> None:
    recipe = (ROOT / 'Makefile').read_text(encoding='utf-8')
    setup = recipe[recipe.index('$(VENV)/.requirements:'):recipe.index('$(VENV)/.develop:')]
    stages = re.findall(r'^\t@(\$\(SHOWN\)|.*\$\(PIP\))', setup, re.MULTILINE)
    assert stages == ['$(SHOWN)', '$(SHOWN)']
    assert 'half a minute' not in recipe
