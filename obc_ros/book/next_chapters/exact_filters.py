# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""References for filters, computed without the library and the nodes."""

from math import exp, sqrt

import numpy as np
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import expm


def solve_scalar_filter(a: float, q: float, r: float) -> tuple[float, float, float]:
    """
    Return p, the gain and the pole of the filter of x' = a x + w, y = x + v.

    Parameters
    ----------
    a, q, r : float
        The plant, and the intensities of w and v, positive.

    Returns
    -------
    p, L, s : float
        The positive root p of 2 a p - p^2/r + q = 0, L = p/r, and s = a - L.

    """
    root = sqrt(a * a + q / r)
    return r * (a + root), a + root, -root


def solve_sampled_scalar_filter(a: float, q: float, R: float, h: float) -> tuple[float, float]:
    """
    Return the variance before and after each measurement of x' = a x + w.

    Parameters
    ----------
    a, q : float
        The plant, a not 0, and the intensity of w.
    R, h : float
        Variance of a measurement, and the time between two of them [s].

    Returns
    -------
    before, after : float
        before is the positive root of p^2 + (R - alpha^2 R - Q) p - Q R = 0 with alpha = exp(a h)
        and Q = q (alpha^2 - 1)/(2 a); after = p R/(p + R).

    """
    square = exp(2.0 * a * h)   # of alpha
    Q = q * (square - 1.0) / (2.0 * a)
    half = 0.5 * (R - square * R - Q)
    before = -half + sqrt(half * half + Q * R)
    return before, before * R / (before + R)


def solve_tracking_filter(index: float) -> tuple[float, float]:
    """
    Return alpha and beta of the steady alpha-beta filter (Kalata 1984).

    Parameters
    ----------
    index : float
        Tracking index sigma_w h^2/sigma_v: the acceleration is random with the standard deviation
        sigma_w and constant in each period h; positions are measured with the standard deviation
        sigma_v.

    Returns
    -------
    alpha, beta : float
        The gain is (alpha, beta/h).

    """
    root = 0.25 * (4.0 + index - sqrt(8.0 * index + index * index))
    alpha = 1.0 - root * root
    return alpha, 2.0 * (2.0 - alpha) - 4.0 * root


def sample_noise(A: Array, Qw: Array, h: float) -> tuple[Array, Array]:
    """
    Return exp(A h) and the covariance of the noise of a period, by Van Loan's exponential.

    Parameters
    ----------
    A, Qw : ndarray, shape (n, n)
        The plant and the intensity of its noise.
    h : float
        Period [s].

    Returns
    -------
    Ad, Qd : ndarray, shape (n, n)

    """
    n = len(A)
    block = expm(h * np.block([[-A, Qw], [np.zeros((n, n)), A.T]]))
    Ad = block[n:, n:].T
    return Ad, Ad @ block[:n, n:]


def run_filter(A: Array, C: Array, Qw: Array, Rv: Array, t: Array, y: Array, x: Array, P: Array
               ) -> tuple[Array, Array]:
    """
    Return the estimates of the Kalman filter of x' = A x + w after each measurement.

    Parameters
    ----------
    A, C, Qw, Rv : ndarray, shape (n, n), (q, n), (n, n) and (q, q)
        The plant, the intensity of its noise, and the covariance of a measurement.
    t, y : ndarray, shape (N,) and (N, q)
        Times [s] and measurements.
    x, P : ndarray, shape (n,) and (n, n)
        Estimate and covariance after the first measurement.

    Returns
    -------
    x, P : ndarray, shape (N, n) and (N, n, n)
        Computed in information form: each measurement adds C'Rv^-1 C to P^-1.

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
