# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Stiff and large linear quadratic problems: time from the statement to the certified solution.

A chain of three states whose time constants span up to six decades, and the heat equation on a rod
of 20, 40, 80 cells that is heated at its end. Compared with CasADi and IPOPT by hand: Radau
collocation of degree 3 on 100 equal intervals, with the options for a quadratic cost and linear
constraints. Its time excludes the construction, and it has no certificate.
"""

import timing  # isort: skip - before numpy

from collections.abc import Callable
import math
import sys

import casadi as ca
import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.solve import solve

Mapping = dict[str, object]

INTERVALS, DEGREE = 100, 3
SECONDS = {'decades 2': 0.1, 'decades 4': 0.1, 'decades 6': 0.1, 'rod 20': 0.1, 'rod 40': 0.3,
           'rod 80': 2.0}


def main() -> int:
    """Measure and print; return the exit status."""
    timing.arguments('stiff and large linear quadratic problems')
    rows: list[tuple[object, ...]] = []
    kept = []
    for title, limit in SECONDS.items():
        kind, size = title.split()
        mapping = decades(10.0**int(size)) if kind == 'decades' else rod(int(size))
        rows += beside(title, mapping, limit, kept)
    timing.table('minimum cost over 1 s, processor time', (
        '', 'median [minimum to maximum]', 'cost', 'worst residual, samples'), rows)
    for what, value, limit in kept:
        timing.require(what, value, limit)
    return timing.finish()


def decades(ratio: float) -> Mapping:
    """Return a chain of three states, the fastest `ratio` times as fast as the slowest."""
    middle = math.sqrt(ratio)
    return stated({'a': 'b - a', 'b': f'{middle}*(c - b)', 'c': f'{ratio}*(u - c)'},
                  'a**2 + b**2 + c**2 + u**2', {'a': 1, 'b': 1, 'c': 1})


def rod(cells: int) -> Mapping:
    """Return the heat equation on a rod, cold at its left end, heated at its right end."""
    names = ['0', *(f'y{k}' for k in range(1, cells + 1)), 'u']
    rate, inner = (cells + 1)**2, names[1:-1]
    return stated(
        {names[k]: f'{rate}*({names[k - 1]} - 2*{names[k]} + {names[k + 1]})'
         for k in range(1, cells + 1)},
        f'({" + ".join(f"{name}**2" for name in inner)})/{cells} + 0.01*u**2',
        {name: math.sin(math.pi * k / (cells + 1)) for k, name in enumerate(inner, 1)})


def stated(dynamics: dict[str, str], cost: str, start: dict[str, float]) -> Mapping:
    """Return a problem with one input over 1 s."""
    return {'states': list(dynamics), 'inputs': ['u'], 'dynamics': dynamics,
            'running_cost': cost, 'initial_state': start,
            'final_time': {'free': False, 'value': 1}}


def beside(title: str, mapping: Mapping, limit: float, kept: list[tuple[str, float, float]]
           ) -> list[tuple[object, ...]]:
    """Return the rows of a problem, and check its requirements."""
    problem = build_problem(mapping)
    collocated, answers = by_hand(problem), list[Solution]()

    def answer() -> None:
        answers.append(solve(build_problem(mapping)))

    times = timing.measure({'ours': answer, 'IPOPT': collocated}, rounds=7, least=0.0)
    found, cost = answers[-1], collocated()
    worst = found.certificate.residuals[found.certificate.worst] if found.certificate else math.inf
    kept.append((f'{title}: seconds', times['ours'].median, limit))
    kept.append((f'{title}: status other than solved', found.status is not Status.SOLVED, 0))
    return [(f'{title}: statement to certificate', times['ours'], f'{found.objective:.9g}',
             f'{worst:.1e}, {len(found.t)}'),
            (f'{title}: IPOPT by hand, again', times['IPOPT'], f'{cost:.9g}', '')]


def by_hand(problem: Problem) -> Callable[[], float]:
    """Return a function that solves a problem by collocation, as a user of CasADi writes it."""
    h, n = problem.final_time.value / INTERVALS, problem.n
    roots = ca.collocation_points(DEGREE, 'radau')
    C, D, B = (np.array(part) for part in ca.collocation_coeff(roots))
    f = ca.Function('f', [problem.x, problem.u], [problem.f, problem.L])
    X = [ca.MX.sym(f'x{k}', n, DEGREE) for k in range(INTERVALS)]
    U = [ca.MX.sym(f'u{k}', 1, DEGREE) for k in range(INTERVALS)]
    last, g, J = ca.MX(ca.DM(problem.x0)), [], ca.MX(0)
    for x, u in zip(X, U, strict=True):
        rate, cost = f.map(DEGREE)(x, u)
        g.append(ca.vec(ca.mtimes(ca.horzcat(last, x), ca.DM(C)) - h*rate))
        J += h * ca.mtimes(cost, ca.DM(B))
        last = x[:, -1]
    w = ca.vertcat(*(ca.vertcat(ca.vec(x), ca.vec(u)) for x, u in zip(X, U, strict=True)))
    solver = ca.nlpsol('hand', 'ipopt', {'x': w, 'f': J, 'g': ca.vertcat(*g)}, {
        'print_time': False, 'expand': True, 'ipopt': {
            'print_level': 0, 'sb': 'yes', 'jac_c_constant': 'yes', 'hessian_constant': 'yes'}})
    return lambda: float(solver(x0=0, lbg=0, ubg=0)['f'])


if __name__ == '__main__':
    sys.exit(main())
