# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Stability margins and step figures compared with closed forms and python-control."""

import math

import control
import numpy as np
from obc_ros.core.lqr.lqr import dlqr, lqr
from obc_ros.core.lqr.margins import compute_margins, compute_step_figures
from plants import aircraft, CHAIN, FORCE
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq


def random_plant(seed, n, m):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, n)), rng.standard_normal((n, m))


def test_margins_of_the_double_integrator_have_closed_forms():
    """K = [1, sqrt 2]: L = (1 + sqrt(2) s) / s^2, its closed loop overshoots by e^-pi."""
    design = lqr(CHAIN, FORCE, np.diag([1, 0]), [[1]])
    found = compute_margins(CHAIN, FORCE, design.K)
    w = math.sqrt(1 + math.sqrt(2))  # w^4 = 1 + 2 w^2
    assert found.bandwidth[0] == pytest.approx(w, rel=1e-9)
    assert found.phase_margin[0] == pytest.approx(math.atan(math.sqrt(2) * w), rel=1e-9)
    assert found.gain_margin[0] == math.inf
    assert found.gain_reduction_margin[0] == pytest.approx(0.0, abs=1e-9)
    assert found.damping == pytest.approx([math.sqrt(0.5)] * 2)
    assert found.frequency == pytest.approx([1.0] * 2)
    assert found.overshoot[0] == pytest.approx(math.exp(-math.pi), rel=1e-3)
    assert math.isnan(found.overshoot[1])
    assert found.peak_input[0] == pytest.approx(1.0)
    assert found.sensitivity_peak == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize('a', [0.5, 2.0])
def test_an_unstable_scalar_has_gain_reduction_one_half(a):
    """For Qx = 0, K = 2 a: the loop gain 2 may be halved, and the input holds the set point."""
    design = lqr([[a]], [[1]], [[0]], [[1]], to_rest=True)
    found = compute_margins(design.A, design.B, design.K)
    assert found.gain_reduction_margin[0] == pytest.approx(0.5, rel=1e-9)
    assert found.phase_margin[0] == pytest.approx(math.pi / 3, rel=1e-9)
    assert found.rise_time[0] == pytest.approx(math.log(9) / a, rel=1e-3)
    assert found.peak_input[0] == pytest.approx(2 * a - a)


