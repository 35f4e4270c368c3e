# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Minimum time for linear systems: error against exact solutions, and processor time.

Compared with multiple shooting for the double integrator by CasADi and IPOPT, with 50 intervals
and free T; the solver is built for one problem and used once.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Callable
from dataclasses import replace
from math import acos, factorial, sqrt

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.exact.time_optimal import solve_time_optimal

Array = NDArray[np.float64]

INTERVALS = 50
FIRST, AGAIN, SHOOTING = 'first solution', 'again', 'CasADi + IPOPT, shooting'


def main() -> int:
    """Measure and print; return the exit status."""
    timing.arguments('minimum time for linear systems with |u| <= 1')
    accuracy()
    speed()
    return timing.finish()


def question(dynamics: dict[str, str], start: tuple[float, ...]) -> Problem:
    """Return the problem from a start to the origin in minimum time."""
    return build_problem({
        'states': list(dynamics), 'inputs': ['u'], 'dynamics': dynamics, 'running_cost': 1,
        'initial_state': dict(zip(dynamics, start, strict=True)),
        'terminal_constraints': list(dynamics), 'input_bounds': {'u': [-1, 1]},
        'final_time': {'free': True, 'lower': 0.01, 'upper': 50}})


def double_integrator(start: tuple[float, ...]) -> Problem:
    """Return the double integrator."""
    return question({'x': 'v', 'v': 'u'}, start)


def chain(n: int) -> Problem:
    """Return n integrators, from rest at the distance 1."""
    names = [f'x{i}' for i in range(n)]
    return question(dict(zip(names, [*names[1:], 'u'], strict=True)), (1.0, *[0.0] * (n - 1)))


def chain_times(n: int) -> Array:
    """Return switching times and T, from zeros of a Chebyshev polynomial of the second kind."""
    T = (4**(n - 1) * factorial(n - 1))**(1 / n)
    return np.array(T * (1 - np.cos(np.arange(1, n + 1) * np.pi / n)) / 2)


def accuracy() -> None:
    """Compare with exact switching times and T."""
    swing = acos(7 / 8)
    cases: list[tuple[str, Problem, Array, float]] = [
        ('double integrator, (1, 0)', double_integrator((1, 0)), np.array([1, 2.0]), 1e-9),
        ('double integrator, (1, 0.5)', double_integrator((1, 0.5)),
         np.array([0.5 + sqrt(1.125), 0.5 + 2 * sqrt(1.125)]), 1e-9),
        ('harmonic oscillator, (1, 0)', question({'x': 'v', 'v': '-x + u'}, (1, 0)),
         np.array([swing, swing + acos(1 / 4)]), 1e-7),
        *((f'{n} integrators', chain(n), chain_times(n), 1e-7) for n in (3, 4, 5))]
    rows = []
    for name, problem, exact, limit in cases:
        found = solved(problem)
        error = float(np.abs(np.append(found.switching_times, found.objective) - exact).max())
        rows.append((name, f'{found.objective:.12g}', f'{error:.1e}', f'{limit:.0e}',
                     certify(problem, found).holds))
        timing.require(f'{name}: largest error of switching times and T', error, limit)
        timing.require(f'{name}: certificates that do not hold', float(not rows[-1][-1]), 0)
    timing.table('Least time', ('', 'T', 'error', 'limit', 'certified'), rows)


def solved(problem: Problem) -> Solution:
    """Return the solution."""
    found = solve_time_optimal(problem)
    if found is None:
        raise RuntimeError(f'{problem.states}: no solution')
    return found


def speed() -> None:
    """Time the solution of a parsed problem."""
    problem = double_integrator((1, 0.5))
    numbers = iter(range(10**9))   # a new name for each: no cached structure
    rivals: dict[str, Callable[[], object]] = {
        FIRST: lambda: solved(replace(problem, structure=f'first {next(numbers)}')),
        AGAIN: lambda: solved(problem), SHOOTING: shooting}
    times = timing.measure(rivals)
    timing.times_table('Double integrator, (1, 0.5)', times, SHOOTING)
    timing.require('double integrator, first solution [ms]', times[FIRST].median * 1e3, 0.6)
    others = {name: (lambda problem=problem: solved(problem)) for name, problem in (
        ('oscillator, 1 switch', question({'x': 'v', 'v': '-x + u'}, (1, 0))),
        ('oscillator, 16 switches', question({'x': 'v', 'v': '-x + u'}, (30.3, 7))),
        ('3 integrators', chain(3)), ('5 integrators', chain(5)))}
    times = timing.measure(others)
    timing.times_table('Other systems', times, '3 integrators')


def shooting() -> float:
    """Return T of the double integrator by multiple shooting, built and solved."""
    opti = ca.Opti()
    x, u, T = opti.variable(2, INTERVALS + 1), opti.variable(1, INTERVALS), opti.variable()
    h = T / INTERVALS
    opti.minimize(T)
    opti.subject_to(x[:, 0] == [1, 0.5])
    opti.subject_to(x[:, -1] == [0, 0])
    opti.subject_to(x[0, 1:] == x[0, :-1] + h * x[1, :-1] + h**2 / 2 * u)
    opti.subject_to(x[1, 1:] == x[1, :-1] + h * u)
    opti.subject_to(opti.bounded(-1, u, 1))
    opti.subject_to(T >= 0.01)
    opti.set_initial(T, 4)
    opti.solver('ipopt', {'print_time': False}, {'print_level': 0, 'sb': 'yes'})
    return float(opti.solve().value(T))


if __name__ == '__main__':
    sys.exit(main())
