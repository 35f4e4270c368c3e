# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Infeasibility proofs for linear systems with bounded inputs, by weak duality.

For dx/dt = A x + B v + c, |v_j| <= 1, and any weights y_k of constraints at times t_k,

    sum of y_k' x(t_k) = (a constant that follows from A, c and x(0)) + integral of w(t) B v(t),

where w(t) is the sum of y_k' e^(A (t_k - t)) over t_k >= t. The minimum over all inputs is the
constant minus the integral of |w B|. If it exceeds the weighted sum of what the constraints allow,
no input satisfies them. A linear programme suggests the weights. The inequality is then evaluated
for all inputs, not only those of the programme, with a bound of the integral. The proof does not
depend on the accuracy of the programme.

Numbers are doubles. Rounding errors are bounded step by step (`Reach.sizes`): an inequality counts
only if it holds by more than 1e-6 of the sizes of all terms that lead to it.
"""

import math
import time
from typing import NamedTuple

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, optimize
from obc_ros.core.numerics.instructions import has_jumps
from obc_ros.core.ocp.certificate.certificate import COUNTS_AS_MET
from obc_ros.core.ocp.least_time_form import find_affine_dynamics
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.exact.reachable_set import compute_exponential, normalize_inputs, Reach

_ROUNDING = 20 * np.finfo(float).eps   # of a step's terms, for each state
_FINER = 16         # times as many cells as in the linear programme
_MOST_GROWTH = 30.0   # largest real part of a pole times T for which doubles are accurate enough
_NODES, _CELLS = 96, 2    # times at which state bounds are imposed; cells between two of them


def is_never_met(reach: Reach, lower: float, upper: float) -> bool:
    """
    Return whether it is proved that C x(T) = d holds at no T of [lower, upper].

    The interval is halved until one direction separates the target from the reachable set for
    all T of a part.
    """
    if not len(reach.d) or not upper or reach.poles.real.max(initial=0.0) * upper > _MOST_GROWTH:
        return False
    sizes = reach.sizes(upper)
    if not np.isfinite(sizes).all():
        return False
    waiting, programmes = [(lower, upper)], 0
    while waiting:
        a, b = waiting.pop()
        for T in dict.fromkeys((b, a)):
            programmes += 1
            if programmes > 40:   # for all admissible final times
                return False
            eta = _direction(reach, T)
            if eta is None:
                return False   # according to the programme the target can be met at this time
            if _separates(reach, eta, a, b, sizes):
                break
        else:
            if b - a <= 1e-3 * upper:   # it is not halved
                return False
            waiting += [(a, 0.5 * (a + b)), (0.5 * (a + b), b)]
    return True


def _direction(reach: Reach, T: float) -> Array | None:
    """Return a direction that separates the target from the reachable set at T, or None."""
    gap = reach.gap(reach.table(np.array([0.0, T])))[-1] if T else reach.d - reach.C @ reach.x0
    if not gap.any() or not np.isfinite(gap).all():
        return None
    if not T or not reach.B.any():
        return np.asarray(gap / (gap @ gap))
    multiple, eta = reach.largest_multiple(T)
    return eta if multiple < 1 and np.isfinite(eta).all() else None


@np.errstate(over='ignore', invalid='ignore')   # infinite bounds prove nothing
def _separates(reach: Reach, eta: Array, lower: float, upper: float, sizes: Array) -> bool:
    """Return whether eta'(d - C x(T)) > 0 for all inputs and for all T of an interval."""
    tau = reach.times(upper, _FINER) if upper else np.zeros(1)
    tau = np.unique(np.append(tau, lower))
    table = reach.table(tau)
    n, m = reach.B.shape
    w = eta @ table[:, :, :n]
    integral = np.diff(eta @ table[:, :, n:n + m], axis=0)
    most = np.append(0.0, np.cumsum(_absolute(reach.A, reach.B, w, np.diff(tau), integral)))
    margin = reach.gap(table) @ eta - most
    growth = np.exp(np.linalg.norm(reach.A, 2) * np.diff(tau, append=tau[-1]))
    slope = np.linalg.norm(w, axis=1) * growth * (
        np.linalg.norm(reach.A @ reach.x0 + reach.c)
        + np.linalg.norm(reach.B, axis=0).sum())
    terms = np.abs(reach.C) @ sizes
    share = max(COUNTS_AS_MET, _ROUNDING * len(tau) * len(reach.Z))
    small = share * float(np.abs(eta) @ (np.abs(reach.d) + terms))
    part = tau >= lower
    least = margin - slope * np.diff(tau, append=tau[-1])
    return bool(np.isfinite(least).all() and np.all(least[part] > small))


def _absolute(A: Array, B: Array, w: Array, h: Array, integral: Array) -> Array:
    """
    Return upper bounds of the integral of the sum of |w b_j| over cells, shape (N - 1,).

    `w` (N, n): at the ends of cells, dw/dt = +- w A; `integral` (N - 1, m): of w b_j, exact.
    """
    s = np.abs(w @ B)
    growth = np.exp(np.linalg.norm(A, 2) * h)
    change = (np.linalg.norm(w[:-1], axis=1) * growth * h)[:, None] * np.linalg.norm(A @ B, axis=0)
    one_sign = np.maximum(s[:-1], s[1:]) > change
    cells = np.where(one_sign, np.abs(integral), h[:, None] * (np.minimum(s[:-1], s[1:]) + change))
    return np.asarray(cells.sum(axis=1))


class _Demands(NamedTuple):
    """Constraints S x <= s, shapes (r, n) and (r,), each at one of the times, `at` (r,)."""

    S: Array
    s: Array
    at: Index


