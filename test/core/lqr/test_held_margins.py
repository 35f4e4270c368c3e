# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Margins of held and delayed loops: by hand, and by the modes of a loop built step by step."""

from dataclasses import replace
import math
import sys

import numpy as np
from obc_ros.core.lqr.held_loop import find_longest_period, HeldLoop
from obc_ros.core.lqr.held_margins import compute_held_margins
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.margins import compute_margins
from obc_ros.core.lqr.sampled import sampled_lqr
from obc_ros.core.lqr.weights import Weights, with_integrals
from obc_ros.core.text.errors import RefusedDesignError
from plants import aircraft, CHAIN, FORCE
import pytest
from scipy.linalg import expm


def hold(A, B, K, period, delay=0.0, C=None):
    return HeldLoop(np.array(A, float), np.array(B, float),
                    np.zeros((0, len(A))) if C is None else C, np.array(K, float), period, delay,
                    period)


def advance(A, B, x, u, time):
    """Return x after a time with a constant input."""
    n, m = B.shape
    flow = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * time)
    return flow[:n, :n] @ x + flow[:n, n:] @ u


def radius(loop, i=0, gain=1.0, extra=0.0):
    """
    Return the spectral radius with `gain` and an `extra` delay [s] at the plant's input i.

    Each column of the loop's matrix is one period of the motion from a unit vector, integrated
    from each change of an input to the next. The controller predicts with what it has sent.
    """
    (n, m), p, h, K = loop.B.shape, len(loop.C), loop.period, loop.K
    delays = np.full(m, loop.delay)
    delays[i] += extra
    kept = math.ceil(delays.max() / h) + 1
    size = n + p + kept * m
    whole = np.block([[loop.A, np.zeros((n, p))], [loop.C, np.zeros((p, p))]])
    inputs = np.vstack([loop.B, np.zeros((p, m))])

    def active(sent, t, late):  # sent[0]: the command of t = 0, sent[k]: that of k periods before
        return sent[-math.floor((t - late) / h + 1e-9)]

    def edges(end, *late):
        inside = {each - h * math.floor(each / h + 1e-9) + k * h for each in late
                  for k in range(math.ceil(end / h) + 1)}
        times = sorted({0.0, end, *(t for t in inside if 1e-12 < t < end - 1e-12)})
        return zip(times[:-1], times[1:], strict=True)

    state = np.eye(size)
    x, z = state[:n], state[n:n + p]
    past = state[n + p:].reshape(kept, m, size)
    ahead, blank = state[:n + p], np.concatenate([np.zeros((1, m, size)), past])
    for low, high in edges(loop.delay, loop.delay):
        ahead = advance(whole, inputs, ahead, active(blank, 0.5 * (low + high), loop.delay),
                        high - low)
    sent = np.concatenate([(-K @ ahead)[None], past])
    moved = x
    for low, high in edges(h, *delays):
        v = np.array([active(sent, 0.5 * (low + high), late)[j]
                      for j, late in enumerate(delays)])
        v[i] *= gain
        moved = advance(loop.A, loop.B, moved, v, high - low)
    z = z + 0.5 * h * loop.C @ (x + moved)
    M = np.concatenate([moved, z, sent[:kept].reshape(kept * m, size)])
    return np.abs(np.linalg.eigvals(M)).max()


def check_margins(loop):
    """Check that the loop is stable up to each margin, and unstable after it."""
    found = compute_held_margins(loop)
    assert radius(loop) < 1.0
    for i in range(loop.B.shape[1]):
        up, down = found.gain_margin[i], found.gain_reduction_margin[i]
        late = found.delay_margin[i]
        stable = [{'gain': min(0.999 * up, 1e3)}, {'gain': max(1.001 * down, 1e-3)}]
        unstable = [{'gain': 1.001 * up}] if up < 1e3 else []
        unstable += [{'gain': 0.999 * down}] if down > 1e-3 else []
        if late < 20.0 * loop.period:
            stable += [{'extra': part * late} for part in (0.25, 0.5, 0.75, 0.999)]
            unstable += [{'extra': 1.001 * late}]
        for change in stable:
            assert radius(loop, i, **change) < 1.0, (i, change, found)
        for change in unstable:
            assert radius(loop, i, **change) > 1.0, (i, change, found)
    return found