@pytest.mark.slow
@pytest.mark.parametrize('design', [
    lqr(*aircraft(), np.eye(6), np.eye(2)),
    lqr(*aircraft(), np.diag([100, 1, 2 * np.pi / 9, 0, 0, 0]), 0.1 * np.eye(2)),
    *(lqr(*random_plant(seed, 5, 2), np.eye(5), np.eye(2)) for seed in range(4)),
    dlqr(expm(0.1 * CHAIN), [[0.005], [0.1]], np.eye(2), [[1]], period=0.1),
])
def test_margins_agree_with_python_control(design):
    A, B, K, m = design.A, design.B, design.K, design.B.shape[1]
    found = compute_margins(A, B, K, design.period)
    for i in range(m):
        rest = [k for k in range(m) if k != i]
        loop = control.ss(A - B[:, rest] @ K[rest], B[:, [i]], K[[i]], 0, design.period)
        gain, phase, _, _, crossover, _ = control.stability_margins(loop, returnall=True)
        if design.period:  # python-control does not evaluate the Nyquist frequency itself.
            gain = np.append(gain, 1 / abs(loop(-1)))
        above, below = gain[gain > 1], gain[(gain < 1) & (gain > 1e-6)]
        assert found.gain_margin[i] == pytest.approx(min(above, default=math.inf), rel=1e-5)
        assert found.gain_reduction_margin[i] == pytest.approx(
            max(below, default=0.0), rel=1e-5, abs=1e-6)
        assert found.phase_margin[i] == pytest.approx(
            math.radians(min(abs(phase), default=math.inf)), rel=1e-5)
        assert found.bandwidth[i] == pytest.approx(max(crossover, default=0.0), rel=1e-5)
        w = np.geomspace(1e-3, math.pi / design.period if design.period else 1e4, 20000)
        L = control.frequency_response(loop, w).complex
        disk = min(2.0, 1 / abs((1 - L) / (1 + L) / 2).max())
        assert found.disk_margin[i] == pytest.approx(disk, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize('weights', [1.0, 100.0])
def test_step_figures_agree_with_python_control(weights):
    A, B = aircraft()
    design = lqr(A, B, np.eye(6), weights * np.eye(2))
    found = compute_margins(A, B, design.K)
    M = A - B @ design.K
    peaks = []
    for i in range(2):
        loop = control.ss(M, B @ design.K[:, [i]], np.eye(6)[[i]], 0)
        info = control.step_info(loop, T=np.linspace(0, 80, 80001))
        assert found.rise_time[i] == pytest.approx(info['RiseTime'], rel=3e-3)
        assert found.settling_time[i] == pytest.approx(info['SettlingTime'], rel=3e-3)
        assert found.overshoot[i] == pytest.approx(info['Overshoot'] / 100, rel=3e-3, abs=1e-5)
        x = np.array([expm(M * t)[:, i] for t in np.linspace(0, 10, 500)])
        peaks.append(abs(x @ design.K.T).max(axis=0))
    assert found.peak_input == pytest.approx(np.max(peaks, axis=0), rel=1e-3)
    assert np.isnan(found.rise_time[2:]).all()


def test_step_figures_resolve_fast_states_beside_slow_ones():
    """The time grid of a step follows the fast state, not the slowest mode."""
    A = np.zeros((2, 2))
    found = compute_margins(A, np.eye(2), np.diag([1000.0, 0.01]))
    assert found.rise_time == pytest.approx(math.log(9) / np.array([1000.0, 0.01]), rel=1e-2)
    assert found.settling_time == pytest.approx(math.log(50) / np.array([1000, 0.01]), rel=1e-2)


def test_peaks_of_lightly_damped_resonances_are_found():
    """With damping 1e-4 and a small gain the peak of S lies between grid points."""
    A = np.array([[0.0, 1.0], [-1.0, -2e-4]])
    B, K = np.array([[0.0], [1.0]]), np.array([[2e-4, 0.0]])
    found = compute_margins(A, B, K)
    w = np.linspace(0.99, 1.01, 2000001)
    s = 1j * w
    S = (s * s + 2e-4 * s + 1) / (s * s + 2e-4 * s + 1 + 2e-4)
    assert found.sensitivity_peak == pytest.approx(abs(S).max(), rel=1e-4)


def test_a_defective_closed_loop_has_its_margins():
    """Three equal poles form one Jordan block, so no modal form exists."""
    A = np.eye(3, k=1)
    B = np.eye(3)[:, 2:]
    found = compute_margins(A, B, np.array([[1.0, 3.0, 3.0]]))  # (s + 1)^3
    loop = control.tf([3, 3, 1], [1, 0, 0, 0])
    gain, phase, _, _, crossover, _ = control.stability_margins(loop)
    assert found.gain_reduction_margin[0] == pytest.approx(gain, rel=1e-6)
    assert found.phase_margin[0] == pytest.approx(math.radians(phase), rel=1e-6)
    assert found.bandwidth[0] == pytest.approx(crossover, rel=1e-6)


@pytest.mark.parametrize('spread', [0.0, 1.0])
def test_margins_of_several_inputs_need_no_modal_form(spread):
    """Compare with T = K (jw - M)^-1 B; without spread M is one Jordan block."""
    rng = np.random.default_rng(3)
    n, m = 8, 5
    B, K = rng.standard_normal((n, m)), 0.1 * rng.standard_normal((m, n))
    M = 0.3 * np.eye(n, k=1) - np.diag(1.0 + spread * np.arange(n))
    found = compute_margins(M + B @ K, B, K)
    w = np.geomspace(1e-3, 1e2, 20001)
    T = K @ np.linalg.solve(1j * w[:, None, None] * np.eye(n) - M, B + 0j)
    assert found.sensitivity_peak == pytest.approx(
        np.linalg.svd(np.eye(m) - T, compute_uv=False).max(), rel=1e-6)
    for i in range(m):
        t = T[:, i, i]
        assert found.disk_margin[i] == pytest.approx(
            min(2.0, 2.0 / np.abs(1.0 - 2.0 * t).max()), rel=1e-6)
        above = np.flatnonzero(np.abs(t) >= np.abs(1.0 - t))
        assert found.bandwidth[i] == pytest.approx(w[above[-1]] if above.size else 0.0, rel=1e-3)


def test_sampled_modes_at_zero_have_a_finite_time_constant():
    """A mode at z = 0 counts as very fast, not as infinite."""
    found = compute_margins(np.array([[0.0]]), np.array([[1.0]]), np.array([[0.0]]), period=0.1)
    assert np.isfinite(found.poles).all()
    assert found.rise_time.shape == (1,)


def test_the_rise_time_of_second_order_steps_is_exact():
    w, zeta = 3.0, 0.6
    found = compute_step_figures(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]),
                                 np.array([[w * w, 2 * zeta * w]]),
                                 np.roots([1.0, 2 * zeta * w, w * w]).astype(complex))
    wd = w * np.sqrt(1 - zeta**2)

    def above(t, level):
        return 1 - level - np.exp(-zeta * w * t) * (
            np.cos(wd * t) + zeta * w / wd * np.sin(wd * t))

    wanted = brentq(above, 0, np.pi / wd, (0.9,)) - brentq(above, 0, np.pi / wd, (0.1,))
    assert found[0][0] == pytest.approx(wanted, rel=1e-9)
