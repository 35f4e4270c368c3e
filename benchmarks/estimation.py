# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The estimator: gains against python-control, consistency of 500 runs, error of the closed loop.

The loop is that of `config/sensors/aircraft.yaml`, in simulated time and without ROS: gps at
10 Hz, attitude and gyro at 100 Hz, 50 ms late, 5 % lost, the sampled regulator at 100 Hz. Process
noise has the covariance that white noise of the intensity QW gives in a period.
"""

import sys

import timing  # isort: skip - before numpy

import math

import control
import numpy as np
from obc_ros.core.estimation.delayed_filter import DelayedFilter
from obc_ros.core.estimation.filter import Belief, compute_band, KalmanFilter
from obc_ros.core.estimation.kalman_gain import discretize_noise, dlqe, lqe
from obc_ros.core.lqr.sampled import sampled_lqr
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.simulation.sensors import OutputConditions, Sensors
from obc_ros.core.systems.equilibrium import find_equilibrium
from obc_ros.core.systems.registry import get_system
from obc_ros.core.systems.system import System

SYSTEMS, RUNS = 200, 500
LARGEST = 1e-9       # relative difference of the gains
RATE = 100.0         # [Hz] of states and commands
GPS = OutputConditions(10.0, 0.1, 0.0, 0.05, 0.05)
IMU = OutputConditions(100.0, 0.01, 0.0, 0.05, 0.05)
OUTPUTS = {'gps_x': GPS, 'gps_y': GPS, 'attitude': IMU, 'gyro': IMU}
QW = np.diag([0.0, 0.0, 0.0, 0.1, 0.1, 0.5])
RV = np.diag([0.01, 0.01, 1e-4, 1e-4])
P0 = 0.05 * np.eye(6)


def compare_gains() -> float:
    """Return the largest relative difference to `lqe` and `dlqe` of python-control."""
    rng, worst = np.random.default_rng(1), 0.0
    for _ in range(SYSTEMS):
        n = int(rng.integers(1, 9))
        q = int(rng.integers(max(1, n // 2), n + 1))
        A, C = rng.standard_normal((n, n)) / math.sqrt(n), rng.standard_normal((q, n))
        G, H = rng.standard_normal((n, n)), rng.standard_normal((q, q))
        Qw, Rv = G @ G.T, H @ H.T + 0.1 * np.eye(q)
        for ours, theirs in ((lqe, control.lqe), (dlqe, control.dlqe)):
            L = theirs(A, np.eye(n), C, Qw, Rv)[0]
            found = ours(A, C, Qw, Rv).L
            worst = max(worst, float(np.abs(found - L).max() / max(1.0, np.abs(L).max())))
    return worst


def measure_linear_consistency() -> float:
    """Return the mean NEES of `RUNS` runs of a double integrator after 2 s."""
    system, T, rng = get_system('double_integrator'), 0.1, np.random.default_rng(3)
    Qw, Rv, u = np.diag([0.02, 0.5]), np.diag([0.04, 0.09]), np.array([0.3])
    kalman, start = KalmanFilter(system, Qw, Rv), np.diag([1.0, 2.0])
    Ad, Qd = discretize_noise(np.array([[0.0, 1.0], [0.0, 0.0]]), Qw, T)
    total = 0.0
    for _ in range(RUNS):
        x, belief = rng.multivariate_normal(np.zeros(2), start), Belief(np.zeros(2), start)
        for _ in range(20):
            x = Ad @ x + u * np.array([T * T / 2, T]) + rng.multivariate_normal(np.zeros(2), Qd)
            y = x + rng.multivariate_normal(np.zeros(2), Rv)
            belief = kalman.update(kalman.predict(belief, u, T), u, [0, 1], y).belief
        e = belief.x - x
        total += float(e @ np.linalg.solve(belief.P, e))
    return total / RUNS


def fly(seed: int, seconds: float, estimates: bool) -> tuple[Array, Array, float, float]:
    """Return the true states (N, 6), errors of the estimate, the last NEES and the mean NIS."""
    system, rng, period = get_system('aircraft'), np.random.default_rng((seed, 7)), 1.0 / RATE
    held = find_equilibrium(system, None)
    A, B = system.jacobians(held.x, held.u)
    K = sampled_lqr(A, B, Weights(np.eye(6), np.eye(2)), period).K
    x, u = rng.multivariate_normal(np.zeros(6), P0), np.array(held.u)
    sensors = Sensors(system, OUTPUTS, RATE, seed)
    delayed = DelayedFilter(KalmanFilter(system, QW, RV), np.array(held.x), P0, u)
    states, errors = [], []
    mean, nees = np.array(held.x), math.nan
    for k in range(round(seconds * RATE)):
        stamp = round(k * period * 1e9)
        for reading in sensors.take(k, stamp, x, u):
            delayed.measure(reading.stamp, reading.names, reading.y)
        if delayed.newest is not None:
            found = delayed.estimate(stamp)
            mean, e = found.x, found.x - x
            nees = float(e @ np.linalg.solve(found.P, e))
        states.append(x)
        errors.append(mean - x)
        u = held.u - K @ ((mean if estimates else x) - held.x)
        delayed.command(stamp, u)
        noise = discretize_noise(system.jacobians(x, u)[0], QW, period)[1]
        x = step(system, x, u, period) + rng.multivariate_normal(np.zeros(6), noise)
    return np.array(states), np.array(errors), nees, delayed.consistency.ratio


def step(system: System, x: Array, u: Array, h: float) -> Array:
    """Return the state after a step of Runge and Kutta."""
    k1 = system.f(x, u)
    k2 = system.f(x + h / 2 * k1, u)
    k3 = system.f(x + h / 2 * k2, u)
    k4 = system.f(x + h * k3, u)
    after: Array = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return after


def main() -> int:
    """Print the figures; return the exit status."""
    timing.arguments('the estimator: gains, consistency, closed loop')
    timing.require(f'gains of {SYSTEMS} systems against lqe and dlqe', compare_gains(), LARGEST)
    aircraft = float(np.mean([fly(seed, 0.8, True)[2] for seed in range(RUNS)]))
    for name, mean, degrees in (('double integrator', measure_linear_consistency(), 2),
                                ('aircraft', aircraft, 6)):
        low, high = compute_band(degrees, RUNS)
        print(f'NEES of {RUNS} runs, {name}: {mean:.3f}, 95 % band {low:.3f} to {high:.3f}')
        timing.require(f'distance of the NEES from {degrees}, {name}', abs(mean - degrees),
                       high - degrees if mean > degrees else degrees - low)
    rows = []
    for name, estimates in (('whole state', False), ('estimator', True)):
        states, errors = fly(1, 60.0, estimates)[:2]
        rows.append((name, *measure_rms(states)))
        if estimates:
            rows.append(('error of the estimate', *measure_rms(errors)))
    timing.table('rms from 2 s to 60 s', ('loop', 'px [m]', 'py [m]', 'theta [rad]'), rows)
    return timing.finish()


def measure_rms(values: Array) -> list[str]:
    """Return the root mean squares of px, py and theta after 2 s, in words."""
    return [f'{value:.3f}' for value in np.sqrt((values[200:, :3]**2).mean(axis=0))]


if __name__ == '__main__':
    sys.exit(main())
