# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Structure of the expressions of a problem, independent of its numbers: where inputs appear."""

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Mask
from obc_ros.core.ocp.problem import Problem


def find_switching_inputs(problem: Problem) -> tuple[bool, ...]:
    """
    Return for each input whether H is affine in it for constant other inputs.

    Parameters
    ----------
    problem : Problem
        Any problem.

    Returns
    -------
    tuple of bool, length m

    """
    lam = ca.SX.sym('lam', problem.n)
    H = problem.L + ca.dot(lam, problem.f)
    return tuple(
        bool(ca.sparsify(ca.jacobian(ca.gradient(H, u), u)).nnz() == 0)
        for u in ca.vertsplit(problem.u))


def find_idle_inputs(problem: Problem) -> tuple[bool, ...]:
    """
    Return for each input whether it appears neither in L nor in a rate that matters at T.

    Parameters
    ----------
    problem : Problem
        Any problem.

    Returns
    -------
    tuple of bool, length m
        True if the input appears neither in L nor in dx_i/dt of a state x_i in V or psi.

    """
    x, u = problem.x, problem.u
    lam = ca.jacobian_sparsity(ca.vertcat(problem.V, problem.psi), x).get_triplet()[1]
    moved = ca.vertcat(problem.L, problem.f[sorted(set(lam))])
    weighs = ca.jacobian_sparsity(moved, u).get_triplet()[1]
    return tuple(j not in weighs for j in range(problem.m))


def find_deciding_inputs(problem: Problem) -> Mask:
    """
    Return which inputs appear in the derivatives of states and of path constraints.

    Parameters
    ----------
    problem : Problem
        Any problem.

    Returns
    -------
    ndarray of bool, shape (n + l, m)
        A row for each entry of (x, c). The rows of path constraints that depend on inputs
        themselves are False.

    """
    rows = ca.vertcat(problem.x, problem.path)
    rate = ca.mtimes(ca.jacobian(rows, problem.x), problem.f)
    found: Mask = np.zeros((int(rows.numel()), problem.m), dtype=bool)
    found[ca.jacobian_sparsity(rate, problem.u).get_triplet()] = True
    mixed = np.zeros_like(found)
    mixed[ca.jacobian_sparsity(rows, problem.u).get_triplet()] = True
    found[mixed.any(axis=1)] = False
    return found


def find_shared_inputs(problem: Problem) -> Mask:
    """
    Return which inputs appear in path constraints.

    Parameters
    ----------
    problem : Problem
        Any problem.

    Returns
    -------
    ndarray of bool, shape (m,)

    """
    found: Mask = np.zeros(problem.m, dtype=bool)
    found[ca.jacobian_sparsity(problem.path, problem.u).get_triplet()[1]] = True
    return found


def find_clocks(problem: Problem) -> Mask:
    """
    Return the states whose rates are constant, for example a time.

    Parameters
    ----------
    problem : Problem
        Any problem.

    Returns
    -------
    ndarray of bool, shape (n,)
        With T given, such a state is a known function of time.

    """
    z = ca.vertcat(problem.x, problem.u)
    return np.array([not ca.depends_on(rate, z) for rate in ca.vertsplit(problem.f)])


def find_branching_inputs(problem: Problem) -> Mask:
    """
    Return the bounded inputs in which H may have several minima.

    Parameters
    ----------
    problem : Problem
        Any problem.

    Returns
    -------
    ndarray of bool, shape (m,)
        True if both bounds exist, the curvature of H in the input depends on this input, and no
        path constraint contains it.

    """
    boxed = np.isfinite(problem.u_lower) & np.isfinite(problem.u_upper)
    lam, u = ca.SX.sym('lam', problem.n), problem.u
    H = problem.L + ca.dot(lam, problem.f)
    curvature = ca.diag(ca.jacobian(ca.gradient(H, u), u))
    bent, shared = (np.zeros((count, problem.m), dtype=bool) for count in (
        problem.m, problem.path.numel()))
    bent[ca.jacobian_sparsity(curvature, u).get_triplet()] = True
    shared[ca.jacobian_sparsity(problem.path, u).get_triplet()] = True
    return np.asarray(boxed & bent.diagonal() & ~shared.any(axis=0))
