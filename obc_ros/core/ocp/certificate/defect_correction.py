# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Defect correction: the change of the inputs that corrects small jumps of the states.

A small defect need not be harmless, see docs/certificate.md. The linearised dynamics carry the
jumps d_k to T,

dx_(k+1) = A_k dx_k + B_k du_k + d_k.

The jumps are harmless if a small change du of the inputs corrects them. A controllable system has
such a change even if it is unstable; x' = x u at x = 0 has none.
"""

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.structure import make_differentiable

_FINEST = 2.0**-4   # |A| h up to which four terms of the exponential series are enough
_MET = 1e-6         # error of a terminal constraint that counts as met, relative to its size


def find_correction(problem: Problem, x: Array, u: Array, h: Array, jumps: Array,
                    ends: tuple[Array, Array], u_scale: Array) -> float:
    """
    Return the smallest change of the inputs, root mean square, that corrects jumps of x.

    :param x, u: (K, n), (K, m), states and inputs in the middle of each interval.
    :param jumps: (K, n), jumps of x at the ends of the intervals.
    :param ends: (q, n), (q,), slopes of the terminal constraints, and their sizes.
    :return: in units of `u_scale`; infinite if the linearised dynamics are not finite.
    """
    smooth = make_differentiable(problem)
    f_x, f_u = VectorizedFunction([problem.x, problem.u, problem.p], [
        ca.jacobian(smooth.f, problem.x).T, ca.jacobian(smooth.f, problem.u).T])(
            x, u, problem.p_value)
    if not (np.isfinite(f_x).all() and np.isfinite(f_u).all()):
        return np.inf
    n, T, (slopes, sizes) = problem.n, float(h.sum()), ends
    A = _exponentials(f_x.reshape(-1, n, n) * h[:, None, None])
    # A change of one scaling factor over all of T has the root mean square 1.
    B = f_u.reshape(-1, n, problem.m) * (u_scale * np.sqrt(h * T)[:, None])[:, None, :]
    carried, reached = np.zeros(n), np.zeros((n, n))
    for a, b, jump in zip(A, B, jumps, strict=True):
        carried, reached = a @ carried + jump, a @ reached @ a.T + b @ b.T
    missed = np.asarray(slopes @ carried / sizes, dtype=float)
    within = np.asarray(slopes @ reached @ slopes.T / np.outer(sizes, sizes), dtype=float)
    if not (np.isfinite(missed).all() and np.isfinite(within).all()):
        return np.inf
    needed = np.linalg.lstsq(within + _MET**2 * np.eye(len(sizes)), missed, rcond=1e-14)[0]
    return float(np.sqrt(max(missed @ needed, 0.0)))


def _exponentials(M: Array) -> Array:
    size = float(np.abs(M).sum(axis=2).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(max(size, 1e-300) / _FINEST))))
    M = M / 2.0**halvings
    one = np.eye(M.shape[1])
    E = one + M @ (one + M @ (one + M @ (one + M / 4) / 3) / 2)
    for _ in range(halvings):
        E = E @ E
    return np.asarray(E)
