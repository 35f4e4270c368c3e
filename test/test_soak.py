# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The short forms of benchmarks/soak.py and benchmarks/crowd.py, which require their figures."""

from pathlib import Path
import subprocess
import sys

import pytest
import support

BENCHMARKS = Path(__file__).resolve().parents[1] / 'benchmarks'


@pytest.mark.parametrize(('script', 'options', 'required'), [
    # how many states find the processor busy is a figure of the machine
    ('soak.py', ('--seconds', '25', '--unanswered', '0.5'),
     ('answers that are wrong', 'without an answer', 'troubled loop is whole', 'nobody has waited',
      'growth of lqr_node', 'did not end as they should')),
    ('crowd.py', ('--clients', '100', '--requests', '300'),
     ('100 clients, design_lqr: lost', '100 clients, solve: lost', 'solve: wrong', 'zombies'))])
def test_nothing_is_lost_or_left_behind(domain, script, options, required):
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / script), *options], env=support.environment(domain),
        capture_output=True, text=True, timeout=110.0)
    assert done.returncode == 0, done.stdout + done.stderr
    for what in required:
        assert any(what in line and line.strip().startswith('holds')
                   for line in done.stdout.splitlines()), what
