# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""lqr_node in its own process: gains and commands, compared with those computed here."""

import math
from typing import Any

from lqr_bench import Bench, HOVER, LATCHED, matrix, reference
import numpy as np
from numpy.typing import NDArray
from obc_ros.msg import LqrWeights, State, Trajectory
from obc_ros.srv import SuggestWeights, TryDesign
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are
from std_srvs.srv import Trigger
from support import DEMO

pytestmark = pytest.mark.nodes

Array = NDArray[np.float64]

X = [0.3, -0.2, 0.1, 0.05, -0.04, 0.02]
EXAMPLE_2_5 = {'Qx': [100.0, 1.0, 2 * math.pi / 9, 0.0, 0.0, 0.0], 'Qu': [0.1, 0.1]}


def attempt(probe: Any, **weights: Any) -> Any:
    """Return the answer to a dry run."""
    return probe.call(TryDesign, '/lqr_node/try_design',
                      TryDesign.Request(weights=LqrWeights(**weights)))


# Sampled data


def one_period(A: Array, B: Array, Qx: Array, Qu: Array, h: float
               ) -> tuple[Array, Array, Array, Array, Array]:
    """Return Ad, Bd and Qx, Qu, N of a period under a held input, by a quadrature of the cost."""
    n, m = B.shape
    motion, cost = np.zeros((n + m, n + m)), np.zeros((n + m, n + m))
    motion[:n, :n], motion[:n, n:] = A, B
    cost[:n, :n], cost[n:, n:] = Qx, Qu
    total = np.zeros_like(cost)
    for node, share in zip(*np.polynomial.legendre.leggauss(12), strict=True):
        flow = expm(motion * (node + 1) * h / 2)
        total += share * h / 2 * flow.T @ cost @ flow
    end = expm(motion * h)
    return end[:n, :n], end[:n, n:], total[:n, :n], total[n:, n:], total[:n, n:]


def test_the_sampled_design_predicts_over_the_delay(spawn: Any, probe: Any) -> None:
    """Example 2.5 at 20 Hz and 50 ms: optimal gain of the sampled plant, predicted x."""
    bench = Bench(spawn, probe, **EXAMPLE_2_5)
    first, h = bench.design(1), 0.05
    A, B, naive = matrix(first.a, 6), matrix(first.b, 6), matrix(first.k, 2)
    Ad, Bd, Qx, Qu, N = one_period(
        A, B, np.diag(EXAMPLE_2_5['Qx']), np.diag(EXAMPLE_2_5['Qu']), h)
    # x+ = Ad x + Bd u-, u = -K x: a command takes effect one period late
    late = np.block([[Ad, Bd], [-naive, np.zeros((2, 2))]])
    assert np.abs(np.linalg.eigvals(late)).max() == pytest.approx(1.11, abs=0.005)
    P = solve_discrete_are(Ad, Bd, Qx, Qu, s=N)
    K = np.linalg.solve(Qu + Bd.T @ P @ Bd, Bd.T @ P @ Ad + N.T)
    assert bench.set(design='sampled', rate=1 / h, delay=h).successful
    design = bench.design(2)
    np.testing.assert_allclose(matrix(design.k, 2), K, rtol=1e-8, atol=1e-8)
    poles = np.log(np.linalg.eigvals(Ad - Bd @ K).astype(complex)) / h
    told = np.array(design.poles_real) + 1j * np.array(design.poles_imag)
    np.testing.assert_allclose(np.sort_complex(told), np.sort_complex(poles), rtol=1e-6)
    rng, before = np.random.default_rng(5), bench.answer(X, 1.0)
    for k in range(1, 5):
        x = 0.1 * rng.standard_normal(6)
        u = bench.answer(x, 1.0 + k * h)
        np.testing.assert_allclose(u, HOVER - K @ (Ad @ x + Bd @ (before - HOVER)), rtol=1e-8)
        before = u


# Tracking


