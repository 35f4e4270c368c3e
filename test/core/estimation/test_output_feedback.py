# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Margins with an estimator in the loop: the example of Doyle, and their recovery."""

import math

import numpy as np
from obc_ros.core.estimation.kalman_gain import dlqe, lqe
from obc_ros.core.estimation.output_feedback import (
    combine,
    recover_loop_transfer,
    recover_sampled_loop,
)
from obc_ros.core.lqr.held_loop import discretize_plant
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
    assert loop.share < 0.5
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
    assert found.recovered and found.loop.share >= 0.5
    assert pytest.approx(100 * ONES + found.q * B @ B.T) == found.Qw
    assert found.loop.figures.phase_margin[0] > math.radians(45)
    assert 'loses' not in str(found.loop)


def test_plant_of_nonminimum_phase_is_not_said_to_recover():
    A2, B2 = np.array([[0.0, 1.0], [2.0, 1.0]]), np.array([[0.0], [1.0]])
    regulator = lqr(A2, B2, np.eye(2), [[1.0]])
    found = recover_loop_transfer(regulator, np.array([[3.0, -1.0]]), np.eye(2), np.eye(1))
    assert not found.recovered and found.loop.share < 0.5


def test_sampled_loop_and_different_plants():
    Ad, Bd = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])
    loop = combine(dlqr(Ad, Bd, np.eye(2), [[1.0]], period=0.1),
                   dlqe(Ad, C, np.diag([1e-4, 1e-2]), [[0.01]], period=0.1))
    assert 1 < loop.figures.gain_margin[0] < math.inf
    for other in (dlqe(Ad, C, np.eye(2), [[1.0]], period=0.2), lqe(A, C, np.eye(2), [[1.0]])):
        with pytest.raises(StatementError):
            combine(dlqr(Ad, Bd, np.eye(2), [[1.0]], period=0.1), other)


def close_filter_form(Ad, Bd, K, M, factor):
    """Return the loop of (x, estimate before the measurement), with another gain of the plant."""
    eye = np.eye(len(Ad))
    law = -K @ np.hstack([M @ C, eye - M @ C])
    ahead = np.hstack([Ad @ M @ C, Ad @ (eye - M @ C)]) + Bd @ law
    return np.vstack([np.hstack([Ad, 0 * Ad]) + factor * Bd @ law, ahead])


@pytest.mark.parametrize('period', [0.002, 0.02])
def test_margins_of_the_sampled_loop_are_where_its_poles_leave_the_circle(period):
    K = lqr(A, B, 100 * ONES, [[1.0]]).K
    found = recover_sampled_loop(A, B, K, C, 100 * ONES, np.eye(1) / period, period)
    Ad, Bd = discretize_plant(A, B, period)
    for loop in (found.before, found.loop):
        low, high = loop.figures.gain_reduction_margin[0], loop.figures.gain_margin[0]
        for margin, outwards in ((low, -1), (high, 1)):
            room = 1e-3 * min(abs(margin - 1), 1.0)
            for factor, is_stable in ((margin - outwards * room, True),
                                      (margin + outwards * room, False)):
                poles = np.linalg.eigvals(
                    close_filter_form(Ad, Bd, K, loop.estimator.M, factor))
                assert (abs(poles).max() < 1.0) == is_stable


def test_sampled_loop_tends_to_the_continuous_one():
    """Doyle's margin is 1 + 1/(2 + sqrt(104))^2 for the measured intensity 1."""
    K = lqr(A, B, 100 * ONES, [[1.0]]).K
    period = 1e-5
    found = recover_sampled_loop(A, B, K, C, 100 * ONES, np.eye(1) / period, period)
    assert found.before.figures.gain_margin[0] - 1 == pytest.approx(
        1 / (2 + math.sqrt(104))**2, rel=2e-2)
    assert found.before.share < 0.5


def test_recovery_of_the_sampled_loop_restores_the_margins():
    K = lqr(A, B, 100 * ONES, [[1.0]]).K
    found = recover_sampled_loop(A, B, K, C, 100 * ONES, np.eye(1), 0.002)
    assert found.recovered and found.q > 0 and found.loop.share >= 0.5 > found.before.share
    assert pytest.approx(100 * ONES + found.q * B @ B.T) == found.Qw


def test_a_loop_with_its_margins_needs_no_noise():
    K = lqr(A, B, np.eye(2), [[1.0]]).K
    found = recover_sampled_loop(A, B, K, np.eye(2), 1e4 * np.eye(2), 1e-4 * np.eye(2), 0.01)
    assert found.recovered and found.q == 0.0
    assert found.loop is found.before


@pytest.mark.parametrize('K, period, words', [
    (np.zeros((1, 2)), 0.01, 'does not stabilise'), (np.ones((1, 3)), 0.01, 'K'),
    (np.full((1, 2), np.nan), 0.01, 'K'), (np.ones((1, 2)), 0.0, 'period')])
def test_gains_that_cannot_be_used_are_refused(K, period, words):
    with pytest.raises(StatementError, match=words):
        recover_sampled_loop(A, B, K, C, ONES, np.eye(1), period)
