# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Gain schedules over the speed: designed at grid values, verified between them."""

import math
from typing import Any

from hypothesis import given, settings, strategies
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.lqr.design.design import (
    design,
    linearize_plant,
    LinearizedPlant,
    Sampling,
    schedule_gains,
)
from obc_ros.core.lqr.gain_schedule import compute_schedule, Table
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import RefusedDesignError, StatementError
from plants import vehicle
import pytest
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

LENGTH, SLOW, FAST = 2.0, 1.0, 30.0


def with_integral(v: float) -> tuple[Array, Array]:
    """Return the lateral vehicle augmented by the integral of its position."""
    A, B = vehicle(v)
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[2, 0] = A, 1.0
    return whole, np.vstack([B, [[0.0]]])


COSTS = {
    'Exercise 2.10': (vehicle, Weights(np.diag([1.0, 0.0]), np.eye(1))),
    'heading': (vehicle, Weights(np.diag([100.0, 0.1]), np.eye(1))),
    'degree of stability': (vehicle, Weights(np.diag([1.0, 0.1]), np.eye(1), stability=1.0)),
    'integral': (with_integral, Weights(np.diag([1.0, 0.1, 1.0]), np.eye(1))),
}


def gain(found: Table, v: float) -> Array:
    """Return the scheduled gain at speed v."""
    m, n = found.K.shape[1:]
    return np.array([[np.interp(v, found.values, found.K[:, i, j]) for j in range(n)]
                     for i in range(m)])


@pytest.mark.parametrize('name', COSTS)
def test_scheduled_gains_match_the_design_at_each_speed(name: str) -> None:
    """At and between grid values the gain is close to the design's and stabilises."""
    at, cost = COSTS[name]
    found = compute_schedule(at, cost, SLOW, FAST)
    assert found.values[[0, -1]].tolist() == [SLOW, FAST]
    for v in np.linspace(SLOW, FAST, 300):
        A, B = at(v)
        exact, K = lqr(A, B, cost.Qx, cost.Qu, stability=cost.stability).K, gain(found, v)
        assert np.abs(K - exact).max() <= 0.02 * np.abs(exact).max()
        assert np.linalg.eigvals(A - B @ K).real.max() < -0.9 * cost.stability


def test_the_lateral_vehicle_allows_any_rate_of_speed() -> None:
    """
    One cost for all speeds gives the same gain at all speeds, K = [1, sqrt(2 l)].

    Parametrised by arc length s, dx/ds = N x + b phi does not depend on the speed.
    """
    found = compute_schedule(*COSTS['Exercise 2.10'], SLOW, FAST)
    np.testing.assert_allclose(found.K, [[[1.0, math.sqrt(2.0 * LENGTH)]]] * len(found.K))
    assert found.rate == math.inf


@pytest.mark.parametrize('name', ['degree of stability', 'integral'])
def test_the_loop_is_stable_at_the_verified_rate(name: str) -> None:
    """The speed sweeps its whole range at the verified rate; the state still decays."""
    at, cost = COSTS[name]
    found = compute_schedule(at, cost, SLOW, FAST)
    assert 0.1 < found.rate < 100.0
    span = 2.0 * (FAST - SLOW) / found.rate

    def rate(t: float, x: Array) -> Array:
        v = SLOW + found.rate * abs((t + span / 2.0) % span - span / 2.0)
        A, B = at(v)
        return (A - B @ gain(found, v)) @ x

    driven = solve_ivp(rate, (0.0, 2.0 * span), np.ones(len(cost.Qx)), rtol=1e-8, max_step=0.1).y
    assert np.abs(driven[:, -1]).max() < 1e-4


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(strategies.integers(2, 4), strategies.integers(1, 2), strategies.integers(0, 2**32 - 1),
       strategies.floats(0.0, 2.0))
def test_accepted_schedules_stabilise_between_grid_values(
        n: int, m: int, seed: int, slope: float) -> None:
    """Random plants affine in the variable are either verified everywhere or rejected."""
    rng = np.random.default_rng(seed)
    A, dA, B, dB = (rng.standard_normal(shape) for shape in ((n, n), (n, n), (n, m), (n, m)))

    def at(v: float) -> tuple[Array, Array]:
        return A + slope * v * dA, B + slope * v * dB

    try:
        found = compute_schedule(at, Weights(np.eye(n), np.eye(m)), 0.0, 1.0)
    except RefusedDesignError:
        return
    for v in rng.uniform(0.0, 1.0, 50):
        M = at(v)[0] - at(v)[1] @ gain(found, v)
        assert np.linalg.eigvals(M).real.max() < 0.0
    assert found.rate > 0.0


def test_ranges_with_an_uncontrollable_value_are_rejected() -> None:
    """Both ends can be stabilised; at v = 0, where the input changes its sign, nothing can."""
    def turning(v: float) -> tuple[Array, Array]:
        return np.ones((1, 1)), np.array([[v]])

    with pytest.raises(RefusedDesignError, match='uncontrollable|ill-conditioned|between'):
        compute_schedule(turning, Weights(np.eye(1), np.eye(1)), -1.0, 1.0)
    with pytest.raises(RefusedDesignError):
        compute_schedule(turning, Weights(np.eye(1), np.eye(1)), -0.9, 1.0)


def test_invalid_ranges_and_zero_speed_are_rejected() -> None:
    """Invalid ranges are reported; at zero speed steering has no effect."""
    cost = Weights(np.eye(2), np.eye(1))
    for lower, upper in ((2.0, 1.0), (math.nan, 1.0), (0.0, math.inf)):
        with pytest.raises(StatementError, match='wanted finite values'):
            compute_schedule(vehicle, cost, lower, upper)
    with pytest.raises(RefusedDesignError, match='uncontrollable'):
        compute_schedule(vehicle, cost, 0.0, 1.0)


def test_designs_with_integrals_and_periods_are_scheduled() -> None:
    """Gains include the integrals; a period must keep the loop stable at all values."""
    system = registry.get_system('vehicle_lateral')

    def at(v: float) -> LinearizedPlant:
        return linearize_plant(system.with_parameters({'v': v}))

    given: dict[str, Any] = {'Qx': (1.0, 0.1), 'Qu': (1.0,)}
    found = design(at(10.0), given, ('py',), (1.0,))
    made = schedule_gains(found, at, SLOW, FAST)
    assert made.K.shape[1:] == (1, 3)
    np.testing.assert_allclose(gain(made, 10.0)[0], found.lqr.K[0], rtol=0.02)
    held = design(at(1.0), given, sampling=Sampling(0.05))
    assert len(schedule_gains(held, at, SLOW, 10.0).K) == 2
    slow = design(at(1.0), given, sampling=Sampling(0.5))
    with pytest.raises(RefusedDesignError, match='held for 0.5 s'):
        schedule_gains(slow, at, SLOW, FAST)
    exact = design(at(1.0), given, sampling=Sampling(0.05, exact=True))
    with pytest.raises(StatementError, match='wanted design = continuous'):
        schedule_gains(exact, at, SLOW, FAST)
