# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The Riccati differential equation compared with closed forms and 80-digit solutions."""

import math

import high_precision
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.riccati import propagation
from obc_ros.core.riccati.fixed_horizon import solve_finite_horizon
from obc_ros.core.text.errors import RefusedDesignError, StatementError
from plants import aircraft, CHAIN, FORCE
import pytest


def error(P, exact):
    return abs(P - exact).max() / abs(exact).max()


@pytest.mark.slow
@pytest.mark.parametrize('P1', [0.0, 1.0, 10.0, 1e6])
def test_errors_for_the_aircraft_are_within_the_condition(P1):
    """
    The errors are at most n^3 eps times the condition number of the equation.

    The data of the Riccati equation, A, G = B Qu^-1 B', Qx and P1, are each rounded once; no
    method recovers the digits that the condition number loses. n^3 counts the roundings of
    matrix products. An error at one time propagates to all earlier times, so the condition
    number is the maximum over the horizon. For P1 up to 10 it is below 5 and the bound is
    2.5e-13. For P1 = 1e6 and G of rank 2 it is 7000.
    """
    A, B = aircraft()
    t, n, worst = np.linspace(0, 5, 501), 6, np.zeros(2)
    cost = np.eye(n), np.eye(2), P1 * np.eye(n)
    P, K = solve_finite_horizon(A, B, *cost, t, 5.0)
    for k in (499, 497, 400, 137, 0):
        exact = high_precision.riccati(A, B, *cost, 5.0 - t[k])
        worst = np.maximum(worst, high_precision.riccati_condition(
            A, B, cost[0], cost[2], 5.0 - t[k]))
        bound = n**3 * np.finfo(float).eps * worst
        assert P1 > 10 or bound.max() < 2.5e-13
        assert error(P[k], exact) <= bound[0]
        assert error(K[k], B.T @ exact) <= bound[1]
    assert P[-1] == pytest.approx(P1 * np.eye(6), rel=1e-15)


@pytest.mark.parametrize('a, b, c', [(2.0, 0.5, 0.1), (2.0, 0.5, 10.0), (-1.0, 1.0, 3.0)])
@pytest.mark.parametrize('T', [0.5, 1.0, 10.0, 50.0, 1000.0])
def test_example_2_2_equals_its_closed_form(a, b, c, T):
    """Qx = 0: the cost determines no stationary solution; 1 / P is linear in exp(-2 a tau)."""
    t = np.linspace(0, T, 101)
    P, K = solve_finite_horizon([[a]], [[b]], [[0]], [[1]], [[c]], t, T)
    tau = T - t
    if a > 0:
        shrunk = np.exp(-2 * a * tau)
        exact = 1 / (shrunk / c + b * b * (1 - shrunk) / (2 * a))
    else:
        grown = np.exp(2 * a * tau)
        exact = grown * c / (1 + c * b * b * (grown - 1) / (2 * a))
    assert P[:, 0, 0] == pytest.approx(exact, rel=1e-12)
    assert K[:, 0, 0] == pytest.approx(b * exact, rel=1e-12)


def test_uncontrollable_unstable_modes_keep_their_precision():
    """P grows with exp(2 t) in that mode; each entry keeps its relative precision."""
    A, B, Q = np.diag([1.0, -1.0]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.3], [0.3, 1.0]])
    P, _ = solve_finite_horizon(A, B, Q, [[1]], np.eye(2), [0, 10, 20, 29], 30.0)
    for k, to_go in enumerate([30, 20, 10, 1]):
        exact = high_precision.riccati(A, B, Q, [[1]], np.eye(2), to_go)
        assert P[k] == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize('seed', range(6))
def test_random_plants_match_the_high_precision_solution(seed):
    rng = np.random.default_rng(seed)
    n, m = 4, 2
    A, B = 2 * rng.standard_normal((n, n)), rng.standard_normal((n, m))
    H, H1 = rng.standard_normal((2, seed % 3, n))
    Q, P1 = H.T @ H, H1.T @ H1
    P, _ = solve_finite_horizon(A, B, Q, np.eye(m), P1, np.linspace(0, 8, 65), 8.0)
    for k in (0, 32, 60):
        exact = high_precision.riccati(A, B, Q, np.eye(m), P1, 8.0 - k / 8)
        assert abs(P[k] - exact).max() <= 1e-11 * max(abs(exact).max(), 1e-300)


