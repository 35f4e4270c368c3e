# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Verdict, cost, certificate and time of the tests' problems, before and after a change.

python benchmarks/baseline.py --write baseline.json       # before
python benchmarks/baseline.py --compare baseline.json     # after

The problems are all files of obc_ros/examples, and all problems and regulators in the tests of the
numerical core, which are run with a plugin that records them. The comparison lists each verdict
that has changed and each cost that has changed by more than its tolerance. Its exit status is 1
if there is one, or if the median ratio of the times exceeds its limit.
"""

import timing  # isort: skip - before numpy

import argparse
from collections.abc import Mapping
import json
import os
from pathlib import Path
from statistics import median
import subprocess
import sys
import tempfile
import time
from typing import Any

import _recorder
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import ObcError

TESTS = Path(__file__).resolve().parents[1] / 'test'
COST = 1e-6     # relative to 1 + |cost|: the accuracy of certificates
SHORTEST = 1e-2  # [s] shorter times are not compared
LIMIT = 1.1     # limit of the median ratio of times

Records = dict[str, dict[str, Any]]


def solve_files(pattern: str, time_limit: float) -> Records:
    """Return the results of the files of obc_ros/examples whose names match."""
    records: Records = {}
    for path in sorted((TESTS.parent / 'obc_ros' / 'examples').glob(pattern)):
        for number, mapping in enumerate(load_file(path), 1):
            begun = time.process_time()
            found = solve(build_problem(mapping), time_limit=time_limit)
            records[f'{path.stem}#{number}'] = {
                **_recorder.answer(found), 'time': time.process_time() - begun}
            print(f'\r{path.stem:60.60}', end='', file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return records


def run_tests(expression: str) -> Records:
    """Return the results in the tests of the core; `expression` selects tests as -k of pytest."""
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / 'record.json'
        subprocess.run([
            sys.executable, '-m', 'pytest', '-q', '-p', '_recorder', '-m', 'not nodes',
            '-k', expression, str(TESTS)], cwd=TESTS.parent, check=False, env={
                **os.environ, 'OBC_ROS_RECORD': str(record),
                'PYTHONPATH': str(Path(__file__).parent)})
        if not record.is_file():
            raise ObcError('baseline: the tests wrote no record')
        return dict(json.loads(record.read_text(encoding='utf-8')))


def compare(before: Records, after: Records) -> None:
    """Print the changes, and compare them with their limits."""
    common = [name for name in before if name in after]
    verdicts = [(name, before[name]['verdict'], after[name]['verdict'],
                 after[name]['message'][:90])
                for name in common if before[name]['verdict'] != after[name]['verdict']]
    costs = [(name, before[name]['cost'], after[name]['cost']) for name in common
             if moved(before[name], after[name])]
    ratios = [after[name]['time'] / before[name]['time'] for name in common
              if min(before[name]['time'], after[name]['time']) >= SHORTEST]
    timing.table('Verdicts that changed', ('', 'before', 'after', 'message'), verdicts)
    timing.table('Costs that moved', ('', 'before', 'after'), costs)
    gone = [name for name in before if name not in after]
    print(f'\n{len(common)} compared; {len(gone)} are gone, '
          f'{len(after) - len(common)} are new')
    timing.require('verdicts that changed', len(verdicts), 0)
    timing.require('costs that moved', len(costs), 0)
    if ratios:
        timing.require('median ratio of times', median(ratios), LIMIT)


def moved(before: Mapping[str, Any], after: Mapping[str, Any]) -> bool:
    """Return whether the cost of a certified solution changed by more than its tolerance."""
    if before['verdict'] != after['verdict'] or before['verdict'] not in ('solved', 'designed'):
        return False
    scale = 1.0 + abs(before['cost'])
    return not abs(after['cost'] - before['cost']) <= COST * scale


def main() -> int:
    """Solve everything; write or compare the records."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--write', type=Path, metavar='FILE', help='write the records')
    parser.add_argument('--compare', type=Path, metavar='FILE', help='compare with these records')
    parser.add_argument('--problems', default='*.yaml', metavar='GLOB',
                        help='which files of obc_ros/examples (default: all)')
    parser.add_argument('--tests', default='test', metavar='EXPRESSION',
                        help="which tests, as pytest's -k (default: all of the core)")
    parser.add_argument('--time-limit', type=float, default=120.0, metavar='S', help='of one file')
    args = parser.parse_args()
    if not TESTS.is_dir():
        parser.error(f'no tests at {TESTS}: run it from a checkout')
    records = solve_files(args.problems, args.time_limit) | run_tests(args.tests)
    if args.write:
        args.write.write_text(json.dumps(records, indent=1), encoding='utf-8')
        print(f'{len(records)} records in {args.write}')
    if args.compare:
        compare(json.loads(args.compare.read_text(encoding='utf-8')), records)
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())
