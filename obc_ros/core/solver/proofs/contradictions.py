# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Proofs that parts of a problem exclude each other, found without solving it.

The checks compare

- the initial state with its bounds and path constraints;
- terminal constraints with each other, with state bounds and with path constraints;
- states on which no input acts, and uncontrollable modes of a linear system, with the constraints
  on them;
- the minimum time of a linear system with bounded inputs with the available time.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask, optimize
from obc_ros.core.numerics.enclosures.interval_arithmetic import (
    add_intervals,
    enclose_outputs,
    Interval,
    multiply_intervals,
)
from obc_ros.core.numerics.instructions import find_dependence
from obc_ros.core.numerics.rational_polynomials import convert_to_rational, find_null_space
from obc_ros.core.ocp.affine_constraints import End, find_affine_end, find_affine_rows
from obc_ros.core.ocp.certificate.certificate import COUNTS_AS_MET
from obc_ros.core.ocp.least_time_form import find_affine_dynamics
from obc_ros.core.ocp.problem import FinalTime, Problem
from obc_ros.core.ocp.solution import Status
from obc_ros.core.ocp.wording import describe_terminal, format_number, state_bound
from obc_ros.core.solver.exact.time_optimal import solve_time_optimal
from obc_ros.core.solver.proofs.interval_bounds import find_unsatisfiable
from obc_ros.core.solver.proofs.invariants import find_changed_invariants
from obc_ros.core.solver.proofs.uncontrolled_states import (
    find_missed_combinations,
    find_missed_states,
    make_dense,
)

_ROUNDING = 1e-9   # of a state that exact arithmetic has found


def explain_contradiction(problem: Problem) -> str:
    """Return the first contradiction between parts of a problem as a sentence; '' without one."""
    return next((sentence for check in CONTRADICTIONS for sentence in check(problem)), '')


def _at_start(problem: Problem) -> Iterator[str]:
    lowest, highest = problem.start_box
    for index, name in enumerate(problem.states):
        for upper, value, sign, excess in (
                (True, lowest[index], '>=', lowest[index] - problem.x_upper[index]),
                (False, highest[index], '<=', problem.x_lower[index] - highest[index])):
            if excess > COUNTS_AS_MET * (1 + abs(value)):
                sign = '=' if problem.given_at_start[index] else sign
                yield (f'initial state {name} {sign} {format_number(value)} and state bound '
                       f'{state_bound(problem, index, upper)} exclude each other')
    yield from _path_at(problem, problem.start_box, 'at the initial state',
                        np.ones(problem.n, bool))


def _path_at(problem: Problem, box: tuple[Array, Array], where: str, known: Mask
             ) -> Iterator[str]:
    """Yield path constraints that no input satisfies in a box of states; `known`: which count."""
    rate = ca.jacobian(problem.path, problem.u)
    symbols = [problem.x, problem.u, problem.p]
    p, u = (problem.p_value, problem.p_value), (problem.u_lower, problem.u_upper)
    middle = np.clip(np.zeros(problem.m), *u)
    for row in range(problem.path.numel()):
        uses = find_dependence(problem.path[row], problem.x)[0]
        if ca.depends_on(rate[row, :], problem.u) or not known[uses].all():
            continue
        # The constraint is affine in u: its value at one input and its slopes give its range.
        [value] = enclose_outputs(ca.Function('value', symbols, [problem.path[row]]),
                                  [box, (middle, middle), p])
        slopes = enclose_outputs(ca.Function('slopes', symbols, [ca.densify(rate[row, :]).T]),
                                 [box, (middle, middle), p])
        total, fixed = value, True
        for k, slope in enumerate(slopes):
            if slope.low or slope.high:
                fixed = False
                total = add_intervals(total, multiply_intervals(slope, add_intervals(
                    Interval(float(u[0][k]), float(u[1][k])),
                    Interval(-float(middle[k]), -float(middle[k])))))
        slack = COUNTS_AS_MET * (1 + max(abs(value.low), abs(value.high)))
        for excess, sign, bound, seen in (
                (total.low - problem.path_upper[row], '<=', problem.path_upper[row], total.low),
                (problem.path_lower[row] - total.high, '>=', problem.path_lower[row],
                 total.high)):
            if excess > slack:
                extent = 'is' if fixed else 'is at least' if sign == '<=' else 'is at most'
                yield (
                    f'path_constraints[{row}] {extent} {format_number(seen)} {where} but must '
                    f'be {sign} {format_number(bound)}')


