# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Recognition of linear quadratic problems, and their matrices.

dx/dt = A x + B u + a
L     = x'Q x / 2 + x'N u + u'R u / 2 + q'x + r'u + constant,  R > 0
V     = x'P1 x / 2 + p1'x + constant
psi   = C x - d
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem

_DEFINITE = 1e-13   # minimum eigenvalue of R scaled to a unit diagonal


@dataclass(frozen=True, eq=False)
class LqForm:
    """The matrices above; `cost` and `terminal_cost` are the constants of L and V."""

    A: Array
    B: Array
    a: Array
    Q: Array
    N: Array
    R: Array
    q: Array
    r: Array
    cost: float
    P1: Array
    p1: Array
    terminal_cost: float
    C: Array
    d: Array


def find_lq_form(problem: Problem) -> LqForm | None:
    """
    Return the matrices of a problem with affine f and psi and quadratic L and V.

    Bounds, path constraints and final time are ignored.

    :return: None if the problem is not linear quadratic, a matrix is not finite, or L is not
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
    if ca.depends_on(ca.veccat(fz, psix, Lzz, Vxx), z):
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
