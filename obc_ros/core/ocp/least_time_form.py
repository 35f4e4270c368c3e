# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What problems of least time have in common, read off a Problem.

Minimise rate T + V subject to C x(T) = d, u in a bounded box, with rate > 0 and V constant, T
free, and no constraints along the path.
"""

from collections import OrderedDict
from dataclasses import dataclass

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem

_KEPT = 64


@dataclass(frozen=True, eq=False)
class Target:
    """
    A target to be reached in least time.

    Attributes
    ----------
    rate : float
        L, a constant > 0.
    V : float
        The terminal cost, a constant.
    C, d : ndarray, shape (q, n) and (q,)
        The terminal constraints are psi = C x(T) - d = 0, q >= 1.

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
    """The values L, V, psi, f at x = 0, u = 0 and their Jacobian, and which are of the form."""

    at_zero: ca.Function
    has_target: bool
    is_affine: bool


def find_target(problem: Problem) -> Target | None:
    """Return the target of a problem of least time, None for another problem."""
    bounded = (np.isfinite(problem.x_lower).any() or np.isfinite(problem.x_upper).any()
               or problem.path.numel() > 0)
    boxed = np.isfinite(problem.u_lower).all() and np.isfinite(problem.u_upper).all()
    if not problem.final_time.free or bounded or not boxed or problem.q == 0:
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
    """Return the dynamics if they are affine in x and u together, else None."""
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


_forms: OrderedDict[str, _Form] = OrderedDict()


def _form(problem: Problem) -> _Form:
    """Return the form of a problem's structure, from memory where it can be."""
    form = _forms.pop(problem.structure, None) or _new_form(problem)
    if problem.structure:
        _forms[problem.structure] = form
        if len(_forms) > _KEPT:
            _forms.popitem(last=False)
    return form


def _new_form(problem: Problem) -> _Form:
    z = ca.vertcat(problem.x, problem.u)
    values = ca.vertcat(problem.L, problem.V, problem.psi, problem.f)
    J = ca.jacobian(values, z)
    end = 2 + problem.q
    constant = ca.vertcat(values[:2], ca.vec(J[2:end, :]))
    return _Form(ca.Function('form', [z, problem.p], [values, J]),
                 not ca.depends_on(constant, z), not ca.depends_on(J[end:, :], z))


def get_final_time(problem: Problem) -> float:
    """Return T, or where the search for it starts."""
    final = problem.final_time
    if not final.free:
        return final.value
    for wanted in (problem.guess.final_time, final.guess):
        if wanted is not None and np.isfinite(wanted):
            return float(np.clip(wanted, final.lower, final.upper))
    lower, upper = max(final.lower, 1e-3), min(final.upper, 1e6)
    return float(np.sqrt(lower * max(upper, lower)))
