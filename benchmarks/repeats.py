# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Repeated problems with other numbers: solved with one cache, and each without a cache.

Every problem file is solved unchanged and with three changes of its parameters and its initial
state, by factors 1 + 1e-3 r with r in [-1, 1]: all four in turn with one cache, and each without a
cache. Requirements: no exception, equal verdicts, and certified costs that differ by no more than
the certificates allow.
"""

import timing  # isort: skip - before numpy

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
import sys
import traceback
from typing import Any

import numpy as np
from obc_ros.core.ocp.certificate.replay import LEAST_COST
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve

PROBLEMS = Path(__file__).resolve().parent.parent / 'obc_ros' / 'examples'
CHANGES = 3
SIZE = 1e-3
SAME = 1e-5   # relative excess of a cost that the certificate's condition `minimum` allows


def main() -> int:
    """Solve, compare and print; return the exit status."""
    args = timing.arguments('repeats of problems with other numbers', first=0, last=10**6)
    files = sorted(PROBLEMS.glob('*.yaml'))[int(args.first):int(args.last)]
    faults = 0
    for file in files:
        for mapping in load_file(file):
            found = list(compared(mapping))
            faults += len(found)
            print(f'{mapping["name"]}: {"; ".join(found) or "the same"}', flush=True)
    timing.require(f'{len(files)} files, differences', faults, 0)
    return timing.finish()


def compared(mapping: dict[str, Any]) -> Iterator[str]:
    """Yield the differences between solutions with one cache and solutions without."""
    cache = Cache()
    pairs = zip(vary(mapping), vary(mapping), strict=True)
    for number, (one, other) in enumerate(pairs):
        for word in differences(answered(one, cache), answered(other, None)):
            yield f'{number}: {word}'


def vary(mapping: dict[str, Any], changes: int = CHANGES, size: float = SIZE
         ) -> Iterator[Problem]:
    """Yield the problem unchanged and with its changes, each parsed again."""
    chance = np.random.default_rng(0)
    yield build_problem(mapping)
    for _ in range(changes):
        problem = build_problem(mapping)
        x0, p = (value * (1 + size * chance.uniform(-1, 1, len(value)))
                 for value in (problem.x0, problem.p_value))
        yield replace(problem, x0=np.clip(x0, problem.x_lower, problem.x_upper), p_value=p)


def answered(problem: Problem, cache: Cache | None) -> Solution | str:
    """Return the solution, or the exception."""
    try:
        return solve(problem, cache=cache)
    except Exception as error:  # exceptions of any kind are results here
        traceback.print_exc()
        return f'{type(error).__name__}: {str(error).splitlines()[0]}'


def differences(shared: Solution | str, alone: Solution | str) -> Iterator[str]:
    """Yield an exception, or the differences of two solutions."""
    if isinstance(shared, str) or isinstance(alone, str):
        yield from (each for each in (shared, alone) if isinstance(each, str))
    elif shared.status is not alone.status:
        yield (f'{shared.status.value} in one cache ({shared.message}), '
               f'{alone.status.value} alone ({alone.message})')
    elif shared.status is Status.SOLVED and abs(shared.objective - alone.objective) > SAME * max(
            abs(shared.objective), abs(alone.objective), LEAST_COST):
        yield f'cost {shared.objective:.8g} in one cache, {alone.objective:.8g} alone'


if __name__ == '__main__':
    sys.exit(main())
