# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Least squares with inequalities that should hold as far as possible.

The minimum of |A v - b|^2 + |s|^2 with G v + s >= g and v_i >= 0 for some i: s is the violation of
the inequalities. It always exists, and is found by a primal-dual interior-point method with
predictor and corrector (Mehrotra, SIAM J. Optim. 2, 1992) for dense matrices of small rank.

If the minimum is not unique, the one on the central path is taken, far from inequalities that need
not be active. The iteration therefore ends early; a correction of least norm then satisfies the
equations to rounding errors.
"""

import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask


def solve_signed_least_squares(A: Array, b: Array, G: Array, g: Array, positive: Mask) -> Array:
    """
    Return v that minimises |A v - b|^2 + |min(G v - g, 0)|^2 with v_i >= 0 for some i.

    :param A, b: (r, n), (r,), equations; the columns of A and G should have similar sizes.
    :param G, g: (k, n), (k,), inequalities G v >= g.
    :param positive: (n,), which v_i must be >= 0.
    :return: (n,).
    :raises numpy.linalg.LinAlgError: if numbers are not finite, or overflow.
    """
    n, k, ridge = A.shape[1], len(g), 1e-8   # Tikhonov regularisation
    unit: float = max(np.abs(b).max(initial=0.0), np.abs(g).max(initial=0.0)) or 1.0
    # w = C v + soft z - c, where z are the multipliers and, of the soft rows, the violations.
    C = np.vstack((G, np.eye(n)[positive]))
    c = np.append(g / unit, np.zeros(int(positive.sum())))
    soft = np.append(np.ones(k), np.zeros(len(c) - k))
    H, right = A.T @ A + ridge**2 * np.eye(n), A.T @ b / unit
    v, z = np.zeros(n), np.ones(len(c))
    w = np.maximum(C @ v + soft * z - c, 1.0)
    for _ in range(60):
        off, slope = C @ v + soft * z - c - w, H @ v - right - C.T @ z
        mean = float(w @ z) / len(c)
        # b and g are of size 1.
        if mean <= 1e-12 and max(np.abs(off).max(), np.abs(slope).max()) <= 1e-10:
            break
        newton = _Newton(H, C, soft, w, z, off, slope)
        _, dz, dw = newton.step(-w * z)
        part = _reach(w, z, dw, dz)
        ahead = float((w + part * dw) @ (z + part * dz)) / len(c)
        dv, dz, dw = newton.step((ahead / mean)**3 * mean - w * z - dw * dz)
        part = 0.995 * _reach(w, z, dw, dz)   # of the way to the nearest bound
        v, z, w = v + part * dv, z + part * dz, w + part * dw
    violated = z[:k] > w[:k]
    rows, wanted = np.vstack((A, G[violated])), np.append(b, g[violated]) / unit
    near = v + np.linalg.lstsq(rows, wanted - rows @ v, rcond=ridge)[0]
    near[positive] = np.maximum(near[positive], 0.0)
    best: Array = min((v, near), key=lambda v: float(
        np.sum((A @ v - b / unit)**2) + np.sum(np.minimum(G @ v - g / unit, 0)**2)))
    return best * unit


class _Newton:
    """Newton steps of one iterate, for several right sides."""

    def __init__(self, H: Array, C: Array, soft: Array, w: Array, z: Array, off: Array,
                 slope: Array) -> None:
        self._C, self._soft, self._off, self._slope = C, soft, off, slope
        self._z, self._weight = z, 1 / (w + soft * z)
        matrix = H + C.T @ ((self._weight * z)[:, None] * C)
        tiny = np.finfo(float).eps * np.trace(matrix)
        self._inverse = np.linalg.inv(np.linalg.cholesky(matrix + tiny * np.eye(len(H))))

    def step(self, product: Array) -> tuple[Array, Array, Array]:
        """Return the steps of v, z and w after which w z is `product` more, to first order."""
        dz = self._weight * (product - self._z * self._off)
        dv = self._inverse.T @ (self._inverse @ (self._C.T @ dz - self._slope))
        dz = dz - self._weight * self._z * (self._C @ dv)
        return dv, dz, self._C @ dv + self._soft * dz + self._off


def _reach(w: Array, z: Array, dw: Array, dz: Array) -> float:
    """Return the largest part of a step, up to 1, that keeps w and z from being negative."""
    x, dx = np.concatenate((w, z)), np.concatenate((dw, dz))
    falls = dx < 0
    return min(1.0, float((-x[falls] / dx[falls]).min(initial=np.inf)))
