# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What problems of least time have in common, read off a Problem.

Minimise rate T + V subject to C x(T) = d, u in a bounded box, with rate > 0 and V constant, T
free, and no constraints along the path.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from obc_ros.core.problem import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Target:
    """
    A target to be reached in least time.

    Attributes
    ----------
    rate : float
        L, a constant > 0.
    V : float
        The terminal cost, a constant.
    C, d : ndarray, shape (q, n) and (q,)
        The terminal constraints are psi = C x(T) - d = 0, q >= 1.

    """

    rate: float
    V: float
    C: Array
    d: Array


@dataclass(frozen=True, eq=False)
class Affine:
    """dx/dt = A x + B u + c; shapes (n, n), (n, m), (n,)."""

    A: Array
    B: Array
    c: Array


def target(problem: Problem) -> Target | None:
    """Return the target of a problem of least time, None for another problem."""
    bounded = (np.isfinite(problem.x_lower).any() or np.isfinite(problem.x_upper).any()
               or problem.path.numel() > 0)
    boxed = np.isfinite(problem.u_lower).all() and np.isfinite(problem.u_upper).all()
    if not problem.final_time.free or bounded or not boxed or problem.q == 0:
        return None
    z = ca.vertcat(problem.x, problem.u)
    slope = ca.jacobian(problem.psi, problem.x)
    if ca.depends_on(ca.vertcat(problem.L, problem.V, ca.vec(slope)), z):
        return None
    at_zero = ca.Function('target', [problem.x, problem.p],
                          [ca.vertcat(problem.L, problem.V), slope, problem.psi])
    values, C, d = (out.full() for out in at_zero(np.zeros(problem.n), problem.p_value))
    rate, V = values.ravel()
    if not (rate > 0 and np.isfinite(values).all() and np.isfinite(C).all()
            and np.isfinite(d).all()):
        return None
    return Target(float(rate), float(V), C, -d.ravel())


def affine(problem: Problem) -> Affine | None:
    """Return the dynamics if they are affine in x and u together, else None."""
    z = ca.vertcat(problem.x, problem.u)
    slope = ca.jacobian(problem.f, z)
    if ca.depends_on(slope, z):
        return None
    at_zero = ca.Function('affine', [problem.x, problem.u, problem.p], [slope, problem.f])
    J, c = (out.full() for out in at_zero(
        np.zeros(problem.n), np.zeros(problem.m), problem.p_value))
    if not (np.isfinite(J).all() and np.isfinite(c).all()):
        return None
    return Affine(J[:, :problem.n], J[:, problem.n:], c.ravel())
