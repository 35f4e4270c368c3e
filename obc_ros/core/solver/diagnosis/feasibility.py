# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Relaxed problems that minimise the violation of constraints, and which violations remain.

elastic      The cost is the sum of psi_j^2 in place of the terminal constraints.
soft         The cost penalises violations of state bounds and path constraints.

The inputs of a path are also integrated from x(0), independent of its states.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Condition, Solution
from obc_ros.core.ocp.structure import find_switching_inputs
from obc_ros.core.ocp.wording import describe_terminal, format_number, state_bound
from obc_ros.core.solver.adjoint.costates import CostateIntegrator, cut_inputs
from obc_ros.core.solver.proofs.existence import measure_effort

Solver = Callable[[Problem], Solution]
Explanation = Callable[[Solution], str]

# Largest residuals of a certificate for which a solution counts as a path.
FEASIBLE = {Condition.DYNAMICS: 1e-4, Condition.START: 1e-5, Condition.BOUNDS: 1e-4}
_MISSED = 1e-4      # of a constraint's size: above the accuracy of an elastic solution
_EFFORT = 1e-8      # weight of the inputs in problems that do not determine them otherwise


def is_path(solution: Solution, wide: float = FEASIBLE[Condition.BOUNDS]) -> bool:
    """Return whether a solution, optimal or not, is a path; `wide`: largest residual of bounds."""
    return solution.meets(FEASIBLE | {Condition.BOUNDS: wide})


def describe_shortfall(problem: Problem, nearest: Solution) -> str:
    """Return, as text, by how much a path misses the terminal constraints; '' if it meets them."""
    psi = ca.Function('psi', [problem.x, problem.p], [problem.psi])
    values = psi(nearest.x[-1], problem.p_value).full()[:, 0]
    part = np.abs(values) / _sizes(problem)
    parts = []
    # Violations below 1 % of the largest one are not reported.
    for row in map(int, np.flatnonzero(part > max(_MISSED, 1e-2 * part.max(initial=0.0)))):
        wanted = describe_terminal(problem, row)
        name, _, value = wanted.partition(' = ')
        if name in problem.states:
            there = nearest.x[-1, problem.states.index(name)]
            parts.append(f'{name} = {format_number(float(there))} instead of {value}')
        else:
            parts.append(f'{wanted} missed by {format_number(abs(float(values[row])))}')
    return ', '.join(parts)


def relax_terminal(problem: Problem) -> Problem:
    """Return the problem of minimising the violation of the terminal constraints."""
    nearest = replace(problem, L=ca.SX(0), psi=ca.SX(0, 1), structure='',
                      V=ca.sumsqr(problem.psi / _sizes(problem)))
    # Without a cost of inputs, arcs on their bounds are recognised.
    return nearest if problem.boxed.all() and all(find_switching_inputs(nearest)) else replace(
        nearest, L=_EFFORT * measure_effort(problem))


def relax_path_constraints(problem: Problem) -> Problem:
    """Return the problem of minimising the violation of state bounds and path constraints."""
    cost = _EFFORT * measure_effort(problem)
    rows = ca.vertsplit(ca.vertcat(problem.x, problem.path))
    for value, lower, upper in zip(rows, *problem.row_bounds, strict=True):
        size = max((abs(bound) for bound in (lower, upper) if np.isfinite(bound)), default=1.0)
        for bound, excess in ((lower, lower - value), (upper, value - upper)):
            if np.isfinite(bound):
                cost += ca.fmax(excess / (size or 1.0), 0)**2
    unlimited = np.full(problem.n, np.inf)
    return replace(problem, L=cost, V=ca.SX(0), psi=ca.SX(0, 1), path=ca.SX(0, 1), structure='',
                   path_lower=np.zeros(0), path_upper=np.zeros(0), x_lower=-unlimited,
                   x_upper=unlimited)


def _sizes(problem: Problem) -> Array:
    """Return the scale of each terminal constraint, shape (q,)."""
    slope = ca.Function('slope', [problem.x, problem.p],
                        [ca.densify(ca.jacobian(problem.psi, problem.x)), problem.psi])
    psi_x, psi = (value.full() for value in slope(problem.x0, problem.p_value))
    size = np.maximum(np.abs(psi[:, 0]), np.abs(psi_x) @ np.maximum(np.abs(problem.x0), 1e-2))
    return np.where(np.isfinite(size) & (size > 0), size, 1.0)


def find_blocking_bound(problem: Problem, solve: Solver) -> tuple[str, str] | None:
    """Return the first bound without which the terminal constraints are met, and what happens."""
    for name, freed, seen in _without(problem):
        answer = solve(relax_terminal(freed))
        if is_path(answer) and not describe_shortfall(freed, answer):
            return name, seen(answer)
    return None


