# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One explicit Runge-Kutta step of order 6, under an input linear over the step."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.runge_kutta import BUTCHER
from obc_ros.core.ocp.problem import Problem


def step(rate: Callable[[ca.SX, ca.SX], ca.SX], x: ca.SX, inputs: tuple[ca.SX, ca.SX],
         h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """
    Return x after a step of length h, and the integral of L over it, as expressions.

    :param rate: returns (f, L), stacked, as a function of (x, cost), stacked, and of u.
    :param inputs: input at the start and at the end.
    """
    start, slopes = ca.vertcat(x, 0), list[ca.SX]()
    for row, u in zip(BUTCHER.A, _called(_along(inputs[0].numel()), *inputs), strict=True):
        inner = _called(_after(row, start.numel()), start, h, *slopes)[0] if row else start
        slopes.append(rate(inner, u))
    end, = _called(_after(BUTCHER.b, start.numel()), start, h, *slopes)
    return end[:-1], end[-1]


def _called(function: ca.Function, *arguments: ca.SX) -> Sequence[ca.SX]:
    return function.call(arguments)


# Calling a cached function is faster than building its operations again.
@lru_cache(maxsize=64)
def _along(m: int) -> ca.Function:
    """Return the function from the inputs at both ends to those at the stages."""
    a, b = ca.SX.sym('a', m), ca.SX.sym('b', m)
    change, between = b - a, {0.0: a, 1.0: b}
    between |= {c: a + c * change for c in BUTCHER.c if c not in between}
    return ca.Function('along', [a, b], [between[c] for c in BUTCHER.c])


@lru_cache(maxsize=256)
def _after(weights: tuple[float, ...], n: int) -> ca.Function:
    """Return the function from start, h and all slopes, each (n,), to start + h weights'slopes."""
    start, h = ca.SX.sym('start', n), ca.SX.sym('h')
    slopes = [ca.SX.sym('slope', n) for _ in weights]
    total = sum((a * slope for a, slope in zip(weights, slopes, strict=True) if a), ca.SX(0))
    return ca.Function('after', [start, h, *slopes], [start + h * total])


@lru_cache(maxsize=4)
def step_of(problem: Problem) -> ca.Function:
    """
    Return the step of a problem as a function, cached.

    From x, u at the start, u at the end, h and p to x after the step and the integral of L.
    """
    ua, ub = ca.SX.sym('ua', problem.m), ca.SX.sym('ub', problem.m)
    h = ca.SX.sym('h')
    rate = ca.Function('rate', [ca.vertcat(problem.x, ca.SX.sym('cost')), problem.u, problem.p],
                       [ca.vertcat(problem.f, problem.L)])
    return ca.Function('step', [problem.x, ua, ub, h, problem.p], [
        *step(lambda z, u: _called(rate, z, u, problem.p)[0], problem.x, (ua, ub), h)])


def compute_amplification(z: NDArray[np.complex128]) -> Array:
    """Return the |factors| by which a step changes solutions of dx/dt = lambda x; z = lambda h."""
    slopes = np.zeros((len(BUTCHER.c), len(z)), dtype=complex)
    for k, row in enumerate(BUTCHER.A):
        slopes[k] = z * (1 + np.array(row) @ slopes[:k])
    return np.asarray(np.abs(1 + np.array(BUTCHER.b) @ slopes))
