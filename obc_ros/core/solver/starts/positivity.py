# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Positivity: states that remain nonnegative on every path, estimated from samples.

If dx_i/dt >= 0 whenever x_i = 0 and the other amounts are nonnegative, no path from x(0) >= 0 has
x_i < 0. The discretisation on a coarse mesh can violate this: in chemical and biological systems
it jumps over poles of the rates at small negative concentrations, to states for which the model is
not valid. The condition is checked at random states and inputs only; it guides searches and
proves nothing.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem

_LOOKS, _AT_ONCE = 256, 64   # samples, and those that are evaluated first
_RANGE = (-4.0, 2.0)   # powers of ten of samples, in units of the size of a state
_INPUT = 10.0          # bound of an input without a bound
_ROUNDING, _MOST = 1e-12, 0.9   # of this quantile of rates; few samples are close to poles
_FAR = 0.05            # of the largest amount: above the discretisation error


def find_amounts(problem: Problem, size: Array) -> NDArray[np.bool_]:
    """
    Return which states seem to remain nonnegative, shape (n,).

    `size`: the largest values of each on paths; x(0) alone may be 0 for coordinates in a plane.
    """
    chance, n = np.random.default_rng(0), problem.n
    size = np.maximum(size, np.abs(problem.x0))
    size = np.maximum(size, 1e-2 * max(size.max(), 1e-2))
    x = size * 10 ** chance.uniform(*_RANGE, (_LOOKS, n))
    lower, upper = (np.where(np.isfinite(bound), bound, sign * _INPUT) for bound, sign in (
        (problem.u_lower, -1.0), (problem.u_upper, 1.0)))
    part = chance.integers(0, 3, (_LOOKS, problem.m)) / 2
    sign = chance.choice([-1.0, 1.0], (_LOOKS, n))
    # Not only ends and middle: they can be equivalent for angles.
    part[::2] = chance.uniform(0, 1, part[::2].shape)
    u = lower + (upper - lower) * part
    rate = VectorizedFunction([problem.x, problem.u, problem.p], [problem.f])
    found = problem.start_box[0] >= 0
    while found.any():
        before = found.copy()
        for i in np.flatnonzero(before):
            at = np.where(found, x, sign * x)
            at[:, i] = 0.0
            # Most states that can become negative do so at one of the first samples.
            found[i] = all(_never_falls(rate(at[:looks], u[:looks], problem.p_value)[0][:, i])
                           for looks in (_AT_ONCE, _LOOKS))
        if np.array_equal(found, before):
            break
    return found


def _never_falls(rate: Array) -> bool:
    with np.errstate(invalid='ignore'):   # rates may be infinite
        return bool(np.all(rate >= -_ROUNDING * np.quantile(np.abs(rate), _MOST)))


def keep_amounts_positive(problem: Problem, astray: Sequence[Array]) -> Problem:
    """
    Return a problem with lower bounds 0 for amounts that became negative on paths.

    Parameters
    ----------
    problem : Problem
        Any problem.
    astray : sequence of ndarray, shape (N + 1, n)
        States of searches that did not converge. Only amounts that are far below zero on one of
        them are bounded.

    Returns
    -------
    Problem
        The same problem if no amount needs a bound.

    """
    paths = np.nan_to_num(np.vstack(astray))
    size = np.abs(paths).max(axis=0)
    far = paths.min(axis=0) < -_FAR * size
    below = far & (problem.x_lower < 0) & (problem.start_box[0] >= 0)
    below = below & find_amounts(problem, size) if below.any() else below
    return replace(problem, x_lower=np.where(below, 0.0, problem.x_lower),
                   structure='') if below.any() else problem
