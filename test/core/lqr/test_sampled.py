# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sampled inputs with delay: exact discretisation, prediction, and the aircraft."""

import math

import numpy as np
from obc_ros.core.lqr import sampled
from obc_ros.core.lqr.held_loop import discretize_plant, HeldLoop
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.text.errors import RefusedDesignError, StatementError
from plants import aircraft
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

EXAMPLE_2_5 = Weights(np.diag([100, 1, 2 * np.pi / 9, 0, 0, 0]), 0.1 * np.eye(2))


def flight(A, B, K, period, delay, seconds, Phi=None, Gamma=()):
    """Return x at the samples, integrated between the times at which commands change."""
    count = round(seconds / period)
    x, states, commands = np.array([1.0, 1.0, 0, 0, 0, 0]), [], []
    for k in range(count):
        states.append(x)
        seen = x if Phi is None else Phi @ x + sum(
            gamma @ (commands[k - j] if k >= j else np.zeros(2))
            for j, gamma in enumerate(Gamma, start=1))
        commands.append(-K @ seen)
        edges = [k * period, (k + 1) * period] + [
            j * period + delay for j in range(k + 1)
            if k * period + 1e-12 < j * period + delay < (k + 1) * period - 1e-12]
        edges.sort()
        for low, high in zip(edges[:-1], edges[1:], strict=True):
            active = math.floor((0.5 * (low + high) - delay) / period)
            u = commands[active] if active >= 0 else np.zeros(2)
            step, push = discretize_plant(A, B, high - low)
            x = step @ x + push @ u
    return np.array(states)


def test_example_2_5_needs_a_sampled_design_at_20_hz():
    """With a delay of 50 ms the continuous gain is unstable; the sampled design is stable."""
    A, B = aircraft()
    K = lqr(A, B, EXAMPLE_2_5.Qx, EXAMPLE_2_5.Qu).K
    naive = np.block([[*discretize_plant(A, B, 0.05)], [-K, np.zeros((2, 2))]])
    assert abs(np.linalg.eigvals(naive)).max() == pytest.approx(1.11, abs=0.005)
    found = sampled.sampled_lqr(A, B, EXAMPLE_2_5, 0.05, 0.05)
    loop = HeldLoop(A, B, np.zeros((0, 6)), found.K, 0.05, 0.05, 0.05)
    assert abs(np.linalg.eigvals(loop.matrix)).max() < 0.98
    assert abs(flight(A, B, K, 0.05, 0.05, 10)).max() > 100
    states = flight(A, B, found.K, 0.05, 0.05, 15, *loop.prediction)
    assert abs(states[-1]).max() < 1e-2
    assert abs(states).max() < 20


@pytest.mark.parametrize('delay', [0.0, 0.013, 0.05, 0.07, 0.1, 0.23])
def test_prediction_adds_only_poles_at_zero(delay):
    """The poles are those without delay plus the delay's at 0; the simulation agrees."""
    A, B = aircraft()
    found = sampled.sampled_lqr(A, B, EXAMPLE_2_5, 0.05, delay)
    loop = HeldLoop(A, B, np.zeros((0, 6)), found.K, 0.05, delay, 0.05)
    poles = np.linalg.eigvals(loop.matrix)
    assert abs(poles).max() == pytest.approx(abs(found.E).max(), rel=1e-6)
    assert len(poles) == 6 + 2 * math.ceil(delay / 0.05 - 1e-9)
    states = flight(A, B, found.K, 0.05, delay, 2, *loop.prediction)
    z = np.zeros(len(poles))
    z[:6] = states[0]
    for state in states:
        assert z[:6] == pytest.approx(state, abs=1e-9 * abs(states).max())
        z = loop.matrix @ z


