# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Where a path comes to states at which the expressions of its problem have no value, or no slope.

A division by zero, a logarithm or root of what is negative, states that run away in finite time;
the kink of an absolute value, a root of what vanishes; terminal constraints that are met where
they have no slope.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.wording import format_number

_TOUCHED = 1e-6  # of its largest value: what is as near to 0 as it can be told
_NEAR_END = 1e-4   # likewise, where a kink of the terminal cost was rounded in the search
_AT_END = 'terminal_cost'
_SMALL = 1e-3    # likewise: what a kink may be rounded by
_NEWTON = 6      # steps
_BESIDE = 1e-2   # of the largest state: how far from x(T) they begin
_MULTIPLE = 0.2, 0.4   # what each leaves towards a root that is none of the first order
_QUOTED = 80     # letters of an expression
_FAR = 1e6      # times the size of x(0) and of the bounds: where a state is said to run away
_TRIALS = 16    # constant inputs that are tried
_PATIENCE = 4000   # evaluations of f for each of them: stiff systems do not run away so soon


@dataclass(frozen=True)
class Suspect:
    """Something in an expression that must not vanish, or must not be negative."""

    where: str
    value: ca.SX
    fault: str
    may_be_negative: bool


def explain_undefined(problem: Problem, t: Array, x: Array, u: Array) -> str:
    """
    Return which expression has no value on a path, where and why; '' if all have one.

    Parameters
    ----------
    problem : Problem
        The one with the expressions.
    t, x, u : ndarray, shape (N,), (N, n), (N, m)
        The path; between its points a divisor that changes its sign is taken to vanish.

    """
    found = find_suspects(problem)
    if not found or not t.size or not (np.isfinite(x).all() and np.isfinite(u).all()):
        return ''
    values = _values(problem, [each.value for each in found], x, u)
    first: tuple[int, str] | None = None
    for each, row in zip(found, values, strict=True):
        bad = ~np.isfinite(row) | ((row == 0) if each.may_be_negative else (row < 0))
        if each.may_be_negative:
            bad[1:] |= (row[:-1] * row[1:] < 0) & (t[1:] > t[:-1])
        k = int(np.argmax(bad))
        if bad[k] and (first is None or k < first[0]):
            first = k, f'{each.where} {each.fault}'
    if first is None:
        return ''
    k, what = first
    state = ', '.join(f'{name} = {value:.4g}'
                      for name, value in zip(problem.states, x[k], strict=True))
    return f'{what} at t = {t[k]:.4g} on the nearest path that was found, where {state[:200]}'


def explain_kink(problem: Problem, t: Array, x: Array, u: Array) -> str:
    """
    Return which absolute value of states has its kink on a path, and what to write; '' if none.

    Without a slope there the costate equation says nothing.
    The parameters are those of `explain_undefined`.
    """
    found = [(where, operands[0]) for where, operation, operands in chain(
                 _operations(problem), ((_AT_END, *each) for each in _done_in(problem, problem.V)))
             if operation == ca.OP_FABS and ca.depends_on(operands[0], problem.x)]
    if not found or not t.size or not (np.isfinite(x).all() and np.isfinite(u).all()):
        return ''
    for (where, value), row in zip(
            found, _values(problem, [value for _, value in found], x, u), strict=True):
        size = float(np.abs(row).max())
        at = np.abs(row) <= _TOUCHED * size
        at[1:] |= row[:-1] * row[1:] < 0
        if where == _AT_END:   # whose slope counts there alone; it was rounded on the way to it
            at[:-1], at[-1] = False, np.abs(row[-1]) <= _NEAR_END * size
        if at.any():
            what = _quoted(problem, value)
            return (f'{where} has no slope where abs({what}) is 0, as at t = '
                    f'{t[int(np.argmax(at))]:.4g} on the best path that was found: no costates '
                    f'are known there; sqrt(({what})**2 + e**2) in its place, with a small e such '
                    f'as {format_number(_SMALL * size)}, has a slope')
    return ''


