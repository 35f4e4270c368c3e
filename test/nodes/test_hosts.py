# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A loop on three hosts: packet loss, delay, a cut connection, and isolation from others."""

from pathlib import Path
import subprocess
import sys

import pytest
import support

SCRIPT = Path(__file__).resolve().parents[2] / 'benchmarks' / 'hosts.py'


@pytest.mark.alone
def test_a_loop_on_three_hosts_survives_losses_and_a_cut(domain):
    """Run the short form of benchmarks/hosts.py, which checks the figures that it prints."""
    completed = subprocess.run(
        [sys.executable, str(SCRIPT), '--seconds', '4', '--settle', '3', '--clean', '0'],
        env=support.environment(domain), capture_output=True, text=True, timeout=100.0)
    if 'skipped: several hosts' in completed.stdout:
        pytest.skip(completed.stdout.split('skipped: ')[1].strip())
    assert completed.returncode == 0, completed.stdout + completed.stderr
    for trial in ('UDP frames that leave a host', 'hosts that discover each other',
                  'an answered state', 'requests lost in the cut', 'stale states missed',
                  'missing commands not noticed', 'bad wire: largest', 'after it: largest'):
        assert any(trial in line and line.strip().startswith('holds')
                   for line in completed.stdout.splitlines()), trial
