# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solution of linear quadratic problems with a fixed horizon by the Riccati equation (2.7)."""

from dataclasses import replace

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import has_jumps
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.riccati.first_order_hold import LqForm
from obc_ros.core.riccati.terminal_constraints import solve_form
from obc_ros.core.solver.proofs.contradictions import explain_contradiction

_DEFINITE = 1e-13   # minimum eigenvalue of R scaled to a unit diagonal


def solve_lq(problem: Problem) -> Solution | None:
    """
    Solve a linear quadratic problem with a fixed horizon.

    :return: None if the problem is not linear quadratic (affine terms are allowed, the cost must
        be strictly convex in u), has path constraints, or a bound may be active. Status
        'infeasible' if exact arithmetic proves that no input meets the terminal constraints;
        'not_converged' if that is not proved, or if the cost has no minimum (a conjugate point).
    """
    if problem.final_time.free or problem.path.numel() or problem.start is not None:
        return None
    form = _find_form(problem)
    if form is None:
        return None
    solution = solve_form(form, problem.x0, problem.final_time.value, problem.states)
    if solution.status is Status.INFEASIBLE and not explain_contradiction(problem):
        # In floating point a target within reach may look out of reach.
        solution = replace(solution, status=Status.NOT_CONVERGED, message=(
            f'no path was found; infeasibility has not been proved ({solution.message})'))
    if not solution.t.size:
        bounds = problem.x_lower, problem.x_upper, problem.u_lower, problem.u_upper
        return solution if np.isinf(np.concatenate(bounds)).all() else None
    return solution if _is_within(problem, solution) else None


def _is_within(problem: Problem, solution: Solution) -> bool:
    """Return whether a path is inside its bounds by its largest change between two samples."""
    for values, lower, upper in ((solution.x, problem.x_lower, problem.x_upper),
                                 (solution.u, problem.u_lower, problem.u_upper)):
        room = np.abs(np.diff(values, axis=0)).max(axis=0, initial=0.0)
        if (values.min(axis=0) - room < lower).any() or (values.max(axis=0) + room > upper).any():
            return False
    return True


def _find_form(problem: Problem) -> LqForm | None:
    """
    Return the matrices of a problem with affine f and psi and quadratic L and V.

    None is returned if the problem is not linear quadratic, a matrix is not finite, or L is not
    strictly convex in u.
    """
    x, u = problem.x, problem.u
    z = ca.vertcat(x, u)
    values = ca.DM(problem.p_value)
    f, L, V, psi = (ca.substitute(expression, problem.p, values) for expression in (
        problem.f, problem.L, problem.V, problem.psi))
    fz, psix = ca.jacobian(f, z), ca.jacobian(psi, x)
    Lzz, Lz = ca.hessian(L, z)
    Vxx, Vx = ca.hessian(V, x)
    if ca.depends_on(ca.veccat(fz, psix, Lzz, Vxx), z) or has_jumps(
            ca.vertcat(f, L, V, psi), z):
        return None
    read = ca.Function('read', [z], [ca.densify(part) for part in (
        fz, f, Lzz, Lz, L, Vxx, Vx, V, psix, psi)])
    parts = [part.full() for part in read(ca.DM.zeros(z.numel()))]
    if not all(np.isfinite(part).all() for part in parts):
        return None
    fz, f, Lzz, Lz, L, Vxx, Vx, V, psix, psi = parts
    n = problem.n
    form = LqForm(
        A=fz[:, :n], B=fz[:, n:], a=f.ravel(),
        Q=Lzz[:n, :n], N=Lzz[:n, n:], R=Lzz[n:, n:], q=Lz[:n, 0], r=Lz[n:, 0], cost=float(L[0, 0]),
        P1=Vxx, p1=Vx[:, 0], terminal_cost=float(V[0, 0]),
        C=psix.reshape(-1, n), d=-psi.ravel())
    return form if _is_definite(form.R) else None


def _is_definite(R: Array) -> bool:
    """Return whether R, scaled to a unit diagonal, is positive definite beyond rounding."""
    size = np.diag(R)
    if not np.all(size > 0.0):
        return False
    d = 1.0 / np.sqrt(size)
    return bool(np.linalg.eigvalsh(R * d * d[:, None])[0] > _DEFINITE)
