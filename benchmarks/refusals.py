# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Refusals: what is lost without each check of the explanation and each proof of infeasibility.

The tests of refusals are run once, to see in which of them each check gives a reason. Then each
check is left out of its registry, and the tests in which it gave one are run again: those that
fail have lost their reason. A check without any test that fails is of no use.
"""

import timing  # isort: skip - before numpy

import argparse
from collections.abc import Sequence
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile

from _without_check import CHECKS, PROOFS
from obc_ros.core.text.errors import ObcError

ROOT = Path(__file__).resolve().parents[1]
TESTS = ('test/core/solver',)
LIMIT = 1800.0   # [s] maximum of a run of tests

Given = dict[str, list[str]]   # names of the checks that gave a reason, by test


def main() -> int:
    """Measure and print; return the exit status."""
    args = _arguments()
    given, _ = run('', args.tests)
    rows = []
    for name in args.only or (*CHECKS, *PROOFS):
        used = [test for test, names in given.items() if name in names]
        lost = run(name, used)[1] if used else []
        rows.append((name, str(len(used)), str(len(lost)), ', '.join(lost[:2])))
        print(f'  {name}: {len(lost)} of {len(used)} tests', file=sys.stderr, flush=True)
        timing.require(f'refusals that need: {name}', -len(lost), -1)
    timing.table('Without each check', ('without', 'gives a reason in', 'lost', 'as'), rows)
    return timing.finish()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    parser.add_argument('--peers', action='store_true', help='there are none')
    parser.add_argument('--only', nargs='+', choices=(*CHECKS, *PROOFS), metavar='NAME',
                        help=f'checks; default: all of {", ".join((*CHECKS, *PROOFS))}')
    parser.add_argument('--tests', nargs='+', default=list(TESTS), metavar='PATH',
                        help='files or folders of tests; default: those of the solver')
    return parser.parse_args()


def run(without: str, tests: Sequence[str]) -> tuple[Given, list[str]]:
    """Run tests without a check; return what gave reasons, and the tests that fail."""
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder) / 'given.json'
        done = subprocess.run(
            [sys.executable, '-m', 'pytest', '-p', '_without_check', '-q', '--tb=no',
             '-m', 'not nodes', '-p', 'no:cacheprovider', *tests], cwd=ROOT, capture_output=True,
            text=True, timeout=LIMIT, check=False, env=os.environ | {
                'OBC_ROS_WITHOUT': without, 'OBC_ROS_GIVEN': str(given),
                'PYTHONPATH': str(Path(__file__).parent)})
        if not given.is_file():
            raise ObcError(f'refusals: the tests wrote no record:\n{done.stdout[-2000:]}')
        noted, failed = json.loads(given.read_text(encoding='utf-8'))
        return noted, failed


if __name__ == '__main__':
    sys.exit(main())
