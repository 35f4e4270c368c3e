# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Bounds in the norm |e|_P = sqrt(e'P e), with a proof that P is positive definite.

The certificate is a matrix Z, computed in double precision; any Z is a valid one. With e = Z y,
Gershgorin's theorem bounds the eigenvalues of the forms of y. If Z'P Z >= least I with least > 0,
then Z is invertible, P is positive definite and P^-1 <= Z Z' / least. If also
Z'M'P M Z <= most I, then |M e|_P <= sqrt(most / least) |e|_P. The bounds are tight if Z has the
eigenvectors of the pencil (M'P M, P), for which both forms are diagonal.
"""

import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, linalg
from obc_ros.core.numerics.enclosures.matrix_balls import MatrixBall, multiply_up, round_up
from obc_ros.core.text.errors import RefusedDesignError


class DefiniteNorm:
    """
    The norm |e|_P of e (n,).

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Its symmetric part is used.
    M : ndarray, shape (n, n)
        Near the matrices of `bound_map`.

    Raises
    ------
    RefusedDesignError
        If P cannot be proved to be positive definite.

    """

    def __init__(self, P: Array, M: Array) -> None:
        self._P, self._size = MatrixBall.exact(P), np.abs(P)
        image = M.T @ P @ M
        try:
            found = linalg.eigh(0.5 * (image + image.T), 0.5 * (P + P.T))[1]
        except (np.linalg.LinAlgError, ValueError):   # not definite, or not finite
            found = np.zeros_like(P)
        self._Z = MatrixBall.exact(found)
        least = _bound_eigenvalues(self._Z.T @ self._P @ self._Z)[0]
        if not least > 0.0:
            raise RefusedDesignError(
                'P cannot be proved to be positive definite in double precision: it is singular '
                'or too ill-conditioned; wanted weights of all states, and of more similar effect')
        self._least = least

    def bound_map(self, M: MatrixBall) -> float:
        """
        Return an upper bound of |M e|_P / |e|_P for all e and all M of a ball.

        Parameters
        ----------
        M : MatrixBall, shape (n, n)
            The matrices.

        """
        image = M @ self._Z
        most = _bound_eigenvalues(image.T @ self._P @ image)[1]
        return _divide_root(most, self._least)

    def bound_functionals(self, C: Array) -> Array:
        """
        Return upper bounds w (r,) with |c'e| <= w |e|_P for each row c of C and all e.

        Parameters
        ----------
        C : ndarray, shape (r, n)
            The rows.

        """
        image = (MatrixBall.exact(C) @ self._Z).size
        squares = round_up((image * image).sum(axis=1), image.shape[1])
        return np.array([_divide_root(float(each), self._least) for each in squares])

    def bound_box(self, size: Array) -> float:
        """
        Return an upper bound of |e|_P for all e with |e_i| <= size_i.

        Parameters
        ----------
        size : ndarray, shape (n,)
            Nonnegative numbers.

        """
        square = float(multiply_up(multiply_up(self._size, size), size))
        return math.nextafter(math.sqrt(square), math.inf)


def _divide_root(most: float, least: float) -> float:
    """Return an upper bound of sqrt(most / least), 0 if `most` is negative; `least` > 0."""
    ratio = math.nextafter(max(most, 0.0) / least, math.inf)
    return math.nextafter(math.sqrt(ratio), math.inf)


def _bound_eigenvalues(form: MatrixBall) -> tuple[float, float]:
    """Return bounds of y'form y / y'y for all y, by Gershgorin's theorem."""
    size = form.size
    np.fill_diagonal(size, 0.0)
    centre = form.middle.diagonal()
    # The symmetric part has the means of the entries and of their transposes.
    others = 0.5 * size.sum(axis=0) + 0.5 * size.sum(axis=1)
    spread = round_up(others + form.radius.diagonal(), 2 * len(size))
    return (float(np.nextafter(centre - spread, -np.inf).min()),
            float(np.nextafter(centre + spread, np.inf).max()))
