# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Finitely many arcs that attain the minimum of a relaxed problem.

A mixture of u and v has the mean of f(x, u) and f(x, v) as its rate. If these and the costs do not
depend on the states that the mixture moves, as in sailing upwind, a few arcs of u and of v with
the same shares reach the same end at the same cost. Two arcs show whether this is so: their path
has to meet all conditions but the bounds of states. Only then is [0, T] divided into more and more
equal periods, each with an arc of u and one of v in alternating order, until it stays within
bounds. Otherwise arcs would get ever closer to the minimum without attaining it.
"""

from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Condition, Solution
from obc_ros.core.solver.adjoint.costates import CostateIntegrator

Mixture = tuple[Array, Array, Array]


def attain_by_arcs(problem: Problem, mixed: Solution, mixture: Mixture) -> Solution | None:
    """
    Return a certified path of finitely many arcs that costs as much as the relaxed solution.

    :param mixed: of the relaxed problem.
    :param mixture: its inputs u, v and the share of v, as `relaxed_controls.split_mixture` returns
        them.
    :return: with its certificate; None if no number of arcs that was tried has one that passes.
    """
    follow = _Follower(problem, mixed, mixture)
    for periods in (2**k for k in range(9)):
        for v_first in (False, True):
            path = follow.sample(periods, v_first)
            slack = 1e-6 * (1.0 + np.abs(path.x).max(axis=0))   # in doubt the certificate decides
            out = (path.x < problem.x_lower - slack) | (path.x > problem.x_upper + slack)
            if periods > 1 and out.any():
                continue
            certificate = certify(problem, path)
            if certificate.holds:
                return replace(path, certificate=certificate)
            if any(certificate.residuals[key] > allowed
                   for key, allowed in certificate.tolerances.items()
                   if key != Condition.BOUNDS):
                return None
    return None


class _Follower:
    """Paths that switch between the two inputs of a mixture."""

    def __init__(self, problem: Problem, mixed: Solution, mixture: Mixture) -> None:
        self._problem, self._mixed = problem.pin_start(mixed.x[0]), mixed
        self._u, self._v, share = mixture
        step = np.diff(mixed.t) * (share[1:] + share[:-1]) / 2
        self._shared = np.append(0.0, np.cumsum(step))   # integral of the share of v
        self._integrator = CostateIntegrator(problem)

    def sample(self, periods: int, v_first: bool) -> Solution:
        """Return a path without certificate; `v_first`: v is the first input."""
        problem, mixed = self._problem, self._mixed
        ends, is_v = self._switch(periods, v_first)
        T = float(mixed.t[-1])
        t = np.unique(np.concatenate([mixed.t, ends, np.linspace(0.0, T, 200)]))   # at least
        t = t[np.append(True, np.diff(t) > 1e-12 * T)]
        t[-1] = T
        arc = np.clip(np.searchsorted(ends, (t[1:] + t[:-1]) / 2), 0, len(is_v) - 1)
        inside = 1e-6 * np.diff(t)
        a, b = t[:-1] + inside, t[1:] - inside   # the two sides of a jump differ
        ua, ub = (np.where(is_v[arc][:, None], interpolate_columns(at, mixed.t, self._v),
                           interpolate_columns(at, mixed.t, self._u)) for at in (a, b))
        x, spent = self._integrator.forward(problem, t, ua, ub)
        cost = spent[-1] + self._integrator.ends(problem, x[-1:])[0][0]
        return self._solution(t, x, (ua, ub), float(cost),
                              t[1:-1][np.diff(is_v[arc].astype(int)) != 0])

    def _switch(self, periods: int, v_first: bool) -> tuple[Array, Mask]:
        """Return the end of each arc, and whether its input is v."""
        edges = np.linspace(0.0, self._mixed.t[-1], periods + 1)
        part = np.diff(np.interp(edges, self._mixed.t, self._shared))
        ends, is_v = list[float](), list[bool]()
        for k, (begin, end) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
            before = v_first != bool(k % 2)
            ends += [begin + part[k] if before else end - part[k], end]
            is_v += [before, not before]
        return np.array(ends), np.array(is_v)

    def _solution(self, t: Array, x: Array, inputs: tuple[Array, Array], J: float,
                  switches: Array) -> Solution:
        """Return samples, two at a time at which the input jumps."""
        problem, mixed = self._problem, self._mixed
        rows = np.repeat(np.arange(len(t)), 2)[1:-1]
        u = np.clip(np.stack(inputs, axis=1).reshape(len(rows), -1), problem.u_lower,
                    problem.u_upper)
        keep = np.append(True, (np.diff(rows) > 0) | np.isin(t[rows[1:]], switches))
        rows, u = rows[keep], u[keep]
        lam = interpolate_columns(t[rows], mixed.t, mixed.lam)
        H, _, _ = self._integrator.hamiltonian(problem, x[rows], u, lam)
        return replace(
            mixed, message='', objective=J, t=t[rows], x=x[rows], u=u, lam=lam, hamiltonian=H,
            interpolation='linear', switching_times=switches, state_multipliers=None,
            path_multipliers=None, certificate=None, optimality=None, attempts=())