def test_margins_of_a_held_integrator_are_those_by_hand():
    """
    The loop of x' = u with u = -K x is K h / (z - 1).

    It is unstable from K h = 2 on. |L| = 1 where 2 sin(theta / 2) = K h. With a longer delay t < h
    the loop is z^2 - (1 - K (h - t)) z + K t, so that by Jury's criterion K t < 1.
    """
    K, h = 1.5, 1.0
    loop = hold([[0]], [[1]], [[K]], h)
    found = check_margins(loop)
    assert found.gain_margin[0] == pytest.approx(2.0 / (K * h), rel=1e-9)
    assert found.phase_margin[0] == pytest.approx(math.pi / 2 - math.asin(K * h / 2), rel=1e-9)
    assert found.delay_margin[0] == pytest.approx(1.0 / K, rel=1e-6)
    assert found.bandwidth[0] == pytest.approx(2.0 * math.asin(K * h / 2) / h, rel=1e-9)
    assert find_longest_period(loop) == pytest.approx(2.0 / K, rel=2e-6)


def test_margins_of_a_held_first_order_plant_are_those_by_hand():
    """The plant x' = -a x + u: L = K (1 - e) / a / (z - e) with e = exp(-a h) is -1 at z = -1."""
    a, K, h = 0.7, 3.0, 0.4
    e = math.exp(-a * h)
    loop = hold([[-a]], [[1]], [[K]], h)
    found = check_margins(loop)
    assert found.gain_margin[0] == pytest.approx(a * (1 + e) / (K * (1 - e)), rel=1e-9)
    assert found.gain_reduction_margin[0] == 0.0
    assert found.poles[0] == pytest.approx(
        np.log(complex(e - K * (1 - e) / a)) / h, rel=1e-9)
    assert find_longest_period(loop) == pytest.approx(math.log((K + a) / (K - a)) / a, rel=2e-6)
    assert find_longest_period(hold([[-1]], [[1]], [[0.5]], 0.1)) == math.inf


def test_margins_of_the_double_integrator_at_2_hz_are_those_by_hand():
    """
    With K = (1, sqrt 3) the loop is z^2 - (2 - g (K1 h^2/2 + K2 h)) z + 1 + g (K1 h^2/2 - K2 h).

    By Jury's criterion it is stable for g K2 h < 2 (z = -1) and K1 h < 2 K2.
    """
    K = lqr(CHAIN, FORCE, np.eye(2), [[1]]).K
    found = check_margins(hold(CHAIN, FORCE, K, 0.5))
    assert found.gain_margin[0] == pytest.approx(4.0 / math.sqrt(3.0), rel=1e-9)
    assert math.degrees(found.phase_margin[0]) == pytest.approx(47.26, abs=0.01)
    assert find_longest_period(hold(CHAIN, FORCE, K, 0.01)) == pytest.approx(
        2.0 / math.sqrt(3.0), rel=2e-6)


def test_margins_with_a_predicted_delay_are_those_by_hand():
    """
    x+ = x + h v with v = u of the period before, u = -K (x + h u_before), K h = k.

    (z - 1) z x = h v z and u (1 + k / z) = -K x give L = k / ((z - 1) (z + k)). For k = 1 it is
    1 / (z^2 - 1): with a gain g the modes are z^2 = 1 - g, stable for 0 < g < 2.
    """
    found = check_margins(hold([[0]], [[1]], [[2.0]], 0.5, 0.5))
    assert found.gain_margin[0] == pytest.approx(2.0, rel=1e-9)
    assert found.gain_reduction_margin[0] == pytest.approx(0.0, abs=1e-9)
    assert found.phase_margin[0] == pytest.approx(math.pi / 3, rel=1e-9)


@pytest.mark.parametrize(('A', 'period', 'delay'), [
    (CHAIN, 0.5, 0.5), (CHAIN, 0.1, 0.5), ([[0, 1], [3, 0]], 0.05, 1.0)])
def test_a_delay_costs_margins_although_it_is_predicted(A, period, delay):
    """The frequency sweep of L in closed form: S = S0 (1 + K sum of Gamma_j z^-j)."""
    loop = hold(A, FORCE, sampled_lqr(np.array(A, float), FORCE, Weights(np.eye(2), np.eye(1)),
                                      period, delay).K, period, delay)
    found = check_margins(loop)
    Ad, Bd = loop.plant
    w = np.linspace(1e-3, math.pi / period, 200_001)
    z = np.exp(1j * w * period)
    S0 = 1.0 - np.linalg.solve(
        z[:, None, None] * np.eye(2) - (Ad - Bd @ loop.K), Bd + 0j)[..., 0] @ loop.K[0]
    S = S0 * (1.0 + sum((loop.K @ Gamma)[0, 0] * z**-(j + 1.0)
                        for j, Gamma in enumerate(loop.prediction[1])))
    L = 1.0 / S - 1.0
    assert found.disk_margin[0] == pytest.approx(2.0 / np.abs(2.0 * S - 1.0).max(), rel=1e-5)
    assert found.sensitivity_peak == pytest.approx(np.abs(S).max(), rel=1e-5)
    at = np.flatnonzero(np.diff(np.signbit(np.abs(L) - 1.0)))
    assert found.bandwidth[0] == pytest.approx(w[at[-1]], abs=2e-4 / period)
    assert found.phase_margin[0] == pytest.approx(np.abs(np.angle(-L[at])).min(), rel=1e-3)


