# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Chattering: problems whose infimum only inputs that switch ever faster approach.

If L + lam' f is not convex in u, a path that follows a mean of f(x, u) and f(x, v) can cost less
than every path that follows f. An input that alternates between u and v fast enough comes
arbitrarily close to it, and no input attains the infimum. The relaxed problem, with u, v and the
share of v as inputs, has a minimum then (L. C. Young, Lectures on the Calculus of Variations and
Optimal Control Theory, 1969). If L + lam' f is concave in an input, mixtures of that input's two
bounds suffice, and the relaxed problem is linear in their share.
"""

from dataclasses import replace
import math

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Mask
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.solver.diagnosis.finite_arcs import Mixture
from obc_ros.core.solver.proofs.convexity import has_one_mean_input

_LOOKS = 11      # points of a path, and inputs at each, at which convexity is examined
_SHARED = '#share'   # suffix of the name of an input's share


def relax_controls(problem: Problem, found: Solution) -> Problem | None:
    """Return the problem with mixtures of two inputs, or None if they cannot cost less."""
    x, u, p = problem.x, problem.u, problem.p
    if ca.depends_on(problem.path, u) or _convex(problem, found):
        return None
    concave = np.flatnonzero(_concave(problem, found))
    if len(concave) == 1:
        return _between_bounds(problem, int(concave[0]), found)
    v, share = ca.SX.sym('v', problem.m), ca.SX.sym('share')
    rate = ca.Function('rate', [x, u, p], [problem.f, problem.L])
    (f, L), (g, M) = rate.call([x, u, p]), rate.call([x, v, p])
    inputs = *problem.inputs, *(f'{name}#v' for name in problem.inputs), '#share'
    # An input that switches is approximated by a mixture of its high and its low values.
    high, low = (np.quantile(found.u, part, axis=0) for part in (0.9, 0.1))
    mixed = np.concatenate([high, low, [0.5]])[:, None]
    return replace(
        problem, structure='', u=ca.vertcat(u, v, share), f=(1 - share) * f + share * g,
        inputs=inputs, guess=Guess(u=dict(zip(inputs, mixed, strict=True))),
        L=(1 - share) * L + share * M,
        u_lower=np.concatenate([problem.u_lower, problem.u_lower, [0.0]]),
        u_upper=np.concatenate([problem.u_upper, problem.u_upper, [1.0]]))


def _between_bounds(problem: Problem, j: int, found: Solution) -> Problem:
    """Return the problem with an input replaced by the share of its lower bound in mixtures."""
    x, u, p, share = problem.x, problem.u, problem.p, ca.SX.sym('share')
    rate = ca.Function('rate', [x, u, p], [problem.f, problem.L])
    names, inputs, bounds = list(problem.inputs), ca.SX(u), (
        problem.u_lower.copy(), problem.u_upper.copy())
    mixed = []
    for bound in (problem.u_upper, problem.u_lower):
        held = ca.SX(u)
        held[j] = bound[j]
        mixed.append(rate.call([x, held, p]))
    (f, L), (g, M) = mixed
    inputs[j], names[j], bounds[0][j], bounds[1][j] = share, f'{names[j]}{_SHARED}', 0.0, 1.0
    part = (problem.u_upper[j] - found.u[:, j]) / (problem.u_upper[j] - problem.u_lower[j])
    times = np.linspace(0.0, found.t[-1], 101)
    x_guess, u_guess = (dict(zip(keys, interpolate_columns(times, found.t, values).T, strict=True))
                        for keys, values in ((problem.states, found.x), (names, np.where(
                            np.arange(problem.m) == j, part[:, None], found.u))))
    return replace(
        problem, structure='', u=inputs, f=(1 - share) * f + share * g, inputs=tuple(names),
        L=(1 - share) * L + share * M, u_lower=bounds[0], u_upper=bounds[1],
        guess=Guess(x=x_guess, u=u_guess, final_time=float(found.t[-1])))


def _concave(problem: Problem, found: Solution) -> Mask:
    """Return in which bounded inputs L + lam' f is concave all along a path, shape (m,)."""
    lam = ca.SX.sym('lam', problem.n)
    H = problem.L + ca.dot(lam, problem.f)
    curvature = ca.vertcat(*[ca.jacobian(ca.jacobian(H, each), each)
                             for each in ca.vertsplit(problem.u)])
    look = ca.Function('curvature', [problem.x, problem.u, lam, problem.p], [curvature])
    spans = problem.u_upper - problem.u_lower
    concave = np.isfinite(spans) & (spans > 0)
    rows = np.linspace(0, len(found.t) - 1, 101).astype(int)
    values = []
    for part in np.linspace(0.0, 1.0, _LOOKS):
        u = np.where(concave, problem.u_lower + part * np.where(concave, spans, 0.0),
                     found.u[rows])
        values.append(look(found.x[rows].T, u.T, found.lam[rows].T, problem.p_value).full())
    each = np.stack(values)   # (looks, m, rows)
    size = np.abs(each).max(axis=(0, 2))
    # The costates, and with them the curvatures, err by up to 0.1 %.
    return np.asarray(concave & (size > 0) & np.all(np.isfinite(each), axis=(0, 2))
                      & np.all(each <= 1e-3 * size[:, None], axis=(0, 2)))


