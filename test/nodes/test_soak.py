# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Soak test, short form: two loops under permanent tuning, one of them killed repeatedly."""

from pathlib import Path
import subprocess
import sys

import pytest
import support

SCRIPT = Path(__file__).resolve().parents[2] / 'benchmarks' / 'soak.py'


REQUIRED = ('incorrect responses', 'rejected for lack of time', 'without a response',
            'troubled loop is complete', 'zombie processes', 'growth of lqr_node',
            'did not end correctly')


@pytest.mark.alone
@pytest.mark.timeout(180)
def test_a_short_soak_loses_and_leaves_nothing(domain):
    """
    Each process is killed once, its workers first: a zombie counts after 10 s.

    A busy machine may miss the 5 ms of a command, so these are not required.
    """
    completed = subprocess.run(
        [sys.executable, str(SCRIPT), '--seconds', '18', '--pace', '2',
         '--unanswered', '0.5'],
        env=support.environment(domain), capture_output=True, text=True, timeout=170.0)
    assert completed.returncode == 0, completed.stdout + completed.stderr
    for requirement in REQUIRED:
        assert any(requirement in line and line.strip().startswith('holds')
                   for line in completed.stdout.splitlines()), requirement
