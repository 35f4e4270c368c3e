# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Choice of the cost of a linear quadratic regulator (section 2.5).

The cost is the integral of x'Qx x + 2 x'N u + u'Qu u. All conversions from lists of numbers to Qx,
Qu and N are in this module.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.riccati.checks import check_semidefinite
from obc_ros.core.text.errors import quote, StatementError

Numbers = Sequence[float] | Sequence[Sequence[float]] | Array

WEIGHT_KINDS = ('matrices', 'bryson', 'output')


@dataclass(frozen=True, eq=False)
class Weights:
    """
    The cost of a linear quadratic regulator.

    :ivar Qx, Qu: (n, n) and (m, m), state and input weights.
    :ivar cross: (n, m), or None, N in 2 x'N u.
    :ivar stability: prescribed degree of stability [1/s]: the cost is weighted with exp(2
        stability t), and so the closed-loop poles lie left of -stability.
    """

    Qx: Array
    Qu: Array
    cross: Array | None = None
    stability: float = 0.0


def choose(n: int, m: int, *, weights: str = 'matrices', Qx: Numbers = (), Qu: Numbers = (),
           cross: Numbers = (), x_max: Numbers = (), u_max: Numbers = (), H: Numbers = (),
           rho: float = 1.0, stability: float = 0.0) -> Weights:
    """
    Return the cost that is given by lists of numbers.

    :param weights: 'matrices': from Qx and Qu; 'bryson': from x_max and u_max; 'output': from H
        and rho. Arguments of the other kinds are ignored.
    :param Qx, Qu: n or n*n, m or m*m numbers: a diagonal, or a full matrix row by row.
    :param cross: n*m numbers row by row, or none.
    :param x_max, u_max: see `from_bryson`.
    :param H, rho: see `from_output`.
    :raises StatementError: if a list has a wrong number of entries, or an entry is not a number or
        out of range. The design checks the definiteness of Qx and Qu.
    """
    if weights == 'matrices':
        chosen = Weights(square('Qx', Qx, n), square('Qu', Qu, m))
    elif weights == 'bryson':
        chosen = from_bryson(n, m, x_max, u_max)
    elif weights == 'output':
        chosen = from_output(n, m, H, rho)
    else:
        raise StatementError(f'weights = {weights!r}: wanted one of {", ".join(WEIGHT_KINDS)}')
    degree = check_number('stability', stability)
    if degree < 0.0:
        raise StatementError(f'stability = {degree:g}: wanted 0 or a positive number')
    N = _list('cross', cross)
    if N.size not in (0, n * m):
        raise StatementError(f'cross has {count(N.size)}; wanted {n * m} (a full matrix row by '
                             'row)')
    return replace(chosen, cross=N.reshape(n, m) if N.size else None, stability=degree)


def from_bryson(n: int, m: int, x_max: Numbers, u_max: Numbers) -> Weights:
    """
    Return diagonal weights by Bryson's rule: the inverse squares of acceptable deviations.

    :param x_max, u_max: largest acceptable deviation of each state (n numbers; inf: weight 0) and
        each input (m numbers), in their units.
    :raises StatementError: if a list has a wrong length, or a number is not positive.
    """
    return Weights(np.diag(_inverse_squares('x_max', x_max, n, may_be_infinite=True)),
                   np.diag(_inverse_squares('u_max', u_max, m, may_be_infinite=False)))


def from_output(n: int, m: int, H: Numbers, rho: float) -> Weights:
    """
    Return Qx = H'H and Qu = rho I, which keep the output z = H x small.

    :param H: p*n numbers, row by row, for p outputs.
    :param rho: input weight against the square of z; positive.
    :raises StatementError: if the numbers of H are no rows of n, or rho is not positive.
    """
    rows = _rows('H', H, n)
    weight = check_number('rho', rho)
    if weight <= 0.0:
        raise StatementError(f'rho = {weight:g}: wanted a positive number')
    return Weights(rows.T @ rows, weight * np.eye(m))


def with_integrals(A: Array, B: Array, weights: Weights, C: Numbers, Qi: Numbers
                   ) -> tuple[Array, Array, Weights]:
    """
    Augment a plant with the integrals of outputs, so that constant disturbances are rejected.

    The state becomes (x, xi) with dxi/dt = C x.

    :param C: p*n numbers row by row: the outputs to integrate.
    :param Qi: p or p*p numbers: weights of the integrals.
    :raises StatementError, RefusedDesignError: if a list has a wrong length, or Qi is not positive
        semidefinite.
    """
    n, m = B.shape
    rows = _rows('C', C, n)
    p = len(rows)
    below, beside = np.zeros((p, m)), np.zeros((n, p))
    Qi = check_semidefinite('Qi', square('Qi', Qi, p), p)
    return np.block([[A, beside], [rows, np.zeros((p, p))]]), np.vstack([B, below]), replace(
        weights, Qx=np.block([[weights.Qx, beside], [beside.T, Qi]]),
        cross=None if weights.cross is None else np.vstack([weights.cross, below]))


def square(name: str, numbers: Numbers, n: int) -> Array:
    """
    Return the (n, n) matrix that is given by n (diagonal) or n*n (row by row) numbers.

    :raises StatementError: if there are neither n nor n*n finite numbers; the message begins with
        `name`.
    """
    values = _list(name, numbers)
    if values.size == n:
        return np.diag(values)
    if values.size == n * n:
        return values.reshape(n, n)
    wanted = f'{n} (a diagonal) or {n * n} (a full matrix row by row)' if n > 1 else '1'
    raise StatementError(f'{name} has {count(values.size)}; wanted {wanted}')


def check_number(name: str, value: Any) -> float:
    """Return a value as a finite float; an error begins with `name`."""
    return float(_list(name, [value])[0])


def _rows(name: str, numbers: Numbers, n: int) -> Array:
    values = _list(name, numbers)
    if values.size == 0 or values.size % n:
        raise StatementError(f'{name} has {count(values.size)}; wanted a multiple of {n} '
                             f'(rows of {n})')
    return values.reshape(-1, n)


def _inverse_squares(name: str, numbers: Numbers, n: int, may_be_infinite: bool) -> Array:
    values = _list(name, numbers, finite=not may_be_infinite)
    if values.size != n:
        raise StatementError(f'{name} has {count(values.size)}; wanted {n}')
    for i, value in enumerate(values):
        if not value >= 1e-150:
            raise StatementError(f'{name}[{i}] = {value:g}: wanted a positive number')
    return 1.0 / values**2


def count(size: int) -> str:
    """Return the size of a list in words: 'no numbers', '1 number', '2 numbers', ..."""
    return '1 number' if size == 1 else f'{size or "no"} numbers'


def _list(name: str, numbers: Any, finite: bool = True) -> Array:
    """Return a flat copy as floats; an error names the index of the number."""
    try:
        values = np.array(numbers).ravel()
    except ValueError as error:
        raise StatementError(f'{name}: wanted numbers in rows of equal length') from error
    if values.size == 0:
        return np.zeros(0)
    if values.dtype.kind not in 'fiu':
        raise StatementError(f'{name}: wanted numbers but found {quote(str(numbers))}')
    values = values.astype(float)
    if finite and not np.isfinite(values).all():
        i = int(np.flatnonzero(~np.isfinite(values))[0])
        raise StatementError(f'{name}[{i}] = {values[i]:g}: wanted a finite number')
    return values