def test_gains_along_a_curve_solve_the_riccati_equation(spawn: Any, probe: Any) -> None:
    """The vehicle accelerates on a curve: u = ud - K(t) (x - xd), P by (2.7) backwards from P1."""
    Qx, Qu, P1, T, length = [1.0, 2.0, 0.5], [1.0, 3.0], [5.0, 4.0, 3.0], 4.0, 2.0
    bench = Bench(spawn, probe, system='vehicle', setpoint_input=[10.0, 0.0], Qx=Qx, Qu=Qu, P1=P1)
    t = np.linspace(0.0, T, 401)
    v, theta, dtheta = 3.0 + t, 0.5 * np.sin(t), 0.5 * np.cos(t)
    phi = np.arctan(length * dtheta / v)
    x = np.column_stack([0.0 * t, 0.0 * t, theta])
    for i, slope in enumerate((v * np.cos(theta), v * np.sin(theta))):
        x[1:, i] = np.cumsum(0.5 * (slope[1:] + slope[:-1])) * T / 400
    probe.publisher(Trajectory, 'reference', LATCHED).publish(
        reference(t, x, np.column_stack([v, phi]), 10.0))
    bench.process.wait_for_output('a reference of 4 s')

    def gain(time: float, P: Array) -> tuple[Array, Array]:
        speed, heading = 3.0 + time, 0.5 * math.sin(time)
        steer = math.atan(length * 0.5 * math.cos(time) / speed)
        A = np.zeros((3, 3))
        A[:2, 2] = -speed * math.sin(heading), speed * math.cos(heading)
        B = np.array([[math.cos(heading), 0.0], [math.sin(heading), 0.0],
                      [math.tan(steer) / length, speed / (length * math.cos(steer)**2)]])
        return A, np.linalg.solve(np.diag(Qu), B.T @ P)

    def slope_of(time: float, flat: Array) -> Array:
        P = flat.reshape(3, 3)
        A, K = gain(time, P)
        return -(A.T @ P + P @ A - K.T @ np.diag(Qu) @ K + np.diag(Qx)).ravel()

    found = solve_ivp(slope_of, (T, 0.0), np.diag(P1).ravel(), rtol=1e-9, atol=1e-10,
                      dense_output=True).sol
    error, seen = np.array([0.05, -0.04, 0.02]), []
    for k in (0, 50, 137, 250, 333, 390):
        K = gain(t[k], found(t[k]).reshape(3, 3))[1]
        u = bench.answer(x[k] + error, 10.0 + t[k])
        np.testing.assert_allclose(u, [v[k], phi[k]] - K @ error, atol=1e-3 * np.abs(K).max())
        seen.append(K)
    assert np.abs(np.ptp(seen, axis=0)).max() > 0.3 * np.abs(seen).max()  # they vary


# Integral action


def test_integral_action_removes_the_steady_state_error(spawn: Any, probe: Any) -> None:
    """Under a constant force the plain loop keeps an error of push / K1, with K1 = sqrt(4)."""
    push, states = 0.3, {}
    loops = {'plain': {}, 'integral': {'integral': ['x1'], 'Qi': [1.0]}}
    for name in loops:
        states[name] = probe.listen(State, f'/{name}/state', 1_000)
        spawn('plant_simulator', {
            'system': 'double_integrator', 'lockstep': True, 'speed': 10.0, 'x0': [0.0, 0.0],
            'publish_rate': 20.0, 'disturbance.constant.x2': push}, namespace=f'/{name}')
    probe.wait_for(lambda: all(states.values()), what='the first states')
    for name, extra in loops.items():
        spawn('lqr_node', {**DEMO, 'system': 'double_integrator', 'Qx': [4.0, 0.0],
                           'state_timeout': 0.0, 'stamp_timeout': 0.0, **extra},
              namespace=f'/{name}')
    probe.wait_for(lambda: all(seen[-1].header.stamp.sec >= 35 for seen in states.values()), 40.0)
    assert states['plain'][-1].x[0] == pytest.approx(push / 2.0, rel=1e-6)
    assert np.abs(states['integral'][-1].x).max() < 1e-6
    assert max(each.x[0] for each in states['integral']) > 0.03  # the force had an effect


# Suggestions


