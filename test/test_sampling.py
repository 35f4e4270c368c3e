# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Designs for the rate and the delay that they run at."""

from dataclasses import replace
import math
from typing import Any

from hypothesis import given, settings, strategies
import numpy as np
from numpy.typing import NDArray
from obc_ros.core import systems
from obc_ros.core.conditions import Conditions
from obc_ros.core.control import Control
from obc_ros.core.design import Design, design, plant
from obc_ros.core.errors import StatementError
from obc_ros.core.following import course, leg
from obc_ros.core.loop import Loop
from obc_ros.core.regulator import Limits
from obc_ros.core.sampling import held, prediction, sampled, Sampling
from obc_ros.core.simulate import Simulator
from obc_ros.core.weights import Weights
import pytest
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

# Example 2.5, its weight of theta as errata.md has it
EXAMPLE_2_5: dict[str, Any] = {
    'Qx': (100.0, 1.0, (3.6 / math.pi)**2, 0.0, 0.0, 0.0), 'Qu': (0.1, 0.1)}


def test_double_integrator_held() -> None:
    """The closed form."""
    Ad, Bd = held(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 0.3)
    np.testing.assert_allclose(Ad, [[1.0, 0.3], [0.0, 1.0]], atol=1e-15)
    np.testing.assert_allclose(Bd, [[0.045], [0.3]], atol=1e-15)


@settings(max_examples=20, deadline=None)
@given(strategies.integers(0, 2**32 - 1), strategies.floats(0.05, 1.0))
def test_the_sum_is_the_integral(seed: int, h: float) -> None:
    """The cost over a period, integrated numerically, is the sampled quadratic form."""
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    root = rng.normal(size=(5, 5))
    Q = root @ root.T
    weights = Weights(Q[:3, :3], Q[3:, 3:], Q[:3, 3:])
    x, u = rng.normal(size=3), rng.normal(size=2)

    def slope(_: float, y: Array) -> Array:
        z = np.concatenate([y[:3], u])
        return np.append(A @ y[:3] + B @ u, z @ Q @ z)

    end = solve_ivp(slope, (0.0, h), np.append(x, 0.0), rtol=1e-11, atol=1e-12).y[:, -1]
    Ad, Bd, cost = sampled(A, B, weights, h)
    np.testing.assert_allclose(Ad @ x + Bd @ u, end[:3], rtol=1e-8, atol=1e-9)
    assert cost.cross is not None
    assert x @ cost.Qx @ x + 2 * x @ cost.cross @ u + u @ cost.Qu @ u == pytest.approx(
        end[3], rel=1e-7)


@pytest.mark.parametrize('delay', [0.05, 0.1, 0.07, 0.03])
def test_prediction_is_exact_for_a_linear_plant(delay: float) -> None:
    """Whole periods and parts of one: the state at the end of the delay, from what is known."""
    rng, h, q = np.random.default_rng(1), 0.05, 3
    A, B = rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    x, past = rng.normal(size=3), rng.normal(size=(q, 2))  # the last command first
    found = prediction(A, B, Sampling(h, delay))
    assert found is not None and found.delay == round(delay * 1e9)
    expected = np.array(found.Phi) @ x + sum(
        np.array(gamma) @ u for gamma, u in zip(found.Gammas, past, strict=False))
    # by steps of 10 ms: at time t the command in effect is the one given at t - delay or before
    y = x
    for k in range(round(delay / 0.01)):
        age = math.ceil((delay - k * 0.01) / h - 1e-9)  # periods ago
        Ad, Bd = held(A, B, 0.01)
        y = Ad @ y + Bd @ past[age - 1]
    np.testing.assert_allclose(expected, y, rtol=1e-12)


