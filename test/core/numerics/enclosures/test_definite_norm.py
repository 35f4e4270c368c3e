# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bounds in the norm of P against mpmath with 60 digits, ill-conditioned matrices, refusals."""

from hypothesis import given, settings, strategies
import mpmath
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.enclosures.definite_norm import DefiniteNorm
from obc_ros.core.numerics.enclosures.matrix_balls import MatrixBall
from obc_ros.core.text.errors import RefusedDesignError
import pytest

DIGITS = 60


def read(M: Array) -> mpmath.matrix:
    """Return the numbers of a matrix exactly."""
    return mpmath.matrix(M.tolist())


def measure_map(P: Array, M: Array) -> mpmath.mpf:
    """Return the norm of M in the norm of P, from the Cholesky factor P = L L'."""
    L = mpmath.cholesky(read(P))
    image = L.T * read(M) * mpmath.inverse(L).T
    return mpmath.sqrt(max(mpmath.eigsy(image.T * image, eigvals_only=True)))


def build_hilbert(n: int, shift: int = 0) -> Array:
    """Return a matrix whose condition number is about 10^(1.5 n)."""
    i = np.arange(n)
    return np.asarray(1.0 / (1.0 + shift + i + i[:, None]))


@strategies.composite
def draw_case(draw: strategies.DrawFn) -> tuple[Array, Array, Array]:
    """Draw P, M and rows C, with states in units of different sizes."""
    random = np.random.default_rng(draw(strategies.integers(0, 2**32)))
    n = draw(strategies.integers(1, 4))
    part = 10.0**draw(strategies.sampled_from([-4, -2, 0]))
    root = random.normal(size=(n, n)) * np.geomspace(1.0, part, n)
    P = root @ root.T + part**2 * np.eye(n)
    units = 10.0**random.uniform(-5.0, 5.0, n)
    P = P * units * units[:, None]
    P = 0.5 * (P + P.T)
    M = random.normal(size=(n, n)) * units / units[:, None]
    return P, M, random.normal(size=(3, n)) * units


@settings(max_examples=40)   # mpmath is slow
@given(draw_case())
def test_bounds_are_above_the_exact_values_and_tight(case: tuple[Array, Array, Array]) -> None:
    """The norm of M and the extents of the ellipsoid, by mpmath."""
    P, M, C = case
    norm = DefiniteNorm(P, M)
    contraction, extents = norm.bound_map(MatrixBall.exact(M)), norm.bound_functionals(C)
    with mpmath.workdps(DIGITS):
        exact = measure_map(P, M)
        assert exact <= mpmath.mpf(contraction) <= exact * 1.001
        inverse = mpmath.inverse(read(P))
        for row, bound in zip(C, extents.tolist(), strict=True):
            c = read(row)
            wanted = mpmath.sqrt((c.T * inverse * c)[0])
            assert wanted <= mpmath.mpf(bound) <= wanted * 1.001


@settings(max_examples=40)
@given(draw_case())
def test_all_maps_of_a_ball_are_below_the_bound(case: tuple[Array, Array, Array]) -> None:
    """The radius is 1 % of each entry."""
    P, M, C = case
    bound = DefiniteNorm(P, M).bound_map(MatrixBall(M, 0.01 * np.abs(M)))
    sign = np.where(np.outer(C[0], C[1])[:len(M), :len(M)] > 0.0, 0.0099, -0.0099)
    with mpmath.workdps(DIGITS):
        assert measure_map(P, M * (1.0 + sign)) <= mpmath.mpf(bound)


@given(draw_case())
def test_vectors_of_a_box_are_below_the_bound(case: tuple[Array, Array, Array]) -> None:
    """At a corner of the box."""
    P, M, C = case
    size = np.abs(1.0 / C[0])
    bound = DefiniteNorm(P, M).bound_box(size)
    with mpmath.workdps(DIGITS):
        r = read(size * np.sign(C[1]))
        assert mpmath.sqrt((r.T * read(P) * r)[0]) <= mpmath.mpf(bound)


def test_the_inverse_in_double_precision_is_wrong_by_more_than_its_former_margin() -> None:
    """Each extent was enlarged by a relative 1e-9, and P inverted in double precision."""
    missed = 0
    for shift in range(4):
        P = build_hilbert(9, shift)
        former = np.sqrt(np.diag(np.linalg.inv(P))) * (1.0 + 1e-9)
        proved = DefiniteNorm(P, 0.9 * np.eye(9)).bound_functionals(np.eye(9))
        with mpmath.workdps(DIGITS):
            inverse = mpmath.inverse(read(P))
            for i in range(9):
                exact = mpmath.sqrt(inverse[i, i])
                assert exact <= mpmath.mpf(float(proved[i])) <= 1.1 * exact
                missed += mpmath.mpf(float(former[i])) < exact
    assert missed > 0


def test_units_do_not_change_the_bounds() -> None:
    """Units of 2^-200 to 2^200 scale the extents exactly and leave the contraction."""
    P, M = build_hilbert(3), np.diag([0.9, 0.5, -0.3])
    units = np.ldexp(1.0, np.array([-200, 0, 200]))
    plain, scaled = DefiniteNorm(P, M), DefiniteNorm(P * units * units[:, None], M)
    assert scaled.bound_map(MatrixBall.exact(M)) == pytest.approx(
        plain.bound_map(MatrixBall.exact(M)), rel=1e-9)
    assert scaled.bound_functionals(np.diag(units)) == pytest.approx(
        plain.bound_functionals(np.eye(3)), rel=1e-9)


@pytest.mark.parametrize('P', [np.diag([1.0, -1.0]), np.diag([1.0, 0.0]), build_hilbert(14),
                               np.array([[np.nan, 0.0], [0.0, 1.0]])])
def test_a_matrix_without_proof_is_refused(P: Array) -> None:
    """It is indefinite, singular, too ill-conditioned, or not finite."""
    with pytest.raises(RefusedDesignError, match='cannot be proved to be positive definite'):
        DefiniteNorm(P, np.eye(len(P)))