def test_long_horizons_start_at_the_stationary_solution():
    A, B = aircraft()
    P, K = solve_finite_horizon(A, B, np.eye(6), np.eye(2), np.zeros((6, 6)), [0.0], 1e4)
    design = lqr(A, B, np.eye(6), np.eye(2))
    assert error(P[0], design.P) <= 1e-12
    assert error(K[0], design.K) <= 1e-12


def test_solutions_do_not_depend_on_the_grid():
    A, B = aircraft()
    rng = np.random.default_rng(7)
    uneven = np.sort(rng.uniform(0, 4.5, 30))
    even = np.linspace(0, 4.5, 46)
    cost = (A, B, np.eye(6), np.eye(2), 3 * np.eye(6))
    P_uneven, _ = solve_finite_horizon(*cost, uneven, 5.0)
    P_even, _ = solve_finite_horizon(*cost, even, 5.0)
    for k in (0, 11, 29):
        alone, _ = solve_finite_horizon(*cost, [uneven[k]], 5.0)
        assert error(P_uneven[k], alone[0]) <= 1e-12
        alone, _ = solve_finite_horizon(*cost, [even[k]], 5.0)
        assert error(P_even[k], alone[0]) <= 1e-12


def test_a_cross_term_equals_completing_the_square():
    """P is that of the transformed plant without a cross term."""
    A, B = aircraft()
    N = 0.1 * np.random.default_rng(1).standard_normal((6, 2))
    t = [0.0, 1.0, 2.0]
    P, K = solve_finite_horizon(A, B, np.eye(6), np.eye(2), np.eye(6), t, 3.0, cross=N)
    plain, gain = solve_finite_horizon(A - B @ N.T, B, np.eye(6) - N @ N.T, np.eye(2), np.eye(6),
                                       t, 3.0)
    assert pytest.approx(plain, rel=1e-11) == P
    assert pytest.approx(gain + N.T, rel=1e-10) == K


def test_solutions_satisfy_the_differential_equation():
    """Evaluate the residual of (2.7) by differences of order four on a fine grid."""
    A, B = aircraft()
    Q, h = np.diag([100, 1, 2 * np.pi / 9, 0, 0, 0]), 1e-3
    t = np.arange(2001) * h
    P, K = solve_finite_horizon(A, B, Q, 0.1 * np.eye(2), np.eye(6), t, 2.0)
    rate = (P[:-4] - 8 * P[1:-3] + 8 * P[3:-1] - P[4:]) / (12 * h)
    P, K = P[2:-2], K[2:-2]
    defect = rate + P @ A + A.T @ P - np.swapaxes(K, 1, 2) @ (0.1 * K) + Q
    assert abs(defect[:1500]).max() <= 1e-8 * abs(P).max()  # P changes within 4 ms of the end


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 3), st.floats(0.01, 3))
def test_joining_two_stretches_gives_the_stretch_of_their_sum(seed, first, second):
    """The stretch over a + b seconds equals the join of those over a and over b."""
    rng = np.random.default_rng(seed)
    A, F, H = rng.standard_normal((3, 3, 3))
    G, Q = F @ F.T, H @ H.T
    a, b = (propagation.build_stretch(A, G, Q, length) for length in (first, second))
    whole = propagation.build_stretch(A, G, Q, first + second)
    both = propagation.join_stretches(a, b, np.eye(3))
    for one, other in zip(whole, both, strict=True):
        assert abs(one - other).max() <= 1e-9 * abs(one).max()


def test_invalid_times_and_weights_are_rejected():
    good = (CHAIN, FORCE, np.eye(2), [[1]], np.eye(2))
    for t, T, words in [([0, 1], 0.5, 'at most T = 0.5'), ([1, 0], 2.0, 'increasing'),
                        ([], 1.0, 'finite times'), ([0, math.nan], 1.0, 'finite times'),
                        ([0], math.inf, 'finite final time')]:
        with pytest.raises(StatementError, match=words):
            solve_finite_horizon(*good, t, T)
    with pytest.raises(RefusedDesignError, match=r'P1\[1\] = -1: P1 must be positive'):
        solve_finite_horizon(CHAIN, FORCE, np.eye(2), [[1]], np.diag([1, -1]), [0], 1.0)
    with pytest.raises(StatementError, match=r'P1: expected \(2, 2\) but found \(3, 3\)'):
        solve_finite_horizon(CHAIN, FORCE, np.eye(2), [[1]], np.eye(3), [0], 1.0)
    with pytest.raises(RefusedDesignError, match='Qu'):
        solve_finite_horizon(CHAIN, FORCE, np.eye(2), [[0]], np.eye(2), [0], 1.0)
