# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Two loops, tuned all the time, one of them killed again and again: in short."""

from pathlib import Path
import subprocess
import sys

import pytest
import support

SCRIPT = Path(__file__).resolve().parents[1] / 'benchmarks' / 'soak.py'


REQUIRED = ('answers that are wrong', 'refused for want of time', 'without an answer',
            'troubled loop is whole', 'nobody has waited', 'growth of lqr_node',
            'did not end as they should')


@pytest.mark.timeout(300)
def test_nothing_is_lost_or_left_behind(domain):
    """
    What is lost, wrong or left behind is judged here, and that a killed loop comes back.

    How soon it does, and commands within their 5 ms, are figures of the benchmark: other tests
    run meanwhile.
    """
    done = subprocess.run(
        [sys.executable, str(SCRIPT), '--seconds', '60', '--unanswered', '0.5', '--back', '20'],
        env=support.environment(domain), capture_output=True, text=True, timeout=290.0)
    assert done.returncode == 0, done.stdout + done.stderr
    for what in REQUIRED:
        assert any(what in line and line.strip().startswith('holds')
                   for line in done.stdout.splitlines()), what
