# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""References for loops, filters and receding horizons, computed without library and nodes."""

from collections.abc import Callable
from itertools import product
from math import exp, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from obc_ros.core.numerics.arrays import Array, Complex
from scipy.integrate import ode
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import linear_sum_assignment

RateFunction = Callable[[Array, Array], Any]
Law = Callable[[float, Array], Array]
ROUNDING_ERROR = 1e-9   # violations of a condition up to this are rounding errors


def run_sampled_loop(A: Array, B: Array, K: Array, x0: ArrayLike, step: float, count: int
                     ) -> tuple[Array, Array]:
    """Return x (N + 1, n) and u of x' = A x + B u with u = -K x(t_k), held for a step [s]."""
    n, m = np.shape(B)
    whole = expm(step * np.block([[A, B], [np.zeros((m, n + m))]]))
    one = whole[:n, :n] - whole[:n, n:] @ K
    x = [np.asarray(x0, dtype=float)]
    for _ in range(count):
        x.append(one @ x[-1])
    states = np.array(x)
    return states, -states @ np.asarray(K).T


def simulate_loop(rate: RateFunction, law: Law, x0: ArrayLike, step: float, count: int
                  ) -> tuple[Array, Array]:
    """
    Return states and inputs of x' = rate(x, u) with u = law(t_k, x(t_k)), held for a step [s].

    They are at t_0 .. t_N, integrated by the method of Dormand and Prince of order 8 at a relative
    tolerance of 1e-12.
    """
    solver = ode(lambda _, y, u: rate(y, u)).set_integrator('dop853', rtol=1e-12, atol=1e-14)
    solver.set_initial_value(np.asarray(x0, dtype=float))
    x, u = [solver.y], [law(0.0, solver.y)]
    for k in range(1, count + 1):
        x.append(solver.set_f_params(u[-1]).integrate(k * step))
        u.append(law(k * step, x[-1]))
    return np.array(x), np.array(u)


def compute_free_motion(A: Array, x0: ArrayLike, t: Array) -> Array:
    """Return x(t) (N, n) of x' = A x, for A with n independent eigenvectors."""
    E, V = np.linalg.eig(A)
    modes = np.linalg.solve(V, np.asarray(x0, dtype=complex))
    return np.real((V * modes) @ np.exp(np.outer(E, t))).T


def match_poles(poles: Complex, wanted: Complex) -> Complex:
    """Return poles in the order of their references: the sum of the distances is minimal."""
    _, order = linear_sum_assignment(np.abs(np.subtract.outer(wanted, poles)))
    paired: Complex = poles[order]
    return paired


def solve_scalar_filter(a: float, q: float, r: float) -> tuple[float, float, float]:
    """
    Return p, gain L and pole s of the filter of x' = a x + w, y = x + v with intensities q and r.

    p is the positive root of 2 a p - p^2/r + q = 0, L = p/r, and s = a - L.
    """
    root = sqrt(a * a + q / r)
    return r * (a + root), a + root, -root


def solve_sampled_scalar_filter(a: float, q: float, R: float, h: float) -> tuple[float, float]:
    """
    Return the variance before and after each measurement of x' = a x + w.

    Before is the positive root of p^2 + (R - alpha^2 R - Q) p - Q R = 0 with alpha = exp(a h) and
    Q = q (alpha^2 - 1)/(2 a); after = p R/(p + R).

    :param a, q: the plant, a not 0, and the intensity of w.
    :param R, h: variance of a measurement, and the time between two of them [s].
    """
    square = exp(2.0 * a * h)   # of alpha
    Q = q * (square - 1.0) / (2.0 * a)
    half = 0.5 * (R - square * R - Q)
    before = -half + sqrt(half * half + Q * R)
    return before, before * R / (before + R)


def solve_tracking_filter(index: float) -> tuple[float, float]:
    """
    Return alpha and beta of the steady alpha-beta filter (Kalata 1984), of gain (alpha, beta/h).

    :param index: tracking index sigma_w h^2/sigma_v: the acceleration is random with the standard
        deviation sigma_w and constant in each period h; positions are measured with the standard
        deviation sigma_v.
    """
    root = 0.25 * (4.0 + index - sqrt(8.0 * index + index * index))
    alpha = 1.0 - root * root
    return alpha, 2.0 * (2.0 - alpha) - 4.0 * root


def sample_noise(A: Array, Qw: Array, h: float) -> tuple[Array, Array]:
    """Return Ad = exp(A h) and the covariance Qd of the noise of a period, as Van Loan does."""
    n = len(A)
    block = expm(h * np.block([[-A, Qw], [np.zeros((n, n)), A.T]]))
    Ad = block[n:, n:].T
    return Ad, Ad @ block[:n, n:]


