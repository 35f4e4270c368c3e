# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
States on a path at which expressions of the problem are undefined or not differentiable.

Undefined are a division by zero and the logarithm or root of a negative number. Not differentiable
are an absolute value at its kink and a root at 0. Reported are also states that diverge before T,
and terminal constraints whose gradient vanishes where they are met.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, integrate
from obc_ros.core.numerics.instructions import apply_to_expressions, Instructions
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.wording import format_number

_Place = TypeVar('_Place')
_TOUCHED = 1e-6  # of an operand's largest value: below it counts as 0
_AT_END = 'terminal_cost'
_SMALL = 1e-3    # of an operand's largest value: e that a message suggests

_QUOTED = 80     # characters of an expression in a message
_FAR = 1e6      # times 1 + |x(0)|: beyond it a state counts as diverging


@dataclass(frozen=True)
class Suspect:
    """An operand that must not vanish (`may_be_negative`), or must not be negative."""

    where: str
    value: ca.SX
    fault: str
    may_be_negative: bool


def explain_undefined(problem: Problem, t: Array, x: Array, u: Array) -> str:
    """
    Return which expression is undefined on a path, at what time and why.

    :param t, x, u: (N,), (N, n), (N, m), the path. A divisor that changes its sign between points
        counts as zero there.
    :return: a sentence; '' if all expressions are defined.
    """
    faults = []
    suspects = [(each, each.value) for each in find_suspects(problem)]
    for each, _, row in _follow(problem, suspects, x, u):
        bad = ~np.isfinite(row) | ((row == 0) if each.may_be_negative else (row < 0))
        if each.may_be_negative:
            bad[1:] |= (row[:-1] * row[1:] < 0) & (t[1:] > t[:-1])
        if bad.any():
            faults.append((int(np.argmax(bad)), f'{each.where} {each.fault}'))
    if not faults:
        return ''
    k, what = min(faults, key=lambda fault: fault[0])
    state = ', '.join(f'{name} = {value:.4g}'
                      for name, value in zip(problem.states, x[k], strict=True))
    return f'{what} at t = {t[k]:.4g} on the closest path found, where {state[:200]}'


def explain_kink(problem: Problem, t: Array, x: Array, u: Array) -> str:
    """
    Return which absolute value of states vanishes on a path, and a smooth replacement.

    At the kink the costate equation does not determine dlam/dt. '' is returned if there is none.
    """
    found = [(where, operands[0])
             for where, operation, operands in _operations(problem, (_AT_END, problem.V))
             if operation == ca.OP_FABS and ca.depends_on(operands[0], problem.x)]
    for where, value, row in _follow(problem, found, x, u):
        size = float(np.abs(row).max())
        at = np.abs(row) <= _TOUCHED * size
        at[1:] |= row[:-1] * row[1:] < 0
        if where == _AT_END:   # only its gradient at T matters; its kinks were smoothed
            at[:-1], at[-1] = False, np.abs(row[-1]) <= 1e-4 * size   # in the search
        if at.any():
            what = _quoted(problem, value)
            return (f'{where} is not differentiable where abs({what}) is 0, as at t = '
                    f'{t[int(np.argmax(at))]:.4g} on the best path found, so that costates '
                    f'are not determined there; replace abs({what}) by sqrt(({what})**2 + e**2) '
                    f'with a small e such as {format_number(_SMALL * size)}')
    return ''


def explain_steep_root(problem: Problem, t: Array, x: Array, u: Array) -> str:
    """
    Return which root of states vanishes on a path, and a smooth replacement.

    Its derivative is infinite there, and so is dlam/dt. '' is returned if there is none.
    """
    found = [(where, operands[0]) for where, operation, operands in _operations(problem)
             if _root(operation, operands) and ca.depends_on(operands[0], problem.x)]
    for where, value, row in _follow(problem, found, x, u):
        size = float(np.abs(row).max())
        k = int(np.argmin(np.abs(row)))
        if size > 0 and abs(row[k]) <= _TOUCHED * size:
            what = _quoted(problem, value)
            return (f'{where} contains a root of {what}, whose derivative is infinite where this '
                    f'is 0, as at t = {t[k]:.4g} on the best path found, so that the costate '
                    f'equation is singular there; replace {what} by {what} + e with a small e '
                    f'such as {format_number(_SMALL * size)}')
    return ''


