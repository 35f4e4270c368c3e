# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Proof of convexity of a problem by the rules of disciplined convex programming.

An expression is a sum. The terms with constant second derivatives are added, and the matrix of
their sum is examined. For every other term, curvature and sign of an operation follow from those
of its arguments (M. Grant, S. Boyd, Y. Ye, Disciplined convex programming, 2006). No point is
evaluated: an expression found convex is convex everywhere within the bounds. If the rules do not
apply nothing is concluded.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction

import casadi as ca
import numpy as np
from obc_ros.core.numerics.enclosures.interval_arithmetic import enclose_outputs
from obc_ros.core.numerics.instructions import Instructions
from obc_ros.core.numerics.rational_polynomials import split_affine, TooHardError
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.structure import find_clocks, is_semidefinite
from obc_ros.core.solver.proofs.existence import read_exactly


@dataclass(frozen=True)
class Shape:
    """Known curvature and sign of an expression over a convex set."""

    convex: bool = False
    concave: bool = False   # both if it is affine
    above: bool = False     # >= 0
    below: bool = False     # <= 0

    @property
    def affine(self) -> bool:
        """Return whether it is affine."""
        return self.convex and self.concave

    def negative(self) -> 'Shape':
        """Return the shape of its negative."""
        return Shape(self.concave, self.convex, self.below, self.above)

    def times(self, factor: float) -> 'Shape':
        """Return the shape of a multiple."""
        return self.negative() if factor < 0 else self


def is_convex_problem(problem: Problem) -> bool:
    """
    Return whether Pontryagin's conditions are proved to be sufficient for a global minimum.

    They are if the final time is given, dynamics and terminal constraints are affine, costs are
    convex, and path constraints are convex and depend on the states alone or the inputs alone.
    States with constant rates are functions of time, on which all of these may depend.

    O. L. Mangasarian, Sufficient conditions for the optimal control of nonlinear systems, SIAM J.
    Control 4, 1966.
    """
    if problem.final_time.free:
        return False
    values = ca.DM(problem.p_value)
    f, psi, path, L, V = (ca.substitute(expression, problem.p, values) for expression in (
        problem.f, problem.psi, problem.path, problem.L, problem.V))
    reader = _Reader(problem)
    if ca.depends_on(ca.jacobian(ca.vertcat(f, psi), reader.z), reader.z):
        return False
    if not (reader.read(L).convex and reader.read(V).convex):
        return False
    for row, c in enumerate(ca.vertsplit(path)):
        shape = reader.read(c)
        if (np.isfinite(problem.path_upper[row]) and not shape.convex
                or np.isfinite(problem.path_lower[row]) and not shape.concave
                or not reader.is_apart(c)):
            return False
    return True