def is_excluded(problem: Problem, seconds: float = math.inf) -> bool:
    """
    Return whether it is proved that no path satisfies all constraints.

    Proofs exist only for affine dynamics and constraints, given x(0) and T, and bounded inputs.
    State bounds and path constraints without inputs are imposed at a finite number of times, other
    path constraints are ignored; fewer constraints exclude fewer problems, never too many.

    :param seconds: limit of the wall-clock time [s].
    """
    begun = time.monotonic()
    plant = find_affine_dynamics(problem) if problem.start is None else None
    if plant is None or not problem.boxed.all() or problem.final_time.free or seconds <= 0:
        return False
    T = problem.final_time.value
    reach, _ = normalize_inputs(problem, plant, np.eye(problem.n), problem.x0)
    if reach.poles.real.max(initial=0.0) * T > _MOST_GROWTH or not reach.B.any():
        return False
    demands = _demands(problem)
    return demands is not None and _excluded(reach, T, demands, begun + seconds)


def _demands(problem: Problem) -> _Demands | None:
    n, q, z = problem.n, problem.q, ca.vertcat(problem.x, problem.u)
    values = ca.vertcat(problem.psi, problem.path)
    slopes = ca.jacobian(values, z)
    if ca.depends_on(slopes, z) or has_jumps(values, z):
        return None
    both = ca.Function('rows', [z, problem.p], [ca.densify(slopes), ca.densify(values)])
    J, at_zero = (each.full() for each in both(np.zeros(n + problem.m), problem.p_value))
    ends, rest, shared = J[:q, :n], at_zero[:, 0], ~J[q:, n:].any(axis=1)
    always = np.vstack([np.eye(n), J[q:, :n][shared]])
    upper = np.append(problem.x_upper, (problem.path_upper - rest[q:])[shared])
    lower = np.append(problem.x_lower, (problem.path_lower - rest[q:])[shared])
    bounds = np.append(upper, -lower)
    finite = np.isfinite(bounds)
    bounds, always = bounds[finite], np.vstack([always, -always])[finite]
    S = np.vstack([ends, -ends, np.tile(always, (_NODES, 1))])
    s = np.concatenate([-rest[:q], rest[:q], np.tile(bounds, _NODES)])
    if not len(s) or not (np.isfinite(S).all() and np.isfinite(s).all()):
        return None
    nodes = np.repeat(np.arange(1, _NODES + 1), len(bounds))
    return _Demands(S, s, np.append(np.full(2 * q, _NODES), nodes))


def _excluded(reach: Reach, T: float, demands: _Demands, deadline: float) -> bool:
    """
    Return whether weights are found that prove that no input satisfies all constraints.

    `deadline`: on the monotonic clock [s]; the linear programme takes nearly all of the time.
    """
    n, m = reach.B.shape
    N = _NODES * _CELLS
    step = compute_exponential(reach.Z * (T / N))
    E, G, drift = step[:n, :n], step[:n, n:n + m], step[:n, -1]
    # x at the ends of cells without inputs, and its derivative by the inputs of all cells.
    free, forced = [reach.x0], np.zeros((N + 1, n, N * m))
    for k in range(N):
        free.append(E @ free[-1] + drift)
        forced[k + 1] = E @ forced[k]
        forced[k + 1][:, k * m:(k + 1) * m] = G
    at = demands.at * _CELLS
    size = np.abs(demands.s) + np.abs(demands.S) @ np.abs(free).max(axis=0)
    unit = 1 / np.where(size > 0, size, 1.0)
    left = np.einsum('rn,rnk->rk', demands.S, forced[at]) * unit[:, None]
    right = (demands.s - np.einsum('rn,rn->r', demands.S, np.array(free)[at])) * unit
    if not (np.isfinite(left).all() and np.isfinite(right).all()):
        return False
    cost = np.zeros(N * m + 1)
    cost[-1] = 1.0
    found = optimize.linprog(
        cost, A_ub=np.column_stack([left, -np.ones(len(left))]), b_ub=right,
        bounds=[*[(-1, 1)] * (N * m), (None, None)], method='highs',
        options={'time_limit': max(deadline - time.monotonic(), 0.0)})
    if found.status != 0 or found.x[-1] <= 0:
        return False
    y = np.maximum(-found.ineqlin.marginals, 0.0) * unit
    return _proves(reach, T, demands, y)


@np.errstate(over='ignore', invalid='ignore')   # as in `_separates`
def _proves(reach: Reach, T: float, demands: _Demands, y: Array) -> bool:
    """Return whether no input satisfies the sum of the constraints with weights y >= 0."""
    n, m = reach.B.shape
    parts = _CELLS * _FINER * 4
    h = T / (_NODES * parts)
    step = compute_exponential(reach.Z * h)
    w, reached, constant, size = np.zeros(n), 0.0, 0.0, 0.0
    for node in range(_NODES, 0, -1):
        rows = demands.at == node
        w = w + y[rows] @ demands.S[rows]
        course = [w]
        for _ in range(parts):
            course.append(course[-1] @ step[:n, :n])
        at = np.array(course)
        integral = at[:-1] @ step[:n, n:n + m]
        reached += float(_absolute(reach.A, reach.B, at, np.full(parts, h), integral).sum())
        constant += float((at[:-1] @ step[:n, -1]).sum())
        size += float((np.abs(at[:-1]) @ np.abs(step[:n, -1])).sum())
        w = at[-1]
    wanted = float(y @ demands.s)
    least = constant + float(w @ reach.x0) - reached
    size += float(np.abs(y) @ (np.abs(demands.s) + np.abs(demands.S) @ reach.sizes(T))) + reached
    return bool(np.isfinite(least) and least - wanted > COUNTS_AS_MET * size)