def _at_end(problem: Problem) -> Iterator[str]:
    end = find_affine_end(problem)
    if end is None:
        return
    for row, (*slopes, b) in zip(end.rows, make_dense(
            end.rows.values(), problem.n + 1).astype(float), strict=True):
        a = np.array(slopes)
        used = a != 0
        ends = a[used] * np.array([problem.x_lower, problem.x_upper])[:, used]
        low, high = b + ends.min(axis=0).sum(), b + ends.max(axis=0).sum()
        slack = COUNTS_AS_MET * (1 + abs(b) + np.abs(ends[np.isfinite(ends)]).sum())
        if low > slack or high < -slack:
            blamed = [state_bound(problem, k, bool((a[k] < 0) == (low > slack)))
                      for k in map(int, np.flatnonzero(a))]
            plural = 's' * (len(blamed) > 1)
            yield (f'state bound{plural} {", ".join(blamed)} and terminal constraint '
                   f'{describe_terminal(problem, row)} exclude each other')
    if end.clash is not None and abs(float(end.clash.gap)) > COUNTS_AS_MET * sum(
            abs(float(weight)) * (1 + abs(float(end.rows[k].get(problem.n, 0))))
            for k, weight in end.clash.weights.items()):
        names = [describe_terminal(problem, k) for k in sorted(end.clash.weights)]
        yield (f'{names[0]} holds at no state' if len(names) == 1 else
               f'terminal constraints {", ".join(names[:-1])} and {names[-1]} exclude each other')
    yield from _where_pinned(problem, end)
    yield from _together_against_bounds(problem, end)


def _box(end: End) -> tuple[Array, Array]:
    """Return a small box around a state that satisfies the affine terminal constraints."""
    x = np.array([float(value) for value in end.x])
    return x - _ROUNDING * (1 + np.abs(x)), x + _ROUNDING * (1 + np.abs(x))


def _where_pinned(problem: Problem, end: End) -> Iterator[str]:
    """Yield nonlinear terminal constraints that are violated wherever the affine ones hold."""
    if not end.is_clear or len(end.rows) == problem.q:
        return
    pinned, box = end.pinned(), _box(end)
    x = 0.5 * (box[0] + box[1])
    for row in set(range(problem.q)) - set(end.rows):
        used = find_dependence(problem.psi[row], problem.x)[0]
        if not pinned[used].all():
            continue
        psi = ca.Function('psi', [problem.x, problem.p], [problem.psi[row]])
        [value] = enclose_outputs(psi, [box, (problem.p_value, problem.p_value)])
        size = COUNTS_AS_MET * (1 + float(np.abs(x).max()))**2
        if value.low > size or value.high < -size:
            where = ', '.join(f'{name} = {format_number(float(x[index]))}'
                              for index, name in enumerate(problem.states) if used[index])
            yield (
                f'{problem.ends[row]} is {format_number(0.5 * (value.low + value.high))} '
                f'and not 0 where the other terminal constraints hold ({where})')


def _together_against_bounds(problem: Problem, end: End) -> Iterator[str]:
    """
    Yield affine terminal constraints that no state within its bounds satisfies together.

    The residual of a bounded least squares problem suggests a weighted sum of them. It is a proof
    if states without a bound on the relevant side do not appear in the sum and the sum is above
    0 for all states within their bounds, by a margin (J. Farkas, 1902).
    """
    finite = np.isfinite(problem.x_lower) | np.isfinite(problem.x_upper)
    if len(end.rows) < 2 or not finite.any() or np.any(problem.x_lower >= problem.x_upper):
        return
    n, exact = problem.n, make_dense(end.rows.values(), problem.n + 1)
    A, b = exact[:, :n].astype(float), exact[:, n].astype(float)
    unit = 1 / np.maximum(np.abs(A).max(axis=1), 1e-300)
    nearest = optimize.lsq_linear(
        A * unit[:, None], -b * unit, (problem.x_lower, problem.x_upper), tol=1e-12)
    y = unit * (A * unit[:, None] @ nearest.x + b * unit)
    kept = nearest.active_mask != 0
    free = [k for k in range(n) if not kept[k] and not np.isfinite(
        [problem.x_lower[k], problem.x_upper[k]]).all()]
    basis = make_dense(find_null_space([{j: value for j, value in enumerate(exact[:, k]) if value}
                                        for k in free], len(exact)), len(exact))
    if not len(basis) or not np.isfinite(y).all() or not y.any():
        return
    parts = np.linalg.lstsq(basis.T.astype(float), y, rcond=None)[0]
    weights = np.array([convert_to_rational(part) for part in parts], dtype=object) @ basis
    total = weights @ exact
    terms = [float(each) * (low if each > 0 else high) for each, low, high in zip(
        total, problem.x_lower, problem.x_upper, strict=False) if each]
    reach = np.abs(np.where(np.isfinite([problem.x_lower, problem.x_upper]),
                            [problem.x_lower, problem.x_upper], 0.0)).max(axis=0)
    size = np.abs(weights.astype(float)) @ (np.abs(A) @ reach + np.abs(b))
    if sum(terms) + float(total[n]) > COUNTS_AS_MET * size:
        names = ', '.join(describe_terminal(problem, row) for row, weight in zip(
            end.rows, weights, strict=True) if weight)
        bounds = ', '.join(
            state_bound(problem, i, bool(nearest.active_mask[i] > 0))
            for i in map(int, np.flatnonzero(nearest.active_mask)))
        yield f'state bounds {bounds} and terminal constraints {names} exclude each other'


