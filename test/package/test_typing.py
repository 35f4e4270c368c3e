# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What type checkers say of a program that uses the library."""

import os
from pathlib import Path
import subprocess
import sys

import obc_ros as obc
import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_mypy_knows_the_types_of_a_users_program(tmp_path):
    """As of an installed package: mypy says nothing of its modules."""
    pytest.importorskip('mypy')
    program = tmp_path / 'user_project.py'
    program.write_text((Path(__file__).parent / 'user_project.py').read_text(encoding='utf-8'))
    done = subprocess.run(
        [sys.executable, '-m', 'mypy', '--strict', '--config-file', os.devnull,
         '--follow-imports', 'silent', '--cache-dir', str(tmp_path / 'cache'), program.name],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {'MYPYPATH': str(ROOT)})
    assert done.stdout == 'Success: no issues found in 1 source file\n', done.stdout + done.stderr


def test_the_names_of_type_checkers_are_those_of_the_package():
    text = (ROOT / 'obc_ros' / '__init__.pyi').read_text(encoding='utf-8')
    names = {line.rpartition(' as ')[2] for line in text.splitlines() if ' as ' in line}
    assert names == set(obc.__all__)
    assert '__version__: str' in text