def _convex(problem: Problem, found: Solution) -> bool:
    """Return whether L + lam' f is convex in u for all lam, along a path and around its inputs."""
    x, u, p = problem.x, problem.u, problem.p
    if ca.depends_on(ca.jacobian(problem.f, u), u):
        return False
    curvature = ca.hessian(problem.L, u)[0]
    look = ca.Function('curvature', [x, u, p], [ca.densify(curvature)])
    # Convexity is examined up to twice the largest inputs.
    size = 2.0 * np.abs(found.u).max(axis=0) + 1.0
    for k in np.linspace(0, len(found.t) - 1, _LOOKS).astype(int):
        for part in np.linspace(-1.0, 1.0, _LOOKS):
            inputs = np.clip(found.u[k] + part * size, problem.u_lower, problem.u_upper)
            value = look(found.x[k], inputs, problem.p_value).full()
            if not np.isfinite(value).all() or np.linalg.eigvalsh(value)[0] < -1e-9 * np.abs(
                    value).max():   # beyond rounding
                return False
    return True


def split_mixture(problem: Problem, other: Problem, mixed: Solution) -> Mixture | None:
    """
    Return the two inputs that a solution of the relaxed problem mixes.

    :param problem, other: as stated, and relaxed by `relax_controls`.
    :param mixed: of the relaxed problem, with N samples.
    :return: u, v, share: (N, m), (N, m), (N,), the inputs, and the share of v; None if others
        would cost less.
    """
    m = problem.m
    if other.m != m:
        return mixed.u[:, :m], mixed.u[:, m:2*m], mixed.u[:, 2*m]
    j = next(k for k, name in enumerate(other.inputs) if name.endswith(_SHARED))
    u, v, mean, share = mixed.u.copy(), mixed.u.copy(), mixed.u.copy(), mixed.u[:, j]
    u[:, j], v[:, j] = problem.u_upper[j], problem.u_lower[j]
    mean[:, j] = problem.u_upper[j] - share * (problem.u_upper[j] - problem.u_lower[j])
    return (u, v, share) if _concave(problem, replace(mixed, u=mean))[j] else None


def explain_chattering(problem: Problem, other: Problem, mixed: Solution, found: Solution) -> str:
    """Return a sentence if the relaxed problem's solution costs less by mixing inputs, else ''."""
    gain, parts = found.objective - mixed.objective, split_mixture(problem, other, mixed)
    if parts is None:
        return ''
    u, v, share = parts
    size = np.maximum(np.abs(u).max(axis=0), np.abs(v).max(axis=0))
    # Where u and v differ, and neither share is below 0.01; it must last for 0.01 of T.
    apart = np.abs(u - v) > 1e-2 * size
    mixes = apart.any(axis=1) & (np.abs(share - 0.5) < 0.5 - 1e-2)
    step = np.diff(mixed.t)
    both = mixes[:-1] & mixes[1:] & (step > 0)
    # If a path of the problem itself costs the same, mixing two optimal inputs gains nothing.
    least = 1e-6 * abs(mixed.objective) if found.feasible else 0   # accuracy of certified costs
    if gain <= least or float(step[both].sum()) < 1e-2 * mixed.t[-1]:
        return ''
    k = int(np.flatnonzero(both)[both.sum() // 2])
    pairs = ' and between '.join(
        f'{problem.inputs[i]} = {u[k, i]:.4g} and {v[k, i]:.4g}' for i in np.flatnonzero(apart[k]))
    best = f'; the best path found costs {found.objective:.6g}' if found.feasible else ''
    # Digits beyond what mixing gains are errors of the solution.
    infimum = round(mixed.objective, 5 - math.floor(math.log10(gain))) + 0.0
    verb = 'is not' if has_one_mean_input(problem) else 'may not be'
    return (f'the infimum {infimum:.6g} {verb} attained: minimising sequences chatter, '
            f'at t = {mixed.t[k]:.3g} between {pairs} (relax or regularise the problem){best}')
