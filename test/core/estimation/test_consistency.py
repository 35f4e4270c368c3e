# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Normalised errors and innovations against the chi-square distribution."""

import numpy as np
from obc_ros.core.estimation.filter import (
    assess_innovations,
    Belief,
    compute_band,
    compute_chi_square_quantile,
    KalmanFilter,
)
from obc_ros.core.estimation.kalman_gain import discretize_noise
from obc_ros.core.systems.registry import get_system
import pytest
from scipy.stats import chi2


@pytest.mark.parametrize('degrees', [1, 2, 4, 3000])
def test_quantiles_are_those_of_scipy(degrees):
    for p in (0.025, 0.5, 0.975, 0.9999):
        assert compute_chi_square_quantile(p, degrees) == pytest.approx(
            chi2.ppf(p, degrees), rel=1e-9)
    low, high = compute_band(degrees, 500)
    assert low < degrees < high
    assert low * 500 == pytest.approx(chi2.ppf(0.025, 500 * degrees))


def test_consistency_says_what_is_wrong():
    rng = np.random.default_rng(0)
    for scale, word in ((1.0, 'consistent ('), (3.0, 'inconsistent'), (0.3, 'cautious')):
        squares = [(scale * chi2.rvs(2, random_state=rng), 2) for _ in range(200)]
        assert str(assess_innovations(squares)).startswith(word)
    assert str(assess_innovations([])) == 'no innovation yet'


@pytest.mark.slow
def test_linear_filter_is_consistent():
    """The mean of 500 runs is in its band at 95 % of the instants, up to sampling."""
    system, T, rng = get_system('double_integrator'), 0.1, np.random.default_rng(3)
    Qw, Rv = np.diag([0.02, 0.5]), np.diag([0.04, 0.09])
    kalman, u = KalmanFilter(system, Qw, Rv), np.array([0.3])
    A = np.array([[0.0, 1.0], [0.0, 0.0]])
    Ad, Qd = discretize_noise(A, Qw, T)
    runs, steps, P0 = 500, 20, np.diag([1.0, 2.0])
    truth = rng.multivariate_normal(np.zeros(2), P0, runs)
    beliefs = [Belief(np.zeros(2), P0)] * runs
    inside, (low, high) = 0, compute_band(2, runs)
    for _ in range(steps):
        w = rng.multivariate_normal(np.zeros(2), Qd, runs)
        truth = truth @ Ad.T + u * np.array([T * T / 2, T]) + w
        y = truth + rng.multivariate_normal(np.zeros(2), Rv, runs)
        beliefs = [kalman.update(kalman.predict(belief, u, T), u, [0, 1], measured).belief
                   for belief, measured in zip(beliefs, y, strict=True)]
        errors = [belief.x - x for belief, x in zip(beliefs, truth, strict=True)]
        mean = np.mean([e @ np.linalg.solve(belief.P, e)
                        for e, belief in zip(errors, beliefs, strict=True)])
        inside += low <= mean <= high
    assert inside >= 17   # P(fewer than 17 of 20 at 95 %) is 1.6 % if independent