def explain_steep_root(problem: Problem, t: Array, x: Array, u: Array) -> str:
    """
    Return which root of states vanishes on a path, and what to write; '' if none does.

    Its slope is infinite there, and with it dlam/dt. Parameters are those of `explain_undefined`.
    """
    found = [*find_roots(problem)]
    if not found or not t.size or not (np.isfinite(x).all() and np.isfinite(u).all()):
        return ''
    for (where, value), row in zip(
            found, _values(problem, [value for _, value in found], x, u), strict=True):
        size = float(np.abs(row).max())
        k = int(np.argmin(np.abs(row)))
        if size > 0 and abs(row[k]) <= _TOUCHED * size:
            what = _quoted(problem, value)
            return (f'{where} has a root of {what}, whose slope is infinite where that is 0, as '
                    f'at t = {t[k]:.4g} on the best path that was found: no finite costates do '
                    f'there; {what} + e in its place, with a small e such as '
                    f'{format_number(_SMALL * size)}, has a slope')
    return ''


def explain_level_terminal(problem: Problem, x: Array) -> str:
    """
    Return which terminal constraint has no slope where it is met, next to x(T); '' if none.

    Newton's steps towards a simple root square what is left, those towards a root of order k
    leave a part (1 - 1/k)^k of it each time, from a quarter up. They begin beside x(T), where
    what is left is far above rounding.
    """
    if not problem.q or not np.isfinite(x).all():
        return ''
    slopes = ca.Function('slopes', [problem.x, problem.p], [
        problem.psi, ca.densify(ca.jacobian(problem.psi, problem.x))])
    size = float(np.abs(x).max()) or 1.0
    for row in range(problem.q):
        slope = slopes(x, problem.p_value)[1].full()[row]
        if not (np.isfinite(slope).all() and slope.any()):
            slope = np.arange(1.0, problem.n + 1.0)   # level there: any direction that leaves it
        there, left = x + _BESIDE * size * slope / np.abs(slope).max(), list[float]()
        for _ in range(_NEWTON):
            value, slope = (each.full()[row] for each in slopes(there, problem.p_value))
            left.append(abs(float(value[0])))
            if not (np.isfinite(slope).all() and slope.any()):
                break
            there = there - value * slope / (slope @ slope)
        parts = [after / before for before, after in zip(left, left[1:], strict=False) if before]
        if len(parts) == _NEWTON - 1 and all(
                _MULTIPLE[0] < part < _MULTIPLE[1] for part in parts):
            what = _quoted(problem, problem.psi[row])
            return (f'terminal_constraints[{row}], {what}, has no slope where it is met: no '
                    f'finite multiplier does there; write what is to vanish itself in its place, '
                    f'as x - 1 in that of (x - 1)**2')
    return ''


def explain_escape(problem: Problem, T: float) -> str:
    """
    Return a sentence if the states grow beyond all bounds before T with every input tried.

    The inputs are constant: the corners of their box (1 in place of a bound that is missing) and
    its middle.
    """
    from scipy.integrate import solve_ivp
    f = ca.Function('f', [problem.x, problem.u, problem.p], [problem.f])
    low = np.where(np.isfinite(problem.u_lower), problem.u_lower, np.minimum(-1, problem.u_upper))
    high = np.where(np.isfinite(problem.u_upper), problem.u_upper, np.maximum(1, low))
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(problem.m, -1).T \
        if 2**problem.m < _TRIALS else np.array([low, high])
    size = 1.0 + np.abs(problem.x0)

    def far(t: float, x: Array) -> float:
        return float(_FAR - np.max(np.abs(x) / size))

    far.terminal = True  # type: ignore[attr-defined]  # how SciPy is told
    latest, name = 0.0, ''
    for u in (0.5 * (low + high), *corners):
        left = iter(range(_PATIENCE))

        def rate(t: float, x: Array, u: Array = u, left: Iterator[int] = left) -> Array:
            next(left)
            return np.asarray(f(x, u, problem.p_value).full()[:, 0], dtype=np.float64)

        try:
            with np.errstate(all='ignore'):
                course = solve_ivp(rate, (0.0, T), problem.x0, events=far, rtol=1e-4,
                                   max_step=T / 20)
        except StopIteration:
            return ''
        if course.status != 1:
            return ''
        if course.t[-1] > latest:
            latest = float(course.t[-1])
            name = problem.states[int(np.argmax(np.abs(course.y[:, -1]) / size))]
    return (f'{name} runs away: with each of {len(corners) + 1} constant inputs within the bounds '
            f'it has grown more than {_FAR:.0e} times by t = {latest:.4g}, before T = {T:.6g}')


