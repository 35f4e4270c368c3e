# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""References for receding horizons: the sampled cost, and plans by enumeration of active sets."""

from itertools import product
from math import exp, sqrt

import numpy as np
from obc_ros.book.next_chapters.exact_filters import sample_noise
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import expm, solve_discrete_are

ROUNDING_ERROR = 1e-9   # violations of a condition up to this are rounding errors


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
        """
        Return the optimal inputs (k, N) and active sets (k, N) from states (k, n).

        An active set has -1 for an input at its lower bound, 1 for one at its upper bound, and 0
        for one between them.
        """
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
