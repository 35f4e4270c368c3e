# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Balls of matrices against rational arithmetic, which is exact."""

from collections.abc import Callable
from fractions import Fraction

from hypothesis import given, strategies
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.enclosures.matrix_balls import (
    add_up,
    MatrixBall,
    multiply_up,
    round_up,
)
import pytest

Exact = list[list[Fraction]]


@strategies.composite
def draw_pair(draw: strategies.DrawFn) -> tuple[MatrixBall, MatrixBall, int]:
    """Draw two square balls with entries of very different sizes, and a seed."""
    random = np.random.default_rng(seed := draw(strategies.integers(0, 2**32)))
    n, spread = draw(strategies.integers(1, 5)), draw(strategies.sampled_from([0.0, 1.0, 8.0]))

    def entries() -> Array:
        size: Array = 10.0**random.uniform(-spread, spread, (n, n))
        return size * random.normal(size=(n, n))

    part = draw(strategies.sampled_from([0.0, 1e-16, 1e-3]))
    a, b = entries(), entries()
    return MatrixBall(a, part * np.abs(a)), MatrixBall(b, part * np.abs(b)), seed


def choose(ball: MatrixBall, random: np.random.Generator) -> Exact:
    """Return a matrix of a ball with entries at an end, exactly."""
    sign = random.choice([-1, 1], size=ball.middle.shape)
    return [[Fraction(x) + int(s) * Fraction(r) for x, r, s in zip(*rows, strict=True)]
            for rows in zip(ball.middle.tolist(), ball.radius.tolist(), sign, strict=True)]


def holds(ball: MatrixBall, exact: Exact) -> bool:
    """Return whether a matrix is in a ball."""
    return all(abs(Fraction(x) - value) <= Fraction(r) for rows in zip(
        ball.middle.tolist(), ball.radius.tolist(), exact, strict=True)
        for x, r, value in zip(*rows, strict=True))


def multiply(a: Exact, b: Exact) -> Exact:
    """Return the exact product."""
    return [[sum((x * y for x, y in zip(row, column, strict=True)), Fraction(0))
             for column in zip(*b, strict=True)] for row in a]


def combine(operation: Callable[[Fraction, Fraction], Fraction], a: Exact, b: Exact) -> Exact:
    """Return the results for each pair of entries."""
    return [[operation(x, y) for x, y in zip(*rows, strict=True)]
            for rows in zip(a, b, strict=True)]


@given(draw_pair())
def test_results_of_all_matrices_are_in_the_balls(pair: tuple[MatrixBall, MatrixBall, int]
                                                  ) -> None:
    """Product, sum, difference, quotient and multiple of matrices at the ends of two balls."""
    a, b, seed = pair
    random = np.random.default_rng(seed)
    A, B = choose(a, random), choose(b, random)
    assert holds(a @ b, multiply(A, B))
    assert holds(a + b, combine(lambda x, y: x + y, A, B))
    assert holds(a - b, combine(lambda x, y: x - y, A, B))
    assert holds(a * 0.1, [[x * Fraction(0.1) for x in row] for row in A])
    assert holds(a / 3.0, [[x / 3 for x in row] for row in A])
    assert holds(a.T, [list(row) for row in zip(*A, strict=True)])
    for row, sizes, highs in zip(A, a.size.tolist(), a.high.tolist(), strict=True):
        assert all(abs(x) <= Fraction(size) and x <= Fraction(high)
                   for x, size, high in zip(row, sizes, highs, strict=True))


@given(draw_pair())
def test_bounds_of_nonnegative_numbers_are_above_the_exact_ones(
        pair: tuple[MatrixBall, MatrixBall, int]) -> None:
    """By at most 1e-14 of them."""
    a, b = (np.abs(ball.middle) for ball in pair[:2])
    A, B = ([[Fraction(x) for x in row] for row in each.tolist()] for each in (a, b))
    for found, exact in ((multiply_up(a, b), multiply(A, B)),
                         (add_up(a, b), combine(lambda x, y: x + y, A, B))):
        for row, wanted in zip(found.tolist(), exact, strict=True):
            assert all(value <= Fraction(bound) <= value * (1 + Fraction(1e-14))
                       for bound, value in zip(row, wanted, strict=True))


def test_a_product_that_underflows_is_in_its_ball() -> None:
    """1e-200 squared is computed as 0."""
    ball = MatrixBall.exact(np.array([[1e-200]]))
    found = ball @ ball
    assert found.middle[0, 0] == 0.0 and holds(found, [[Fraction(1e-200)**2]])
    assert Fraction(float(round_up(np.float64(0.0), 1))) >= Fraction(1e-200)**2


def test_intervals_are_in_their_ball() -> None:
    """Also if the ends have different sizes."""
    lower, upper = np.array([[-1e-20, 0.1]]), np.array([[1.0, 0.1]])
    ball = MatrixBall.enclose(lower, upper)
    assert holds(ball, [[Fraction(-1e-20), Fraction(0.1)]])
    assert holds(ball, [[Fraction(1), Fraction(0.1)]])
    assert ball.radius[0] == pytest.approx([0.5, 0.0], abs=1e-15)


def test_a_ball_without_bounds_says_so() -> None:
    """An entry that is not finite spreads to the products."""
    ball = MatrixBall(np.eye(2), np.array([[np.inf, 0.0], [0.0, 0.0]]))
    with np.errstate(invalid='ignore'):
        assert not ball.is_finite and not (ball @ ball).is_finite
    assert MatrixBall.exact(np.eye(2)).is_finite
