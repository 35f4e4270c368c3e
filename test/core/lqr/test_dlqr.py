# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Sampled designs: closed forms, the collection of Benner, Laub and Mehrmann, residuals, errors.

P. Benner, A. J. Laub, V. Mehrmann, A collection of benchmark examples for the numerical solution
of algebraic Riccati equations II: discrete-time case, Technical Report SPC 95-23, TU Chemnitz,
1995. Numbers and exact solutions are the report's.
"""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.lqr.lqr import dlqr
from obc_ros.core.text.errors import RefusedDesignError, StatementError
import pytest
from scipy.linalg import solve_discrete_are


def residual(design):
    """Return the Riccati residual relative to its terms."""
    growth = math.exp(design.stability * design.period)
    A, B, P = growth * design.A, growth * design.B, design.P
    N = np.zeros_like(design.B) if design.cross is None else design.cross
    reduced = design.A - design.B @ np.linalg.solve(design.Qu, N.T)
    A = growth * reduced
    Q = design.Qx - N @ np.linalg.solve(design.Qu, N.T)
    BP = B.T @ P
    terms = [A.T @ P @ A, -P, Q, -(BP @ A).T @ np.linalg.solve(design.Qu + BP @ B, BP @ A)]
    return abs(sum(terms)).max() / max(abs(term).max() for term in terms)


def test_scalar_designs_equal_the_closed_form():
    """For b = r = 1 the solution satisfies P = a^2 P / (1 + P) + q."""
    for a, q in [(2.0, 1.0), (0.5, 3.0), (1.0, 1e-4), (1e3, 1e-3)]:
        c = 1 - a * a - q
        P = (math.hypot(c, 2 * math.sqrt(q)) - c) / 2
        design = dlqr([[a]], [[1]], [[q]], [[1]])
        assert design.P[0, 0] == pytest.approx(P, rel=1e-12)
        assert design.K[0, 0] == pytest.approx(a * P / (1 + P), rel=1e-12)


def test_example_1_of_the_collection_has_its_exact_solution():
    X = (1 + math.sqrt(5)) / 2 * np.array([[9, 6], [6, 4]])
    design = dlqr([[4, 3], [-4.5, -3.5]], [[1], [-1]], [[9, 6], [6, 4]], [[1]])
    assert pytest.approx(X, rel=1e-12) == design.P


@pytest.mark.parametrize('e', [1.0, 1e3, 1e6])
def test_example_12_of_the_collection_has_its_exact_solution(e):
    design = dlqr([[0, e], [0, 0]], [[0], [1]], np.eye(2), [[1]])
    assert pytest.approx(np.diag([1, 1 + e * e]), rel=1e-12) == design.P


@pytest.mark.parametrize('r', [1.0, 1e3, 1e6])
def test_example_13_of_the_collection_has_its_exact_solution(r):
    """A = V diag(0, 1, 3) V with Qx = Qu = r I decouples into scalar equations."""
    V = np.eye(3) - 2 / 3 * np.ones((3, 3))
    d = np.array([0.0, 1.0, 3.0])
    p = ((d * d) + np.sqrt(d**4 + 4)) / 2  # p = d^2 p / (1 + p) + 1
    design = dlqr(V @ np.diag(d) @ V, np.eye(3), r * np.eye(3), r * np.eye(3))
    assert pytest.approx(r * V @ np.diag(p) @ V, rel=1e-12) == design.P


def test_example_15_of_the_collection_has_its_exact_solution():
    """A shift register has P = diag(1, 2, ..., n)."""
    n = 100
    design = dlqr(np.eye(n, k=1), np.eye(n)[:, -1:], np.eye(n), [[1]])
    assert pytest.approx(np.diag(np.arange(1.0, n + 1)), rel=1e-12) == design.P


EXAMPLES = {
    2: ([[0.9512, 0], [0, 0.9048]], [[4.877, 4.877], [-1.1895, 3.569]],
        np.diag([0.005, 0.02]), np.diag([1 / 3, 3])),
    6: ([[0.998, 0.067, 0, 0], [-0.067, 0.998, 0, 0], [0, 0, 0.998, 0.153], [0, 0, -0.153, 0.998]],
        [[0.0033, 0.02], [0.1, -0.0007], [0.04, 0.0073], [-0.0028, 0.1]],
        [[1.87, 0, 0, -0.244], [0, 0.744, 0.205, 0], [0, 0.205, 0.589, 0], [-0.244, 0, 0, 1.048]],
        np.eye(2)),
    10: (np.kron(np.eye(2), np.diag([1, 1], k=1)), np.kron(np.eye(2), [[0], [0], [1]]),
         np.diag([1, 1, 0, 1, 1, 0]) + np.kron(
             np.diag([1, -1]), [[0, 1, 0], [1, 0, 0], [0, 0, 0]]),
         np.diag([3, 1])),
    14: ([[1 - 1e-8, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], [[1e-8], [0], [0], [0]],
         np.diag([0, 0, 0, 1]), [[0.25]]),
}


@pytest.mark.parametrize('number', EXAMPLES)
def test_designs_of_the_collection_have_small_residuals(number):
    design = dlqr(*EXAMPLES[number])
    assert abs(np.linalg.eigvals(design.A - design.B @ design.K)).max() < 1
    assert residual(design) <= 1e-12
    if number != 14:
        P = solve_discrete_are(*EXAMPLES[number])
        assert abs(design.P - P).max() <= 1e-10 * abs(P).max()


def test_designs_respect_cross_terms_and_degree_of_stability():
    rng = np.random.default_rng(3)
    A, B = rng.standard_normal((4, 4)), rng.standard_normal((4, 2))
    N = 0.3 * rng.standard_normal((4, 2))
    design = dlqr(A, B, 2 * np.eye(4), np.eye(2), cross=N)
    P = solve_discrete_are(A, B, 2 * np.eye(4), np.eye(2), s=N)
    assert pytest.approx(P, rel=1e-9) == design.P
    assert pytest.approx(
        np.linalg.solve(np.eye(2) + B.T @ P @ B, B.T @ P @ A + N.T), rel=1e-8) == design.K
    fast = dlqr(A, B, 2 * np.eye(4), np.eye(2), cross=N, stability=3.0, period=0.2)
    assert abs(fast.E).max() < math.exp(-0.6)
    assert residual(fast) < 1e-12


def test_unsuitable_data_are_rejected():
    with pytest.raises(RefusedDesignError, match=r'^the sampled \(A, B\) is .* z = \+2 is uncon'):
        dlqr(np.diag([2.0, 0.5]), [[0], [1]], np.eye(2), [[1]])
    with pytest.raises(RefusedDesignError, match=r'^the sampled \(A, Qx\) is .* z = -1.5 does no'):
        dlqr(np.diag([-1.5, 0.5]), np.eye(2), np.diag([0, 1]), np.eye(2))
    with pytest.raises(RefusedDesignError, match=r'^the sampled \(A, Qx\) is .* z = \+1 does not'):
        dlqr([[1]], [[1]], [[0]], [[1]])
    with pytest.raises(RefusedDesignError, match=r'Qu\[0\] = -1: Qu must be positive definite'):
        dlqr([[1]], [[1]], [[1]], [[-1]])
    with pytest.raises(StatementError, match='period = 0'):
        dlqr([[1]], [[1]], [[1]], [[1]], period=0.0)
    with pytest.raises(RefusedDesignError, match=r'^the sampled \(A, B\) is not stabilisable with '
                       r'the degree of stability 1 1/s: the mode z = \+0.5 is uncontrollable'):
        dlqr(np.diag([2.0, 0.5]), [[1], [0]], np.eye(2), [[1]], stability=1.0)
    assert dlqr([[0.5]], [[1]], [[0]], [[1]]).K[0, 0] == 0.0


@pytest.mark.slow
@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.integers(1, 6), st.integers(1, 3), st.integers(0, 2**32 - 1), st.floats(-3, 3))
def test_accepted_gains_stabilise(n, m, seed, decades):
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, m)) * 10**decades
    H = rng.standard_normal((rng.integers(1, n + 1), n))
    try:
        design = dlqr(A, B, H.T @ H, np.eye(m))
    except RefusedDesignError as error:
        assert 'ill-conditioned' in str(error) or 'uncontrollable' in str(error)
        assert n > m
        return
    assert abs(np.linalg.eigvals(A - B @ design.K)).max() < 1
    assert residual(design) < 1e-8