class _Reader:
    """
    Shapes of expressions in the states and inputs of a problem, within their bounds.

    `z`: these without the clocks (`find_clocks`). Expressions of clocks alone are constants.
    """

    def __init__(self, problem: Problem) -> None:
        clocks = find_clocks(problem)
        moving = np.flatnonzero(~clocks)
        self._x, self._u = problem.x[moving.tolist(), 0], problem.u
        self.z, self._all = ca.vertcat(self._x, self._u), ca.vertcat(problem.x, problem.u)
        lower = np.concatenate([problem.x_lower[moving], problem.u_lower])
        upper = np.concatenate([problem.x_upper[moving], problem.u_upper])
        # Expressions are stored too: no other has the same hash while they exist.
        self._known = {
            symbol.element_hash(): (symbol, Shape(True, True, low >= 0.0, high <= 0.0))
            for symbol, low, high in zip(ca.vertsplit(self.z), lower, upper, strict=True)}
        self._clocks = problem.x[np.flatnonzero(clocks).tolist(), 0]
        rates = ca.substitute(problem.f[np.flatnonzero(clocks).tolist(), 0], problem.p,
                              ca.DM(problem.p_value))
        moved = ca.DM(rates).full().ravel() * np.nan_to_num(problem.final_time.value)
        ends, error = (problem.x0[clocks], problem.x0[clocks] + moved), np.spacing(np.abs(moved))
        self._span = np.nextafter(np.minimum(*ends) - error, -np.inf), np.nextafter(
            np.maximum(*ends) + error, np.inf)

    def read(self, expression: ca.SX) -> Shape:
        """Return the shape of a sum."""
        if self._is_quadratic(expression):
            return self._quadratic(expression)
        terms: list[tuple[float, ca.SX]] = []
        try:
            if not _split(1.0, expression, terms):
                return Shape()
            quadratic, found = ca.SX(0), _ZERO
            for factor, term in terms:
                if self._is_quadratic(term):
                    quadratic += factor * term
                else:
                    found = _add(found, self._shape(term).times(factor))
            return _add(found, self._quadratic(quadratic))
        except RecursionError:   # too deeply nested
            return Shape()

    def _is_quadratic(self, expression: ca.SX) -> bool:
        """Return whether second derivatives are constant and the gradient is continuous."""
        slope = ca.gradient(expression, self.z)
        return not (ca.depends_on(ca.jacobian(slope, self.z), self._all) or Instructions(
            ca.Function('slope', [self._all], [slope])).have(ca.OP_SIGN, ca.OP_LE, ca.OP_LT))

    def _quadratic(self, expression: ca.SX) -> Shape:
        """Return the shape of an expression with constant second derivatives."""
        H = ca.DM(ca.hessian(expression, self.z)[0]).full()
        if not np.isfinite(H).all():
            return Shape()
        return Shape(is_semidefinite(H), is_semidefinite(-H))

    def _shape(self, term: ca.SX) -> Shape:
        key = term.element_hash()
        if key not in self._known:
            self._known[key] = term, self._operation(term)
        return self._known[key][1]

    def _operation(self, term: ca.SX) -> Shape:
        if term.is_constant():
            return _constant(float(term))
        if not ca.depends_on(term, self.z):
            return self._of_time(term)
        if term.is_symbolic():
            return Shape()
        operation, first = term.op(), term.dep(0)
        if operation in (ca.OP_ADD, ca.OP_SUB):
            second = self._shape(term.dep(1))
            return _add(self._shape(first),
                        second if operation == ca.OP_ADD else second.negative())
        if operation in (ca.OP_MUL, ca.OP_DIV):
            return self._product(operation, first, term.dep(1))
        if operation in (ca.OP_POW, ca.OP_CONSTPOW):
            exponent = term.dep(1)
            return (_power(self._shape(first), float(exponent)) if exponent.is_constant()
                    else Shape())
        if operation == ca.OP_FABS:   # its derivative is discontinuous: see `_apart`
            return _absolute(self._shape(first)) if self.is_apart(first) else Shape(above=True)
        if operation == ca.OP_SQRT and self._is_norm(first):
            return Shape(convex=True, above=True)
        apply = _UNARY.get(operation)
        return apply(self._shape(first)) if apply else Shape()

    def _product(self, operation: int, first: ca.SX, second: ca.SX) -> Shape:
        a, b = self._shape(first), self._shape(second)
        if second.is_constant():
            factor = float(second)
            return a.times(factor) if factor or operation == ca.OP_MUL else Shape()
        if not ca.depends_on(second, self.z):
            return _scaled(a, b)
        if operation == ca.OP_MUL and not ca.depends_on(first, self.z):
            return _scaled(b, a)
        if first.is_constant():
            inverse = _power(b, -1.0) if operation == ca.OP_DIV else b
            return inverse.times(float(first))
        base, exponent = _monomial(first)
        same, more = _monomial(second)
        if operation == ca.OP_MUL and base.element_hash() == same.element_hash():
            return _power(self._shape(base), exponent + more)
        return Shape(above=a.above and b.above or a.below and b.below,
                     below=a.above and b.below or a.below and b.above)

    def _of_time(self, term: ca.SX) -> Shape:
        """Return the shape of an expression of clocks alone: that of a constant."""
        function = ca.Function('of_time', [self._clocks], [term], {'allow_free': True})
        if function.has_free():
            return Shape()
        found, = enclose_outputs(function, [self._span])
        return Shape(True, True, found.low >= 0.0, found.high <= 0.0)

    def is_apart(self, term: ca.SX) -> bool:
        """
        Return whether a term depends on states alone or on inputs alone.

        At a kink of any other term, subgradients in x and in u belong together, which
        Pontryagin's conditions do not require.
        """
        return not (ca.depends_on(term, self._x) and ca.depends_on(term, self._u))

    def _is_norm(self, square: ca.SX) -> bool:
        """Return whether an expression is the square of the norm of affine expressions."""
        if not (self._is_quadratic(square) and self.is_apart(square)) or (
                ca.depends_on(square, self._clocks)):
            return False
        H, slope = ca.hessian(square, self.z)
        at_zero = ca.substitute(ca.vertcat(square, slope), self.z, ca.SX.zeros(self.z.shape))
        value = ca.DM(at_zero).full().ravel()
        whole = np.block([[ca.DM(H).full() / 2, value[1:, None] / 2],
                          [value[None, 1:] / 2, value[:1, None]]])
        return bool(np.isfinite(whole).all()) and is_semidefinite(whole)


_ZERO = Shape(True, True, True, True)


def _split(factor: float, term: ca.SX, found: list[tuple[float, ca.SX]]) -> bool:
    """Collect the terms of a sum with their factors; return False if there are too many."""
    # Shared parts can make the number of terms exponential in the depth.
    if len(found) > 2000:
        return False
    operation = -1 if term.is_leaf() else term.op()
    if operation in (ca.OP_NEG, ca.OP_TWICE):
        return _split((2.0 if operation == ca.OP_TWICE else -1.0) * factor, term.dep(0), found)
    if operation in (ca.OP_ADD, ca.OP_SUB):
        sign = -1.0 if operation == ca.OP_SUB else 1.0
        return _split(factor, term.dep(0), found) and _split(sign * factor, term.dep(1), found)
    if operation == ca.OP_MUL and term.dep(0).is_constant():
        return _split(factor * float(term.dep(0)), term.dep(1), found)
    if operation == ca.OP_MUL and term.dep(1).is_constant():
        return _split(factor * float(term.dep(1)), term.dep(0), found)
    if operation == ca.OP_DIV and term.dep(1).is_constant() and float(term.dep(1)):
        return _split(factor / float(term.dep(1)), term.dep(0), found)
    found.append((factor, term))
    return True