@pytest.mark.parametrize('seed', [pytest.param(seed, marks=pytest.mark.slow if seed > 9 else ())
                                  for seed in range(60)])
def test_margins_bracket_the_stability_of_random_designs(seed):
    """Plants of 1 to 4 states, 1 or 2 inputs, hold, delay of up to 2.5 periods, an integral."""
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(1, 5), rng.integers(1, 3), rng.integers(0, 2)
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, m))
    period = float(10.0**rng.uniform(-1.7, -0.3))
    delay = float(rng.choice([0.0, 1.0, rng.uniform(0.0, 2.5)])) * period
    cost = Weights(np.eye(n), np.eye(m) * 10.0**rng.uniform(-1, 1))
    C = np.eye(n)[:p]
    whole = with_integrals(A, B, cost, C, np.ones(p)) if p else (A, B, cost)
    try:
        K = sampled_lqr(*whole, period, delay).K
    except RefusedDesignError:   # an integral of a state that no input holds
        pytest.skip('there is no design')
    loop = hold(A, B, K, period, delay, C)
    assert loop.radius == pytest.approx(radius(loop), rel=1e-6)
    if loop.radius < 0.999:
        check_margins(loop)


def test_margins_of_the_aircraft_bracket_its_stability():
    A, B = aircraft()
    K = lqr(A, B, np.eye(6), np.eye(2)).K
    check_margins(hold(A, B, K, 0.02))
    check_margins(hold(A, B, K, 0.1))
    check_margins(hold(A, B, K, 0.05, 0.07))


def test_fast_commands_have_the_margins_of_continuous_time():

    A, B = aircraft()
    K = lqr(A, B, np.eye(6), np.eye(2)).K
    continuous, fast = compute_margins(A, B, K), compute_held_margins(hold(A, B, K, 1e-5))
    for name in ('phase_margin', 'disk_margin', 'delay_margin', 'bandwidth', 'rise_time',
                 'settling_time', 'overshoot', 'peak_input', 'sensitivity_peak'):
        assert getattr(fast, name) == pytest.approx(
            getattr(continuous, name), rel=1e-3, abs=2e-3, nan_ok=True), name
    w, t = continuous.bandwidth, continuous.phase_margin
    assert continuous.delay_margin == pytest.approx(t / w, rel=1e-9)   # one crossover each


def test_steps_between_the_samples_are_those_of_the_motion():
    """For x' = u, K = 1, h = 0.5: x = 1 - 0.5^k at the samples, lines between them."""
    found = compute_held_margins(hold([[0]], [[1]], [[1.0]], 0.5))
    t = np.linspace(0.0, 10.0, 200_001)
    y = np.interp(t, 0.5 * np.arange(21), 1.0 - 0.5**np.arange(21))
    rise = t[np.argmax(y >= 0.9)] - t[np.argmax(y >= 0.1)]
    assert found.rise_time[0] == pytest.approx(rise, abs=0.02)
    assert found.settling_time[0] == pytest.approx(t[np.argmax(y >= 0.98)], abs=0.02)
    assert found.peak_input[0] == pytest.approx(1.0)
    late = compute_held_margins(hold([[0]], [[1]], [[1.0]], 0.5, 1.2))
    assert late.rise_time[0] == pytest.approx(rise, abs=0.02)
    assert late.settling_time[0] == pytest.approx(found.settling_time[0] + 1.2, abs=0.02)


def test_an_unstable_loop_has_no_margins():
    found = compute_held_margins(hold([[0]], [[1]], [[3.0]], 1.0))
    assert found.poles.real.max() > 0.0
    for name in ('gain_margin', 'phase_margin', 'disk_margin', 'delay_margin', 'rise_time'):
        assert np.isnan(getattr(found, name)).all()


@pytest.mark.parametrize(('period', 'delay'), [(0.05, 0.0), (0.05, 0.07), (0.02, 0.3)])
def test_the_loop_is_stable_up_to_the_longest_period_only(period, delay, monkeypatch):
    """The two ways of judging, by the modes and by the argument of the determinant, agree."""
    A, B = aircraft()
    K = sampled_lqr(A, B, Weights(np.eye(6), np.eye(2)), period, delay).K
    loop = hold(A, B, K, period, delay)
    longest = find_longest_period(loop)
    for each in np.geomspace(period, 0.9999 * longest, 9):
        assert replace(loop, period=float(each)).radius < 1.0
    assert replace(loop, period=1.0001 * longest).radius > 1.0
    monkeypatch.setattr(sys.modules[HeldLoop.__module__], '_SMALL', 0)
    assert find_longest_period(loop) == pytest.approx(longest, rel=1e-4)
