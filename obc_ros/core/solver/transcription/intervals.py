# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The pieces of a transcription: an interval by one of two schemes, ends, path constraints."""

import casadi as ca
from obc_ros.core.numerics.collocation import build_collocation, compute_gauss_points
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.transcription.block_program import Piece
from obc_ros.core.solver.transcription.runge_kutta import step_of


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


def _explicit(problem: Problem, states: tuple[ca.SX, ca.SX, ca.SX],
              inputs: tuple[ca.SX, ca.SX], h: ca.SX) -> tuple[list[ca.SX], ca.SX]:
    """Return the row and the cost of an interval by one Runge-Kutta step."""
    end, cost = step_of(problem).call([states[0], *inputs, h, problem.p])
    return [states[2] - end], cost


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
        rows, cost = (_gauss if stages else _explicit)(
            problem, (sx * xa, ca.repmat(sx, 1, stages) * inner, sx * xb), (su * ua, su * ub), h)
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
