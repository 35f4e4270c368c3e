# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One prediction and one update of the filter."""

import math

import numpy as np
from obc_ros.core.estimation.filter import Belief, KalmanFilter
from obc_ros.core.estimation.kalman_gain import discretize_noise, dlqe
from obc_ros.core.systems.file import build_system
from obc_ros.core.systems.registry import get_system
from obc_ros.core.text.errors import DynamicsError, ObcError
import pytest
from scipy.integrate import solve_ivp


def test_prediction_of_a_linear_system_is_exact():
    system = get_system('double_integrator')
    Qw, P = np.diag([0.1, 2.0]), np.array([[1.0, 0.3], [0.3, 0.5]])
    kalman = KalmanFilter(system, Qw, np.eye(2))
    found = kalman.predict(Belief(np.array([1.0, 2.0]), P), np.array([3.0]), 1.7)
    Ad, Qd = discretize_noise(np.array([[0.0, 1.0], [0.0, 0.0]]), Qw, 1.7)
    assert found.x == pytest.approx([1 + 2 * 1.7 + 1.5 * 1.7**2, 2 + 3 * 1.7], rel=1e-12)
    assert pytest.approx(Ad @ P @ Ad.T + Qd, rel=1e-10) == found.P


def test_prediction_of_the_aircraft_follows_its_equations():
    system = get_system('aircraft')
    Qw, u = np.diag([0, 0, 0, 0.1, 0.1, 0.2]), np.array([1.0, 35.0])
    x = np.array([0, 1, 0.3, 2, -1, 0.4])
    found = KalmanFilter(system, Qw, np.eye(4)).predict(Belief(x, 0.01 * np.eye(6)), u, 0.3)

    def rate(_, z):
        A, P = system.jacobians(z[:6], u)[0], z[6:].reshape(6, 6)
        return np.concatenate([system.f(z[:6], u), (A @ P + P @ A.T + Qw).ravel()])

    exact = solve_ivp(rate, (0, 0.3), np.concatenate([x, 0.01 * np.eye(6).ravel()]),
                      rtol=1e-10, atol=1e-12).y[:, -1]
    assert found.x == pytest.approx(exact[:6], abs=2e-3)
    assert pytest.approx(exact[6:].reshape(6, 6), abs=2e-3) == found.P


def test_repeated_updates_reach_the_steady_gain():
    system = get_system('double_integrator')
    Qw, Rv, T = np.diag([0.0, 1.0]), np.diag([0.04, 0.01]), 0.1
    kalman, belief = KalmanFilter(system, Qw, Rv), Belief(np.zeros(2), 10 * np.eye(2))
    for _ in range(200):
        belief = kalman.update(belief, np.zeros(1), [0, 1], np.zeros(2)).belief
        belief = kalman.predict(belief, np.zeros(1), T)
    Ad, Qd = discretize_noise(np.array([[0.0, 1.0], [0.0, 0.0]]), Qw, T)
    assert pytest.approx(dlqe(Ad, np.eye(2), Qd, Rv, period=T).P, rel=1e-8) == belief.P


def test_angles_are_wrapped_and_outliers_leave_the_estimate():
    system = get_system('vehicle')
    kalman = KalmanFilter(system, np.eye(3), 0.01 * np.eye(3), gate=0.99)
    belief = Belief(np.array([0.0, 0.0, math.pi - 0.01]), 0.1 * np.eye(3))
    near = kalman.update(belief, np.array([1.0, 0.0]), [2], np.array([-math.pi + 0.01]))
    assert near.innovation == pytest.approx([0.02])
    far = kalman.update(belief, np.array([1.0, 0.0]), [0, 1], np.array([9.0, 0.0]))
    assert far.is_outlier and far.belief is belief
    assert far.nis == pytest.approx(81 / 0.11)


def test_covariance_stays_semidefinite_with_exact_measurements():
    system = get_system('double_integrator')
    kalman = KalmanFilter(system, np.zeros((2, 2)), 1e-14 * np.eye(2))
    belief = Belief(np.zeros(2), 1e6 * np.eye(2))
    for _ in range(50):
        belief = kalman.update(belief, np.zeros(1), [0], np.zeros(1)).belief
        belief = kalman.predict(belief, np.zeros(1), 0.01)
        assert np.linalg.eigvalsh(belief.P)[0] >= -1e-12 * np.linalg.eigvalsh(belief.P)[-1]


@pytest.mark.parametrize('given', [
    {'Qw': -np.eye(2)}, {'Rv': np.zeros((2, 2))}, {'Qw': np.eye(3)}, {'gate': 0.0},
    {'gate': 1.5}, {'gate': math.nan}])
def test_bad_arguments_are_refused(given):
    with pytest.raises(ObcError):
        KalmanFilter(get_system('double_integrator'), **{
            'Qw': np.eye(2), 'Rv': np.eye(2), **given})


def test_an_estimate_beyond_numbers_is_an_error():
    system = build_system({'states': ['q'], 'inputs': ['u'], 'dynamics': {'q': 'exp(q) + u'}})
    with pytest.raises(DynamicsError, match='cannot be predicted'):
        KalmanFilter(system, np.eye(1), np.eye(1)).predict(
            Belief(np.array([5.0]), np.eye(1)), np.zeros(1), 10.0)
