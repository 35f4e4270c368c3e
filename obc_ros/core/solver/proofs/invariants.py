# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Invariants of the dynamics: quadratic polynomials of the states that no input changes.

Examples are the norm of a quaternion and the size of a closed population. A polynomial c'phi(x)
is invariant if c'(dphi/dx) f(x, u) = 0 for all x and u.

Derivatives at random states and inputs, more than there are monomials, give linear equations for
c, which suggest the monomials of an invariant. The proof uses exact arithmetic
(`rational_polynomials`): the derivatives of these monomials are polynomials with rational
coefficients, and c is accepted only if their weighted sum is identically 0. The value of c'phi at
the end counts only if c'phi is, as a polynomial, constant on the set that the affine terminal
constraints define.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import combinations_with_replacement
from math import prod

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, linalg
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

_NOISE = 1e-8    # relative: smaller coefficients count as 0

_SEED = 5


def find_changed_invariants(problem: Problem) -> Iterator[str]:
    """Yield the invariants whose value at the end differs from that at the start, as sentences."""
    states = range(problem.n)
    if not problem.q or problem.n > 24 or problem.start is not None:   # not too large
        return
    end = find_affine_end(problem)
    if end is None or not end.is_clear:
        return
    try:
        rates = _exact_rates(problem)
    except TooHardError:
        return
    surface = _Surface(end)
    yield from _changed(problem, surface, rates, [(i,) for i in states])
    yield from _changed(problem, surface, rates, [
        *((i,) for i in states), *combinations_with_replacement(states, 2)])


class _Surface:
    """The states at which the affine terminal constraints hold, as polynomials of y."""

    def __init__(self, end: End) -> None:
        self.x, self.directions = end.x, end.directions
        self.algebra = Algebra(len(end.directions))
        self.states: list[Polynomial] = []
        for k, start in enumerate(end.x):
            value = make_constant(start)
            for number, direction in enumerate(end.directions):
                if k in direction:
                    value = self.algebra.add(
                        value, self.algebra.generator(number), direction[k])
            self.states.append(value)

    def values(self, monomials: Sequence[StateMonomial]) -> list[Polynomial]:
        """Return monomials of x as polynomials of y."""
        found = []
        for each in monomials:
            value = make_constant(1)
            for k in each:
                value = self.algebra.multiply(value, self.states[k])
            found.append(value)
        return found


def _exact_rates(problem: Problem) -> tuple[Algebra, list[Polynomial]]:
    """Return f as polynomials; the first symbols are the states."""
    f = ca.Function('f', [problem.x, problem.u, problem.p], [ca.densify(problem.f)])
    held = [float(low) if low == high else None
            for low, high in zip(problem.u_lower, problem.u_upper, strict=True)]
    return read_polynomials(f, [[None] * problem.n, held, problem.p_value])


def _changed(problem: Problem, end: _Surface, rates: tuple[Algebra, list[Polynomial]],
             monomials: list[StateMonomial]) -> Iterator[str]:
    """Yield the changed invariants that are sums of the given monomials."""
    constants, size = _constants(problem, monomials)
    if not len(constants):
        return
    # Keep the invariants that have one value at all states that meet the terminal constraints.
    point = np.array([float(value) for value in end.x])
    free = np.array([[float(direction.get(k, 0)) for direction in end.directions]
                     for k in range(problem.n)]).reshape(problem.n, -1)
    rng = np.random.default_rng(_SEED)
    others = point + rng.normal(size=(len(monomials), free.shape[1])) @ free.T * (
        1 + np.abs(point).max())
    varied = (_values(others, monomials) - _values(point[None], monomials)) @ constants.T
    proposed = _readable(_null(varied / (1 + np.abs(varied).max(initial=0))) @ constants, size)
    for c in proposed:
        kept = [monomials[k] for k in np.flatnonzero(c)]
        try:
            found = _proved(end, rates, kept)
        except TooHardError:
            continue
        for coefficients in found:
            yield from _compared(problem, end, coefficients, kept)


def _proved(end: _Surface, rates: tuple[Algebra, list[Polynomial]], monomials: list[StateMonomial]
            ) -> list[RationalRow]:
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
    ends = [{term: value for term, value in each.items() if term}
            for each in end.values(monomials)]
    rows: list[RationalRow] = []
    for columns in (algebra.cleared(changes), ends):
        terms = dict.fromkeys(term for each in columns for term in each)
        rows += [{k: each[term] for k, each in enumerate(columns) if term in each}
                 for term in terms]
    return find_null_space(rows, len(monomials))


