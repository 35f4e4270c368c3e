# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of the matrices of a linear quadratic problem: shape, symmetry and definiteness."""

from typing import Any

import numpy as np
from obc_ros.core.numerics.arrays import Array, lapack
from obc_ros.core.numerics.rounding import EPS
from obc_ros.core.text.errors import RefusedDesignError, StatementError

LARGEST = 400  # states or inputs; a much larger request would block its server for minutes
LARGEST_NUMBER = 1e100  # a product of three such numbers is finite


def check_matrices(A: Any, B: Any, Qx: Any, Qu: Any, cross: Any
                   ) -> tuple[Array, Array, Array, Array, Array | None]:
    """
    Check shapes, numbers and symmetry, and return float copies.

    :param A, B: (n, n) and (n, m), system and input matrix.
    :param Qx, Qu: (n, n) and (m, m), weights; definiteness is checked by `remove_cross_term`.
    :param cross: (n, m), or None, weight N of the cross term 2 x'N u.
    :raises StatementError: if an argument is not a matrix of finite numbers, has the wrong shape
        or is not symmetric (Qx, Qu), or if there are more than `LARGEST` states or inputs.
    """
    A, B = _matrix('A', A), _matrix('B', B)
    n, m = len(A), B.shape[1]
    _check_size('A', A, (n, n))
    _check_size('B', B, (n, m))
    if not n or not m:
        raise StatementError('A and B: wanted at least one state and one input')
    if n > LARGEST or m > LARGEST:
        raise StatementError(f'{max(n, m)} states or inputs: at most {LARGEST} are taken')
    Qx, Qu = _symmetric('Qx', Qx, n), _symmetric('Qu', Qu, m)
    if cross is not None:
        cross = _matrix('cross', cross)
        _check_size('cross', cross, (n, m))
    return A, B, Qx, Qu, cross


def _matrix(name: str, M: Any) -> Array:
    try:
        given = np.array(M)
    except ValueError as error:
        raise StatementError(f'{name}: wanted rows of equal length') from error
    if given.dtype.kind not in 'fiu':
        raise StatementError(f'{name}: wanted a matrix of real numbers')
    if given.ndim != 2:
        raise StatementError(f'{name}: expected a matrix (rows, columns) but found {given.shape}')
    matrix: Array = given.astype(float, copy=False)
    # The sum of squares is the fastest check; it is nan if an entry is.
    if not np.vdot(matrix, matrix) <= LARGEST_NUMBER**2 and not (
            np.abs(matrix) <= LARGEST_NUMBER).all():
        i, j = np.argwhere(~(np.abs(matrix) <= LARGEST_NUMBER))[0]
        raise StatementError(f'{name}[{i}, {j}] = {matrix[i, j]:g}: wanted a finite number of at '
                             f'most {LARGEST_NUMBER:g}')
    return matrix


def _check_size(name: str, M: Array, shape: tuple[int, int]) -> None:
    if M.shape != shape:
        raise StatementError(f'{name}: expected {shape} but found {M.shape}')


def _symmetric(name: str, M: Any, n: int) -> Array:
    matrix = _matrix(name, M)
    _check_size(name, matrix, (n, n))
    if (matrix != matrix.T).any():
        size = np.sqrt(np.abs(matrix.diagonal()))
        wrong = np.abs(matrix - matrix.T) > 1e-10 * (size * size[:, None] + np.abs(matrix))
        if wrong.any():
            i, j = np.argwhere(wrong)[0]
            raise StatementError(f'{name}[{i}, {j}] = {matrix[i, j]:g} but {name}[{j}, {i}] = '
                                 f'{matrix[j, i]:g}: {name} must be symmetric')
        matrix = 0.5 * (matrix + matrix.T)
    return matrix


