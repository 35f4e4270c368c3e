# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated sensors: rates, delay, drop-outs, noise and bias."""

import numpy as np
from obc_ros.core.simulation.sensors import OutputConditions, Sensors
from obc_ros.core.systems.registry import get_system
from obc_ros.core.text.errors import StatementError
import pytest

AIRCRAFT = get_system('aircraft')
X, U = np.array([1.0, 2.0, 0.1, 0.0, 0.0, 0.5]), np.array([0.0, 39.2])


def collect(outputs, count=1000, seed=0):
    sensors = Sensors(AIRCRAFT, outputs, 200.0, seed)
    return [(k, each) for k in range(count) for each in sensors.take(k, k * 5_000_000, X, U)]


def test_outputs_of_a_rate_come_together_at_that_rate_after_their_delay():
    gps, gyro = OutputConditions(10.0, delay=0.05), OutputConditions(100.0)
    found = collect({'gps_x': gps, 'gps_y': gps, 'gyro': gyro}, 400)
    slow = [(k, each) for k, each in found if each.names == ('gps_x', 'gps_y')]
    assert [k for k, _ in slow] == list(range(10, 400, 20))
    assert [each.stamp for _, each in slow] == [(k - 10) * 5_000_000 for k, _ in slow]
    assert all(each.y.tolist() == [1.0, 2.0] for _, each in slow)
    assert [k for k, each in found if each.names == ('gyro',)] == list(range(0, 400, 2))


def test_noise_bias_and_dropouts_have_their_size():
    found = collect({'gps_x': OutputConditions(200.0, noise=0.5, bias=3.0, dropout=0.25)}, 8000)
    values = np.array([each.y[0] for _, each in found])
    assert len(values) == pytest.approx(6000, abs=5 * np.sqrt(8000 * 0.25 * 0.75))
    assert values.mean() == pytest.approx(4.0, abs=5 * 0.5 / np.sqrt(6000))
    assert values.std() == pytest.approx(0.5, rel=0.05)


def test_a_seed_repeats_and_a_dropout_changes_no_noise():
    noisy = {'gps_x': OutputConditions(200.0, noise=1.0)}
    lossy = {'gps_x': OutputConditions(200.0, noise=1.0, dropout=0.5)}
    values = {k: each.y[0] for k, each in collect(noisy)}
    assert values == {k: each.y[0] for k, each in collect(noisy)}
    assert all(values[k] == each.y[0] for k, each in collect(lossy))
    assert values != {k: each.y[0] for k, each in collect(noisy, seed=1)}


def test_a_state_is_measured_once_and_a_reset_begins_anew():
    sensors = Sensors(AIRCRAFT, {'gyro': OutputConditions(200.0, noise=1.0)}, 200.0)
    first = sensors.take(0, 0, X, U)[0].y
    assert sensors.take(0, 0, X, U) == []
    sensors.reset()
    assert sensors.take(0, 0, X, U)[0].y == first


@pytest.mark.parametrize('rate', [30.0, 400.0, 199.0])
def test_a_rate_must_divide_that_of_the_states(rate):
    with pytest.raises(StatementError, match=r'measurement.gyro.rate'):
        Sensors(AIRCRAFT, {'gyro': OutputConditions(rate)}, 200.0)


def test_nothing_is_measured_without_a_rate():
    assert collect({}) == [] and len(Sensors(AIRCRAFT, {}, 200.0)) == 0
