# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Integration of the inputs of a path from x(0), independent of its states."""

from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.solver.adjoint.costates import CostateIntegrator, cut_inputs


def guess_from_inputs(problem: Problem, found: Solution) -> Problem:
    """Return a problem with a guess from integrating the inputs of a path, within its bounds."""
    t = np.linspace(0.0, found.t[-1], 101)
    u = np.clip(interpolate_columns(t, found.t, found.u), problem.u_lower, problem.u_upper)
    x = _led(problem.pin_start(found.x[0]), t, u[:-1], u[1:])
    if not np.isfinite(x).all():
        return problem
    return replace(problem, guess=Guess(
        dict(zip(problem.states, x.T, strict=True)), dict(zip(problem.inputs, u.T, strict=True)),
        float(t[-1]) if problem.final_time.free else None))


def reaches_end(problem: Problem, found: Solution) -> bool:
    """
    Return whether the inputs of a path lead from x(0) nearly to its x(T).

    If each interval is integrated from the stated state at its begin, states can cross points that
    no path crosses, such as x = 0 for x' = x u: the defect is small relative to the size of x.
    """
    ub = found.u[:-1] if found.interpolation == 'zoh' else found.u[1:]
    problem = problem.pin_start(found.x[0])
    end = _led(problem, *cut_inputs(found.t, found.u[:-1], ub, 16))[-1]   # steps per interval
    size = np.abs(found.x).max(axis=0)
    return bool(np.all(np.abs(end - found.x[-1]) <= 1e-2 * np.maximum(size, 1e-2 * size.max())))


def _led(problem: Problem, t: Array, ua: Array, ub: Array) -> Array:
    with np.errstate(all='ignore'):
        return CostateIntegrator(problem).forward(problem, t, ua, ub)[0]