def _path_at_end(problem: Problem) -> Iterator[str]:
    end = find_affine_end(problem) if problem.path.numel() else None
    if end is None or not end.is_clear:
        return
    pinned = end.pinned()
    yield from _path_at(
        problem, _box(end), 'at the state that the terminal constraints demand', pinned)
    yield from _in_between(problem, np.array([float(value) for value in end.x]), pinned)


def _in_between(problem: Problem, end: Array, pinned: Mask) -> Iterator[str]:
    """Yield constraints on one state that are violated at a value which this state must pass."""
    path = ca.Function('path', [problem.x, problem.u, problem.p], [problem.path])
    uses = find_dependence(problem.path, ca.vertcat(problem.x, problem.u))
    for row in np.flatnonzero(uses.sum(axis=1) == 1):
        index = int(np.argmax(uses[row]))
        if index >= problem.n or not pinned[index] or not problem.given_at_start[index]:
            continue
        count = 1001   # of values between its ends
        x = np.tile(problem.x0, (count, 1))
        x[:, index] = np.linspace(problem.x0[index], end[index], count)
        c = path.map(count)(x.T, np.zeros((problem.m, count)), problem.p_value).full()[row]
        excess = np.maximum(c - problem.path_upper[row], problem.path_lower[row] - c)
        worst = int(np.argmax(np.where(np.isfinite(excess), excess, -np.inf)))
        if excess[worst] > COUNTS_AS_MET * (1 + np.abs(c[np.isfinite(c)]).max(initial=0.0)):
            sign, bound = (('<=', problem.path_upper[row]) if c[worst] > problem.path_upper[row]
                           else ('>=', problem.path_lower[row]))
            name = problem.states[index]
            yield (f'path_constraints[{row}] is {format_number(float(c[worst]))} at {name} = '
                   f'{format_number(float(x[worst, index]))} but must be {sign} '
                   f'{format_number(bound)}, and {name} must pass this value on its way from '
                   f'{format_number(problem.x0[index])} to {format_number(float(end[index]))}')


def _too_soon(problem: Problem) -> Iterator[str]:
    """Yield the minimum time of a linear system with bounded inputs if less time is available."""
    if problem.start is not None or not problem.q:
        return
    *_, affine = find_affine_rows(problem)
    if not affine.any() or not problem.boxed.all() or (
            find_affine_dynamics(problem) is None):
        return
    unlimited, none = np.full(problem.n, np.inf), np.zeros(0)
    within = FinalTime(free=True, lower=0.0, upper=problem.final_time.latest)
    found = solve_time_optimal(replace(
        problem, L=ca.SX(1), V=ca.SX(0), psi=problem.psi[np.flatnonzero(affine).tolist()],
        path=ca.SX(0, 1), path_lower=none, path_upper=none, x_lower=-unlimited,
        x_upper=unlimited, final_time=within, structure=''))
    if found is not None and found.status is Status.INFEASIBLE:
        more = problem.constrained or not affine.all()
        yield f'{found.message}{", without regard to the other constraints" if more else ""}'


CONTRADICTIONS: tuple[Callable[[Problem], Iterator[str]], ...] = (
    _at_start, _at_end, _path_at_end, find_missed_states, find_missed_combinations, _too_soon,
    find_unsatisfiable, find_changed_invariants)
