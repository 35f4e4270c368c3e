# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A linear system of given matrices."""

from collections.abc import Sequence
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.system import define, Signal, System
from obc_ros.core.text.errors import DynamicsError, quote

Matrix = Array | Sequence[float] | Sequence[Sequence[float]]

MAX_STATES = 200


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
