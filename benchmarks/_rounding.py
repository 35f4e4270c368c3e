# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A process of benchmarks/rounding.py: ``python _rounding.py SECONDS SEED FILE...``.

Prints a line of JSON for each file: its name, the status and the cost. A SEED above 0 changes
every number of the statement.
"""

import timing  # isort: skip - before numpy

from dataclasses import replace
import json
from pathlib import Path
import sys

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.ocp.problem import FinalTime, Problem
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.solve import solve

CHANGE = 1e-12   # largest relative change
BOUNDS = 'x_lower', 'x_upper', 'u_lower', 'u_upper', 'path_lower', 'path_upper'


class Changed:
    """Numbers times 1 + CHANGE r, r uniform in [-1, 1]; numbers of equal size get the same r."""

    def __init__(self, seed: int) -> None:
        self._chance = np.random.default_rng(seed)
        self._known: dict[float, float] = {}

    def number(self, value: float) -> float:
        """Return a changed number."""
        factor = self._known.setdefault(abs(value), 1 + CHANGE * self._chance.uniform(-1, 1))
        return value * factor

    def numbers(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return changed numbers."""
        return np.array([self.number(value) for value in values.tolist()])

    def problem(self, problem: Problem) -> Problem:
        """Return a problem with changed parameters and changed numbers in its expressions."""
        time = problem.final_time
        return replace(
            problem, p_value=self.numbers(problem.p_value), x0=self.numbers(problem.x0),
            final_time=FinalTime(
                time.free, self.number(time.value), self.number(time.lower),
                self.number(time.upper), time.guess),
            **{name: self.numbers(getattr(problem, name)) for name in BOUNDS})


def main() -> None:
    """Solve the problems and print their results."""
    assert timing
    seconds, seed = float(sys.argv[1]), int(sys.argv[2])
    for file in map(Path, sys.argv[3:]):
        problem = build_problem(load_file(file)[0])
        found = solve(Changed(seed).problem(problem) if seed else problem, time_limit=seconds)
        print(json.dumps({'name': file.stem, 'status': found.status.value,
                          'cost': float(found.objective)}), flush=True)


if __name__ == '__main__':
    main()