def test_the_discretised_cost_equals_the_integral():
    """Integrate the cost over one period of a constant input independently."""
    A, B = aircraft()
    rng = np.random.default_rng(4)
    x0, u = rng.standard_normal(6), rng.standard_normal(2)
    cost = Weights(np.diag([1.0, 2, 3, 4, 5, 6]), np.diag([7.0, 8]), cross=0.1 * np.ones((6, 2)))
    _, _, found = sampled.discretize_cost(A, B, cost, 0.3)

    def rate(t, z):
        x = z[:6]
        return np.append(A @ x + B @ u, x @ cost.Qx @ x + 2 * x @ cost.cross @ u + u @ cost.Qu @ u)

    end = solve_ivp(rate, (0, 0.3), np.append(x0, 0), rtol=1e-12, atol=1e-13).y[-1, -1]
    summed = x0 @ found.Qx @ x0 + 2 * x0 @ found.cross @ u + u @ found.Qu @ u
    assert summed == pytest.approx(end, rel=1e-10)


@pytest.mark.parametrize('rate', [1.0, 1e2, 1e4, 1e6])
def test_stiff_plants_are_discretised_to_full_precision(rate):
    """Van Loan's exponential contains exp(+rate) and overflows; this discretisation does not."""
    Ad, Bd, found = sampled.discretize_cost(
        np.array([[-rate]]), np.array([[rate]]), Weights(np.eye(1), np.eye(1)), 1.0)
    e = math.exp(-rate)
    assert Ad[0, 0] == pytest.approx(e, rel=1e-9, abs=1e-300)
    assert Bd[0, 0] == pytest.approx(1 - e, rel=1e-12)
    assert found.Qx[0, 0] == pytest.approx((1 - e * e) / (2 * rate), rel=1e-11)
    assert found.Qu[0, 0] == pytest.approx(
        2 - 2 * (1 - e) / rate + (1 - e * e) / (2 * rate), rel=1e-11)


def test_fast_sampling_tends_to_the_continuous_design():
    A, B = aircraft()
    found = sampled.sampled_lqr(A, B, Weights(np.eye(6), np.eye(2)), 1e-5)
    K = lqr(A, B, np.eye(6), np.eye(2)).K
    assert abs(found.K - K).max() <= 1e-3 * abs(K).max()


def test_sampled_gains_cost_less_than_perturbed_ones():
    """P is the integral of the cost; no other sampled feedback has a lower one."""
    A, B = aircraft()
    found = sampled.sampled_lqr(A, B, Weights(np.eye(6), np.eye(2)), 0.1)
    Ad, Bd, cost = sampled.discretize_cost(A, B, Weights(np.eye(6), np.eye(2)), 0.1)
    rng = np.random.default_rng(6)
    K = found.K
    assert Ad == pytest.approx(expm(A * 0.1), rel=1e-10, abs=1e-14)
    for other in (K, *(K + 0.05 * rng.standard_normal(K.shape) for _ in range(20))):
        M = Ad - Bd @ other
        if abs(np.linalg.eigvals(M)).max() >= 1:
            continue
        Q = cost.Qx - cost.cross @ other - other.T @ cost.cross.T + other.T @ cost.Qu @ other
        P, power = Q.copy(), M
        for _ in range(16):
            P, power = P + power.T @ P @ power, power @ power
        assert np.linalg.eigvalsh(P - found.P)[0] > -1e-8 * abs(P).max()


def test_invalid_periods_and_delays_are_rejected():
    A, B = aircraft()
    cost = Weights(np.eye(6), np.eye(2))
    for period, delay, words in [(0.0, 0.0, 'period = 0'), (math.nan, 0.0, 'period = nan'),
                                 (0.1, -1.0, 'delay = -1'), (0.1, math.inf, 'delay = inf'),
                                 (0.001, 2.0, 'more than 300 periods')]:
        with pytest.raises(StatementError, match=words):
            sampled.sampled_lqr(A, B, cost, period, delay)
    with pytest.raises((StatementError, RefusedDesignError)):
        sampled.sampled_lqr(np.array([[50.0]]), np.eye(1), Weights(np.eye(1), np.eye(1)), 0.1, 1.0)
