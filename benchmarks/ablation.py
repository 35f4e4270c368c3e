# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Ablation in groups: what the search can do without, on all problem files and collections.

One strategy off at a time cannot show that two stand in for each other. Here strategies are
switched off together, those that act on the fewest problems first: each joins those that are off
unless a verdict, a cost or a time that users feel is lost then. Each file is solved once, and once
more with other numbers and the cache of the first solution.

``--off NAME...`` measures one group instead. ``--tests`` also runs the tests of refusals without
the group that is left off, and lists those that fail.
"""

import timing  # isort: skip - before numpy

import argparse
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

from _ablation import STRATEGIES
from obc_ros.core.ocp.certificate.certificate import TOLERANCES
from obc_ros.core.ocp.certificate.replay import LEAST_COST
from obc_ros.core.solver.diagnosis.explanation import CHECKS

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ('obc_ros/examples', 'test/collections/psopt', 'test/collections/control_toolbox',
           'test/collections/practical')
REFUSALS = ('test/core/solver/proofs', 'test/core/solver/diagnosis',
            'test/core/solver/test_solve.py')
SECONDS = 30.0
FELT = {0: 2.0, 1: 3.0}   # ratio of times that users feel: of the first answer, of the repeat
LEAST = 0.1               # [s] a longer time that users do not feel

Results = dict[str, dict[str, Any]]


def main() -> int:
    """Measure and print; return the exit status."""
    args = _arguments()
    files = [str(file.relative_to(ROOT)) for folder in args.folders
             for file in sorted((ROOT / folder).glob('*.yaml'))]
    whole = run((), files, args)
    rows: list[Sequence[object]] = []
    if args.off:
        group = tuple(args.off)
        rows.append(_row(', '.join(group), whole, run(group, files, args)))
    else:
        group = choose(whole, args, rows)
    solved = sum(each['status'][0] == 'solved' for each in whole.values())
    timing.table(f'{solved} of {len(files)} problems are solved with all strategies', (
        'also without', 'acts on', 'off', 'not solved', 'higher cost', 'slow', 'time'), rows)
    if args.tests:
        timing.table('Tests of refusals that fail without the group', ('test',), [
            (test,) for test in fail(group)])
    return timing.finish()


def choose(whole: Results, args: argparse.Namespace, rows: list[Sequence[object]]
           ) -> tuple[str, ...]:
    """Return the strategies that can be off together; append what each of them loses."""
    group, now = (), dict(whole)
    untried = [name for name in STRATEGIES if name not in {check.name for check in CHECKS}
               and not name.startswith('proof')]
    while untried:
        uses = {name: [file for file, each in now.items() if name in each['acted']]
                for name in untried}
        name = min(untried, key=lambda name: len(uses[name]))
        untried.remove(name)
        part = run((*group, name), uses[name], args)
        row = _row(name, whole, part)
        rows.append(row)
        if row[2]:
            group, now = (*group, name), now | part
        print(*row, sep=' | ', file=sys.stderr, flush=True)
    return group


def _row(name: str, whole: Results, part: Results) -> Sequence[object]:
    """Return a row of the table: what is lost on some files, and whether that is nothing."""
    losses = [list(find(whole, part)) for find in (find_lost, find_costlier, find_slow)]
    times = [sum(sum(of[file]['time']) for file in part) for of in (part, whole)]
    return (name, len(part), '' if any(losses) else 'off', *map(_names, losses),
            f'{times[0] / times[1]:.2f}' if part else '')


def find_lost(whole: Results, part: Results) -> Iterator[str]:
    """Yield the files of which an answer is lost."""
    for file, each in part.items():
        if any(before == 'solved' != now for before, now in zip(
                whole[file]['status'], each['status'], strict=True)):
            yield file


def find_costlier(whole: Results, part: Results) -> Iterator[str]:
    """Yield the files of which an answer costs more than the certificate tolerates."""
    for file, each in part.items():
        if any(each['status'][k] == whole[file]['status'][k] == 'solved' and (
                each['cost'][k] - before > TOLERANCES['cost'] * max(abs(before), LEAST_COST))
                for k, before in enumerate(whole[file]['cost'])):
            yield file


def find_slow(whole: Results, part: Results) -> Iterator[str]:
    """Yield the files whose first answer or repeat takes longer than users tolerate."""
    for file, each in part.items():
        if any(each['time'][k] > max(ratio * whole[file]['time'][k],
                                     whole[file]['time'][k] + LEAST)
               for k, ratio in FELT.items()):
            yield file


def run(without: Collection[str], files: Sequence[str], args: argparse.Namespace) -> Results:
    """Return the results of the files without some strategies."""
    parts = [part for part in (files[k::args.jobs] for k in range(args.jobs)) if part]
    with ThreadPoolExecutor(args.jobs) as pool:
        done = pool.map(lambda part: subprocess.run(
            [sys.executable, str(Path(__file__).with_name('_ablation.py')),
             json.dumps(list(without)), f'{args.seconds:g}', *part], check=True, cwd=ROOT,
            capture_output=True, text=True).stdout.splitlines(), parts)
        found = [json.loads(line) for lines in done for line in lines]
    return {each.pop('file'): each for each in found}


def fail(without: Collection[str]) -> list[str]:
    """Return the tests of refusals that fail without some strategies."""
    with tempfile.TemporaryDirectory() as folder:
        failed = Path(folder) / 'failed.json'
        environment: Mapping[str, str] = os.environ | {
            'OBC_ROS_WITHOUT': json.dumps(list(without)), 'OBC_ROS_FAILED': str(failed),
            'PYTHONPATH': str(Path(__file__).parent)}
        subprocess.run(
            [sys.executable, '-m', 'pytest', '-p', '_ablation', '-q', '--tb=no', '-m', 'not nodes',
             '-p', 'no:cacheprovider', *REFUSALS], cwd=ROOT, capture_output=True, check=False,
            env=environment)
        return list(json.loads(failed.read_text(encoding='utf-8')))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    parser.add_argument('--peers', action='store_true', help='there are none')
    parser.add_argument('--off', nargs='+', choices=STRATEGIES, metavar='NAME',
                        help=f'one group of {", ".join(STRATEGIES)}')
    parser.add_argument('--folders', nargs='+', default=FOLDERS, metavar='PATH',
                        help=f'folders of problem files; default: {" ".join(FOLDERS)}')
    parser.add_argument('--seconds', type=float, default=SECONDS, metavar='N',
                        help=f'time limit of one solution; default: {SECONDS:g}')
    parser.add_argument('--jobs', type=int, default=1, metavar='N',
                        help='processes at a time; default: 1')
    parser.add_argument('--tests', action='store_true', help='also the tests of refusals')
    return parser.parse_args()


def _names(files: Sequence[str]) -> str:
    return f'{len(files)}: {", ".join(Path(file).stem for file in files)}' if files else '0'


if __name__ == '__main__':
    sys.exit(main())
