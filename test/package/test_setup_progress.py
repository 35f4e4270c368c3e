# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The progress that `make setup` shows while it installs."""

from importlib import util
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRESS = [sys.executable, str(ROOT / 'requirements' / 'progress.py'), 'packages']


@pytest.mark.slow
def test_progress_shows_the_last_line_and_the_duration(monkeypatch: pytest.MonkeyPatch,
                                                       capsys: pytest.CaptureFixture[str]) -> None:
    """The interval is two seconds here, not ten."""
    spec = util.spec_from_file_location('progress', PROGRESS[1])
    progress = util.module_from_spec(spec)
    spec.loader.exec_module(progress)
    assert progress.PLAIN == 10.0
    monkeypatch.setattr(progress, 'PLAIN', 2.0)
    assert progress.run('packages', ['sh', '-c', 'echo one; echo two; sleep 2.6; echo three']) == 0
    output = capsys.readouterr()
    assert re.fullmatch(r'obc_ros: packages\nobc_ros:    [23] s  two\n'
                        r'obc_ros: packages: done after \d s\n', output.out)
    assert output.err == ''


def test_the_whole_output_of_a_failure_is_shown() -> None:
    failed = subprocess.run([*PROGRESS, 'sh', '-c', 'echo one; echo two >&2; exit 3'],
                            capture_output=True, text=True, check=False)
    assert failed.returncode == 3
    assert failed.stderr == 'one\ntwo\n\n'
    assert failed.stdout.endswith('obc_ros: packages: failed after 0 s\n')


def test_every_long_stage_of_the_setup_shows_progress() -> None:
    recipe = (ROOT / 'Makefile').read_text(encoding='utf-8')
    setup = recipe[recipe.index('$(VENV)/.requirements:'):recipe.index('$(VENV)/.develop:')]
    stages = re.findall(r'^\t@(\$\(SHOWN\)|.*\$\(PIP\))', setup, re.MULTILINE)
    assert stages == ['$(SHOWN)', '$(SHOWN)']
    assert 'half a minute' not in recipe