def _monomial(term: ca.SX) -> tuple[ca.SX, float]:
    """Return a base and its exponent; CasADi writes x**3 as x*sq(x)."""
    if term.is_leaf():
        return term, 1.0
    if term.op() == ca.OP_SQ:
        base, exponent = _monomial(term.dep(0))
        return base, 2.0 * exponent
    if term.op() == ca.OP_MUL:
        (base, exponent), (other, more) = _monomial(term.dep(0)), _monomial(term.dep(1))
        if base.element_hash() == other.element_hash():
            return base, exponent + more
    return term, 1.0


def _constant(value: float) -> Shape:
    return Shape(True, True, value >= 0.0, value <= 0.0)


def _add(a: Shape, b: Shape) -> Shape:
    return Shape(a.convex and b.convex, a.concave and b.concave, a.above and b.above,
                 a.below and b.below)


def _scaled(a: Shape, factor: Shape) -> Shape:
    """Return the shape of a times, or divided by, a factor that is constant at each time."""
    if factor.above or factor.below:
        return a if factor.above else a.negative()
    return Shape(a.affine, a.affine)


def _power(a: Shape, exponent: float) -> Shape:
    """Return the shape of a to a constant power."""
    even = exponent % 2.0 == 0.0
    if exponent == 1.0:
        return a
    if exponent > 1.0:
        rises = a.above and a.convex
        falls = even and a.below and a.concave
        return Shape(even and a.affine or rises or falls, above=even or a.above)
    if 0.0 < exponent < 1.0:   # undefined where a < 0
        return Shape(concave=a.concave, above=True)
    if exponent == 0.0:
        return _constant(1.0)
    return Shape(a.concave and a.above, above=even or a.above)


def _absolute(a: Shape) -> Shape:
    convex = a.affine or a.convex and a.above or a.concave and a.below
    return Shape(convex, above=True)


_UNARY: dict[int, Callable[[Shape], Shape]] = {
    ca.OP_NEG: Shape.negative,
    ca.OP_SQ: lambda a: _power(a, 2.0),
    ca.OP_TWICE: lambda a: a,
    ca.OP_INV: lambda a: _power(a, -1.0),
    ca.OP_SQRT: lambda a: _power(a, 0.5),
    ca.OP_EXP: lambda a: Shape(a.convex, above=True),
    ca.OP_LOG: lambda a: Shape(concave=a.concave),
    ca.OP_COSH: _absolute,
}


def has_one_mean_input(problem: Problem) -> bool:
    """
    Return whether it is proved that only one mean input attains the infimum of a problem.

    Let f = A x + B u + c, L = l(x) + m(u) with an input u, and V, l and the constraints be convex.
    Relaxed, m is replaced by its convex hull, and the problem is convex. The difference d of two
    of its solutions has d' = A d + B w, d(0) = 0 and Q d = 0, where Q is the constant second
    derivative of l: otherwise their mean would cost less. If a k exists with Q A^k B != 0, let it
    be the first one: then the derivative k + 1 of Q d = 0 gives w as a linear function of d, so
    that d = 0 and w = 0. An input that attains the infimum is a solution of the relaxed problem.
    Hence it is the mean of the relaxed one, and where m is above its hull there, it costs more.
    Without constraints along the path the infimum is the minimum of the relaxed problem: by
    Lyapunov's theorem inputs that switch have the same states at the ends of any short intervals.
    """
    x, u = problem.x, problem.u
    # The running cost l(x), up to a constant.
    cost = ca.substitute(problem.L, u, ca.DM(np.clip(0.0, problem.u_lower, problem.u_upper)))
    slopes = ca.veccat(ca.jacobian(problem.f, ca.vertcat(x, u)), ca.hessian(problem.L, x)[0])
    if (problem.m != 1 or problem.start is not None or problem.constrained
            or ca.depends_on(ca.jacobian(problem.L, x), u)
            or ca.depends_on(slopes, ca.vertcat(x, u))
            or not is_convex_problem(replace(problem, structure='', L=cost))):
        return False
    try:
        *f, L = read_exactly(problem, ca.vertcat(problem.f, problem.L))
    except TooHardError:
        return False
    n, zero = problem.n, Fraction(0)
    rows = [part[0] for part in (split_affine(each, n + 1) for each in f) if part]
    if len(rows) < n:
        return False
    A, reached = np.array([row[:n] for row in rows]), np.array([row[n] for row in rows])
    Q = np.array([[2 * L.get(((i, 2),), zero) if i == j else
                   L.get(((min(i, j), 1), (max(i, j), 1)), zero) for j in range(n)]
                  for i in range(n)], dtype=object)
    for _ in range(n):
        if any(Q @ reached):
            return True
        reached = A @ reached
    return False