def explain_level_terminal(problem: Problem, x: Array) -> str:
    """
    Return which terminal constraint has a vanishing gradient where it is met.

    Newton's method converges quadratically to a simple root. At a root of order k each step
    multiplies the residual by (1 - 1/k)^k, which is 1/4 or more. The steps begin near x(T), where
    the residual is far above rounding.

    :param x: (n,), a state near one that meets them, x(T).
    :return: a sentence; '' if there is none.
    """
    if not problem.q or not np.isfinite(x).all():
        return ''
    slopes = ca.Function('slopes', [problem.x, problem.p], [
        problem.psi, ca.densify(ca.jacobian(problem.psi, problem.x))])
    size, steps = float(np.abs(x).max()) or 1.0, 6
    for row in range(problem.q):
        slope = slopes(x, problem.p_value)[1].full()[row]
        if not (np.isfinite(slope).all() and slope.any()):
            slope = np.arange(1.0, problem.n + 1.0)   # without gradient: any direction
        # Newton's method begins beside x(T). At a multiple root it converges slowly.
        there, left = x + 1e-2 * size * slope / np.abs(slope).max(), list[float]()
        for _ in range(steps):
            value, slope = (each.full()[row] for each in slopes(there, problem.p_value))
            left.append(abs(float(value[0])))
            if not (np.isfinite(slope).all() and slope.any()):
                break
            there = there - value * slope / (slope @ slope)
        parts = [after / before for before, after in zip(left, left[1:], strict=False) if before]
        if len(parts) == steps - 1 and all(0.2 < part < 0.4 for part in parts):
            what = _quoted(problem, problem.psi[row])
            return (f'{problem.ends[row]}, {what}, has zero gradient where it is met, '
                    'so that it has no finite multiplier; constrain the expression itself, not '
                    'its power: x - 1 instead of (x - 1)**2')
    return ''


@dataclass
class _Far:
    """The event of SciPy's integrators at which a state has become very large."""

    size: Array
    terminal: bool = True

    def __call__(self, t: float, x: Array) -> float:
        """Return a number that changes its sign there."""
        return float(_FAR - np.max(np.abs(x) / self.size))


def explain_escape(problem: Problem, T: float) -> str:
    """
    Return a sentence if the states diverge before T for every constant input tried.

    These are the corners of the input bounds and their middle; a missing bound is replaced by 1
    or -1. '' is returned if the states stay below 1e6 times 1 + |x(0)| for an input.
    """
    f = ca.Function('f', [problem.x, problem.u, problem.p], [problem.f])
    low = np.where(np.isfinite(problem.u_lower), problem.u_lower, np.minimum(-1, problem.u_upper))
    high = np.where(np.isfinite(problem.u_upper), problem.u_upper, np.maximum(1, low))
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(problem.m, -1).T \
        if 2**problem.m < 16 else np.array([low, high])
    size = 1.0 + np.abs(problem.x0)
    far, latest, name = _Far(size), 0.0, ''
    for u in (0.5 * (low + high), *corners):
        left = iter(range(4000))   # evaluations of f: stiff systems are left out

        def rate(t: float, x: Array, u: Array = u, left: Iterator[int] = left) -> Array:
            next(left)
            return np.asarray(f(x, u, problem.p_value).full()[:, 0], dtype=np.float64)

        try:
            with np.errstate(all='ignore'):
                course = integrate.solve_ivp(
                    rate, (0.0, T), problem.x0, events=far, rtol=1e-4, max_step=T / 20)
        except StopIteration:
            return ''
        if course.status != 1:
            return ''
        if course.t[-1] > latest:
            latest = float(course.t[-1])
            name = problem.states[int(np.argmax(np.abs(course.y[:, -1]) / size))]
    return (f'{name} diverges: with each of {len(corners) + 1} constant inputs within the bounds '
            f'a state exceeds {_FAR:.0e} (1 + |x(0)|) by t = {latest:.4g}, before T = {T:.6g}')


