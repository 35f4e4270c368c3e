# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Linear systems of given matrices, and small systems of the book."""

from collections.abc import Sequence
from itertools import combinations
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.system import define, Parameter, Signal, System
from obc_ros.core.text.errors import DynamicsError, quote

Matrix = Array | Sequence[float] | Sequence[Sequence[float]]

MAX_STATES = 200
MAX_M = 50


def define_scalar() -> System:
    """Return x' = a x + b u (Example 2.2; Exercise 2.9; with -a for a, Exercise 2.4)."""
    return define(
        'scalar',
        states=(Signal('x'),),
        inputs=(Signal('u'),),
        parameters=(Parameter('a', 1.0, '1/s'), Parameter('b', 1.0)),
        dynamics=lambda x, u, p: (p[0] * x[0] + p[1] * u[0],),
        description='linear system with one state (Example 2.2)')


def define_cubic() -> System:
    """Return x' = -a x^3 + b u (Exercise 2.5)."""
    return define(
        'cubic',
        states=(Signal('x'),),
        inputs=(Signal('u'),),
        parameters=(Parameter('a', 1.0), Parameter('b', 1.0)),
        dynamics=lambda x, u, p: (-p[0] * x[0]**3 + p[1] * u[0],),
        description='cubic system with one state (Exercise 2.5)')


def define_double_integrator() -> System:
    """Return the double integrator x1' = x2, x2' = u (Examples 2.3 and 2.4)."""
    return define(
        'double_integrator',
        states=(Signal('x1', 'm', description='position'),
                Signal('x2', 'm/s', description='velocity')),
        inputs=(Signal('u', 'm/s^2', description='acceleration'),),
        parameters=(),
        dynamics=lambda x, u, _: (x[1], u[0]),
        description='double integrator (Examples 2.3 and 2.4)')


def build_nonholonomic_integrator() -> System:
    """Return x1' = u1, x2' = u2, x3' = x2 u1 with limits 1 of both inputs (Example 2.6)."""
    return define(
        'nonholonomic_integrator',
        states=(Signal('x1'), Signal('x2'), Signal('x3')),
        inputs=(Signal('u1', '1/s', -1.0, 1.0), Signal('u2', '1/s', -1.0, 1.0)),
        parameters=(),
        dynamics=lambda x, u, _: (u[0], u[1], x[1] * u[0]),
        description='nonholonomic integrator (Example 2.6)')


def define_brockett(m: int = 3) -> System:
    """
    Return Brockett's system q' = u, Y' = q u' - u q', q and u in R^m, Y skew-symmetric.

    The states are q1 .. qm and the entries of Y above its diagonal, row by row: y1_2, y1_3, ...

    Book, Exercise 2.2, with Y' = -Y.
    """
    if isinstance(m, bool) or not isinstance(m, int) or not 2 <= m <= MAX_M:
        raise DynamicsError(f'brockett.m = {m}: wanted a whole number from 2 to {MAX_M}')
    pairs = list(combinations(range(m), 2))

    def dynamics(x: list[ca.SX], u: list[ca.SX], _: list[ca.SX]) -> tuple[Any, ...]:
        return (*u, *(x[i] * u[j] - u[i] * x[j] for i, j in pairs))

    return define(
        'brockett',
        states=(*(Signal(f'q{i + 1}') for i in range(m)),
                *(Signal(f'y{i + 1}_{j + 1}') for i, j in pairs)),
        inputs=tuple(Signal(f'u{i + 1}', '1/s') for i in range(m)),
        parameters=(),
        dynamics=dynamics,
        description="Brockett's system (Exercise 2.2)")


def define_linear(A: Matrix = (), B: Matrix = (), states: str = '', inputs: str = '') -> System:
    """
    Return x' = A x + B u.

    :param A, B: (n, n) and (n, m), or n * n and n * m numbers, row by row.
    :param states, inputs: names with commas between them; empty: x1, x2, ... and u1, u2, ...
    :raises DynamicsError: if the shapes or the number of names do not fit, or an entry is not
        finite.
    """
    given = _numbers('A', A), _numbers('B', B)
    n = math.isqrt(given[0].size)
    if not 1 <= n <= MAX_STATES or n * n != given[0].size or given[0].shape[0] not in (n, n * n):
        raise DynamicsError(f'linear.A: wanted n x n numbers, n from 1 to {MAX_STATES}, '
                            f'found {_shape(given[0])}')
    m = given[1].size // n
    if not 1 <= m <= MAX_STATES or n * m != given[1].size or given[1].shape[0] not in (n, n * m):
        raise DynamicsError(f'linear.B: wanted {n} x m numbers, as A is {n} x {n}, '
                            f'found {_shape(given[1])}')
    a, b = given[0].reshape(n, n), given[1].reshape(n, m)

    def dynamics(x: list[ca.SX], u: list[ca.SX], _: list[ca.SX]) -> list[Any]:
        # Zeros are omitted, so that the sparsity is that of A and B.
        return [sum((a[i, j] * x[j] for j in range(n) if a[i, j]), ca.SX(0))
                + sum((b[i, j] * u[j] for j in range(m) if b[i, j]), ca.SX(0))
                for i in range(n)]

    return define(
        'linear',
        states=_name('states', states, n, 'x'),
        inputs=_name('inputs', inputs, m, 'u'),
        parameters=(),
        dynamics=dynamics,
        description=f'linear system with {n} states and {m} inputs')


def _name(what: str, given: str, count: int, letter: str) -> tuple[Signal, ...]:
    """Return signals with the given names, or with a letter and a number each."""
    names = [each.strip() for each in given.split(',')] if given else [
        f'{letter}{k + 1}' for k in range(count)]
    if len({each for each in names if each.isidentifier()}) != count or len(names) != count:
        raise DynamicsError(f'linear.{what}: wanted {count} different names with commas between '
                            f"them, found '{quote(given)}'")
    return tuple(map(Signal, names))


def _numbers(name: str, given: Matrix) -> Array:
    try:
        array = np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise DynamicsError(f'linear.{name}: wanted rows of numbers, all of one length') from None
    if array.ndim not in (1, 2) or not np.isfinite(array).all():
        raise DynamicsError(f'linear.{name}: wanted a matrix of finite numbers')
    return array


def _shape(array: Array) -> str:
    return ' x '.join(map(str, array.shape)) + ' numbers'
