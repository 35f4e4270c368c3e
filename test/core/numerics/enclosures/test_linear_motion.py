# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Enclosures of exp(A t) and its integral against mpmath with 60 digits, and closed forms."""

import math

from hypothesis import given, settings, strategies
import mpmath
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.enclosures.linear_motion import bound_motion, enclose_transition
from obc_ros.core.numerics.enclosures.matrix_balls import MatrixBall
import pytest

DIGITS = 60


def integrate(A: Array, time: float) -> tuple[mpmath.matrix, mpmath.matrix]:
    """Return exp(A t) and its integral from the exponential of a block matrix."""
    n = len(A)
    block = mpmath.zeros(2 * n)
    for i in range(n):
        block[i, n + i] = mpmath.mpf(time)
        for j in range(n):
            block[i, j] = mpmath.mpf(float(A[i, j])) * mpmath.mpf(time)
    flow = mpmath.expm(block)
    return flow[:n, :n], flow[:n, n:]


def is_inside(ball: MatrixBall, exact: mpmath.matrix) -> bool:
    """Return whether a matrix is in a ball."""
    rows, columns = ball.middle.shape
    return all(abs(mpmath.mpf(float(ball.middle[i, j])) - exact[i, j])
               <= mpmath.mpf(float(ball.radius[i, j]))
               for i in range(rows) for j in range(columns))


@settings(max_examples=20)   # mpmath is slow
@given(strategies.integers(1, 5), strategies.sampled_from([1e-6, 0.1, 1.0, 20.0]),
       strategies.sampled_from([0.0, 4.0]), strategies.integers(0, 2**32))
def test_exponential_and_integral_are_enclosed(n: int, norm: float, spread: float, seed: int
                                               ) -> None:
    """For matrices with units of different sizes; the radii are small."""
    random = np.random.default_rng(seed)
    sizes = 10.0**random.uniform(-spread, spread, n)
    time = float(random.uniform(0.01, 1.0))
    A = norm / time * random.normal(size=(n, n)) / n * sizes[:, None] / sizes
    found = enclose_transition(MatrixBall.exact(A), time, sizes)
    assert found is not None
    with mpmath.workdps(DIGITS):
        exact = integrate(A, time)
    for ball, wanted in zip(found, exact, strict=True):
        with mpmath.workdps(DIGITS):
            assert is_inside(ball, wanted)
        scaled = ball.radius / sizes[:, None] * sizes
        assert scaled.max() <= 1e-12 * (time if ball is found[1] else 1.0) * math.exp(2 * norm)


@settings(max_examples=20)   # mpmath is slow
@given(strategies.integers(1, 4), strategies.integers(0, 2**32))
def test_matrices_at_the_ends_of_a_ball_are_enclosed(n: int, seed: int) -> None:
    """The ball of A has a radius of 1 %."""
    random = np.random.default_rng(seed)
    middle = random.normal(size=(n, n))
    ball = MatrixBall(middle, 0.01 * np.abs(middle))
    A = middle + 0.0099 * np.abs(middle) * random.choice([-1.0, 1.0], size=(n, n))
    found = enclose_transition(ball, 0.5, np.ones(n))
    assert found is not None
    with mpmath.workdps(DIGITS):
        assert all(is_inside(*each) for each in zip(found, integrate(A, 0.5), strict=True))


def test_a_double_integrator_has_its_closed_form() -> None:
    """exp(A t) = [1 t; 0 1], its integral [t t^2/2; 0 t]."""
    found = enclose_transition(MatrixBall.exact(np.array([[0.0, 1.0], [0.0, 0.0]])), 0.25,
                               np.array([1.0, 3.0]))
    assert found is not None
    for ball, wanted in zip(found, ([[1, 0.25], [0, 1]], [[0.25, 0.03125], [0, 0.25]]),
                            strict=True):
        assert (np.abs(ball.middle - wanted) <= ball.radius).all()
        assert ball.radius.max() < 1e-14


@settings(max_examples=20)   # mpmath is slow
@given(strategies.integers(1, 4), strategies.sampled_from([0.01, 1.0, 30.0]),
       strategies.integers(0, 2**32))
def test_motions_stay_below_their_bound(n: int, norm: float, seed: int) -> None:
    """At the end and before it; the bound is tight at the end."""
    random = np.random.default_rng(seed)
    M = norm * random.uniform(size=(n, n)) / n
    start, forcing = random.uniform(0.1, 1.0, size=(2, n, 2))
    bound = bound_motion(M, start, forcing, 1.0, np.ones(n))
    assert bound is not None
    with mpmath.workdps(DIGITS):
        y0, g = mpmath.matrix(start.tolist()), mpmath.matrix(forcing.tolist())
        for time in (1.0, 0.6):
            E, G = integrate(M, time)
            y = E * y0 + G * g
            for i in range(n):
                for k in range(2):
                    limit = mpmath.mpf(float(bound[i, k]))
                    assert y[i, k] <= limit
                    assert time < 1.0 or limit <= y[i, k] * (1 + mpmath.mpf(1e-11))


@pytest.mark.parametrize('entry', [math.inf, math.nan, 1e6])
def test_a_motion_that_cannot_be_bounded_has_no_enclosure(entry: float) -> None:
    """exp(1e6) is above all numbers of double precision."""
    A, one = np.array([[entry]]), np.ones((1, 1))
    assert enclose_transition(MatrixBall.exact(A), 1.0, np.ones(1)) is None
    assert bound_motion(A, one, one, 1.0, np.ones(1)) is None
