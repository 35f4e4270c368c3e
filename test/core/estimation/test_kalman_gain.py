# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Steady Kalman gains: closed forms, python-control as a second method, refusals."""

import math

import control
import numpy as np
from obc_ros.core.estimation.kalman_gain import discretize_noise, dlqe, lqe, sampled_lqe
from obc_ros.core.text.errors import ObcError, RefusedDesignError, StatementError
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm


def random_systems(count):
    """Yield A, C, Qw, Rv with at least half as many outputs as states."""
    rng = np.random.default_rng(1)
    for _ in range(count):
        n = int(rng.integers(1, 9))
        q = int(rng.integers(max(1, n // 2), n + 1))
        G, H = rng.standard_normal((n, n)), rng.standard_normal((q, q))
        yield (rng.standard_normal((n, n)) / math.sqrt(n), rng.standard_normal((q, n)), G @ G.T,
               H @ H.T + 0.1 * np.eye(q))


@pytest.mark.slow
def test_gains_are_those_of_python_control():
    for A, C, Qw, Rv in random_systems(200):
        for ours, theirs in ((lqe, control.lqe), (dlqe, control.dlqe)):
            found = ours(A, C, Qw, Rv)
            L = theirs(A, np.eye(len(A)), C, Qw, Rv)[0]
            assert np.abs(found.L - L).max() <= 1e-9 * max(1.0, np.abs(L).max())


@pytest.mark.parametrize('a', [-2.0, 0.0, 3.0])
def test_scalar_filter(a):
    q, r = 0.7, 0.2
    found = lqe([[a]], [[1.0]], [[q]], [[r]])
    gain = a + math.sqrt(a * a + q / r)
    assert pytest.approx(gain, rel=1e-12) == found.L
    assert found.E[0] == pytest.approx(-math.sqrt(a * a + q / r), rel=1e-12)
    assert pytest.approx(r * gain, rel=1e-12) == found.P


def test_double_integrator():
    q, r = 3.0, 0.5
    found = lqe([[0, 1], [0, 0]], [[1, 0]], np.diag([0, q]), [[r]])
    assert found.L.ravel() == pytest.approx(
        [math.sqrt(2) * (q / r)**0.25, math.sqrt(q / r)], rel=1e-10)


def test_alpha_beta_filter():
    """The gains of Kalata (1984) for a constant acceleration in each period."""
    T, sw, sv = 0.1, 2.0, 0.05
    G = np.array([[T * T / 2], [T]])
    found = dlqe([[1, T], [0, 1]], [[1, 0]], sw**2 * G @ G.T, [[sv**2]], period=T)
    index = sw * T * T / sv
    root = math.sqrt(index * index + 8 * index)
    alpha = -(index * index + 8 * index - (index + 4) * root) / 8
    beta = (index * index + 4 * index - index * root) / 4
    assert found.M.ravel() == pytest.approx([alpha, beta / T], rel=1e-9)
    assert pytest.approx(found.A @ found.M, rel=1e-12) == found.L


def test_forms_and_covariances_satisfy_their_equations():
    for A, C, Qw, Rv in random_systems(10):
        found = dlqe(A, C, Qw, Rv)
        size = np.abs(found.P).max()
        assert np.abs(A @ found.P_filtered @ A.T + Qw - found.P).max() < 1e-10 * size
        assert np.abs(A @ found.M - found.L).max() < 1e-9 * max(1, np.abs(found.L).max())
        assert sorted(np.abs(np.linalg.eigvals(A - found.L @ C))) == pytest.approx(
            sorted(np.abs(found.E)), rel=1e-5, abs=1e-7)


def test_noise_of_a_period_is_the_integral():
    A = np.array([[0.0, 1.0], [-400.0, -50.0]])
    Qw = np.array([[1.0, 0.2], [0.2, 3.0]])
    Ad, Qd = discretize_noise(A, Qw, 0.4)
    exact = quad_vec(lambda s: expm(A * s) @ Qw @ expm(A.T * s), 0, 0.4, epsabs=1e-13)[0]
    assert pytest.approx(expm(0.4 * A), abs=1e-12) == Ad
    assert pytest.approx(exact, abs=1e-10) == Qd


def test_fast_sampling_tends_to_continuous_time():
    A, C, Qw = [[0, 1], [2, -1]], [[1, 0]], np.diag([0.1, 1.0])
    continuous = lqe(A, C, Qw, [[0.3]])
    for period in (1e-2, 1e-3):
        found = sampled_lqe(A, C, Qw, [[0.3 / period]], period)
        assert found.M / period == pytest.approx(continuous.L, rel=3 * period)
        assert found.bandwidth == pytest.approx(continuous.bandwidth, rel=20 * period)


def undetectable_or_indefinite(count):
    """Yield (function, A, C, Qw, Rv, words) of cases without an estimator."""
    rng = np.random.default_rng(2)
    for k in range(count):
        n = int(rng.integers(2, 6))
        T = rng.standard_normal((n, n)) + 3 * np.eye(n)
        modes, seen = rng.uniform(-0.8, -0.2, n), rng.standard_normal((2, n))
        function = (lqe, dlqe)[k // 3 % 2]
        modes[0] = (1.5, 2.0)[k % 2]
        Qw, Rv, words = np.eye(n), np.eye(2), f'+{modes[0]:g} cannot be seen in gps_x, gps_y'
        if k % 3 == 0:
            seen[:, 0] = 0.0
        elif k % 3 == 1:
            Qw[1, 1], words = -1.0, 'Qw[1] = -1: Qw must be positive semidefinite'
        else:
            Rv[0, 1] = Rv[1, 0] = 2.0
            words = 'Rv must be positive definite'
        back = np.linalg.inv(T)
        yield function, T @ np.diag(modes) @ back, seen @ back, Qw, Rv, words


def test_refusals_name_mode_or_entry():
    answered = 0
    for function, A, C, Qw, Rv, words in undetectable_or_indefinite(30):
        with pytest.raises(RefusedDesignError) as refused:
            function(A, C, Qw, Rv, outputs=('gps_x', 'gps_y'))
        answered += words in str(refused.value)
    assert answered == 30


def test_a_mode_without_noise_is_refused():
    with pytest.raises(RefusedDesignError, match=r'mode s = \+2 is not driven by Qw'):
        lqe(np.diag([2.0, -1.0]), [[1.0, 1.0]], np.diag([0.0, 1.0]), [[1.0]])


@pytest.mark.parametrize('given', [
    ([[math.nan]], [[1]], [[1]], [[1]]), ([[1, 0]], [[1]], [[1]], [[1]]),
    ([[1]], [[1, 2]], [[1]], [[1]]), ([[1]], [[1]], np.eye(2), [[1]]),
    ([[1]], [[1]], [[1]], np.eye(2)), ([['a']], [[1]], [[1]], [[1]]), (1, 2, 3, 4),
    ([[1]], np.zeros((0, 1)), [[1]], np.zeros((0, 0))),
])
def test_malformed_matrices_are_named(given):
    with pytest.raises(StatementError):
        dlqe(*given)


@pytest.mark.parametrize('period', [0.0, -1.0, math.nan, math.inf])
def test_period_must_be_positive(period):
    for function in (dlqe, sampled_lqe):
        with pytest.raises(ObcError, match='period'):
            function([[0.5]], [[1.0]], [[1.0]], [[1.0]], period=period)