def test_suggested_weights_meet_all_three_specifications(spawn: Any, probe: Any) -> None:
    """Each row of the table agrees with a dry run of its weights."""
    bench = Bench(spawn, probe, system='double_integrator')
    asked = SuggestWeights.Request(rise_time=1.0, overshoot=0.05, peak_input=[8.0],
                                   x_max=[0.5, 2.0], u_max=[3.0])
    answer = probe.call(SuggestWeights, '/lqr_node/suggest_weights', asked)
    assert answer.success, answer.message
    tried = attempt(probe, qx=list(answer.qx), qu=list(answer.qu)).design
    for design in (answer.design, tried):
        assert design.rise_time[0] <= 1.0
        assert design.overshoot[0] <= 0.05
        assert design.peak_input[0] <= 8.0
    assert (matrix(answer.qx, 2) == np.diag(np.diag(matrix(answer.qx, 2)))).all()
    for k in (0, len(answer.table_scale) // 2, -1):  # Bryson's rule with a scaled input
        row = attempt(probe, qx=[4.0, 0.25], qu=[1 / (3.0 * answer.table_scale[k])**2]).design
        assert row.rise_time[0] == pytest.approx(answer.table_rise_time[k], rel=1e-6)
        assert row.overshoot[0] == pytest.approx(answer.table_overshoot[k], rel=1e-6, abs=1e-9)
        assert row.peak_input[0] == pytest.approx(answer.table_peak_input[k], rel=1e-6)
    asked.peak_input = [1.0]  # |u| <= 1 cannot rise within 1 s
    refused = probe.call(SuggestWeights, '/lqr_node/suggest_weights', asked)
    assert not refused.success
    assert 'together: the minimum ' in refused.message
    assert len(bench.designs) == 1


# Safety


def test_each_choice_of_on_envelope_is_obeyed(spawn: Any, probe: Any) -> None:
    """Inside the envelope the law continues, except after `stop`, which lasts until ~/start."""
    bench = Bench(spawn, probe, x_limits=[1.0] * 6, state_timeout=0.0)
    inside, outside = bench.answer(X), [2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    for choice, commanded in (('equilibrium', HOVER), ('hold', inside), ('silent', None),
                              ('stop', HOVER)):
        assert bench.set(on_envelope=choice).successful
        assert (bench.answer(X) == inside).all()
        if commanded is None:
            seen = len(bench.commands)
            bench.send(outside)
            probe.spin_for(0.2)
            assert len(bench.commands) == seen
        else:
            assert (bench.answer(outside) == commanded).all(), choice
        if choice in ('silent', 'stop'):
            bench.report('commands', lambda status, _: 'error of px is 2' in status.message
                         and status.level == b'\x01')
        assert (bench.answer(X) == (HOVER if choice == 'stop' else inside)).all(), choice
    assert probe.call(Trigger, '/lqr_node/start').success
    assert (bench.answer(X) == inside).all()


# What a change does


def test_margins_agree_with_a_frequency_sweep(spawn: Any, probe: Any) -> None:
    """The loop of each input of the aircraft, the other closed, for two designs."""
    bench = Bench(spawn, probe)
    tried = attempt(probe, qx=EXAMPLE_2_5['Qx'], qu=EXAMPLE_2_5['Qu'])
    assert tried.success
    w = np.geomspace(1e-3, 1e3, 60_001)
    for design in (bench.design(1), tried.design):
        A, B, K = matrix(design.a, 6), matrix(design.b, 6), matrix(design.k, 2)
        T = K @ np.linalg.solve(1j * w[:, None, None] * np.eye(6) - (A - B @ K), B + 0j)
        S = np.eye(2) - T
        assert design.sensitivity_peak == pytest.approx(
            np.linalg.svd(S, compute_uv=False).max(), rel=1e-4)
        for i in range(2):
            L = T[:, i, i] / S[:, i, i]
            crossing = np.flatnonzero(np.diff(np.signbit(np.abs(L) - 1.0)))
            assert design.bandwidth[i] == pytest.approx(w[crossing[-1]], rel=1e-3)
            phase = np.abs(np.angle(-L[crossing])).min()
            assert design.phase_margin[i] == pytest.approx(phase, abs=2e-3)
            disk = 2.0 / np.abs(S[:, i, i] - T[:, i, i]).max()
            assert design.disk_margin[i] == pytest.approx(min(2.0, disk), rel=1e-4)
            least = design.gain_reduction_margin[i]
            for factor, stays in ((0.99 * design.gain_margin[i], True), (1.01 * least, True),
                                  (0.99 * least, False)):
                if factor < 1e-9:  # at a factor of 0 a pole may be on the imaginary axis
                    continue
                changed = K.copy()
                changed[i] *= min(factor, 1e6)
                stable = np.linalg.eigvals(A - B @ changed).real.max() < 0.0
                assert stable == stays
