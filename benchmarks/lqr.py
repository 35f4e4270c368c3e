# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Regulators: time and error for the infinite and the finite horizon.

Compared with control.lqr without slycot (scipy's solve_continuous_are), which does not verify its
result, with the exponential of the Hamiltonian matrix applied step by step, and with --peers with
control.lqr with slycot. The references of the errors are in extended precision.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Callable

import control
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.margins import compute_margins
from obc_ros.core.riccati.fixed_horizon import solve_finite_horizon
from obc_ros.core.systems import registry
from obc_ros.core.systems.equilibrium import find_equilibrium, linearize
from scipy.linalg import expm, solve_continuous_lyapunov

Array = NDArray[np.float64]
Plant = tuple[Array, Array]

HORIZON, SAMPLES = 5.0, 501
WIDE = np.longdouble


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments('linear quadratic regulators')
    aircraft = registry.get_system('aircraft')
    at = find_equilibrium(aircraft)
    pvtol = linearize(aircraft, at.x, at.u)
    stationary('aircraft, n = 6', pvtol, 0.3, args.peers)
    for n in (2, 12, 50):
        stationary(f'random, n = {n}', random_plant(n), None, args.peers)
    stationary('random, n = 100', random_plant(100), 0.35, args.peers)
    horizon(pvtol)
    margins(pvtol)
    return timing.finish()


def random_plant(n: int) -> Plant:
    """Return a random plant with n states and half as many inputs."""
    rng = np.random.default_rng(0)
    return rng.standard_normal((n, n)) / np.sqrt(n) - np.eye(n) / 2, rng.standard_normal(
        (n, max(n // 2, 1)))


def stationary(title: str, plant: Plant, limit: float | None, peers: bool) -> None:
    """Time a verified design, and compare P with Newton's method in extended precision."""
    A, B = plant
    Q, R = np.eye(len(A)), np.eye(B.shape[1])
    rivals: dict[str, Callable[[], object]] = {
        'lqr': lambda: lqr(A, B, Q, R),
        'control.lqr (scipy)': lambda: control.lqr(A, B, Q, R, method='scipy')}
    if peers and timing.peer('slycot'):
        rivals['control.lqr (slycot)'] = lambda: control.lqr(A, B, Q, R, method='slycot')
    times = timing.measure(rivals)
    timing.times_table(f'Gain for {title}', times, 'control.lqr (scipy)')
    exact = refined(A, B, lqr(A, B, Q, R).P)
    error = distance(lqr(A, B, Q, R).P, exact)
    theirs = distance(control.lqr(A, B, Q, R, method='scipy')[1], exact)
    print(f'  relative error of P: lqr {error:.1e}, control.lqr (scipy) {theirs:.1e}')
    timing.require(f'{title}: error of P', error, 1e-12)
    if limit is not None:
        ratio = times['lqr'].ratio(times['control.lqr (scipy)'])
        timing.require(f'{title}: time against control.lqr', ratio, limit)


def refined(A: Array, B: Array, P: Array) -> NDArray[np.longdouble]:
    """Return the solution by Newton's method with residuals in extended precision."""
    exact, a = P.astype(WIDE), A.astype(WIDE)
    G = B.astype(WIDE) @ B.T.astype(WIDE)
    for _ in range(4):
        R = exact @ a + a.T @ exact - exact @ G @ exact + np.eye(len(A), dtype=WIDE)
        M = (a - G @ exact).astype(float)
        exact = exact + solve_continuous_lyapunov(M.T, -R.astype(float))
    return exact


def horizon(plant: Plant) -> None:
    """Time P and K on the samples of a horizon."""
    A, B = plant
    Q, R, P1 = np.eye(6), np.eye(2), 10 * np.eye(6)
    t = np.linspace(0.0, HORIZON, SAMPLES)
    times = timing.measure({
        'finite_horizon': lambda: solve_finite_horizon(A, B, Q, R, P1, t, HORIZON),
        'Hamiltonian exponential, stepped': lambda: stepped(A, B, Q, P1)})
    timing.times_table(f'P and K of the aircraft on {SAMPLES} points of {HORIZON:g} s', times,
                       'Hamiltonian exponential, stepped')
    exact = exact_horizon(A, B, Q, P1)
    ours, _ = solve_finite_horizon(A, B, Q, R, P1, t, HORIZON)
    error = max(distance(P, wide) for P, wide in zip(ours, exact, strict=True))
    theirs = max(distance(P, wide) for P, wide in zip(stepped(A, B, Q, P1)[0], exact, strict=True))
    print(f'  largest relative error of P: finite_horizon {error:.1e}, stepped {theirs:.1e}')
    timing.require('finite horizon: error of P', error, 1e-12)
    timing.require('finite horizon: time against stepping',
                   times['finite_horizon'].ratio(times['Hamiltonian exponential, stepped']), 0.3)


def hamiltonian(A: Array, B: Array, Q: Array) -> Array:
    """Return the Hamiltonian matrix for Qu = I."""
    return np.block([[A, -B @ B.T], [-Q, -A.T]])


def stepped(A: Array, B: Array, Q: Array, P1: Array) -> tuple[Array, Array]:
    """Return P and K from steps of the exponential, backwards in time."""
    n = len(A)
    step = expm(-hamiltonian(A, B, Q) * HORIZON / (SAMPLES - 1))
    P, K = np.empty((SAMPLES, n, n)), np.empty((SAMPLES, B.shape[1], n))
    P[-1], K[-1] = P1, B.T @ P1
    for k in range(SAMPLES - 2, -1, -1):
        X = step[:, :n] + step[:, n:] @ P[k + 1]
        found = np.linalg.solve(X[:n].T, X[n:].T)
        P[k] = 0.5 * (found + found.T)
        K[k] = B.T @ P[k]
    return P, K


def exact_horizon(A: Array, B: Array, Q: Array, P1: Array) -> NDArray[np.longdouble]:
    """Return P as `stepped` does, in extended precision."""
    n = len(A)
    M = -hamiltonian(A, B, Q).astype(WIDE) * (WIDE(HORIZON) / (SAMPLES - 1))
    step = term = np.eye(2 * n, dtype=WIDE)
    for k in range(1, 40):
        term = term @ M / k
        step = step + term
    P = np.empty((SAMPLES, n, n), dtype=WIDE)
    P[-1] = P1
    for k in range(SAMPLES - 2, -1, -1):
        X = step[:, :n] + step[:, n:] @ P[k + 1]
        found = eliminated(X[:n].T, X[n:].T)
        P[k] = (found + found.T) / 2
    return P


def eliminated(M: NDArray[np.longdouble], right: NDArray[np.longdouble]
               ) -> NDArray[np.longdouble]:
    """Return M^-1 in the precision of M, which LAPACK does not support."""
    n, rows = len(M), np.concatenate([M, right], axis=1)
    for k in range(n):
        pivot = k + int(np.abs(rows[k:, k]).argmax())
        rows[[k, pivot]] = rows[[pivot, k]]
        rows[k] = rows[k] / rows[k, k]
        others = np.arange(n) != k
        rows[others] -= rows[others, k:k + 1] * rows[k]
    return rows[:, n:]


def distance(P: Array, exact: NDArray[np.longdouble]) -> float:
    """Return the largest difference relative to the largest entry."""
    return float(np.abs(P - exact).max() / np.abs(exact).max())


def margins(plant: Plant) -> None:
    """Time poles, margins and step figures."""
    A, B = plant
    design = lqr(A, B, np.eye(6), np.eye(2))
    times = timing.measure({'figures': lambda: compute_margins(A, B, design.K)})
    timing.times_table('Poles, margins and steps of the aircraft', times, 'figures')
    timing.require('figures [ms]', times['figures'].median * 1e3, 10.0)


if __name__ == '__main__':
    sys.exit(main())
