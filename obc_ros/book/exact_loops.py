# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""References for closed loops, computed without the nodes."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from obc_ros.core.numerics.arrays import Array, Complex
from scipy.integrate import ode
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment

RateFunction = Callable[[Array, Array], Any]
Law = Callable[[float, Array], Array]


def run_sampled_loop(A: Array, B: Array, K: Array, x0: ArrayLike, step: float, count: int
                     ) -> tuple[Array, Array]:
    """
    Return states (N + 1, n) and inputs of x' = A x + B u with u = -K x(t_k), held for a step [s].

    The matrix exponential is exact up to rounding.
    """
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
