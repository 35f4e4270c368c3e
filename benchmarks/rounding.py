# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Sensitivity to rounding: the problems of obc_ros/examples with changes in the last bits.

Each is solved with several kernels of OpenBLAS, which round matrix products differently, and with
every number of its statement times 1 + 1e-12 r, r uniform in [-1, 1]. Changed verdicts are
printed, and costs of certified solutions that differ by more than a certificate allows. Problems
that reach the time limit are not compared, and are counted separately.
"""

import timing  # isort: skip - before numpy

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
import json
import os
from pathlib import Path
import subprocess
import sys

from obc_ros.core.ocp.certificate.certificate import TOLERANCES
from obc_ros.core.ocp.certificate.replay import LEAST_COST

PROBLEMS = Path(__file__).parent.parent / 'obc_ros' / 'examples'
WORKER = Path(__file__).with_name('_rounding.py')
OWN = 'own'   # the kernel that OpenBLAS selects for the machine
KERNELS = OWN, 'Haswell', 'Nehalem'
SECONDS = 60.0


@dataclass(frozen=True)
class Variant:
    """A kernel of OpenBLAS, and the seed of the changes of numbers; 0: no changes."""

    kernel: str
    seed: int

    def __str__(self) -> str:
        return f'{self.kernel}, numbers changed by {self.seed}' if self.seed else self.kernel


@dataclass(frozen=True)
class Verdict:
    """A result: the status of the solution or how the process ended, and the cost."""

    status: str
    cost: float

    def differs(self, other: 'Verdict') -> str:
        """Return the difference between two verdicts, '' if there is none."""
        if 'timed_out' in (self.status, other.status):
            return ''
        if self.status != other.status:
            return f'{other.status} -> {self.status}'
        allowed = TOLERANCES['cost'] * max(abs(other.cost), LEAST_COST)
        if self.status == 'solved' and abs(self.cost - other.cost) > allowed:
            return f'cost {other.cost:.10g} -> {self.cost:.10g}'
        return ''


def main() -> int:
    """Measure and print; return the exit status."""
    args = _arguments()
    names = args.only or sorted(path.stem for path in PROBLEMS.glob('*.yaml'))
    variants = [*(Variant(kernel, 0) for kernel in args.kernels), *(
        Variant(args.kernels[0], seed) for seed in range(1, args.seeds + 1))]
    found = verdicts(names, variants, args.seconds)
    told = [(name, *each) for name in names for each in differences(found[name])]
    late = sum(each.status == 'timed_out' for of in found.values() for each in of.values())
    rows = [(variant, len(names), *_counted([found[name][variant] for name in names]),
             sum(each[1] == variant for each in told)) for variant in variants]
    timing.table(f'{len(names)} problems, at most {args.seconds:g} s each', (
        'rounding', 'problems', 'solved', 'timed out', 'other', 'differ'), rows)
    if told:
        timing.table(f'beside {variants[0]}', ('problem', 'rounding', 'what changes'), told)
    print(f'  {late} of {len(names) * len(variants)} reached the time limit and are not compared')
    timing.require('problems whose results depend on rounding', len({each[0] for each in told}), 0)
    return timing.finish()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    parser.add_argument('--peers', action='store_true', help='there are none')
    parser.add_argument('--kernels', nargs='+', default=KERNELS, metavar='NAME', help=(
        f'of OpenBLAS, as in OPENBLAS_CORETYPE, or {OWN}; default: {" ".join(KERNELS)}'))
    parser.add_argument('--seeds', type=int, default=1, metavar='N',
                        help='number of random changes of the numbers; default: 1')
    parser.add_argument('--only', nargs='+', metavar='NAME', help='which problems; default: all')
    parser.add_argument('--seconds', type=float, default=SECONDS, metavar='N',
                        help=f'time limit of one solution; default: {SECONDS:g}')
    return parser.parse_args()


def verdicts(names: Sequence[str], variants: Sequence[Variant], seconds: float
             ) -> dict[str, dict[Variant, Verdict]]:
    """Return the results of each problem with each variant, one process for each processor."""
    jobs = list(product(names, variants))
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        done = pool.map(lambda job: verdict(*job, seconds), jobs)
        found: dict[str, dict[Variant, Verdict]] = {name: {} for name in names}
        for (name, variant), each in zip(jobs, done, strict=True):
            found[name][variant] = each
    return found


def verdict(name: str, variant: Variant, seconds: float) -> Verdict:
    """Return the result of one problem in a process of its own."""
    environment = dict(os.environ)
    environment.pop('OPENBLAS_CORETYPE', None)
    if variant.kernel != OWN:
        environment['OPENBLAS_CORETYPE'] = variant.kernel
    done = subprocess.run(
        [sys.executable, str(WORKER), f'{seconds:g}', str(variant.seed),
         str(PROBLEMS / f'{name}.yaml')], env=environment, capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [''])[-1]
        return Verdict(f'died with {done.returncode}: {last[:80]}', float('nan'))
    line = json.loads(done.stdout.splitlines()[-1])
    return Verdict(line['status'], line['cost'])


def differences(of: dict[Variant, Verdict]) -> Iterator[tuple[Variant, str]]:
    """Yield the variants whose verdict differs from the first one, and the difference."""
    first, *others = of
    if of[first].status.startswith('died'):
        yield first, of[first].status
    for variant in others:
        if said := of[variant].differs(of[first]):
            yield variant, said


def _counted(of: Sequence[Verdict]) -> tuple[int, int, int]:
    """Return the numbers of solved problems, of time limits, and of other results."""
    solved, late = (sum(each.status == status for each in of)
                    for status in ('solved', 'timed_out'))
    return solved, late, len(of) - solved - late


if __name__ == '__main__':
    sys.exit(main())
