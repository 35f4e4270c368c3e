# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Recognition of minimum-time problems and of affine dynamics.

A minimum-time problem minimises rate T + V subject to C x(T) = d, u in a bounded box, with
constant rate > 0 and V, T free, and without constraints along the path.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import has_jumps
from obc_ros.core.ocp.problem import ByStructure, Problem


@dataclass(frozen=True, eq=False)
class Target:
    """
    Target to be reached in minimum time.

    :ivar rate: L, a constant > 0.
    :ivar V: the terminal cost, a constant.
    :ivar C, d: (q, n) and (q,), the terminal constraints are psi = C x(T) - d = 0, q >= 1.
    """

    rate: float
    V: float
    C: Array
    d: Array


@dataclass(frozen=True, eq=False)
class Affine:
    """dx/dt = A x + B u + c; shapes (n, n), (n, m), (n,)."""

    A: Array
    B: Array
    c: Array


@dataclass(frozen=True, eq=False)
class _Form:
    """Values of L, V, psi, f at x = 0, u = 0 with their Jacobian, and whether the forms hold."""

    at_zero: ca.Function
    has_target: bool
    is_affine: bool


def find_target(problem: Problem) -> Target | None:
    """Return the target of a minimum-time problem; None for another problem."""
    if not (problem.final_time.free and problem.boxed.all() and problem.q) or problem.constrained:
        return None
    form = _form(problem)
    if not form.has_target:
        return None
    values, J = _numbers(problem, form)
    end = 2 + problem.q
    rate, V, d, C = float(values[0]), float(values[1]), -values[2:end], J[2:end, :problem.n]
    if not (rate > 0 and np.isfinite(values[:end]).all() and np.isfinite(C).all()):
        return None
    return Target(rate, V, C, d)


def find_affine_dynamics(problem: Problem) -> Affine | None:
    """Return the coefficients of affine dynamics; None if they are not, or not finite at 0."""
    form = _form(problem)
    if not form.is_affine:
        return None
    values, J = _numbers(problem, form)
    c, J = values[-problem.n:], J[-problem.n:]
    if not (np.isfinite(J).all() and np.isfinite(c).all()):
        return None
    return Affine(J[:, :problem.n], J[:, problem.n:], c)


def _numbers(problem: Problem, form: _Form) -> tuple[Array, Array]:
    values, J = form.at_zero(np.zeros(problem.n + problem.m), problem.p_value)
    return values.full().ravel(), J.full()


def _build_form(problem: Problem) -> _Form:
    z = ca.vertcat(problem.x, problem.u)
    values = ca.vertcat(problem.L, problem.V, problem.psi, problem.f)
    J = ca.jacobian(values, z)
    end = 2 + problem.q
    constant = ca.vertcat(values[:2], ca.vec(J[2:end, :]))
    return _Form(ca.Function('form', [z, problem.p], [values, J]),
                 not (ca.depends_on(constant, z) or has_jumps(values[:end], z)),
                 not (ca.depends_on(J[end:, :], z) or has_jumps(problem.f, z)))


_form = ByStructure(_build_form, 64)


def get_final_time(problem: Problem) -> float:
    """Return T [s] if it is given, else its guess, or the geometric mean of its bounds."""
    final = problem.final_time
    if not final.free:
        return final.value
    for wanted in (problem.guess.final_time, final.guess):
        if wanted is not None and np.isfinite(wanted):
            return float(np.clip(wanted, final.lower, final.upper))
    lower, upper = max(final.lower, 1e-3), min(final.upper, 1e6)
    return float(np.sqrt(lower * max(upper, lower)))
