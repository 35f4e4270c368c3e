# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Whether there is a path close to one whose states jump a little at the ends of its intervals.

x' = x u never passes 0, but a path may: it falls to 1e-9, jumps to -1e-9, which is nothing beside
its size, and grows from there. The jumps are carried to T by what follows,

    dx_(k+1) = A_k dx_k + B_k du_k + d_k,

and are harmless if a small change of the inputs makes up for them: always where an unstable
system can be steered, and never there.
"""

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem

_FINEST = 2.0**-4   # of |A| h, for which four terms are exact enough
_MET = 1e-6         # of its size: how nearly a terminal constraint is met


def find_correction(problem: Problem, x: Array, u: Array, h: Array, jumps: Array,
                    ends: tuple[Array, Array], u_scale: Array) -> float:
    """
    Return the least change of the inputs, root mean square, that makes up for jumps of x.

    Parameters
    ----------
    problem : Problem
        Whose dynamics are linearised.
    x, u : ndarray, shape (K, n), (K, m)
        States and inputs in the middle of each interval.
    h : ndarray, shape (K,)
        Lengths of the intervals.
    jumps : ndarray, shape (K, n)
        Of x at their ends.
    ends : pair of ndarray, shape (q, n), (q,)
        Slopes of the terminal constraints, and their sizes.
    u_scale : ndarray, shape (m,)
        What counts as one in u.

    """
    f_x, f_u = VectorizedFunction([problem.x, problem.u, problem.p], [
        ca.jacobian(problem.f, problem.x).T, ca.jacobian(problem.f, problem.u).T])(
            x, u, problem.p_value)
    n, T, (slopes, sizes) = problem.n, float(h.sum()), ends
    A = _exponentials(f_x.reshape(-1, n, n) * h[:, None, None])
    # Of a change by one, held for all T, each interval has its part.
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
    """Return the exponential of each matrix, (K, n, n)."""
    size = float(np.abs(M).sum(axis=2).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(max(size, 1e-300) / _FINEST))))
    M = M / 2.0**halvings
    one = np.eye(M.shape[1])
    E = one + M @ (one + M @ (one + M @ (one + M / 4) / 3) / 2)
    for _ in range(halvings):
        E = E @ E
    return np.asarray(E)
