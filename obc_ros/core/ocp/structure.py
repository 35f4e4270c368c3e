# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Structure of the expressions of a problem: where inputs appear, and the curvature of costs.

If L and V are convex, local minima that are not global come from dynamics and bounds only. If
their curvature changes sign there may be more. If L and V are convex, dynamics and constraints
affine, and T given, Pontryagin's conditions are sufficient (O. L. Mangasarian, Sufficient
conditions for the optimal control of nonlinear systems, SIAM J. Control 4, 1966).
"""

from dataclasses import replace

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.instructions import find_dependence, make_norms_differentiable
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem

_POINTS, _HALVINGS = 64, 4   # samples; halvings of their distance, to find small regions
_DOWN = 1e-6        # of the largest curvature: negative curvature above rounding
_ROUNDING = 1e-12   # rounding of eigenvalues, in units in which all curvatures along axes are 1


def find_switching_inputs(problem: Problem) -> tuple[bool, ...]:
    """Return for each input whether H is affine in it for constant other inputs."""
    lam = ca.SX.sym('lam', problem.n)
    H = problem.L + ca.dot(lam, problem.f)
    return tuple(
        bool(ca.sparsify(ca.jacobian(ca.gradient(H, u), u)).nnz() == 0)
        for u in ca.vertsplit(problem.u))


def find_idle_inputs(problem: Problem) -> tuple[bool, ...]:
    """Return for each input whether it is neither in L nor in the rate of a state in V or psi."""
    x, u = problem.x, problem.u
    ends = find_dependence(ca.vertcat(problem.V, problem.psi), x).any(axis=0)
    moved = ca.vertcat(problem.L, problem.f[np.flatnonzero(ends).tolist()])
    return tuple(bool(not column.any()) for column in find_dependence(moved, u).T)


def find_deciding_inputs(problem: Problem) -> Mask:
    """
    Return which inputs appear in the derivatives of states and of path constraints.

    :return: (n + l, m), a row for each entry of (x, c). The rows of path constraints that depend
        on inputs themselves are False.
    """
    rows = ca.vertcat(problem.x, problem.path)
    rate = ca.mtimes(ca.jacobian(rows, problem.x), problem.f)
    mixed = find_dependence(rows, problem.u).any(axis=1, keepdims=True)
    return np.asarray(find_dependence(rate, problem.u) & ~mixed)


def find_shared_inputs(problem: Problem) -> Mask:
    """Return which inputs appear in path constraints, (m,)."""
    return np.asarray(find_dependence(problem.path, problem.u).any(axis=0))


def find_mixed_equalities(problem: Problem) -> Mask:
    """Return the inputs of each path equality of states and inputs, (equalities, m)."""
    inputs = np.asarray(find_dependence(problem.path, problem.u))
    mixed = inputs.any(axis=1) & find_dependence(problem.path, problem.x).any(axis=1)
    return np.asarray(inputs[(problem.path_lower == problem.path_upper) & mixed])


def find_clocks(problem: Problem) -> Mask:
    """Return the states with a given x(0) and a constant rate, for example a time, (n,)."""
    z = ca.vertcat(problem.x, problem.u)
    steady = [not ca.depends_on(rate, z) for rate in ca.vertsplit(problem.f)]
    return np.array(steady) & problem.given_at_start


def make_differentiable(problem: Problem) -> Problem:
    """
    Return a problem in whose expressions norms of states have derivatives at 0.

    :return: to be differentiated, not for proofs: a norm that is 0 becomes 1e-150. `problem`
        itself if no norm of states alone occurs.
    """
    stated = problem.f, problem.L, problem.V, problem.psi, problem.path
    f, L, V, psi, path = make_norms_differentiable(
        stated, (problem.x, problem.u, problem.p), problem.u)
    if f is problem.f:
        return problem
    return replace(problem, f=f, L=L, V=V, psi=psi, path=path)


def has_convex_paths(problem: Problem) -> bool:
    """
    Return whether the set of admissible paths is convex.

    :return: whether dynamics and constraints are affine and T is given; costs are not examined.
        States with constant rates are functions of time, on which these may depend.
    """
    moving = np.flatnonzero(~find_clocks(problem)).tolist()
    z = ca.vertcat(problem.x[moving, 0], problem.u)
    slopes = ca.jacobian(ca.vertcat(problem.f, problem.psi, problem.path), z)
    return not problem.final_time.free and not ca.depends_on(slopes, z)


class Uneven:
    """Curvature of L and V for problems of one structure; `curved`: where it is not constant."""

    def __init__(self, problem: Problem) -> None:
        both = ca.vertcat(problem.x, problem.u)
        self.curved = []
        self._constant = list[ca.Function]()
        for cost, z in ((problem.L, both), (problem.V, problem.x)):
            curvature = ca.hessian(cost, z)[0]
            if ca.depends_on(curvature, z):
                self.curved.append(
                    VectorizedFunction([problem.x, problem.u, problem.p], [curvature], 1))
            else:
                self._constant.append(ca.Function('curvature', [problem.p], [curvature]))

    def upwards(self, problem: Problem) -> bool:
        """Return whether L and V are quadratic and convex."""
        return not self.curved and all(
            is_semidefinite(curvature(problem.p_value).full()) for curvature in self._constant)

    def __call__(self, problem: Problem, x_room: Array, u_room: Array) -> bool:
        """Return whether L or V has negative curvature at a sample within x_room and u_room."""
        chance = np.random.default_rng(3)
        x = chance.uniform(-1, 1, (_POINTS, problem.n))
        u = chance.uniform(-1, 1, (_POINTS, problem.m))
        nearer = 2.0 ** -chance.integers(1, _HALVINGS + 1, (_POINTS, 1))
        x = problem.x0 + x_room * np.vstack([x, nearer * x])
        u = u_room * np.vstack([u, nearer * u])
        x = np.clip(x, problem.x_lower, problem.x_upper)
        u = np.clip(u, problem.u_lower, problem.u_upper)
        for curved in self.curved:
            values, = curved(x, u, problem.p_value)
            good = values[np.isfinite(values).all(axis=1)]
            if len(good):
                n = round(np.sqrt(good.shape[1]))
                size = np.append(x_room, u_room)[:n]
                curvature = good.reshape(-1, n, n) * size[:, None] * size
                least = np.linalg.eigvalsh(curvature)[:, 0]
                if least.min() < -_DOWN * np.abs(curvature).max():
                    return True
        return False


def is_semidefinite(H: Array) -> bool:
    """Return whether a symmetric matrix is positive semidefinite, up to rounding."""
    size = np.sqrt(np.maximum(np.diag(H), 0.0))
    none = size == 0
    size = np.where(none, 1.0, size)
    H = H / size / size[:, None]
    return not H[none].any() and bool(np.linalg.eigvalsh(H)[0] >= -_ROUNDING)
