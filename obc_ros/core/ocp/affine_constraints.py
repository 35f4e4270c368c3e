# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Affine terminal constraints, and the set of states that satisfy them in exact arithmetic."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.instructions import has_jumps
from obc_ros.core.numerics.rational_polynomials import (
    find_null_space,
    RationalRow,
    read_polynomials,
    reduce_rows,
    split_affine,
    TooHardError,
)
from obc_ros.core.ocp.problem import Problem

_WELL = 1e-7        # relative: singular values of the terminal constraints above it are nonzero
_SLACK = 1e-9       # relative: gaps above it are contradictions
_EQUILIBRATED = 4   # times that rows and columns are scaled before singular values are compared


@dataclass(frozen=True)
class Clash:
    """A weighted sum of terminal constraints that reads 0 = gap; `weights` by their numbers."""

    weights: dict[int, Fraction]
    gap: Fraction


@dataclass(frozen=True)
class End:
    """
    The states x + N y at which all affine terminal constraints hold.

    :ivar rows: the constraints A x + b = 0 by their numbers; b is in column n.
    :ivar x: a state that meets them, shape (n,), unless there is a clash.
    :ivar directions: a basis of the null space of A.
    :ivar is_clear: whether the rank of A is clear numerically. If rows are nearly dependent,
        states far away nearly meet the constraints.
    """

    rows: dict[int, RationalRow]
    x: list[Fraction]
    directions: list[RationalRow]
    clash: Clash | None
    is_clear: bool

    def pinned(self) -> Mask:
        """Return which states have only one value, shape (n,)."""
        pinned = np.ones(len(self.x), dtype=bool)
        pinned[[k for direction in self.directions for k in direction]] = False
        return pinned


def find_affine_end(problem: Problem) -> End | None:
    """Return the states that satisfy all affine terminal constraints, if exact arithmetic can."""
    n = problem.n
    psi = ca.Function('psi', [problem.x, problem.p], [ca.densify(problem.psi)])
    rows = read_affine_rows(psi, [[None] * n, problem.p_value]) if problem.q else {}
    if not rows:
        return None
    echelon, clash = eliminate_rows(rows, n)
    # States without a pivot are 0.
    x = [-echelon[k].get(n, Fraction(0)) if k in echelon else Fraction(0) for k in range(n)]
    directions = find_null_space(rows.values(), n)
    clear = _rank(rows, n) == n - len(directions)
    return End(rows, x, directions, clash, clear and clash is None)


def read_affine_rows(function: ca.Function, values: Sequence[Sequence[float | None] | Array]
                     ) -> dict[int, RationalRow]:
    """
    Return the affine entries of the output of a function of SX.

    :param function: its first input has no values.
    :param values: as for `read_polynomials`.
    :return: for the number of each affine entry its coefficients, the constant behind them; empty
        if an entry is too large for exact arithmetic.
    """
    try:
        found = read_polynomials(function, values)[1]
    except TooHardError:
        return {}
    parts = ((number, split_affine(each, len(values[0]))) for number, each in enumerate(found))
    return {number: {k: value for k, value in enumerate([*part[0], part[1]]) if value}
            for number, part in parts if part}


def eliminate_rows(rows: dict[int, RationalRow], n: int) -> tuple[dict[int, RationalRow],
                                                                  Clash | None]:
    """
    Bring linear equations into echelon form and find a contradiction between them.

    :param rows: the equations A x + b = 0 by their numbers; b is in column n.
    :return: echelon: as of `reduce_rows`; entries behind column n are weights; clash: the first
        contradiction, if there is one.
    """
    echelon, rest = reduce_rows(
        (row | {n + 1 + number: Fraction(1)} for number, row in rows.items()), n)
    for row in rest:
        weights = {k - n - 1: value for k, value in row.items() if k > n}
        size = sum((abs(value * rows[k].get(n, Fraction(0))) for k, value in weights.items()),
                   Fraction(0))
        if abs(gap := row.get(n, Fraction(0))) > Fraction(_SLACK) * size:
            return echelon, Clash(weights, gap)
    return echelon, None


def _rank(rows: dict[int, RationalRow], n: int) -> int:
    """Return the numerical rank of the rows, independent of units."""
    A = np.array([[float(row.get(k, 0)) for k in range(n)] for row in rows.values()])
    for _ in range(_EQUILIBRATED):
        for axis in (0, 1):
            size = np.abs(A).max(axis=axis, keepdims=True)
            A = A / np.sqrt(np.where(size > 0, size, 1.0))
    sizes = np.linalg.svd(A, compute_uv=False)
    return int(np.sum(sizes > _WELL * sizes.max(initial=0.0)))


def find_affine_rows(problem: Problem) -> tuple[Array, Array, Mask]:
    """
    Return the terminal constraints A x + b = 0, and which of them are affine.

    :return: (q, n), (q,), (q,). Rows of nonlinear ones have no meaning.
    """
    x = problem.x
    slope = ca.jacobian(problem.psi, x)
    bent = np.array([ca.depends_on(slope[row, :], x) or has_jumps(problem.psi[row], x)
                     for row in range(problem.q)], bool)
    at_zero = ca.Function('rows', [x, problem.p], [ca.densify(slope), problem.psi])
    A, b = (value.full() for value in at_zero(np.zeros(problem.n), problem.p_value))
    return A, b[:, 0], ~bent & np.isfinite(A).all(axis=1) & np.isfinite(b[:, 0])
