# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Back-ends: the problems of obc_ros/examples with each solver of the same nonlinear programs.

Meshes, initial guesses and certificates are the same, and so is the search. Each problem is solved
with each back-end in turn: first without a cache, then with its numbers changed by up to 1 %, all
with one cache. The own interior-point method applies to programs of one phase with Runge-Kutta
steps and without path constraints; where it never ran, the problem is in the second table.
"""

import timing  # isort: skip - before numpy

import argparse
from collections.abc import Sequence
import json
import math
from pathlib import Path
from statistics import median
import subprocess
import sys
from typing import Any

from _backends import BACKENDS
from obc_ros.core.ocp.certificate.certificate import TOLERANCES
from obc_ros.core.ocp.certificate.replay import LEAST_COST

PROBLEMS = Path(__file__).parent.parent / 'obc_ros' / 'examples'
WORKER = Path(__file__).with_name('_backends.py')
SHIPPED = 'own, IPOPT'
HEAD = ('back-end', 'solved', 'higher cost', 'time [s]', 'median', 'ratio', 'repeats solved',
        'higher cost', 'time [s]', 'median', 'ratio')

Results = dict[str, dict[str, Any]]   # of one problem, by back-end


def main() -> int:
    """Measure and print; return the exit status."""
    args = _arguments()
    names = [SHIPPED, *(name for name in args.backends if name != SHIPPED)]
    found = [run(file, names, args) for file in sorted(PROBLEMS.glob(args.pattern))[::args.every]]
    used = [each for each in found if each.get(SHIPPED, {}).get('all')]
    own = [each for each in used if each[SHIPPED].get('own')]
    others = [each for each in used if not each[SHIPPED].get('own')]
    print(f'{len(found)} problems, {len(found) - len(used)} of them without a nonlinear program')
    for title, group in (('the own method applies', own), ('it does not', others)):
        common = [each for each in group if all(is_solved(each, name) for name in names)]
        timing.table(
            f'{len(group)} problems to which {title}; times are of {len(common)} that are solved '
            'with all back-ends', HEAD, [row(name, group, common) for name in names])
    for name in names[1:]:
        print(f'\n{name}, not solved: {" ".join(lost(used, name))}')
        print(f'{name}, solved where the own method does not: {" ".join(lost(used, name, -1))}')
    return timing.finish()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    parser.add_argument('--peers', action='store_true', help='there are no others')
    parser.add_argument('--backends', nargs='+', choices=BACKENDS, metavar='NAME',
                        default=list(BACKENDS)[:4],
                        help=f'of {"; ".join(BACKENDS)}; default: the first four')
    for name, default, text in (
            ('changes', 2, 'repeats of each problem'), ('every', 1, 'take every N-th problem')):
        parser.add_argument(f'--{name}', type=int, default=default, metavar='N',
                            help=f'{text}; default: {default}')
    parser.add_argument('--seconds', type=float, default=60.0, metavar='N',
                        help='time limit of one solution; default: 60')
    parser.add_argument('--pattern', default='*.yaml', help='files; default: all')
    return parser.parse_args()


def run(file: Path, names: Sequence[str], args: argparse.Namespace) -> Results:
    """Return the results of a problem; a back-end that ended or blocked the process has none."""
    command = [sys.executable, str(WORKER), f'{args.seconds:g}', str(args.changes), str(file)]
    found: Results = {}
    left = list(names)
    while left:
        try:
            text = subprocess.run([*command, *left], capture_output=True, text=True, timeout=(
                3 * args.seconds * (1 + args.changes))).stdout
        except subprocess.TimeoutExpired as late:
            text = (late.stdout or b'').decode()
        got = [json.loads(line) for line in text.splitlines() if line.startswith('{')]
        found.update((each['backend'], each) for each in got)
        left = left[len(got) + 1:]
    print(f'  {file.stem}: ' + ', '.join(
        f'{name} {found[name]["times"][0]:.2f}' if name in found else f'{name} ended'
        for name in names), file=sys.stderr, flush=True)
    return found


def is_solved(of: Results, name: str) -> bool:
    """Return whether the first solution and all repeats of a back-end have certificates."""
    return name in of and all(status == 'solved' for status in of[name]['status'])


def row(name: str, group: Sequence[Results], common: Sequence[Results]) -> tuple[object, ...]:
    """Return a row of the table: first solutions and repeats."""
    cells: list[object] = [name]
    for part in (slice(1), slice(1, None)):
        status = [each for of in group if name in of for each in of[name]['status'][part]]
        times = [sum(of[name]['times'][part]) for of in common]
        own = [sum(of[SHIPPED]['times'][part]) for of in common]
        repeats = len(status) // max(len(group), 1) or 1
        cells += [
            sum(each == 'solved' for each in status), higher(name, group, part),
            f'{sum(times):.1f}', f'{1e3 * median(times or [math.nan]) / repeats:.0f} ms',
            f'{median(a / b for a, b in zip(times, own, strict=True)) if own else math.nan:.2f}']
    return tuple(cells)


def higher(name: str, group: Sequence[Results], part: slice) -> int:
    """Return the number of solved problems whose cost is above that of the own method."""
    count = 0
    for of in group:
        if name not in of:
            continue
        mine, own = of[name], of[SHIPPED]
        count += sum(
            a == b == 'solved' and x - y > TOLERANCES['cost'] * max(abs(y), LEAST_COST)
            for a, b, x, y in zip(mine['status'][part], own['status'][part], mine['cost'][part],
                                  own['cost'][part], strict=True))
    return count


def lost(used: Sequence[Results], name: str, sign: int = 1) -> list[str]:
    """Return the problems solved at first by the own method only, or by the other one only."""
    names = []
    for of in used:
        first = [of[each]['status'][0] == 'solved' if each in of else False
                 for each in (SHIPPED, name)]
        if sign * (first[0] - first[1]) > 0:
            names.append(of[SHIPPED]['name'])
    return names


if __name__ == '__main__':
    sys.exit(main())
