# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Structure of the expressions of a problem, independent of its numbers: where inputs appear."""

from dataclasses import replace

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Mask
from obc_ros.core.numerics.instructions import find_dependence, make_norms_differentiable
from obc_ros.core.ocp.problem import Problem


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


def find_branching_inputs(problem: Problem) -> Mask:
    """
    Return the bounded inputs in which H may have several minima.

    :return: (m,), True if both bounds exist, the curvature of H in the input depends on this
        input, and no path constraint contains it.
    """
    lam, u = ca.SX.sym('lam', problem.n), problem.u
    H = problem.L + ca.dot(lam, problem.f)
    curvature = ca.diag(ca.jacobian(ca.gradient(H, u), u))
    bent = find_dependence(curvature, u).diagonal()
    return np.asarray(problem.boxed & bent & ~find_shared_inputs(problem))


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
