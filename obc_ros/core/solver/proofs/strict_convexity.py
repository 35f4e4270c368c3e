# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Proof that only one mean input attains the infimum of a problem.

Let f = A x + B u + c, L = l(x) + m(u) with an input u, and V, l and the constraints be convex.
Relaxed, m is replaced by its convex hull, and the problem is convex. The difference d of two of
its solutions has d' = A d + B w, d(0) = 0 and Q d = 0, where Q is the constant second derivative
of l: otherwise their mean would cost less. If a k exists with Q A^k B != 0, let it be the first
one: then the derivative k + 1 of Q d = 0 gives w as a linear function of d, so that d = 0 and
w = 0. An input that attains the infimum is a solution of the relaxed problem. Hence it is the mean
of the relaxed one, and where m is above its hull there, it costs more. Without constraints along
the path the infimum is the minimum of the relaxed problem: by Lyapunov's theorem inputs that
switch have the same states at the ends of any short intervals.
"""

from dataclasses import replace
from fractions import Fraction

import casadi as ca
import numpy as np
from obc_ros.core.numerics.rational_polynomials import Polynomial, TooHardError
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.proofs.convexity import is_convex_problem
from obc_ros.core.solver.proofs.existence import read_exactly


def has_one_mean_input(problem: Problem) -> bool:
    """
    Return whether all solutions of the relaxed problem have the same mean input.

    :return: False if nothing is proved.
    """
    x, u = problem.x, problem.u
    rows = ca.vertcat(ca.jacobian(problem.f, ca.vertcat(x, u)), ca.horzcat(
        ca.hessian(problem.L, x)[0], ca.SX(problem.n, 1)))
    if (problem.m != 1 or problem.start is not None or problem.constrained
            or ca.depends_on(ca.jacobian(problem.L, x), u)
            or ca.depends_on(rows, ca.vertcat(x, u))
            or not is_convex_problem(_drop_input_cost(problem))):
        return False
    try:
        *f, L = read_exactly(problem, ca.vertcat(problem.f, problem.L))
    except TooHardError:
        return False
    n = problem.n
    A = np.array([[_linear(each, j) for j in range(n)] for each in f], dtype=object)
    Q = np.array([[_second(L, i, j) for j in range(n)] for i in range(n)], dtype=object)
    reached = np.array([_linear(each, n) for each in f], dtype=object)
    for _ in range(n):
        if any(Q @ reached):
            return True
        reached = A @ reached
    return False


def _drop_input_cost(problem: Problem) -> Problem:
    """Return the problem whose running cost is l(x), up to a constant."""
    inside = np.clip(0.0, problem.u_lower, problem.u_upper)
    return replace(problem, structure='', L=ca.substitute(problem.L, problem.u, ca.DM(inside)))


def _linear(a: Polynomial, k: int) -> Fraction:
    return a.get(((k, 1),), Fraction(0))


def _second(a: Polynomial, i: int, j: int) -> Fraction:
    if i == j:
        return 2 * a.get(((i, 2),), Fraction(0))
    return a.get(((min(i, j), 1), (max(i, j), 1)), Fraction(0))
