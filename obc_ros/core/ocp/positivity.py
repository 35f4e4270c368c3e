# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Bounds that every path keeps to by itself: amounts that cannot become negative.

Where dx_i/dt >= 0 whenever x_i = 0 and the other amounts are not negative, no path from
x(0) >= 0 has x_i < 0. Long steps of a coarse mesh do not know that: in chemical and biological
systems they jump over poles of the rates at small negative concentrations, to where the model
says nothing. The condition is looked at where chance leads; it only guides searches.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem

_LOOKS, _AT_ONCE = 256, 64
_RANGE = (-4.0, 2.0)   # powers of ten of what counts as one in a state
_INPUT = 10.0          # how large an input without a bound is taken to be
_ROUNDING, _MOST = 1e-12, 0.9   # of a rate larger than such a part of all: few are at poles
_FAR = 0.05            # of the largest amount: beyond what the errors of steps explain


def find_amounts(problem: Problem, size: Array) -> NDArray[np.bool_]:
    """
    Return which states seem to stay at or above zero by themselves, shape (n,).

    `size`: the largest values seen of each; x(0) alone may lie at the origin of some map.
    """
    chance, n = np.random.default_rng(0), problem.n
    size = np.maximum(size, np.abs(problem.x0))
    size = np.maximum(size, 1e-2 * max(size.max(), 1e-2))
    x = size * 10 ** chance.uniform(*_RANGE, (_LOOKS, n))
    lower, upper = (np.where(np.isfinite(bound), bound, sign * _INPUT) for bound, sign in (
        (problem.u_lower, -1.0), (problem.u_upper, 1.0)))
    part = chance.integers(0, 3, (_LOOKS, problem.m)) / 2
    sign = chance.choice([-1.0, 1.0], (_LOOKS, n))
    part[::2] = chance.uniform(0, 1, part[::2].shape)   # ends and middle of turns look alike
    u = lower + (upper - lower) * part
    rate = VectorizedFunction([problem.x, problem.u, problem.p], [problem.f])
    found = problem.x0 >= 0
    while found.any():
        before = found.copy()
        for i in np.flatnonzero(before):
            at = np.where(found, x, sign * x)
            at[:, i] = 0.0
            # Most that fall do so at once.
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
    Return a problem that keeps amounts from becoming negative, or itself if it has no need to.

    `astray`: paths (N + 1, n); amounts that are not far below zero on one are left as they are.
    """
    paths = np.nan_to_num(np.vstack(astray))
    size = np.abs(paths).max(axis=0)
    far = paths.min(axis=0) < -_FAR * size
    below = far & (problem.x_lower < 0) & (problem.x0 >= 0)
    below = below & find_amounts(problem, size) if below.any() else below
    return replace(problem, x_lower=np.where(below, 0.0, problem.x_lower),
                   structure='') if below.any() else problem
