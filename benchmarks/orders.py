# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
All problem files in shuffled orders, each order in one cache.

Each problem is also solved alone. Requirements: no exception, equal verdicts, and certified costs
that differ by no more than the certificates allow. An answer that the time limit has cut short
depends on the machine: it is counted and not compared.
"""

import timing  # isort: skip - before numpy

import sys
import traceback
from typing import Any

import numpy as np
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
from repeats import differences, PROBLEMS

LATE = 0.9   # of the time limit: later answers may be those of the limit


def main() -> int:
    """Solve, compare and print; return the exit status."""
    args = timing.arguments('orders of all problem files in one cache', orders=3, seed=0,
                            limit=10.0, first=0, last=10**6)
    problems = {mapping['name']: mapping
                for file in sorted(PROBLEMS.glob('*.yaml'))[args.first:args.last]
                for mapping in load_file(file)}
    alone = {name: answer(mapping, Cache(), args.limit) for name, mapping in problems.items()}
    compared = [name for name, found in alone.items() if not is_late(found, args.limit)]
    print(f'  {len(compared)} of {len(problems)} problems are answered alone within '
          f'{LATE * args.limit:g} s', flush=True)
    faults = late = 0
    for number in range(args.orders):
        order = np.random.default_rng(args.seed + number).permutation(compared).tolist()
        cache = Cache()
        for place, name in enumerate(order):
            found = answer(problems[name], cache, args.limit)
            if is_late(found, args.limit):
                late += 1
                continue
            for words in differences(found, alone[name]):
                faults += 1
                print(f'  order {args.seed + number}, {name}, after '
                      f'{", ".join(order[max(0, place - 3):place])}: {words}', flush=True)
    print(f'  {late} answers were cut short by the time limit')
    timing.require(f'{len(compared)} problems in {args.orders} orders, differences', faults, 0)
    return timing.finish()


def answer(mapping: dict[str, Any], cache: Cache, limit: float) -> Solution | str:
    """Return the solution of a problem within a time limit [s], or the exception."""
    try:
        return solve(build_problem(mapping), cache=cache, time_limit=limit)
    except Exception as error:  # exceptions of any kind are results here
        traceback.print_exc()
        return f'{type(error).__name__}: {str(error).splitlines()[0]}'


def is_late(found: Solution | str, limit: float) -> bool:
    """Return whether the time limit [s] may have decided an answer."""
    return not isinstance(found, str) and (
        found.status is Status.TIMED_OUT or found.solve_time > LATE * limit)


if __name__ == '__main__':
    sys.exit(main())
