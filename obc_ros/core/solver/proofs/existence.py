# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Proofs that the cost has no minimum because an input has no bounds.

concave      f is affine in an input u_j without bounds and L decreases with its square. An input
             that alternates between -R and R hardly changes the path, and the cost falls with R^2.
linear       The problem is affine in x and u, T is given, and no nu satisfies dH/du = 0. The cost
             is linear along a direction of inputs that the constraints do not limit.

The curvature is computed in exact arithmetic. In the second case a linear system for nu at some
instants has no solution, by a margin of 1e-6; hence none exists for all times. If H is convex in
all inputs without bounds neither case applies.
"""

from functools import lru_cache

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.rational_polynomials import (
    Polynomial,
    read_polynomials,
    split_affine,
    TooHardError,
)
from obc_ros.core.ocp.least_time_form import find_affine_dynamics
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.exact.reachable_set import compute_exponential

_CLEAR = 1e-6   # relative size of singular values that are clearly not 0


def explain_no_minimum(problem: Problem) -> str:
    """
    Return why the cost provably has no lower bound, if an input without bounds is the reason.

    :return: a sentence that names the input; '' if nothing is proved.
    """
    free = _unlimited(problem)
    if not free.any():
        return ''
    curved, linear = _curvature(problem)
    both = free & ~np.isfinite(problem.u_lower) & ~np.isfinite(problem.u_upper)
    concave = both & (curved < 0)
    if concave.any():
        name = problem.inputs[int(np.argmax(concave))]
        return (f'the cost has no lower bound: running_cost decreases with the square of {name}, '
                'which has no bounds')
    both &= linear
    return _linear(problem, both) if both.any() else ''


def find_growing_inputs(problem: Problem) -> list[str]:
    """Return the names of the inputs without bounds in which H is linear."""
    free = _unlimited(problem)
    free &= _curvature(problem)[1] if free.any() else free
    return [name for name, yes in zip(problem.inputs, free, strict=True) if yes]


def advise_bounds(problem: Problem) -> str:
    """Return a clause that advises to bound the inputs that the cost does not limit, or ''."""
    names = find_growing_inputs(problem)
    return (f'the cost does not limit {", ".join(names)} (it is linear in '
            f'{"them" if len(names) > 1 else "it"}): input_bounds may be missing'
            if names else '')


def find_constant_cost(problem: Problem) -> float | None:
    """
    Return L if all paths cost the same, so that all multipliers are 0.

    :return: the constant L; None if L or V is not constant, or if L is not 0 and T is free.
    """
    if problem.L.is_constant() and problem.V.is_constant():
        L = float(problem.L)
        return L if not L or not problem.final_time.free else None
    return None


def measure_effort(problem: Problem) -> ca.SX:
    """
    Return |u - u_m|^2, each input in units of half the width of its bounds.

    u_m is the middle of the bounds; without both of them the admissible input nearest to 0.
    """
    boxed = problem.boxed
    half = np.where(boxed, 0.5 * (problem.u_upper - problem.u_lower), 1.0)
    middle = np.where(boxed, problem.u_lower + half, np.clip(
        0.0, problem.u_lower, problem.u_upper))
    return ca.sumsqr((problem.u - middle) / np.where(half > 0, half, 1.0))


def _unlimited(problem: Problem) -> Mask:
    """Return which inputs have a missing bound and no path constraint, shape (m,)."""
    free: Mask = ~problem.boxed
    if free.any() and problem.path.numel():
        free &= [not ca.depends_on(problem.path, u) for u in ca.vertsplit(problem.u)]
    return free


@lru_cache(maxsize=4)
def _curvature(problem: Problem) -> tuple[Array, Mask]:
    """
    Return second derivatives of L by inputs (m,), and the inputs in which f and L are affine.

    A derivative that is not constant, or in an input in which f is not affine, counts as 0.
    """
    curved, linear = np.zeros(problem.m), np.zeros(problem.m, dtype=bool)
    for index, u in enumerate(ca.vertsplit(problem.u)):
        slope = ca.vertcat(ca.jacobian(problem.L, u), ca.jacobian(problem.f, u))
        if ca.depends_on(slope[1:], u):
            continue
        second = ca.jacobian(slope[0], u)
        if not ca.depends_on(second, ca.vertcat(problem.x, problem.u)):
            try:
                [L] = read_exactly(problem, problem.L)
            except TooHardError:
                continue
            curved[index] = float(L.get(((problem.n + index, 2),), 0))
            linear[index] = not curved[index]
    return curved, linear


def read_exactly(problem: Problem, expressions: ca.SX) -> list[Polynomial]:
    """
    Return expressions as exact polynomials of (x, u).

    Here terms cancel exactly. CasADi sums the constants of derivatives in doubles, so that the
    second derivative of 0.3 u^2 - 0.2 u^2 - 0.1 u^2 is below 0 there.

    :raises TooHardError: if there are too many terms, or a number is not finite.
    """
    function = ca.Function('exact', [problem.x, problem.u, problem.p], [ca.densify(expressions)])
    return read_polynomials(
        function, [[None] * problem.n, [None] * problem.m, problem.p_value])[1]


def _linear(problem: Problem, free: Mask) -> str:
    """Return a sentence if no nu satisfies dH/du = 0 for the inputs without bounds, else ''."""
    if (find_affine_dynamics(problem) is None or problem.constrained
            or problem.final_time.free):
        return ''
    n = problem.n
    try:
        parts = [split_affine(each, n + problem.m) for each in read_exactly(
            problem, ca.vertcat(problem.f, problem.L, problem.V, problem.psi))]
    except TooHardError:
        return ''
    if None in parts:
        return ''
    numbers = np.array([[float(each) for each in part[0]] for part in parts if part])
    A, B_all = numbers[:n, :n], numbers[:n, n:]
    L_x, L_u, V_x = numbers[n, :n], numbers[n, n:], numbers[n + 1, :n]
    psi_x = numbers[n + 2:, :n]
    # With tau = T - t to go, d/dtau (lam, 1) = [[A', L_x], [0, 0]] (lam, 1).
    Z = np.zeros((n + 1, n + 1))
    Z[:n, :n], Z[:n, n] = A.T, L_x
    B = B_all[:, free].T
    rows, wanted = [], []
    instants = np.linspace(0.0, problem.final_time.value, 20)   # dH/du = 0 is required there
    for tau in instants:
        flow = compute_exponential(Z * tau)
        rows.append(B @ flow[:n, :n] @ psi_x.T)
        wanted.append(-L_u[free] - B @ (flow[:n, :n] @ V_x + flow[:n, n]))
    M, r = np.vstack(rows), np.concatenate(wanted)
    if not np.isfinite(M).all() or not np.isfinite(r).all():
        return ''
    M = M / np.where(M.any(axis=0), np.abs(M).max(axis=0), 1.0)   # removes the units of psi
    sizes = np.linalg.svd(M, compute_uv=False)
    part = sizes / max(float(sizes.max(initial=0.0)), 1e-300)
    if not np.all((part <= 1e-12) | (part >= _CLEAR)):
        return ''
    nu = np.linalg.lstsq(M, r, rcond=_CLEAR)[0] if problem.q else np.zeros(0)
    left = np.abs(M @ nu - r).reshape(len(instants), -1).max(axis=0)
    if left.max() <= 1e-6 * max(float(np.abs(r).max()), 1e-300):
        return ''
    name = problem.inputs[int(np.flatnonzero(free)[np.argmax(left)])]
    return (f'the cost has no lower bound: it is linear in {name}, which has no bounds, and the '
            'constraints do not limit it')
