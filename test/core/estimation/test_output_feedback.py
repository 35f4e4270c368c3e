# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Margins with an estimator in the loop: the example of Doyle, and their recovery."""

import math

import numpy as np
from obc_ros.core.estimation.kalman_gain import dlqe, lqe
from obc_ros.core.estimation.output_feedback import combine, recover_loop_transfer
from obc_ros.core.lqr.lqr import dlqr, lqr
from obc_ros.core.text.errors import StatementError
import pytest

A, B, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
ONES = np.ones((2, 2))


@pytest.mark.parametrize('q', [10.0, 100.0, 1e4])
def test_example_of_doyle(q):
    """J. C. Doyle, Guaranteed margins for LQG regulators, 1978: f = d = 2 + sqrt(4 + q)."""
    regulator, estimator = lqr(A, B, q * ONES, [[1.0]]), lqe(A, C, q * ONES, [[1.0]])
    gain = 2 + math.sqrt(4 + q)
    assert pytest.approx(np.full((1, 2), gain), rel=1e-8) == regulator.K
    assert pytest.approx(np.full((2, 1), gain), rel=1e-8) == estimator.L
    loop = combine(regulator, estimator)
    # The constant of the characteristic polynomial is 1 + (1 - gain margin) d f.
    assert loop.figures.gain_margin[0] - 1 == pytest.approx(1 / gain**2, rel=1e-4)
    assert loop.full_state.gain_margin[0] == math.inf
    assert not loop.keeps_margins
    assert 'loses the margins' in str(loop)


def test_loop_is_unstable_beyond_the_margin():
    regulator, estimator = lqr(A, B, 100 * ONES, [[1.0]]), lqe(A, C, 100 * ONES, [[1.0]])
    margin = combine(regulator, estimator).figures.gain_margin[0]
    K, L = regulator.K, estimator.L
    for factor, sign in ((1 + 0.9 * (margin - 1), -1), (1 + 1.1 * (margin - 1), 1)):
        loop = np.block([[A, -factor * B @ K], [L @ C, A - B @ K - L @ C]])
        assert math.copysign(1, np.linalg.eigvals(loop).real.max()) == sign


def test_recovery_restores_the_margins():
    regulator = lqr(A, B, 100 * ONES, [[1.0]])
    found = recover_loop_transfer(regulator, C, 100 * ONES, np.eye(1))
    assert found.recovered and found.loop.keeps_margins
    assert pytest.approx(100 * ONES + found.q * B @ B.T) == found.Qw
    assert found.loop.figures.phase_margin[0] > math.radians(45)
    assert 'loses' not in str(found.loop)


def test_plant_of_nonminimum_phase_is_not_said_to_recover():
    A2, B2 = np.array([[0.0, 1.0], [2.0, 1.0]]), np.array([[0.0], [1.0]])
    regulator = lqr(A2, B2, np.eye(2), [[1.0]])
    found = recover_loop_transfer(regulator, np.array([[3.0, -1.0]]), np.eye(2), np.eye(1))
    assert not found.recovered and not found.loop.keeps_margins


def test_sampled_loop_and_different_plants():
    Ad, Bd = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])
    loop = combine(dlqr(Ad, Bd, np.eye(2), [[1.0]], period=0.1),
                   dlqe(Ad, C, np.diag([1e-4, 1e-2]), [[0.01]], period=0.1))
    assert 1 < loop.figures.gain_margin[0] < math.inf
    for other in (dlqe(Ad, C, np.eye(2), [[1.0]], period=0.2), lqe(A, C, np.eye(2), [[1.0]])):
        with pytest.raises(StatementError):
            combine(dlqr(Ad, Bd, np.eye(2), [[1.0]], period=0.1), other)