def remove_cross_term(A: Array, B: Array, Qx: Array, Qu: Array, cross: Array | None
                      ) -> tuple[Array, Array, Array, bool]:
    """
    Check the definiteness of the weights and remove the cross term.

    :return: L: (m, m), lower Cholesky factor, Qu = L L'; A, Q: (n, n), A - B Qu^-1 N' and Qx - N
        Qu^-1 N'; sees_all: whether Q is positive definite, so that (A, Q) is observable.
    :raises RefusedDesignError: if Qu is not positive definite, or Q not positive semidefinite.
    """
    L = _definite('Qu', Qu)
    Q = Qx
    if cross is not None:
        right = lapack.dpotrs(L, cross.T, lower=1)[0]
        A = A - B @ right
        Q = Qx - cross @ right
        Q = 0.5 * (Q + Q.T)
    root, info = lapack.dpotrf(Q, lower=1)
    diagonal = Q.diagonal()
    sees_all = info == 0 and bool((root.diagonal()**2 > 1e-10 * diagonal).all())
    if not sees_all:
        what = 'Qx' if cross is None else "Qx - cross Qu^-1 cross'"
        _check_semidefinite('Qx', Qx, Q, what)
    return L, A, Q, sees_all


def _definite(name: str, M: Array) -> Array:
    """Return the lower Cholesky factor; raise RefusedDesignError if there is none."""
    L: Array
    L, info = lapack.dpotrf(M, lower=1)
    diagonal = M.diagonal()
    if info or (L.diagonal()**2 <= 4 * len(M) * EPS * diagonal).any():
        for i, value in enumerate(diagonal):
            if value <= 0.0:
                raise RefusedDesignError(
                    f'{name}[{i}] = {value:g}: {name} must be positive definite')
        size = np.sqrt(diagonal)
        least = float(np.linalg.eigvalsh(M / size / size[:, None])[0])
        raise RefusedDesignError(f'{name} must be positive definite: scaled to a unit diagonal, '
                                 f'its minimum eigenvalue is {least:.3g}')
    return L


def _check_semidefinite(name: str, M: Array, reduced: Array, what: str) -> None:
    """Raise RefusedDesignError if M, or `reduced` by the cross term, is not semidefinite."""
    for i, value in enumerate(M.diagonal()):
        if value < 0.0:
            raise RefusedDesignError(
                f'{name}[{i}] = {value:g}: {name} must be positive semidefinite')
    for i, j in np.argwhere(np.abs(M) > 0.0):
        if M[i, i] == 0.0 and i != j:
            raise RefusedDesignError(f'{name}[{i}, {j}] = {M[i, j]:g} but {name}[{i}, {i}] = 0: '
                                     f'{name} must be positive semidefinite')
    # `reduced` carries the rounding error of M and is therefore scaled by the diagonal of M.
    size = np.sqrt(np.where(M.diagonal() > 0.0, M.diagonal(), 1.0))
    least = float(np.linalg.eigvalsh(reduced / size / size[:, None])[0])
    if least < -1e-12 * len(M):
        scaling = 'to a unit diagonal' if what == name else f'by the diagonal of {name}'
        raise RefusedDesignError(f'{what} must be positive semidefinite: scaled {scaling}, its '
                                 f'minimum eigenvalue is {least:.3g}')


def check_semidefinite(name: str, M: Any, n: int) -> Array:
    """
    Check that a weight is symmetric and positive semidefinite, and return a float copy.

    :param name: for messages.
    :raises StatementError: if M is not a symmetric (n, n) matrix of finite numbers.
    :raises RefusedDesignError: if M is not positive semidefinite.
    """
    matrix = _symmetric(name, M, n)
    if lapack.dpotrf(matrix)[1]:
        _check_semidefinite(name, matrix, matrix, name)
    return matrix


def check_definite(name: str, M: Any, n: int) -> Array:
    """
    Check that a matrix is symmetric and positive definite, and return a float copy.

    The parameters and errors are those of `check_semidefinite`.
    """
    matrix = _symmetric(name, M, n)
    _definite(name, matrix)
    return matrix


def check_matrix(name: str, M: Any, shape: tuple[int | None, int | None]) -> Array:
    """
    Check the numbers and the shape of a matrix, and return a float copy.

    :param name: for messages.
    :param shape: wanted numbers of rows and columns; None: any from 1 to `LARGEST`.
    :raises StatementError: if it is not a matrix of finite numbers, or has the wrong shape.
    """
    matrix = _matrix(name, M)
    rows, columns = matrix.shape
    for size, wanted in ((rows, shape[0]), (columns, shape[1])):
        if wanted is None and not 0 < size <= LARGEST:
            raise StatementError(f'{name}: {size} rows or columns: wanted 1 to {LARGEST}')
    _check_size(name, matrix, (rows if shape[0] is None else shape[0],
                               columns if shape[1] is None else shape[1]))
    return matrix
