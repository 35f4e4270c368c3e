# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Expressions, requests, files, recordings and bytes of HTTP that atheris generates.

It is guided by the branches that they reach.

atheris is not among the requirements; without it the benchmark is skipped. An exception that ends
a target is printed, and its input is kept in the folder that is printed.
"""

import timing  # isort: skip - before numpy

from pathlib import Path
import re
import subprocess
import sys
import tempfile

HARNESS = Path(__file__).with_name('_fuzz.py')
TARGETS = ('expression', 'request', 'yaml')
PAGE = ('mcap', 'http')   # of obc view: these need NiceGUI
SLOWEST = 5  # [s] time limit of one input
MEMORY = 2048  # [MiB]


def main() -> int:
    """Fuzz each target and print the results."""
    args = timing.arguments(__doc__ or '', seconds=30)
    if not timing.peer('atheris'):
        return timing.finish()
    rows = []
    for target in TARGETS + (PAGE if timing.peer('nicegui') else ()):
        folder = tempfile.mkdtemp(prefix=f'fuzz_{target}_')
        done = subprocess.run(
            [sys.executable, str(HARNESS), target, f'-max_total_time={args.seconds}',
             f'-timeout={SLOWEST}', f'-rss_limit_mb={MEMORY}', f'-artifact_prefix={folder}/'],
            capture_output=True, text=True)
        runs = re.findall(r'#(\d+)\s', done.stderr) or ['0']
        reached = re.findall(r'cov: (\d+)', done.stderr) or ['0']
        rows.append((target, runs[-1], reached[-1], done.returncode))
        timing.require(f'{target}: inputs that end it', done.returncode != 0, 0)
        if done.returncode:
            print(f'{done.stdout[-2000:]}{done.stderr[-3000:]}\n  the input is in {folder}')
        else:
            Path(folder).rmdir()
    timing.table(f'atheris, {args.seconds} s each',
                 ('target', 'inputs', 'branches', 'status'), rows)
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())
