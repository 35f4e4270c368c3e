# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Linear quadratic problems with a fixed horizon: the Riccati differential equation (2.7).

-dP/dt = P A + A'P - P B Qu^-1 B'P + Qx, P(T) = P1, u = -Qu^-1 B'P(t) x

P is not integrated: stretches of the horizon are joined (`stretches`), which is exact to rounding
for long horizons and unstable plants too, and needs no stationary solution. What is affine or
constrained at T joins the state: with (x, 1, nu) the value function
V(x) = x'P x / 2 + p'x + ..., its linear part and the multipliers nu of C x(T) = d are one P.
"""

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from obc_ros.core import admissible, stretches
from obc_ros.core.care import balancing
from obc_ros.core.contradictions import contradiction
from obc_ros.core.errors import StatementError
from obc_ros.core.lq_form import lq_form
from obc_ros.core.lq_path import solve_form
from obc_ros.core.problem import Problem
from obc_ros.core.solution import Solution, Status
from scipy.linalg import lapack

Array = NDArray[np.float64]


def finite_horizon(A: ArrayLike, B: ArrayLike, Qx: ArrayLike, Qu: ArrayLike, P1: ArrayLike,
                   t: Sequence[float] | Array, T: float, *, cross: ArrayLike | None = None
                   ) -> tuple[Array, Array]:
    """
    Return the solution of the Riccati differential equation (2.7) and the gain, u = -K(t) x.

    They minimise the integral of x'Qx x + 2 x'N u + u'Qu u over [t, T] plus x(T)'P1 x(T).

    Parameters
    ----------
    A, B, Qx, Qu, cross : array_like
        As for `lqr.lqr`; Qx >= 0, Qu > 0. Neither stabilisable nor detectable is needed.
    P1 : array_like, shape (n, n)
        Terminal weight; symmetric, P1 >= 0.
    t : sequence of float, shape (N,)
        Times [s], increasing, at most T. Equally spaced ones are much faster.
    T : float
        Final time [s].

    Returns
    -------
    P : ndarray, shape (N, n, n)
    K : ndarray, shape (N, m, n)

    Raises
    ------
    StatementError, RefusedDesignError
        If a matrix does not fit, or is not definite as needed; if times are not increasing.

    """
    A, B, Qx, Qu, cross = admissible.checked(A, B, Qx, Qu, cross)
    P1 = admissible.semidefinite('P1', P1, len(A))
    L, Ac, Qc, _ = admissible.reduced(A, B, Qx, Qu, cross)
    to_go = _to_go(t, T)
    F = lapack.dtrtrs(L, B.T, lower=1)[0].T
    d = balancing(Ac, F, Qc)
    F = F / d[:, None]
    weight = d * d[:, None]
    P = stretches.at(Ac * (d / d[:, None]), F @ F.T, Qc * weight, P1 * weight, to_go) / weight
    right = P.reshape(-1, len(A)) @ B
    if cross is not None:
        right = (right.reshape(len(P), *B.shape) + cross).reshape(right.shape)
    K = lapack.dpotrs(L, right.T, lower=1)[0].T.reshape(len(P), *B.shape)
    return P, np.swapaxes(K, 1, 2)


def _to_go(t: Sequence[float] | Array, T: float) -> Array:
    """Return T - t, checked."""
    times = np.asarray(t, dtype=float)
    if times.ndim != 1 or not times.size or not np.isfinite(times).all() or not math.isfinite(T):
        raise StatementError('t and T: wanted a list of finite times and a finite final time')
    if (np.diff(times) <= 0.0).any() or times[-1] > T:
        raise StatementError(f't: wanted increasing times of at most T = {T:g}')
    to_go: Array = T - times
    return to_go


def solve_lq(problem: Problem) -> Solution | None:
    """
    Return the optimal path of a linear quadratic problem with a fixed horizon.

    Parameters
    ----------
    problem : Problem
        With bounds, the path is an answer only if it stays within them.

    Returns
    -------
    Solution or None
        None when the problem is not linear quadratic (affine terms are welcome, the cost is
        strictly convex in u), has path constraints, or a bound would be active. Status
        'infeasible' when exact arithmetic proves that the input cannot meet the terminal
        constraints, 'not_converged' when that is not proved, or when the cost has no minimum (a
        conjugate point).

    """
    if problem.final_time.free or problem.path.numel():
        return None
    form = lq_form(problem)
    if form is None:
        return None
    solution = solve_form(form, problem.x0, problem.final_time.value, problem.states)
    if solution.status is Status.INFEASIBLE and not contradiction(problem):
        # What doubles cannot tell from out of reach may be within it.
        solution = replace(solution, status=Status.NOT_CONVERGED, message=(
            f'no path was found; infeasibility is not proved ({solution.message})'))
    if not solution.t.size:
        return solution if _is_unbounded(problem) else None
    return solution if _is_unbounded(problem) or _is_within(problem, solution) else None


def _is_unbounded(problem: Problem) -> bool:
    bounds = np.concatenate([problem.x_lower, problem.x_upper, problem.u_lower, problem.u_upper])
    return bool(np.isinf(bounds).all()) and problem.path.numel() == 0


def _is_within(problem: Problem, solution: Solution) -> bool:
    """Return whether a path is inside its bounds, with room for what it does between samples."""
    for values, lower, upper in ((solution.x, problem.x_lower, problem.x_upper),
                                 (solution.u, problem.u_lower, problem.u_upper)):
        room = np.abs(np.diff(values, axis=0)).max(axis=0, initial=0.0)
        if (values.min(axis=0) - room < lower).any() or (values.max(axis=0) + room > upper).any():
            return False
    return True