def _quoted(problem: Problem, value: ca.SX) -> str:
    """Return an expression as text, truncated if it is long."""
    numbers = [k for k, name in enumerate(problem.parameters) if '#' in name]   # as stated
    what = str(ca.substitute(value, problem.p[numbers], ca.DM(problem.p_value[numbers])))
    return what if len(what) <= _QUOTED else f'{what[:_QUOTED]}...'


def find_steep_operands(problem: Problem) -> Iterator[tuple[str, ca.SX]]:
    """
    Yield the keys of expressions with operations of infinite slope, and their operands.

    These are roots, logarithms, inverse sines and cosines, and powers with variable exponents.
    Differential equations that contain them may have several solutions from one state.
    """
    steep = ca.OP_LOG, ca.OP_ASIN, ca.OP_ACOS
    for where, operation, operands in _operations(problem):
        power = operation in (ca.OP_POW, ca.OP_CONSTPOW) and not operands[1].is_constant()
        if power or operation in steep or _root(operation, operands):
            yield where, operands[0]


def _root(operation: int, operands: list[ca.SX]) -> bool:
    """Return whether the slope of an operation is infinite where its first operand is 0."""
    power = operation in (ca.OP_POW, ca.OP_CONSTPOW) and operands[1].is_constant() and (
        0 < float(operands[1]) < 1)
    return bool(power or operation == ca.OP_SQRT)


def _operations(problem: Problem, *more: tuple[str, ca.SX]
                ) -> Iterator[tuple[str, int, list[ca.SX]]]:
    """Yield the operations in a problem, and in `more` expressions: key, operation, operands."""
    symbols = [problem.x, problem.u, problem.p]
    found: list[tuple[int, list[ca.SX]]] = []

    def apply(operation: int, operands: list[ca.SX]) -> ca.SX:
        found.append((operation, operands))
        return apply_to_expressions(operation, operands)

    for where, expression in (
            *((f'dynamics.{name}', problem.f[k]) for k, name in enumerate(problem.states)),
            ('running_cost', problem.L),
            *((f'path_constraints[{k}]', problem.path[k]) for k in range(problem.path.numel())),
            *more):
        found.clear()
        Instructions(ca.Function('one', symbols, [expression])).evaluate(
            lambda i, k: symbols[i][k], ca.SX, apply)
        yield from [(where, *each) for each in found]


def find_suspects(problem: Problem) -> list[Suspect]:
    """
    Return the divisors and the arguments of logarithms and roots that are not constant.

    Terminal cost and terminal constraints are not examined.
    """
    found = []
    for where, operation, operands in _operations(problem):
        powers = operation in (ca.OP_POW, ca.OP_CONSTPOW) and operands[1].is_constant()
        power = float(operands[1]) if powers else 0.0
        what = {ca.OP_LOG: 'the logarithm', ca.OP_SQRT: 'the root'}.get(
            operation, 'a noninteger power' if power % 1.0 else '')
        if operation in (ca.OP_DIV, ca.OP_INV) or power < 0.0 and not what:
            found.append(Suspect(where, operands[0 if powers else -1], 'divides by zero', True))
        elif what:
            found.append(Suspect(where, operands[0], f'takes {what} of a negative number', False))
    return [each for each in found if not each.value.is_constant()]


def _follow(problem: Problem, found: list[tuple[_Place, ca.SX]], x: Array, u: Array
            ) -> Iterator[tuple[_Place, ca.SX, Array]]:
    """Yield expressions with their values (N,) along a path; none on a path with NaN or inf."""
    if not found or not len(x) or not (np.isfinite(x).all() and np.isfinite(u).all()):
        return
    look = ca.Function('look', [problem.x, problem.u, problem.p],
                       [ca.vertcat(*(value for _, value in found))])
    rows = look.map(len(x))(x.T, u.T, problem.p_value).full()
    for (where, value), row in zip(found, np.asarray(rows), strict=True):
        yield where, value, row
