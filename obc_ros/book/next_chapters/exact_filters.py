# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""References for filters, computed without the library and the nodes."""

from math import exp, sqrt

import numpy as np
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import expm


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
