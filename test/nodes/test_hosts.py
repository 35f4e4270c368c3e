# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One loop on three hosts: a wire that loses and delays, a cut, and no word to others."""

from pathlib import Path
import subprocess
import sys

import pytest
import support

SCRIPT = Path(__file__).resolve().parents[2] / 'benchmarks' / 'hosts.py'


@pytest.mark.alone
def test_a_loop_on_three_hosts_outlives_a_bad_wire_and_a_cut(domain):
    """The short form of benchmarks/hosts.py, which requires the figures that it prints."""
    done = subprocess.run(
        [sys.executable, str(SCRIPT), '--seconds', '4', '--settle', '3', '--clean', '0'],
        env=support.environment(domain), capture_output=True, text=True, timeout=100.0)
    if 'skipped: several hosts' in done.stdout:
        pytest.skip(done.stdout.split('skipped: ')[1].strip())
    assert done.returncode == 0, done.stdout + done.stderr
    for trial in ('UDP frames that leave a host', 'an answered state', 'requests lost in the cut',
                  'stale states missed', 'bad wire: largest', 'after it: largest'):
        assert any(trial in line and line.strip().startswith('holds')
                   for line in done.stdout.splitlines()), trial