def _without(problem: Problem) -> Iterator[tuple[str, Problem, Explanation]]:
    """Yield each bound as text, the problem without it, and a description of a path of that."""
    for index in range(problem.n):
        for upper in (True, False):
            bounds = problem.x_upper if upper else problem.x_lower
            if np.isfinite(bounds[index]):
                key = 'x_upper' if upper else 'x_lower'
                yield (f'state bound {state_bound(problem, index, upper)}',
                       remove_bound(problem, key, index),
                       _extreme(problem.states[index], index, upper, 'x'))
    for row in range(problem.path.numel()):
        yield (f'path_constraints[{row}]',
               remove_bound(remove_bound(problem, 'path_lower', row), 'path_upper', row),
               lambda _: 'they can be met')
    for index in range(problem.m):
        for upper in (True, False):
            bound = (problem.u_upper if upper else problem.u_lower)[index]
            if np.isfinite(bound):
                name = problem.inputs[index]
                yield (f'input bound {name} {"<=" if upper else ">="} {format_number(bound)}',
                       remove_bound(problem, 'u_upper' if upper else 'u_lower', index),
                       _extreme(name, index, upper, 'u'))


def remove_bound(problem: Problem, key: str, index: int) -> Problem:
    """Return a problem without one bound."""
    values = getattr(problem, key).copy()
    values[index] = np.inf if key.endswith('upper') else -np.inf
    changed: dict[str, Array] = {key: values}
    # The row of a path constraint without bounds remains, without effect.
    return replace(problem, structure='', **changed)  # type: ignore[arg-type]  # one of the bounds


def _extreme(name: str, index: int, upper: bool, kind: str) -> Explanation:
    def seen(answer: Solution) -> str:
        values = (answer.x if kind == 'x' else answer.u)[:, index]
        k = int(np.argmax(values) if upper else np.argmin(values))
        return f'{name} reaches {values[k]:.4g} at t = {answer.t[k]:.4g}'
    return seen


def describe_broken_bound(problem: Problem, answer: Solution) -> tuple[str, str] | None:
    """Return the bound that a solution of the soft problem violates most, and how, as text."""
    if not is_path(answer):
        return None
    rows, terms = _rows(problem, answer)
    lower, upper = problem.row_bounds
    size = 1e-2 + np.maximum(np.abs(rows).max(axis=0), terms)
    excess = np.maximum(rows - upper, lower - rows) / size
    k, row = np.unravel_index(int(np.argmax(excess)), excess.shape)
    if excess[k, row] <= _MISSED:
        return None
    over = rows[k, row] > upper[row]
    if row < problem.n:
        name = f'state bound {state_bound(problem, int(row), bool(over))}'
    else:
        bound = upper[row] if over else lower[row]
        sign = '<=' if over else '>='
        name = f'path_constraints[{row - problem.n}] {sign} {format_number(bound)}'
    first = int(np.argmax(excess[:, row] > _MISSED))
    return name, (f'the path with the smallest violation found leaves it at '
                  f't = {answer.t[first]:.3g} and has {rows[k, row]:.4g} '
                  f'at t = {answer.t[k]:.4g}')


def _rows(problem: Problem, answer: Solution) -> tuple[Array, Array]:
    """Return x and c at the samples of a solution, and the largest size of their terms."""
    c, z = problem.path, ca.vertcat(problem.x, problem.u)
    terms = ca.mtimes(ca.fabs(ca.jacobian(c, z)), ca.fabs(z))
    path = ca.Function('path', [problem.x, problem.u, problem.p], [c, terms]).map(len(answer.t))
    values, sizes = (np.array(value).T for value in path(
        answer.x.T, answer.u.T, problem.p_value))
    return np.hstack([answer.x, values]), np.append(
        np.abs(answer.x).max(axis=0), sizes.max(axis=0))


def guess_from_inputs(problem: Problem, found: Solution) -> Problem:
    """Return a problem with a guess from integrating the inputs of a path, within its bounds."""
    t = np.linspace(0.0, found.t[-1], 101)
    u = np.clip(interpolate_columns(t, found.t, found.u), problem.u_lower, problem.u_upper)
    x = _led(problem.pin_start(found.x[0]), t, u[:-1], u[1:])
    if not np.isfinite(x).all():
        return problem
    return replace(problem, guess=Guess(
        dict(zip(problem.states, x.T, strict=True)), dict(zip(problem.inputs, u.T, strict=True)),
        float(t[-1]) if problem.final_time.free else None))


def reaches_end(problem: Problem, found: Solution) -> bool:
    """
    Return whether the inputs of a path lead from x(0) nearly to its x(T).

    If each interval is integrated from the stated state at its begin, states can cross points that
    no path crosses, such as x = 0 for x' = x u: the defect is small relative to the size of x.
    """
    ub = found.u[:-1] if found.interpolation == 'zoh' else found.u[1:]
    problem = problem.pin_start(found.x[0])
    end = _led(problem, *cut_inputs(found.t, found.u[:-1], ub, 16))[-1]   # steps per interval
    size = np.abs(found.x).max(axis=0)
    return bool(np.all(np.abs(end - found.x[-1]) <= 1e-2 * np.maximum(size, 1e-2 * size.max())))


def _led(problem: Problem, t: Array, ua: Array, ub: Array) -> Array:
    with np.errstate(all='ignore'):
        return CostateIntegrator(problem).forward(problem, t, ua, ub)[0]