def _compared(problem: Problem, end: _Surface, c: RationalRow,
              monomials: list[StateMonomial]) -> Iterator[str]:
    """Yield a sentence if an invariant has different values at the start and at the end."""
    if len(c) < 1:
        return
    lead = max(c.values(), key=abs)
    c = {k: value / lead for k, value in c.items()}
    x0 = [convert_to_rational(value) for value in problem.x0]
    terms_before = [value * _product(x0, monomials[k]) for k, value in c.items()]
    terms_after = [value * _product(end.x, monomials[k]) for k, value in c.items()]
    before, after = sum(terms_before, Fraction(0)), sum(terms_after, Fraction(0))
    size = sum((abs(each) for each in (*terms_before, *terms_after, *c.values())), Fraction(0))
    if abs(after - before) > convert_to_rational(COUNTS_AS_MET) * size:
        numbers = np.array([float(c.get(k, 0)) for k in range(len(monomials))])
        yield (f'{_text(problem, numbers, monomials)} is constant for all inputs: it is '
               f'{float(before):.9g} at the initial state and {float(after):.9g} '
               'where the terminal constraints hold')


def _product(x: Sequence[Fraction], monomial: StateMonomial) -> Fraction:
    return prod((x[k] for k in monomial), start=Fraction(1))


def _values(x: Array, monomials: list[StateMonomial]) -> Array:
    return np.column_stack([np.prod(x[:, list(each)], axis=1) for each in monomials])


def _null(matrix: Array) -> Array:
    """Return an orthonormal basis of the null space of a matrix, in rows."""
    _, values, V = np.linalg.svd(matrix)
    null: Array = V[np.sum(values > 1e-10 * values.max(initial=1.0)):]   # up to rounding
    return null


def _constants(problem: Problem, monomials: list[StateMonomial]) -> tuple[Array, Array]:
    """Return coefficients of independent invariants (k, monomials), and sizes of monomials."""
    rng = np.random.default_rng(_SEED)
    asked, again = (_rates(problem, monomials, rng) for _ in range(2))
    size = np.abs(asked).max(axis=0, initial=0.0)
    size = np.where(size > 0, size, 1.0)
    if min(len(asked), len(again)) < 2 * len(monomials):
        return np.zeros((0, len(monomials))), size
    rows = asked / size
    found = _null(rows / np.maximum(np.abs(rows).max(axis=1, keepdims=True), 1e-300)) / size
    # Verified at other points relative to the terms there: rates may have very different sizes.
    left = np.abs(again @ found.T) <= _NOISE * (np.abs(again) @ np.abs(found.T))
    return found[left.all(axis=0)], size


@np.errstate(all='ignore')   # the dynamics may be undefined at some points
def _rates(problem: Problem, monomials: list[StateMonomial], rng: np.random.Generator) -> Array:
    """Return d/dt of monomials at random states and inputs, one row per point."""
    count = 3 * len(monomials)
    x = problem.x0 + (1 + np.abs(problem.x0)) * rng.uniform(-1, 1, (count, problem.n))
    u = _inputs(problem, rng, count)
    f = ca.Function('f', [problem.x, problem.u, problem.p], [problem.f]).map(count)(
        x.T, u.T, ca.repmat(problem.p_value, 1, count)).full().T
    rates = np.column_stack([
        sum(f[:, i] * np.prod(x[:, each[:k] + each[k + 1:]], axis=1)
            for k, i in enumerate(each)) for each in monomials])
    return np.asarray(rates[np.isfinite(rates).all(axis=1)])


def _inputs(problem: Problem, rng: np.random.Generator, count: int) -> Array:
    """Return random inputs within their bounds, shape (count, m)."""
    low, high, wide = problem.u_lower, problem.u_upper, 3.0   # without bounds
    with np.errstate(invalid='ignore'):
        span = np.where(np.isfinite(low) & np.isfinite(high), high - low, wide * (
            1 + np.minimum(np.abs(low), np.abs(high))))
    span = np.where(np.isfinite(span), span, wide)
    first = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - span, -span / 2))
    return np.asarray(first + span * rng.uniform(0, 1, (count, problem.m)))


def _readable(constants: Array, size: Array) -> Array:
    """Return combinations with one leading monomial each, so that they have few terms."""
    if not len(constants):
        return constants
    lead = np.asarray(linalg.qr(constants * size, mode='r', pivoting=True)[1])[:len(constants)]
    found = np.linalg.solve(constants[:, lead], constants)
    parts = np.abs(found * size)
    return np.where(parts > _NOISE * parts.max(axis=1, keepdims=True), found, 0.0)


def _text(problem: Problem, c: Array, monomials: list[StateMonomial]) -> str:
    def name(of: StateMonomial) -> str:
        return (f'{problem.states[of[0]]}**2' if len(of) == 2 and of[0] == of[1]
                else '*'.join(problem.states[i] for i in of))

    return describe_sum((name(each), value) for value, each in zip(c, monomials, strict=True)
                        if value)
