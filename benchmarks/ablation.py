# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Ablation: the problems of obc_ros/examples with each strategy of the search switched off in turn.

A strategy is tried on the problems on which it has an effect. The table shows the verdicts that
are lost without it, the costs that are higher, and the ratio of the processor times.
"""

import timing  # isort: skip - before numpy

import argparse
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import json
import math
from pathlib import Path
import subprocess
import sys
from typing import Any

from _ablation import STRATEGIES
from obc_ros.core.ocp.certificate.certificate import TOLERANCES
from obc_ros.core.ocp.certificate.replay import LEAST_COST

PROBLEMS = Path(__file__).parent.parent / 'obc_ros' / 'examples'
WORKER = Path(__file__).with_name('_ablation.py')
SECONDS = 60.0

Results = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Loss:
    """What is lost without a strategy: names of problems, and the ratio of the times."""

    lost: list[str]
    worse: list[str]
    won: list[str]
    ratio: float


def main() -> int:
    """Measure and print; return the exit status."""
    args = _arguments()
    files = sorted(PROBLEMS.glob('*.yaml'))
    whole = run('', args.seconds, files, args.jobs)
    rows = []
    for name in args.only or STRATEGIES:
        used = [file for file in files if name in whole[file.stem]['acted']]
        loss = compare(whole, run(name, args.seconds, used, args.jobs))
        rows.append((name, len(used), _names(loss.lost), _names(loss.worse), _names(loss.won),
                     f'{loss.ratio:.2f}' if used else ''))
        print(f'  {name}: {len(used)} problems', file=sys.stderr, flush=True)
    solved = sum(each['status'] == 'solved' for each in whole.values())
    timing.table(f'{solved} of {len(files)} problems are solved with all strategies', (
        'without', 'acts on', 'not solved', 'higher cost', 'solved or lower', 'time'), rows)
    return timing.finish()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    parser.add_argument('--peers', action='store_true', help='there are none')
    parser.add_argument('--only', nargs='+', choices=STRATEGIES, metavar='NAME',
                        help=f'strategies; default: all of {", ".join(STRATEGIES)}')
    parser.add_argument('--seconds', type=float, default=SECONDS, metavar='N',
                        help=f'time limit of one solution; default: {SECONDS:g}')
    parser.add_argument('--jobs', type=int, default=1, metavar='N',
                        help='processes at a time; default: 1')
    return parser.parse_args()


def run(name: str, seconds: float, files: Sequence[Path], jobs: int) -> Results:
    """Return the results of the problems without a strategy ('': with all)."""
    parts = [part for part in (files[k::jobs] for k in range(jobs)) if part]
    with ThreadPoolExecutor(jobs) as pool:
        done = pool.map(lambda part: subprocess.run(
            [sys.executable, str(WORKER), name, f'{seconds:g}', *map(str, part)], check=True,
            capture_output=True, text=True).stdout.splitlines(), parts)
        found = [json.loads(line) for lines in done for line in lines]
    return {each['name']: each for each in found}


def compare(whole: Results, part: Results) -> Loss:
    """Return what is lost, comparing results without a strategy with those of all."""
    lost, worse, won = list[str](), list[str](), list[str]()
    for name, now in part.items():
        before = whole[name]
        if before['status'] != now['status']:
            (lost if before['status'] == 'solved' else won).append(name)
            continue
        excess = now['cost'] - before['cost']
        allowed = TOLERANCES['cost'] * max(abs(before['cost']), LEAST_COST)
        if before['status'] == 'solved' and abs(excess) > allowed:
            (worse if excess > 0 else won).append(name)
    times = [sum(of[name]['time'] for name in part) for of in (part, whole)]
    return Loss(lost, worse, won, times[0] / times[1] if part else math.nan)


def _names(names: Sequence[str]) -> str:
    return f'{len(names)}: {", ".join(names)}' if names else '0'


if __name__ == '__main__':
    sys.exit(main())