def run_filter(A: Array, C: Array, Qw: Array, Rv: Array, t: Array, y: Array, x: Array, P: Array
               ) -> tuple[Array, Array]:
    """
    Return the estimates of the Kalman filter of x' = A x + w after each measurement.

    They are in information form: each measurement adds C'Rv^-1 C to P^-1.

    :param t, y: (N,) and (N, q), times [s] and measurements.
    :param x, P: (n,) and (n, n), estimate and covariance after the first measurement.
    """
    states, covariances = [x], [P]
    weight = C.T @ np.linalg.inv(Rv)
    for h, measured in zip(np.diff(t), y[1:], strict=True):
        Ad, Qd = sample_noise(A, Qw, float(h))
        before = Ad @ covariances[-1] @ Ad.T + Qd
        P = np.asarray(np.linalg.inv(np.linalg.inv(before) + weight @ C), dtype=float)
        ahead = Ad @ states[-1]
        states.append(ahead + P @ weight @ (measured - C @ ahead))
        covariances.append(P)
    return np.array(states), np.array(covariances)


def solve_sampled_scalar(a: float, b: float, q: float, r: float, h: float
                         ) -> tuple[float, float, float, float]:
    """
    Return the sampled plant and regulator of x' = a x + b u with the cost q x^2 + r u^2.

    The cost of a period h is integrated in closed form. P is the positive root of a quadratic
    equation.

    :return: alpha, beta, P, K: the plant is x+ = alpha x + beta u, the cost-to-go is P x^2, and
        the regulator is u = -K x.
    """
    one, two = (exp(a * h) - 1.0) / a, (exp(2.0 * a * h) - 1.0) / (2.0 * a)
    alpha, beta, c = exp(a * h), b * one, b / a
    Q, S = q * two, q * c * (two - one)
    R = r * h + q * c**2 * (two - 2.0 * one + h)
    half = 0.5 * (R * (1.0 - alpha**2) - Q * beta**2 + 2.0 * alpha * beta * S)
    P = (-half + sqrt(half**2 + beta**2 * (Q * R - S**2))) / beta**2
    return alpha, beta, P, (alpha * beta * P + S) / (R + beta**2 * P)


class EnumeratedPlan:
    """
    The optimal plan of a linear plant with bounded inputs, by enumeration of the active sets.

    :param A, B, Qx, Qu: (n, n), (n, 1), (n, n) and (1, 1), plant and weights in continuous time.
    :param h: period [s].
    :param N: number of periods; there are 3^N active sets.
    :param bound: |u| <= bound.
    :ivar Ad, Bd, P, K: the sampled plant, and the cost-to-go and the gain of its regulator.
    """

    def __init__(self, A: Array, B: Array, Qx: Array, Qu: Array, h: float, N: int, bound: float
                 ) -> None:
        n, m = B.shape
        motion = np.block([[A, B], [np.zeros((m, n + m))]])
        weight = np.block([[Qx, np.zeros((n, m))], [np.zeros((m, n)), Qu]])
        step, W = expm(h * motion)[:n], sample_noise(motion.T, weight, h)[1]
        self.Ad, self.Bd = step[:, :n], step[:, n:]
        self.P = solve_discrete_are(self.Ad, self.Bd, W[:n, :n], W[n:, n:], s=W[:n, n:])
        self.K = np.linalg.solve(
            W[n:, n:] + self.Bd.T @ self.P @ self.Bd, self.Bd.T @ self.P @ self.Ad + W[n:, :n])
        self.bound = bound
        # (x_k, u_k) = rows (x_0, u_0, ..., u_(N-1)); the cost is a quadratic form of these.
        state, cost = np.hstack([np.eye(n), np.zeros((n, N))]), np.zeros((n + N, n + N))
        for k in range(N):
            rows = np.vstack([state, np.eye(n + N)[n + k]])
            cost += rows.T @ W @ rows
            state = step @ rows
        cost += state.T @ self.P @ state
        self._H, self._F = cost[n:, n:], cost[n:, :n]

    def find_inputs(self, x: Array) -> tuple[Array, Array]:
        """Return inputs and active sets (k, N) at states (k, n): -1 lower, 1 upper bound."""
        N = len(self._H)
        inputs, sets = np.full((len(x), N), np.nan), np.zeros((len(x), N), dtype=int)
        for active in product((0, -1, 1), repeat=N):
            signs = np.array(active)
            free = signs == 0
            u = np.tile(self.bound * signs.astype(float), (len(x), 1))
            slope = x @ self._F.T + u @ self._H
            if free.any():
                u[:, free] = -np.linalg.solve(self._H[np.ix_(free, free)], slope[:, free].T).T
                slope = x @ self._F.T + u @ self._H
            # At an active bound the cost falls outwards; for a free input the slope is zero.
            holds = (np.abs(u) <= self.bound + ROUNDING_ERROR).all(axis=1) & (
                slope * signs <= ROUNDING_ERROR).all(axis=1)
            inputs[holds], sets[holds] = u[holds], signs
        return inputs, sets

    def saturate(self, x: Array) -> Array:
        """Return the saturated input of the regulator (k,) at states (k, n)."""
        u: Array = np.clip(-x @ self.K[0], -self.bound, self.bound)
        return u
