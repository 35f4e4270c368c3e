# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What no input changes: polynomials of degree 2 in the states that are constant along every path.

A quaternion keeps its length, a closed population its number. Of the polynomials c'phi(x) those
are constant for which c'(dphi/dx) f(x, u) vanishes for all x and u, which is a set of linear
equations for c once it is asked at more points than there are monomials.
"""

from collections.abc import Iterator
from itertools import combinations_with_replacement

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.problem import Problem

Array = NDArray[np.float64]
Monomial = tuple[int, ...]

_MOST = 24       # states, beyond which it is not asked
_NULL = 1e-10    # relative: a singular value that is none
_FAR = 1e-6      # relative: far above what rounding and a certificate leave open
_NOISE = 1e-8    # relative: a coefficient that is none
_SEED = 5


def changed(problem: Problem, A: Array, end: Array) -> Iterator[str]:
    """
    Yield what has another value at the end than at the start though no input changes it.

    `A` (k, n): rows of the affine terminal constraints; `end` (n,): a state that meets them.
    """
    states = range(problem.n)
    if problem.n <= _MOST:
        yield from _changed(problem, A, end, [(i,) for i in states])
        yield from _changed(problem, A, end, [
            *((i,) for i in states), *combinations_with_replacement(states, 2)])


def _changed(problem: Problem, A: Array, end: Array, monomials: list[Monomial]
             ) -> Iterator[str]:
    """Yield those that are sums of the given monomials."""
    constants, size = _constants(problem, monomials)
    # Of the constants those that are the same at all states that meet the constraints.
    free = np.linalg.svd(A)[2][np.linalg.matrix_rank(A):]
    rng = np.random.default_rng(_SEED)
    others = end + rng.normal(size=(len(monomials), len(free))) @ free * (1 + np.abs(end).max())
    varied = (_values(others, monomials) - _values(end[None], monomials)) @ constants.T
    constants = _readable(_null(varied / (1 + np.abs(varied).max(initial=0))) @ constants, size)
    before, after = (_values(x[None], monomials)[0] for x in (problem.x0, end))
    for c in constants:
        gap = float(c @ (after - before))
        if abs(gap) > _FAR * float(np.abs(c) @ (1 + np.abs(before))):
            yield (f'{_text(problem, c, monomials)} is constant whatever the inputs are: it is '
                   f'{float(c @ before):.9g} at the initial state and {float(c @ after):.9g} '
                   'where the terminal constraints hold')


def _values(x: Array, monomials: list[Monomial]) -> Array:
    return np.column_stack([np.prod(x[:, list(each)], axis=1) for each in monomials])


def _null(matrix: Array) -> Array:
    """Return an orthonormal basis, in rows, of what a matrix takes to zero."""
    _, values, V = np.linalg.svd(matrix)
    null: Array = V[np.sum(values > _NULL * values.max(initial=1.0)):]
    return null


def _constants(problem: Problem, monomials: list[Monomial]) -> tuple[Array, Array]:
    """Return coefficients of independent constants (k, monomials), and sizes of those."""
    rng = np.random.default_rng(_SEED)
    asked, again = (_rates(problem, monomials, rng) for _ in range(2))
    size = np.abs(asked).max(axis=0, initial=0.0)
    size = np.where(size > 0, size, 1.0)
    if min(len(asked), len(again)) < 2 * len(monomials):
        return np.zeros((0, len(monomials))), size
    rows = asked / size
    found = _null(rows / np.maximum(np.abs(rows).max(axis=1, keepdims=True), 1e-300)) / size
    # Each at other points, beside its own terms there: rates may be of very different sizes.
    left = np.abs(again @ found.T) <= _NOISE * (np.abs(again) @ np.abs(found.T))
    return found[left.all(axis=0)], size


@np.errstate(all='ignore')   # dynamics need not be defined everywhere
def _rates(problem: Problem, monomials: list[Monomial], rng: np.random.Generator) -> Array:
    """Return d/dt of monomials at random states and inputs, a row for each."""
    count = 3 * len(monomials)
    x = problem.x0 + (1 + np.abs(problem.x0)) * rng.uniform(-1, 1, (count, problem.n))
    u = np.clip(rng.normal(size=(count, problem.m)), problem.u_lower, problem.u_upper)
    f = ca.Function('f', [problem.x, problem.u, problem.p], [problem.f]).map(count)(
        x.T, u.T, ca.repmat(problem.p_value, 1, count)).full().T
    rates = np.column_stack([
        sum(f[:, i] * np.prod(x[:, each[:k] + each[k + 1:]], axis=1)
            for k, i in enumerate(each)) for each in monomials])
    return np.asarray(rates[np.isfinite(rates).all(axis=1)])


def _readable(constants: Array, size: Array) -> Array:
    """Return combinations with one leading monomial each: few terms are easily read."""
    if not len(constants):
        return constants
    from scipy.linalg import qr
    lead = np.asarray(qr(constants * size, mode='r', pivoting=True)[1])[:len(constants)]
    found = np.linalg.solve(constants[:, lead], constants)
    parts = np.abs(found * size)
    return np.where(parts > _NOISE * parts.max(axis=1, keepdims=True), found, 0.0)


def _text(problem: Problem, c: Array, monomials: list[Monomial]) -> str:
    text = ''
    for value, each in zip(c, monomials, strict=True):
        if value:
            name = '*'.join(problem.states[i] for i in each)
            if len(each) == 2 and each[0] == each[1]:
                name = f'{problem.states[each[0]]}**2'
            factor = '' if abs(abs(value) - 1) < 1e-8 else f'{abs(value):.6g}*'
            text += f' {"-" if value < 0 else "+"} {factor}{name}'
    return text[3:] if text.startswith(' + ') else '-' + text[3:]
