# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The vehicle of Exercise 2.10: the feedforward substituted into its equations."""

import math

import numpy as np
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.margins import compute_margins
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.systems import courses
from obc_ros.core.text.errors import StatementError
from plants import vehicle
import pytest
from scipy.integrate import solve_ivp

LENGTH, SPEED = 2.0, 10.0
COST = Weights(np.diag([1.0, 0.0]), np.eye(1))


def lateral(x, phi, v=SPEED):
    return [v * math.sin(x[1]), v / LENGTH * math.tan(phi)]


def test_the_slalom_feedforward_tracks_the_slalom_exactly():
    """Integrate the nonlinear vehicle under the feedforward alone (1 m, 1 Hz)."""
    def reference(t):
        return courses.build_lateral_reference(*courses.make_slalom(np.atleast_1d(t)), SPEED,
                                               LENGTH)

    def rate(t, x):
        return lateral(x, reference(t)[1][0, 0])

    t = np.linspace(0, 4, 81)
    x, u = reference(t)
    driven = solve_ivp(rate, (0, 4), x[0], t_eval=t, rtol=1e-10, atol=1e-12, max_step=0.05).y.T
    assert driven == pytest.approx(x, abs=1e-7)
    assert abs(x[:, 0]).max() == pytest.approx(1.0, abs=1e-2)
    # At the turning points theta = 0 and y'' = (2 pi)^2, so phi = atan(l (2 pi)^2 / v^2).
    assert abs(u[t > 1]).max() == pytest.approx(math.atan(2 * (2 * math.pi)**2 / 100), rel=1e-3)


def test_derivatives_of_the_slalom_match_differences():
    t, h = np.linspace(0.0, 3.0, 301), 1e-4
    y, dy, ddy = courses.make_slalom(t, 0.7, 1.3, 0.8)
    later, earlier = courses.make_slalom(t + h, 0.7, 1.3, 0.8), courses.make_slalom(t - h, 0.7,
                                                                                    1.3, 0.8)
    assert (later[0] - earlier[0]) / (2 * h) == pytest.approx(dy, abs=1e-5)
    assert (later[1] - earlier[1]) / (2 * h) == pytest.approx(ddy, abs=1e-4)
    assert y[0] == dy[0] == ddy[0] == 0.0


def test_the_slalom_fades_out_as_it_fades_in():
    """Derivatives match differences; after its end the slalom is at rest."""
    t, h = np.linspace(-0.5, 6.5, 701), 1e-4
    y, dy, ddy = courses.make_slalom(t, end=6.0)
    later, earlier = courses.make_slalom(t + h, end=6.0), courses.make_slalom(t - h, end=6.0)
    assert (later[0] - earlier[0]) / (2 * h) == pytest.approx(dy, abs=1e-5)
    assert (later[1] - earlier[1]) / (2 * h) == pytest.approx(ddy, abs=1e-4)
    assert y == pytest.approx(-y[::-1], abs=1e-12)
    assert not y[t >= 6.0].any()
    assert not dy[t >= 6.0].any()
    assert not ddy[t >= 6.0].any()
    assert y[(t > 1) & (t < 5)].max() == pytest.approx(1.0, abs=1e-3)


def test_feedback_brings_a_vehicle_with_an_offset_onto_the_slalom():
    K = lqr(*vehicle(SPEED, LENGTH), COST.Qx, COST.Qu).K

    def rate(t, x):
        xd, ud = courses.build_lateral_reference(*courses.make_slalom(np.atleast_1d(t)), SPEED,
                                                 LENGTH)
        return lateral(x, ud[0, 0] - float((K @ (x - xd[0]))[0]))

    end = solve_ivp(rate, (0, 6), [0.3, 0.1], rtol=1e-8, max_step=0.05).y[:, -1]
    xd, _ = courses.build_lateral_reference(*courses.make_slalom(np.array([6.0])), SPEED, LENGTH)
    assert end == pytest.approx(xd[0], abs=1e-4)


@pytest.mark.parametrize('q', [0.01, 1.0])
def test_exercise_2_10_has_its_frequency_damping_and_rise_time(q):
    """Py'' = (v^2 / l) phi as in Example 2.4: omega0^2 = (v^2 / l) sqrt(q), zeta = 1 / sqrt(2)."""
    A, B = vehicle(SPEED, LENGTH)
    K = lqr(A, B, np.diag([q, 0.0]), [[1.0]]).K
    w0 = math.sqrt(SPEED**2 / LENGTH * math.sqrt(q))
    assert pytest.approx(np.array([[math.sqrt(q), math.sqrt(2) * w0 * LENGTH / SPEED]])) == K
    found = compute_margins(A, B, K)
    unit = math.sqrt(1 + math.sqrt(2))
    assert found.overshoot[0] == pytest.approx(math.exp(-math.pi), rel=1e-3)
    assert found.bandwidth[0] == pytest.approx(unit * w0, rel=1e-9)
    assert found.phase_margin[0] == pytest.approx(math.atan(math.sqrt(2) * unit), rel=1e-9)
    # From 10 to 90 % a second-order step with zeta = sqrt(1/2) takes 2.148 / omega0.
    assert found.rise_time[0] == pytest.approx(2.1457 / w0, rel=2e-3)


def test_slaloms_faster_than_the_vehicle_are_rejected():
    with pytest.raises(StatementError, match='requires a lateral speed of 12'):
        courses.build_lateral_reference(np.zeros(2), np.array([0, 12.0]), np.zeros(2), 10.0,
                                        LENGTH)
