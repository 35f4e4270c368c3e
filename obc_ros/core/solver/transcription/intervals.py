# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The pieces of a transcription: an interval by one of two schemes, ends, path constraints."""

from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.collocation import build_collocation, compute_gauss_points
from obc_ros.core.numerics.runge_kutta import BUTCHER
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.transcription.block_program import Piece


def step(rate: Callable[[ca.SX, ca.SX], ca.SX], x: ca.SX, inputs: tuple[ca.SX, ca.SX],
         h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """
    Return x after an explicit Runge-Kutta step of order 6, and the integral of L, as expressions.

    The input is linear over the step of length h.

    :param rate: returns (f, L), stacked, as a function of (x, cost), stacked, and of u.
    :param inputs: input at the start and at the end.
    """
    start, slopes = ca.vertcat(x, 0), list[ca.SX]()
    for row, u in zip(BUTCHER.A, _along(inputs[0].numel()).call(inputs), strict=True):
        inner = _after(row, start.numel()).call([start, h, *slopes])[0] if row else start
        slopes.append(rate(inner, u))
    end, = _after(BUTCHER.b, start.numel()).call([start, h, *slopes])
    return end[:-1], end[-1]


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
        *step(lambda z, u: rate.call([z, u, problem.p])[0], problem.x, (ua, ub), h)])


def compute_amplification(z: NDArray[np.complex128]) -> Array:
    """Return the |factors| by which a step changes solutions of dx/dt = lambda x; z = lambda h."""
    slopes = np.zeros((len(BUTCHER.c), len(z)), dtype=complex)
    for k, row in enumerate(BUTCHER.A):
        slopes[k] = z * (1 + np.array(row) @ slopes[:k])
    return np.asarray(np.abs(1 + np.array(BUTCHER.b) @ slopes))


def _gauss(problem: Problem, states: tuple[ca.SX, ca.SX, ca.SX], inputs: tuple[ca.SX, ca.SX],
           h: ca.SX) -> tuple[list[ca.SX], ca.SX]:
    """Return the rows and the cost of an interval by collocation at the Gauss points."""
    xa, inner, xb = states
    c, b, derivative, last = build_collocation(inner.shape[1])
    rate = ca.Function('rate', [problem.x, problem.u, problem.p], [problem.f, problem.L])
    rows, cost, end = [], ca.SX(0), last[0] * xa
    for j, point in enumerate(c):
        f, L = rate.call([inner[:, j], (1 - point) * inputs[0] + point * inputs[1], problem.p])
        rows.append(derivative[j, 0] * xa + ca.mtimes(inner, ca.DM(derivative[j, 1:])) - h * f)
        cost += b[j] * h * L
        end += last[j + 1] * inner[:, j]
    return [*rows, xb - end], cost


class Pieces:
    """
    An interval, both ends and the path constraints of a problem, scaled, with their derivatives.

    :param stages: Gauss points in an interval; 0: an explicit Runge-Kutta step.
    :param free: whether lengths of phases are unknown; the derivatives are much longer then.
    """

    def __init__(self, problem: Problem, stages: int, free: bool) -> None:
        n, m = problem.n, problem.m
        sx, su = ca.SX.sym('sx', n), ca.SX.sym('su', m)
        st, sj = ca.SX.sym('st'), ca.SX.sym('sj')
        self.shared = ca.vertcat(problem.p, sx, su, st, sj)
        xa, xb, inner = ca.SX.sym('xa', n), ca.SX.sym('xb', n), ca.SX.sym('inner', n, stages)
        ua, ub = ca.SX.sym('ua', m), ca.SX.sym('ub', m)
        duration, fraction = ca.SX.sym('duration'), ca.SX.sym('fraction')
        limits = ca.Function('limits', [problem.x, problem.u, problem.p], [problem.path])
        none, h = ca.SX(0, 1), st * duration * fraction
        v, own = ([duration], [fraction]) if free else ([], [fraction, duration])
        given = (ca.vertcat(xa, ua, ub, *v, ca.vec(inner), xb), ca.vertcat(*own), self.shared)
        if stages:
            rows, cost = _gauss(problem, (sx * xa, ca.repmat(sx, 1, stages) * inner, sx * xb),
                                (su * ua, su * ub), h)
        else:
            end, cost = step_of(problem).call([sx * xa, su * ua, su * ub, h, problem.p])
            rows = [sx * xb - end]
        points = [(xa, ua)] + [(inner[:, j], (1 - c) * ua + c * ub)
                               for j, c in enumerate(compute_gauss_points(stages))]
        at_points = (limits(sx * x, su * u, problem.p) for x, u in points)
        self.interval = Piece(
            *given, ca.vertcat(*(row / sx for row in rows), *at_points), cost / sj)
        terminal = ca.Function('terminal', [problem.x, problem.p], [problem.psi, problem.V])
        psi, V = terminal.call([sx * xb, problem.p])
        self.end = Piece(xb, none, self.shared, psi, V / sj)
        self.links = None
        if problem.start is not None and problem.start.linked:
            i, j = (list(each) for each in zip(*problem.start.linked, strict=True))
            # In the unit of the first state of each pair.
            self.links = Piece(xa, none, self.shared, xa[i] - xa[j] * sx[j] / sx[i], ca.SX(0))
        self.limits = Piece(ca.vertcat(xb, ub), none, self.shared,
                            limits(sx * xb, su * ub, problem.p), ca.SX(0))
