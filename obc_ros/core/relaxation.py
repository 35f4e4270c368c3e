# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Whether the least cost is approached only by an input that switches faster and faster.

Where L + lam' f is not convex in u, paths that follow a mean of f(x, u) and f(x, v) can cost less
than any that follows f itself; an input that alternates between u and v quickly enough comes as
near to them as one likes, and none is best. The relaxed problem, with u, v and the share of v as
inputs, has a minimum then (L. C. Young, Lectures on the Calculus of Variations and Optimal Control
Theory, 1969).
"""

from dataclasses import replace

import casadi as ca
import numpy as np
from obc_ros.core.problem import Guess, Problem
from obc_ros.core.solution import Solution

_APART = 1e-2    # of an input's largest value: what counts as two inputs
_SHARE = 1e-2    # of the time, at least, of each of them
_LASTING = 1e-2  # of T, at least
_VALUES = 0.9, 0.1   # quantiles of an input: between what it switches
_LOOKS = 11      # points of a path, and inputs at each
_WINDOW = 2.0    # of the largest inputs: how far around them
_FLAT = 1e-9     # of the largest curvature


def relaxed(problem: Problem, found: Solution) -> Problem | None:
    """Return the problem with mixtures of two inputs, or None where they cannot cost less."""
    x, u, p = problem.x, problem.u, problem.p
    if ca.depends_on(problem.path, u) or _convex(problem, found):
        return None
    v, share = ca.SX.sym('v', problem.m), ca.SX.sym('share')
    rate = ca.Function('rate', [x, u, p], [problem.f, problem.L])
    (f, L), (g, M) = rate.call([x, u, p]), rate.call([x, v, p])
    inputs = *problem.inputs, *(f'{name}#v' for name in problem.inputs), '#share'
    # Where an input switches it is a mixture of its high and its low values.
    high, low = (np.quantile(found.u, part, axis=0) for part in _VALUES)
    mixed = np.concatenate([high, low, [0.5]])[:, None]
    return replace(
        problem, structure='', u=ca.vertcat(u, v, share), f=(1 - share) * f + share * g,
        inputs=inputs, guess=Guess(u=dict(zip(inputs, mixed, strict=True))),
        L=(1 - share) * L + share * M,
        u_lower=np.concatenate([problem.u_lower, problem.u_lower, [0.0]]),
        u_upper=np.concatenate([problem.u_upper, problem.u_upper, [1.0]]))


def _convex(problem: Problem, found: Solution) -> bool:
    """Return whether L + lam' f is convex in u for all lam, along a path and around its inputs."""
    x, u, p = problem.x, problem.u, problem.p
    if ca.depends_on(ca.jacobian(problem.f, u), u):
        return False
    curvature = ca.hessian(problem.L, u)[0]
    look = ca.Function('curvature', [x, u, p], [ca.densify(curvature)])
    size = _WINDOW * np.abs(found.u).max(axis=0) + 1.0
    for k in np.linspace(0, len(found.t) - 1, _LOOKS).astype(int):
        for part in np.linspace(-1.0, 1.0, _LOOKS):
            inputs = np.clip(found.u[k] + part * size, problem.u_lower, problem.u_upper)
            value = look(found.x[k], inputs, problem.p_value).full()
            if not np.isfinite(value).all() or np.linalg.eigvalsh(value)[0] < -_FLAT * np.abs(
                    value).max():
                return False
    return True


def chattering(problem: Problem, mixed: Solution, found: Solution) -> str:
    """Return a sentence if the relaxed answer costs less by mixing inputs; '' if not."""
    m, gain = problem.m, found.objective - mixed.objective
    u, v, share = mixed.u[:, :m], mixed.u[:, m:2*m], mixed.u[:, 2*m]
    size = np.maximum(np.abs(u).max(axis=0), np.abs(v).max(axis=0))
    apart = np.abs(u - v) > _APART * size
    mixes = apart.any(axis=1) & (np.abs(share - 0.5) < 0.5 - _SHARE)
    step = np.diff(mixed.t)
    both = mixes[:-1] & mixes[1:] & (step > 0)
    if gain <= 0 or float(step[both].sum()) < _LASTING * mixed.t[-1]:
        return ''
    k = int(np.flatnonzero(both)[both.sum() // 2])
    pairs = ' and between '.join(
        f'{problem.inputs[i]} = {u[k, i]:.4g} and {v[k, i]:.4g}' for i in np.flatnonzero(apart[k]))
    return (f'no input attains the least cost: {mixed.objective:.6g} is approached by switching '
            f'faster and faster, at t = {mixed.t[k]:.3g} between {pairs}; the best path found '
            f'costs {found.objective:.6g}')
