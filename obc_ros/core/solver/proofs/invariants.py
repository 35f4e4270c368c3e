# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Invariants of the dynamics: quadratic polynomials of the states that no input changes.

Examples are the norm of a quaternion and the size of a closed population. A polynomial c'phi(x)
is invariant if c'(dphi/dx) f(x, u) = 0 for all x and u. Its value at the end counts if it is
constant on the set that the affine terminal constraints define.

Both conditions are linear in c. Derivatives at random states and inputs suggest the monomials.
The proof is exact: derivatives and values of these monomials are polynomials with rational
coefficients (`rational_polynomials`), and c is a vector of their null space.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import combinations_with_replacement
from math import prod

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.rational_polynomials import (
    Algebra,
    convert_to_rational,
    find_null_space,
    make_constant,
    Polynomial,
    RationalRow,
    read_polynomials,
    TooHardError,
)
from obc_ros.core.ocp.affine_constraints import End, find_affine_end
from obc_ros.core.ocp.certificate.certificate import COUNTS_AS_MET
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.wording import describe_sum

StateMonomial = tuple[int, ...]


def find_changed_invariants(problem: Problem) -> Iterator[str]:
    """Yield the invariants whose value at the end differs from that at the start, as sentences."""
    states = range(problem.n)
    if not problem.q or problem.n > 24 or problem.start is not None:   # not too large
        return
    end = find_affine_end(problem)
    if end is None or not end.is_clear:
        return
    f = ca.Function('f', [problem.x, problem.u, problem.p], [ca.densify(problem.f)])
    held = [float(low) if low == high else None
            for low, high in zip(problem.u_lower, problem.u_upper, strict=True)]
    linear: list[StateMonomial] = [(i,) for i in states]
    try:
        # The first symbols are the states.
        rates = read_polynomials(f, [[None] * problem.n, held, problem.p_value])
    except TooHardError:
        return
    for candidates in (linear, [*linear, *combinations_with_replacement(states, 2)]):
        monomials = _suggest(problem, candidates)
        try:
            found = _find_invariants(end, rates, monomials)
        except TooHardError:
            continue
        for c in found:
            yield from _compared(problem, end, c, monomials)


@np.errstate(all='ignore')   # the dynamics may be undefined at some points
def _suggest(problem: Problem, monomials: list[StateMonomial]) -> list[StateMonomial]:
    """Return the monomials in sums that hardly change at random states and inputs."""
    rng, count = np.random.default_rng(5), 3 * len(monomials)
    x = problem.x0 + (1 + np.abs(problem.x0)) * rng.uniform(-1, 1, (count, problem.n))
    u = _draw_inputs(problem, rng, count)
    f = ca.Function('f', [problem.x, problem.u, problem.p], [problem.f]).map(count)(
        x.T, u.T, problem.p_value).full().T
    rates = np.column_stack([
        sum(f[:, i] * np.prod(x[:, each[:k] + each[k + 1:]], axis=1)
            for k, i in enumerate(each)) for each in monomials])
    rates = rates[np.isfinite(rates).all(axis=1)]
    if len(rates) < 2 * len(monomials):
        return []
    for axis in (0, 1):
        rates = rates / np.maximum(np.abs(rates).max(axis=axis, keepdims=True), 1e-300)
    _, values, V = np.linalg.svd(rates)
    null = V[np.sum(values > 1e-10 * values.max(initial=1.0)):]   # up to rounding
    return [each for each, size in zip(monomials, np.abs(null).max(axis=0, initial=0.0),
                                       strict=True) if size > 1e-8]


def _draw_inputs(problem: Problem, rng: np.random.Generator, count: int) -> Array:
    """Return inputs inside their bounds, where the dynamics need not be defined."""
    low, high = problem.u_lower, problem.u_upper
    wide = 3.0 * (1.0 + np.minimum(np.abs(low), np.abs(high)))   # where one of them is infinite
    wide = np.where(np.isfinite(wide), wide, 3.0)
    low = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - wide, -wide / 2))
    high = np.where(np.isfinite(high), high, low + wide)
    return low + (high - low) * rng.uniform(size=(count, problem.m))


def _find_invariants(end: End, rates: tuple[Algebra, list[Polynomial]],
                     monomials: list[StateMonomial]) -> list[RationalRow]:
    """Return coefficients of sums that are constant along every path and on the terminal set."""
    algebra, f = rates
    changes = []
    for each in monomials:
        total: Polynomial = {}
        for k, i in enumerate(each):
            term = f[i]
            for other in each[:k] + each[k + 1:]:
                term = algebra.multiply(term, algebra.generator(other))
            total = algebra.add(total, term)
        changes.append(total)
    rows: list[RationalRow] = []
    for columns in (algebra.cleared(changes), _values_at_end(end, monomials)):
        terms = dict.fromkeys(term for each in columns for term in each)
        rows += [{k: each[term] for k, each in enumerate(columns) if term in each}
                 for term in terms]
    return find_null_space(rows, len(monomials))


def _values_at_end(end: End, monomials: list[StateMonomial]) -> list[Polynomial]:
    """Return monomials of x + N y as polynomials of y, without their constants."""
    algebra, states = Algebra(len(end.directions)), []
    for k, start in enumerate(end.x):
        value = make_constant(start)
        for number, direction in enumerate(end.directions):
            if k in direction:
                value = algebra.add(value, algebra.generator(number), direction[k])
        states.append(value)
    found = []
    for each in monomials:
        value = make_constant(1)
        for k in each:
            value = algebra.multiply(value, states[k])
        found.append({term: factor for term, factor in value.items() if term})
    return found


def _compared(problem: Problem, end: End, c: RationalRow,
              monomials: list[StateMonomial]) -> Iterator[str]:
    """Yield a sentence if an invariant has different values at the start and at the end."""
    lead = max(c.values(), key=abs)
    c = {k: c[k] / lead for k in sorted(c)}
    x0 = [convert_to_rational(value) for value in problem.x0]
    terms_before = [value * _product(x0, monomials[k]) for k, value in c.items()]
    terms_after = [value * _product(end.x, monomials[k]) for k, value in c.items()]
    before, after = sum(terms_before, Fraction(0)), sum(terms_after, Fraction(0))
    size = sum((abs(each) for each in (*terms_before, *terms_after, *c.values())), Fraction(0))
    if abs(after - before) > convert_to_rational(COUNTS_AS_MET) * size:
        text = describe_sum((_name(problem, monomials[k]), float(value))
                            for k, value in c.items())
        yield (f'{text} is constant for all inputs: it is {float(before):.9g} at the initial '
               f'state and {float(after):.9g} where the terminal constraints hold')


def _product(x: Sequence[Fraction], monomial: StateMonomial) -> Fraction:
    return prod((x[k] for k in monomial), start=Fraction(1))


def _name(problem: Problem, monomial: StateMonomial) -> str:
    names = [problem.states[k] for k in monomial]
    return f'{names[0]}**2' if len(names) == 2 and names[0] == names[1] else '*'.join(names)
