# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Proofs that states or modes on which no input acts violate their constraints.

States on which no input acts, directly or through other states, form an autonomous system. If
dx/dt = A x + B u + c, so do the combinations w'x with w'A^k B = 0 for all k; exact arithmetic
finds them. Their values are enclosed (`taylor_enclosure`) for all admissible final times.
"""

from collections.abc import Iterable, Iterator
from fractions import Fraction
from math import inf, nextafter

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array, Index, Mask
from obc_ros.core.numerics.enclosures.interval_arithmetic import (
    add_intervals,
    enclose_outputs,
    Interval,
    multiply_intervals,
)
from obc_ros.core.numerics.enclosures.taylor_enclosure import Box, TaylorStep, Tube
from obc_ros.core.numerics.instructions import find_dependence
from obc_ros.core.numerics.rational_polynomials import (
    convert_to_rational,
    find_null_space,
    RationalRow,
    read_polynomials,
    reduce_rows,
    split_affine,
    TooHardError,
)
from obc_ros.core.ocp.affine_constraints import find_affine_end
from obc_ros.core.ocp.certificate.certificate import COUNTS_AS_MET
from obc_ros.core.ocp.least_time_form import find_affine_dynamics
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.wording import describe_terminal, format_number, state_bound

Exact = NDArray[np.object_]   # of rational numbers


def find_missed_states(problem: Problem) -> Iterator[str]:
    """Yield violated constraints on states on which no input acts, as sentences."""
    if problem.start is not None:
        return
    driven = _driven(problem)
    uses = find_dependence(problem.psi, problem.x)
    bounded = np.isfinite(problem.x_lower) | np.isfinite(problem.x_upper)
    decided = ~uses[:, driven].any(axis=1)
    if driven.all() or not (bounded[~driven].any() or decided.any()):
        return
    alone = np.flatnonzero(~driven)
    symbols, x0 = problem.x[alone.tolist()], problem.x0[alone]
    p = problem.p_value, problem.p_value
    fixed = ca.DM(np.clip(np.zeros(problem.m), problem.u_lower, problem.u_upper))
    rates = ca.substitute(   # inputs in these have only one value
        ca.densify(problem.f[alone.tolist()]), problem.u, fixed)
    steps = list(Tube(symbols, problem.p, rates, p).steps((x0, x0), _stops(problem)))
    boxes = _boxes_at_the_end(problem, steps)
    nothing = 'no input' if (problem.u_lower < problem.u_upper).all() else (
        'no input that can vary')
    yield from _left(problem, alone, steps, nothing)
    for row in map(int, np.flatnonzero(decided)):
        psi = ca.Function('psi', [symbols, problem.p], [ca.densify(problem.psi[row])])
        values = [enclose_outputs(psi, [box, p])[0] for box in boxes]
        names = [problem.states[k] for k in np.flatnonzero(uses[row])]
        where = None
        if len(names) == 1 and steps:
            k = int(np.searchsorted(alone, problem.states.index(names[0])))
            where = float(0.5 * (steps[-1].after[0][k] + steps[-1].after[1][k]))
        yield from _missed(problem, f'{nothing} acts on {", ".join(names)}',
                           describe_terminal(problem, row), values, where,
                           _terms(psi, boxes, p))


def _left(problem: Problem, alone: Index, steps: list[TaylorStep], nothing: str) -> Iterator[str]:
    """Yield bounds that states violate by the first admissible T."""
    earliest = problem.final_time.earliest
    for k, index in enumerate(map(int, alone)):
        for upper in (True, False):
            for step in steps:
                low, high = step.after[0][k], step.after[1][k]
                excess = (low - problem.x_upper[index] if upper
                          else problem.x_lower[index] - high)
                size = 1 + max(abs(low), abs(high))
                if step.end <= earliest and excess > COUNTS_AS_MET * size:
                    yield (f'{nothing} acts on {problem.states[index]}: it violates state bound '
                           f'{state_bound(problem, index, upper)} by t = {step.end:.6g}')
                    break


def find_missed_combinations(problem: Problem) -> Iterator[str]:
    """Yield violated terminal constraints on uncontrollable modes of a linear system."""
    n = problem.n
    if not problem.m or problem.start is not None or n > 12 or (
            find_affine_dynamics(problem) is None):
        return
    end = find_affine_end(problem)
    if end is None or end.clash is not None:
        return
    try:
        W, A, c = _uncontrollable(problem)
    except TooHardError:
        return
    numbers = list(end.rows)
    # Combinations eta'C of terminal constraints that are also combinations omega'W.
    columns = [{k: value for k, value in end.rows[number].items() if k < n}
               for number in numbers] + [{k: -value for k, value in w.items()} for w in W]
    both = find_null_space([{j: column[k] for j, column in enumerate(columns) if k in column}
                            for k in range(n)], len(columns))
    steps: list[TaylorStep] | None = None
    for vector in both:
        eta = {numbers[j]: value for j, value in vector.items() if j < len(numbers)}
        omega = {j - len(numbers): value for j, value in vector.items() if j >= len(numbers)}
        if not eta or not omega:
            continue
        if steps is None:
            steps = _modes_alone(problem, W, A, c)
        size = float(sum(value * value for value in eta.values())) ** 0.5
        rest = sum((value * end.rows[k].get(n, Fraction(0)) for k, value in eta.items()),
                   Fraction(0))
        boxes = _boxes_at_the_end(problem, steps)
        values = [multiply_intervals(_dot(omega, rest, box), Interval(1 / size, 1 / size))
                  for box in boxes]
        terms = abs(float(rest)) / size + max((sum(
            abs(float(value)) * float(max(abs(low[k]), abs(high[k])))
            for k, value in omega.items()) / size for low, high in boxes), default=0.0)
        yield from _missed(problem, f'no input acts on {_names(A)} of A',
                           ' with '.join(describe_terminal(problem, k) for k in eta), values,
                           None, terms)


def _missed(problem: Problem, reason: str, wanted: str, values: list[Interval],
            there: float | None, terms: float) -> Iterator[str]:
    """Yield a sentence if `values`, which must be 0, exclude 0 at all admissible final times."""
    if not values:
        return
    size = COUNTS_AS_MET * (1 + terms + max(max(abs(each.low), abs(each.high)) for each in values))
    if not (all(each.low > size for each in values) or all(each.high < -size for each in values)):
        return
    final = problem.final_time
    if final.free:
        yield (f'{reason}: {wanted} holds at no T from {format_number(final.lower)} to '
               f'{format_number(final.upper)}')
    elif there is not None:
        yield (f'{reason}: at T = {format_number(final.value)} it is {format_number(there)}, and '
               f'the terminal constraint {wanted} cannot be met')
    else:
        missed = abs(0.5 * (values[-1].low + values[-1].high))
        yield (f'{reason}: at T = {format_number(final.value)} the terminal constraint {wanted} '
               f'is missed by {format_number(missed)}')


def _boxes_at_the_end(problem: Problem, steps: list[TaylorStep]) -> list[Box]:
    """Return boxes for all admissible final times; none if the enclosure ends earlier."""
    final = problem.final_time
    if not steps or steps[-1].end < final.latest:
        return []
    if not final.free:
        return [steps[-1].after]
    return [step.during for step in steps if step.end > final.lower] or [steps[-1].after]


def _terms(psi: ca.Function, boxes: list[Box], p: Box) -> float:
    """Return the size of the terms of a terminal constraint, which may cancel."""
    found = 0.0
    y, q = ca.SX.sym('y', psi.size1_in(0)), ca.SX.sym('q', psi.size1_in(1))
    slopes = ca.Function('slopes', [y, q], [ca.densify(ca.jacobian(psi(y, q), y)).T])
    for box in boxes:
        most = np.maximum(np.abs(box[0]), np.abs(box[1]))
        each = [max(abs(one.low), abs(one.high)) for one in enclose_outputs(slopes, [box, p])]
        found = max(found, float(most @ np.array(each)))
    return found


def _stops(problem: Problem) -> Array:
    """Return increasing times up to the last admissible final time."""
    earliest, last = problem.final_time.earliest, problem.final_time.latest
    stops = np.unique(np.concatenate([
        np.linspace(0.0, earliest, 17), np.linspace(earliest, last, 33)]))   # steps, at least
    return np.asarray(stops[stops > 0])


def _uncontrollable(problem: Problem) -> tuple[list[RationalRow], Exact, Exact]:
    """
    Return combinations y = W x on which no input acts, and A, c of dy/dt = A y + c.

    :raises TooHardError: if dx/dt is not affine in exact arithmetic.
    """
    n, movable = problem.n, problem.u_lower < problem.u_upper
    f = ca.Function('f', [problem.x, problem.u, problem.p], [ca.densify(problem.f)])
    held = [None if moves else float(low)
            for moves, low in zip(movable, problem.u_lower, strict=True)]
    parts = [split_affine(each, n + int(movable.sum())) for each in read_polynomials(
        f, [[None] * n, held, problem.p_value])[1]]
    rows = [[*part[0], part[1]] for part in parts if part]
    if len(rows) < n:
        raise TooHardError
    all_rows = np.array(rows, dtype=object)
    A, B, c = all_rows[:, :n], all_rows[:, n:-1], all_rows[:, -1]
    moved: list[RationalRow] = []   # independent columns of B, A B, A^2 B, ...
    columns = B.T
    for _ in range(n):
        before = len(moved)
        more = [{k: value for k, value in enumerate(column) if value} for column in columns]
        moved = list(reduce_rows([*moved, *more])[0].values())
        if len(moved) == before:
            break
        columns = make_dense(moved, n) @ A.T
    W = find_null_space(moved, n)
    own = [next(iter(w)) for w in W]   # each row of W has 1 where the others have 0
    matrix = make_dense(W, n)
    return W, (matrix @ A)[:, own], matrix @ c


def make_dense(rows: Iterable[RationalRow], n: int) -> Exact:
    """Return rows of n rational numbers as a matrix."""
    return np.array([[row.get(k, Fraction(0)) for k in range(n)] for row in rows],
                    dtype=object).reshape(-1, n)


def _modes_alone(problem: Problem, W: list[RationalRow], A: Exact, c: Exact
                 ) -> list[TaylorStep]:
    """Return an enclosure of y = W x."""
    y, places = ca.SX.sym('y', len(W)), list(zip(*np.nonzero(A), strict=True))
    values = [*A[A != 0], *c]
    p, g = ca.SX.sym('p', len(values)), ca.SX(len(W), 1)
    for number, (i, j) in enumerate(places):
        g[int(i)] += p[number] * y[int(j)]
    g += p[len(places):]
    x0 = [convert_to_rational(value) for value in problem.x0]
    start = _around([*(make_dense(W, problem.n) @ np.array(x0, dtype=object))])
    return list(Tube(y, p, ca.densify(g), _around(values)).steps(start, _stops(problem)))


def _enclose(value: Fraction) -> Interval:
    """Return doubles below and above a rational number."""
    return Interval(nextafter(float(value), -inf), nextafter(float(value), inf))


def _around(values: list[Fraction]) -> Box:
    low, high = np.array([_enclose(value) for value in values]).T
    return low, high


def _dot(weights: RationalRow, rest: Fraction, box: Box) -> Interval:
    total = _enclose(rest)
    for k, value in weights.items():
        total = add_intervals(total, multiply_intervals(
            _enclose(value), Interval(float(box[0][k]), float(box[1][k]))))
    return total


def _names(A: Exact) -> str:
    """Return the modes of y' = A y as text."""
    values = sorted(np.linalg.eigvals(A.astype(float)), key=lambda s: (-s.real, s.imag))
    shown = [f'{s.real + 0.0:+.4g}' + (f' {s.imag:+.4g}j' if abs(s.imag) > 1e-9 else '')
             for s in values]
    return f'the mode{"s" * (len(shown) > 1)} at {", ".join(shown)}'


def _driven(problem: Problem) -> Mask:
    """Return on which states an input acts, directly or through other states, shape (n,)."""
    movable = problem.u_lower < problem.u_upper
    driven = find_dependence(problem.f, problem.u)[:, movable].any(axis=1)
    through = find_dependence(problem.f, problem.x)
    for _ in range(problem.n):
        driven = driven | (through & driven).any(axis=1)
    return np.asarray(driven)
