# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Predicted states: closed forms of sampled loops, and the plant simulator's own motion."""

import math

import numpy as np
from obc_ros.core.closed_loop.state_prediction import make_model, MOST_COMMANDS, predict_state
from obc_ros.core.systems.registry import get_registered
from obc_ros.core.text.errors import DynamicsError, StatementError
import pytest
from scipy.linalg import expm

MS = 10**6   # [ns]
INTEGRATOR = get_registered('double_integrator')
A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
K = np.array([[2.0, 3.0]])


def sampled(h):
    """Return Phi and Gamma of the double integrator over h [s]."""
    whole = expm(np.block([[A, B], [np.zeros((1, 3))]]) * h)
    return whole[:2, :2], whole[:2, 2:]


def test_a_sampled_loop_is_its_powers():
    """x(k+1) = (Phi - Gamma K) x(k); within the last period the command is held."""
    x, h = np.array([1.0, -0.5]), 0.1
    Phi, Gamma = sampled(h)
    here = np.linalg.matrix_power(Phi - Gamma @ K, 7) @ x
    Phi, Gamma = sampled(0.04)
    u = -K @ here
    found = predict_state(make_model(INTEGRATOR), x, [(5_000 * MS, -K @ x)], 5_740 * MS,
                          lambda _, x: -K @ x, 100 * MS)
    assert found.x == pytest.approx(Phi @ here + Gamma @ u, abs=1e-8)
    assert found.u == pytest.approx(u, abs=1e-8)


def test_commands_act_after_the_delay():
    """Those that are on their way act first: 0.25 s of delay, a period of 0.1 s."""
    x, Phi, Gamma = np.array([0.3, 0.2]), *sampled(0.05)
    sent = [(-300 * MS, [5.0]), (-200 * MS, [-4.0]), (-100 * MS, [3.0]), (0, -K @ x)]
    acting = [u for _, u in sent]   # from -0.05, 0.05, 0.15, 0.25 s on
    expected = x
    for k in range(6):
        expected = Phi @ expected + Gamma @ np.ravel(acting[(k + 1) // 2])
    found = predict_state(make_model(INTEGRATOR), x, sent, 300 * MS, lambda _, x: -K @ x,
                          100 * MS, 250 * MS)
    assert found.x == pytest.approx(expected, abs=1e-8)
    assert found.u == pytest.approx(-K @ x)


def test_the_law_gets_each_stamp_once_and_in_order():
    calls = []

    def law(stamp, x):
        calls.append(stamp)
        return [0.0]

    predict_state(make_model(INTEGRATOR), [0.0, 1.0], [(7, [0.0])], 7 + 35 * MS, law, 10 * MS)
    assert calls == [7 + 10 * MS, 7 + 20 * MS, 7 + 30 * MS]


def test_the_stamp_of_the_last_state_gives_that_state():
    found = predict_state(make_model(INTEGRATOR), [0.5, 1.0], [(9, [0.7])], 9, lambda *_: [], MS)
    assert found == ([0.5, 1.0], [0.7])


def test_a_nonlinear_plant_moves_on_its_circle():
    """The car with a constant steering angle drives a circle of radius l / tan(phi)."""
    car = get_registered('vehicle')
    length = dict(zip((each.name for each in car.parameters), car.p_value, strict=True))['l']
    radius, turned = length / math.tan(0.3), 1.5 * math.tan(0.3) / length * 4.0
    found = predict_state(make_model(car), [0.0, 0.0, 0.0], [(0, [1.5, 0.3])], 4_000 * MS,
                          lambda *_: [1.5, 0.3], 20 * MS)
    assert found.x == pytest.approx([radius * math.sin(turned), radius * (1 - math.cos(turned)),
                                     turned], abs=1e-6)


def test_what_cannot_be_predicted_is_said_in_words():
    cubic = get_registered('cubic')
    with pytest.raises(StatementError, match='after the last state'):
        predict_state(make_model(INTEGRATOR), [0.0, 0.0], [(0, [0.0])],
                      (MOST_COMMANDS + 1) * MS, lambda *_: [0.0], MS)
    with pytest.raises(DynamicsError, match='diverges'):
        predict_state(make_model(cubic), [10.0], [(0, [0.0])], 60_000 * MS,
                      lambda _, x: [1e3 * x[0]**3], 10 * MS)