def spectral_radius(found: Design, h: float, delays: int) -> float:
    """Return that of the aircraft under a gain without prediction, some periods late."""
    Ad, Bd = held(found.plant.A, found.plant.B, h)
    n, m = Bd.shape
    M = np.zeros((n + delays * m, n + delays * m))
    M[:n, :n] = Ad
    if not delays:
        return float(np.abs(np.linalg.eigvals(Ad - Bd @ found.K)).max())
    M[:n, -m:] = Bd
    M[n:n + m, :n] = -found.K
    for k in range(1, delays):
        M[n + k * m:n + (k + 1) * m, n + (k - 1) * m:n + k * m] = np.eye(m)
    return float(np.abs(np.linalg.eigvals(M)).max())


def fly(found: Design, h: float, delay: float) -> Array:
    """Return the largest of |x| over each second of flight from px = 0.3."""
    system = found.plant.system
    control = Control(
        found.regulator, Limits(tuple(system.u_min), tuple(system.u_max), (2,)),
        found.plant.rest, system.state_names,
        prediction=prediction(found.plant.A, found.plant.B, found.sampling))
    loop = Loop(control)
    craft = Simulator(system, [0.3, 0.0, 0.0, 0.0, 0.0, 0.0],
                      Conditions(dt=1e-3, input_delay=delay))
    sizes = []
    for k in range(round(10.0 / h)):
        u = loop.answer(round(k * h * 1e9), craft.x.tolist(), k * h)
        assert u is not None
        craft.command(np.array(u))
        craft.advance(round(h / 1e-3))
        sizes.append(np.abs(craft.x).max())
    return np.array(sizes)


def test_example_2_5_at_20_hz_and_50_ms_of_delay() -> None:
    """The continuous gain is unstable there; the sampled design with prediction flies."""
    at = plant(systems.get('aircraft'))
    continuous = design(at, EXAMPLE_2_5)
    assert spectral_radius(continuous, 0.05, 1) == pytest.approx(1.11, abs=0.01)
    found = design(at, EXAMPLE_2_5, sampling=Sampling(0.05, 0.05, exact=True))
    sizes = fly(found, 0.05, 0.05)
    assert sizes.max() < 3.0 and sizes[-20:].max() < 0.05
    unpredicted = fly(continuous, 0.05, 0.05)
    assert not unpredicted[-20:].max() < 0.05


def test_poles_of_the_sampled_loop() -> None:
    """They tend to those of the continuous design with the period."""
    at = plant(systems.get('double_integrator'))
    continuous = design(at, {})
    quick = design(at, {}, sampling=Sampling(1e-4, exact=True))
    np.testing.assert_allclose(quick.K, continuous.K, rtol=1e-3)
    slow = design(at, {}, sampling=Sampling(1.0, exact=True))
    assert np.abs(slow.lqr.E).max() < 1.0 and slow.lqr.period == 1.0


@pytest.mark.parametrize(('given', 'sentence'), [
    ({'exact': True}, 'design = sampled needs the period'),
    ({'delay': 0.1}, 'delay = 0.1 needs the period'),
    ({'delay': 10.0, 'period': 0.001}, 'delay = 10: more than 1000 periods'),
])
def test_what_is_refused(given: dict[str, Any], sentence: str) -> None:
    """A delay or a sampled design without a period, or an endless delay."""
    with pytest.raises(StatementError, match=sentence):
        Sampling(**given)


def test_a_reference_with_a_sampled_design() -> None:
    """The gains along it are sampled ones too, and end in that of the design."""
    found = design(plant(systems.get('double_integrator')), {}, sampling=Sampling(0.2, exact=True))
    t = np.linspace(0.0, 20.0, 201)
    along = course(found.plant.system, ((), ()), t.tolist(), [0.0] * 402, [0.0] * 201, '', 0)
    law = leg(along, found)[0]
    np.testing.assert_allclose(law.along.at(0.0).K, found.K, rtol=1e-9)
    np.testing.assert_allclose(law.along.at(20.0).K, found.K, rtol=1e-9)
    other = replace(found, cost=replace(found.cost, Qx=4 * found.cost.Qx))
    K = design(found.plant, {'Qx': (4.0, 4.0)}, sampling=found.sampling).K
    np.testing.assert_allclose(leg(along, other)[0].along.at(0.0).K, K, rtol=1e-6)
