# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The summands of a cost, and their sizes: see *A cost of 0* in docs/certificate.md."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import apply_to_expressions, Instructions
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem


@dataclass(frozen=True, eq=False)
class Summands:
    """
    The summands of a cost along a path: integrals of those of L, and those of V.

    `values`, `sizes`, `largest` (k,) are absolute values, sizes, and sizes about 0.
    """

    values: Array
    sizes: Array
    largest: Array

    @property
    def unit(self) -> float:
        """Return the size about 0 of a cost in small units, otherwise 1."""
        return min(1.0, float(self.largest.sum()) or 1.0)

    def vanish(self, part: float) -> bool:
        """Return whether no summand is more than a part of its size, and not all sizes are 0."""
        return bool(self.sizes.any() and np.all(self.values <= part * self.sizes))


class CostSummands:
    """The summands of the cost of a problem, for any path and numbers."""

    def __init__(self, problem: Problem) -> None:
        parts = [split_sum(each) for each in (problem.L, problem.V)]
        self._running = len(parts[0])
        given, none = [problem.x, problem.u, problem.p], ca.SX(0, 1)
        summands, sizes = ca.vertcat(none, *parts[0], *parts[1]), _Sizes(given)
        found = sizes.measure(summands)
        self._leaves = VectorizedFunction(given, [ca.vertcat(none, *sizes.leaves)])
        self._sizes = VectorizedFunction([*given, ca.vertcat(none, *sizes.middles)], [
            summands, found])

    def measure(self, t: Array, x: Array, u: Array, p: Array) -> Summands:
        """Return the summands along a path t (N,), x (N, n), u (N, m)."""
        leaves, = self._leaves(x, u, p)

        def add_up(rows: Array) -> Array:
            running = np.diff(t) @ (rows[:-1] + rows[1:]) / 2
            return np.append(running[:self._running], rows[-1, self._running:])

        with np.errstate(all='ignore'):
            middle = (leaves.max(axis=0) + leaves.min(axis=0)) / 2
            values, largest = self._sizes(x, u, p, np.zeros_like(middle))
            sizes = np.fmin(largest, self._sizes(x, u, p, middle)[1])
            return Summands(*map(add_up, (np.abs(values), sizes, largest)))


class _Sizes:
    """Sizes as expressions of the symbols and of the middles of what varies."""

    def __init__(self, given: Sequence[ca.SX]) -> None:
        self._given, self.leaves, self.middles = given, list[ca.SX](), list[ca.SX]()

    def measure(self, summands: ca.SX) -> ca.SX:
        function = ca.Function('summands', self._given, [ca.densify(summands)])
        found = Instructions(function).evaluate(
            self._read, lambda value: (ca.SX(value), ca.SX(value), ca.SX(0)), self._apply)[0]
        return ca.vertcat(ca.SX(0, 1), *(ca.fabs(middle) + apart for _, middle, apart in found))

    def _read(self, i: int, k: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        value = self._given[i].nz[k]
        return (value, value, ca.SX(0)) if i == len(self._given) - 1 else self._vary(value)

    def _vary(self, value: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return a value, the middle of its range, and the distance from it."""
        middle = ca.SX.sym('middle')
        self.leaves.append(value)
        self.middles.append(middle)
        return value, middle, ca.fabs(value - middle)

    def _apply(self, operation: int, operands: list[tuple[ca.SX, ca.SX, ca.SX]]
               ) -> tuple[ca.SX, ca.SX, ca.SX]:
        values, middles, apart = ([*part] for part in zip(*operands, strict=True))
        value = apply_to_expressions(operation, values)
        if operation in (ca.OP_ADD, ca.OP_SUB):
            return value, apply_to_expressions(operation, middles), apart[0] + apart[1]
        if operation in (ca.OP_NEG, ca.OP_FABS, ca.OP_TWICE):
            return (value, apply_to_expressions(operation, middles),
                    2 * apart[0] if operation == ca.OP_TWICE else apart[0])
        if operation in (ca.OP_MUL, ca.OP_SQ):
            (a, b), (da, db) = (pair if len(pair) == 2 else pair * 2 for pair in (middles, apart))
            return value, a * b, ca.fabs(a)*db + da*ca.fabs(b) + da*db
        sizes = [ca.fabs(middle) + each for middle, each in zip(middles, apart, strict=True)]
        if operation == ca.OP_SQRT:
            return value, ca.SX(0), ca.sqrt(sizes[0])
        if operation == ca.OP_DIV:
            return value, ca.SX(0), sizes[0] / ca.fabs(values[1])
        if operation in (ca.OP_POW, ca.OP_CONSTPOW) and values[1].is_constant() and float(
                values[1]) > 0:
            return value, ca.SX(0), sizes[0] ** float(values[1])
        return (value, value, ca.SX(0)) if value.is_constant() else self._vary(value)


def split_sum(scalar: ca.SX) -> list[ca.SX]:
    """Return the summands of a scalar, without zeros; products with one sum are multiplied out."""
    summands, left = list[ca.SX](), [(scalar, ca.SX(1))]
    while left:
        part, factor = left.pop()
        operation, parts = part.op(), [part.dep(k) for k in range(part.n_dep())]
        sums = [each.op() in (ca.OP_ADD, ca.OP_SUB) for each in parts]
        fixed = [each.is_constant() for each in parts]
        if operation in (ca.OP_ADD, ca.OP_SUB):
            left += [(parts[1], factor if operation == ca.OP_ADD else -factor), (parts[0], factor)]
        elif operation in (ca.OP_NEG, ca.OP_TWICE):
            left.append((parts[0], -factor if operation == ca.OP_NEG else 2 * factor))
        elif operation == ca.OP_MUL and (any(fixed) or sum(sums) == 1):
            k = fixed.index(False) if any(fixed) else sums.index(True)
            left.append((parts[k], factor * parts[1 - k]))
        elif operation == ca.OP_DIV and (fixed[1] or sums[0] and not sums[1]):
            left.append((parts[0], factor / parts[1]))
        elif not part.is_zero():
            summands.append(factor * part)
    return summands