def _quoted(problem: Problem, value: ca.SX) -> str:
    """Return an expression in words, its beginning if it is long."""
    numbers = [k for k, name in enumerate(problem.parameters) if '#' in name]   # as stated
    what = str(ca.substitute(value, problem.p[numbers], ca.DM(problem.p_value[numbers])))
    return what if len(what) <= _QUOTED else f'{what[:_QUOTED]}...'


def find_roots(problem: Problem) -> Iterator[tuple[str, ca.SX]]:
    """Yield where roots of states are taken, and of what: their slopes are infinite at 0."""
    for where, operation, operands in _operations(problem):
        if _root(operation, operands) and ca.depends_on(operands[0], problem.x):
            yield where, operands[0]


def find_steep_operands(problem: Problem) -> Iterator[tuple[str, ca.SX]]:
    """
    Yield where operations whose slope is infinite somewhere are done, and on what.

    Beside roots these are logarithms, inverse sines and cosines, and powers that are no numbers:
    of differential equations with them more than one path may come from a state.
    """
    steep = ca.OP_SQRT, ca.OP_LOG, ca.OP_ASIN, ca.OP_ACOS
    for where, operation, operands in _operations(problem):
        power = operation in (ca.OP_POW, ca.OP_CONSTPOW) and not operands[1].is_constant()
        if power or operation in steep or _root(operation, operands):
            yield where, operands[0]


def _root(operation: int, operands: list[ca.SX]) -> bool:
    """Return whether the slope of an operation is infinite where its first operand is 0."""
    power = operation in (ca.OP_POW, ca.OP_CONSTPOW) and operands[1].is_constant() and (
        0 < float(operands[1]) < 1)
    return bool(power or operation == ca.OP_SQRT)


def _operations(problem: Problem) -> Iterator[tuple[str, int, list[ca.SX]]]:
    """Yield where in a problem which operation is done on what."""
    named = [(f'dynamics.{name}', each) for name, each in zip(
        problem.states, ca.vertsplit(problem.f), strict=True)]
    named.append(('running_cost', problem.L))
    if problem.path.numel():
        named += [(f'path_constraints[{index}]', each)
                  for index, each in enumerate(ca.vertsplit(problem.path))]
    for where, expression in named:
        for operation, operands in _done_in(problem, expression):
            yield where, operation, operands


def _done_in(problem: Problem, expression: ca.SX) -> Iterator[tuple[int, list[ca.SX]]]:
    """Yield which operation an expression does on what."""
    symbols = [problem.x, problem.u, problem.p]
    function = ca.Function('one', symbols, [expression])
    work: dict[int, ca.SX] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[outputs[0]] = symbols[inputs[0]][inputs[1]]
        elif operation == ca.OP_CONST:
            work[outputs[0]] = ca.SX(function.instruction_constant(k))
        elif operation != ca.OP_OUTPUT:
            operands = [work[index] for index in inputs]
            yield operation, operands
            work[outputs[0]] = (ca.SX.binary(operation, *operands) if len(operands) == 2
                                else ca.SX.unary(operation, *operands))


def find_suspects(problem: Problem) -> list[Suspect]:
    """Return the divisors, and the arguments of logarithms and roots, of all expressions."""
    found = [each for where, operation, operands in _operations(problem)
             for each in _of(operation, operands, where)]
    return [each for each in found if not each.value.is_constant()]


def _values(problem: Problem, expressions: list[ca.SX], x: Array, u: Array) -> Array:
    """Return expressions along a path, one row each."""
    look = ca.Function('look', [problem.x, problem.u, problem.p], [ca.vertcat(*expressions)])
    return np.asarray(look.map(len(x))(x.T, u.T, ca.repmat(problem.p_value, 1, len(x))).full())


def _of(operation: int, operands: list[ca.SX], where: str) -> list[Suspect]:
    """Return what one operation asks of its operands."""
    if operation == ca.OP_DIV:
        return [Suspect(where, operands[1], 'divides by zero', True)]
    if operation == ca.OP_INV:
        return [Suspect(where, operands[0], 'divides by zero', True)]
    if operation == ca.OP_LOG:
        return [Suspect(where, operands[0], 'has the logarithm of a number below 0', False)]
    if operation in (ca.OP_POW, ca.OP_CONSTPOW) and operands[1].is_constant() and (
            float(operands[1]) % 1.0):
        return [Suspect(where, operands[0], 'has a broken power of a number below 0', False)]
    if operation == ca.OP_SQRT:
        return [Suspect(where, operands[0], 'has the root of a number below 0', False)]
    return []
