# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is true of the expressions of a problem whatever its numbers: which inputs do what."""

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Mask
from obc_ros.core.ocp.problem import Problem


def find_switching_inputs(problem: Problem) -> tuple[bool, ...]:
    """Return for each input whether H is linear in it while the others stay."""
    lam = ca.SX.sym('lam', problem.n)
    H = problem.L + ca.dot(lam, problem.f)
    return tuple(
        bool(ca.sparsify(ca.jacobian(ca.gradient(H, u), u)).nnz() == 0)
        for u in ca.vertsplit(problem.u))


def find_idle_inputs(problem: Problem) -> tuple[bool, ...]:
    """Return for each input whether it moves nothing, at T, that weighs there or in L."""
    x, u = problem.x, problem.u
    lam = ca.jacobian_sparsity(ca.vertcat(problem.V, problem.psi), x).get_triplet()[1]
    moved = ca.vertcat(problem.L, problem.f[sorted(set(lam))])
    weighs = ca.jacobian_sparsity(moved, u).get_triplet()[1]
    return tuple(j not in weighs for j in range(problem.m))


def find_deciding_inputs(problem: Problem) -> Mask:
    """Return which inputs enter the rate of each row of (x, c), (n + l, m); none of mixed rows."""
    rows = ca.vertcat(problem.x, problem.path)
    rate = ca.mtimes(ca.jacobian(rows, problem.x), problem.f)
    found: Mask = np.zeros((int(rows.numel()), problem.m), dtype=bool)
    found[ca.jacobian_sparsity(rate, problem.u).get_triplet()] = True
    mixed = np.zeros_like(found)
    mixed[ca.jacobian_sparsity(rows, problem.u).get_triplet()] = True
    found[mixed.any(axis=1)] = False
    return found


def find_shared_inputs(problem: Problem) -> Mask:
    """Return which inputs path constraints hold, (m,)."""
    found: Mask = np.zeros(problem.m, dtype=bool)
    found[ca.jacobian_sparsity(problem.path, problem.u).get_triplet()[1]] = True
    return found


def find_branching_inputs(problem: Problem) -> Mask:
    """Return in which bounded inputs H may have several least points, shape (m,)."""
    boxed = np.isfinite(problem.u_lower) & np.isfinite(problem.u_upper)
    lam, u = ca.SX.sym('lam', problem.n), problem.u
    H = problem.L + ca.dot(lam, problem.f)
    curvature = ca.diag(ca.jacobian(ca.gradient(H, u), u))
    bent, shared = (np.zeros((count, problem.m), dtype=bool) for count in (
        problem.m, problem.path.numel()))
    bent[ca.jacobian_sparsity(curvature, u).get_triplet()] = True
    shared[ca.jacobian_sparsity(problem.path, u).get_triplet()] = True
    return np.asarray(boxed & bent.diagonal() & ~shared.any(axis=0))
