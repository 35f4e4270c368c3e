# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Orders of state constraints, derivatives in time until inputs occur; bounds that they imply.

If the first derivative is a product s(u) g(x), such as that of the distance of a robot on wheels
from an obstacle, with its speed s, a path that moves along the bound has g = 0 there. No input
then changes the derivative, and the constraint is one of order 2 with g in place of it: the path
slides.

Bounds of inputs may touch the set of a path constraint, and follow from it. An example is -g <= a
beside a^2 + b^2 <= g^2. Where both are active their gradients are parallel. Their multipliers are
then not unique, and an interior-point method stays at such a point.
"""

from collections.abc import Iterable, Mapping
from functools import cached_property

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.instructions import find_dependence
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.arcs.state_contacts import StateContact
from obc_ros.core.solver.transcription.mesh import Path

_ORDERS = 3    # highest order of a constraint that is treated


class BoundRates:
    """
    The rows of (x, c) and their time derivatives up to the first in which inputs occur.

    :param sliding: rows along whose bounds the path slides, and a value S of s there, from
        `find_sliding`. For these the derivatives are those of g: c, S g, S dg/dt.
    :ivar count: n + l, the number of rows.
    :ivar orders: (n + l,), order of that derivative; 0: inputs occur in the row itself; -1: in
        none up to _ORDERS.
    :ivar deciding: (n + l, m), inputs that occur in it.
    :ivar straight: (n + l,), whether the row itself has inputs and is linear in them.
    :ivar chains: for each row the row and its derivatives.
    """

    def __init__(self, problem: Problem, sliding: Mapping[int, float] | None = None
                 ) -> None:
        self._problem, self.sliding = problem, dict(sliding or {})
        rows = ca.vertcat(problem.x, problem.path)
        self.count = int(rows.numel())
        self.orders = np.full(self.count, -1)
        self.deciding: Mask = np.zeros((self.count, problem.m), dtype=bool)
        self.straight: Mask = np.zeros(self.count, dtype=bool)
        self.chains: list[list[ca.SX]] = []
        for row, value in enumerate(ca.vertsplit(rows)):
            chain = [value]
            for order in range(_ORDERS + 1):
                if ca.depends_on(chain[-1], problem.u):
                    self.orders[row] = order
                    self.deciding[row] = find_dependence(chain[-1], problem.u)[0]
                    slope = ca.jacobian(chain[-1], problem.u)
                    self.straight[row] = not order and not ca.depends_on(slope, problem.u)
                    break
                chain.append(ca.jtimes(chain[-1], problem.x, problem.f))
            self.chains.append(chain)
        for row, speed in self.sliding.items():
            g = speed * self.slides[row][1]
            rate = ca.jtimes(g, problem.x, problem.f)
            self.chains[row] = [self.chains[row][0], g, rate]
            self.orders[row], self.deciding[row] = 2, find_dependence(rate, problem.u)[0]

    @property
    def following(self) -> Mask:
        """Return the rows that free inputs hold at a bound while others stay at theirs."""
        return np.array([not order or row in self.sliding
                         for row, order in enumerate(self.orders.tolist())], dtype=bool)

    @cached_property
    def slides(self) -> dict[int, tuple[ca.SX, ca.SX]]:
        """Return s(u) and g(x) of the rows of order 1 whose derivative is s(u) g(x)."""
        problem, found = self._problem, {}
        rows = ca.vertsplit(ca.vertcat(problem.x, problem.path))
        for row in np.flatnonzero(self.orders == 1).tolist():
            factors = _factor(problem, ca.jtimes(rows[row], problem.x, problem.f))
            if factors is not None:
                found[row] = factors
        return found

    @cached_property
    def factors(self) -> dict[int, ca.Function]:
        """Return for these rows the functions (x, u, p) -> s, g; of the sliding ones s/S, S g."""
        x, u, p = self._problem.x, self._problem.u, self._problem.p
        return {row: ca.Function('factors', [x, u, p], [s / speed, g * speed])
                for row, (s, g) in self.slides.items()
                for speed in [self.sliding.get(row, 1.0)]}


def find_sliding(problem: Problem, bounds: BoundRates, path: Path,
                 contacts: Iterable[StateContact]) -> dict[int, float]:
    """
    Find the constraints along whose bounds a path slides.

    :param path: it stops at a bound if s is smaller there than g, both relative to their largest
        values.
    :return: rows, and the mean s in their contacts. A row is left out if the path stops at its
        bound, or if s changes its sign from one contact to another.
    """
    parts = np.linspace(0.0, 1.0, 5)[1:-1]
    found = {}
    for row, factors in bounds.factors.items():
        times = [each.start + parts * (each.end - each.start)
                 for each in contacts if each.row == row]
        if not times:
            continue
        t = np.append(path.t, np.concatenate(times))
        x, u = path.states_at(t), path.inputs_at(t, after=True)
        s, g = (each.full()[0] for each in factors.map(len(t))(x.T, u.T, problem.p_value))
        there = slice(len(path.t), None)
        moves = np.abs(s[there]) * np.abs(g).max() > np.abs(g[there]) * np.abs(s).max()
        if moves.all() and np.ptp(np.sign(s[there])) == 0:
            found[row] = float(s[there].mean())
    return found


def _factor(problem: Problem, rate: ca.SX) -> tuple[ca.SX, ca.SX] | None:
    """Return s(u), homogeneous and linear, and g(x) with rate = s g; None if there are none."""
    slope = ca.jacobian(rate, problem.u)
    used = np.flatnonzero(find_dependence(rate, problem.u)[0]).tolist()
    if ca.depends_on(slope, problem.u) or not ca.depends_on(slope, problem.x):
        return None
    g, chance = slope[used[0]], np.random.default_rng(0)
    point = ca.DM(chance.uniform(0.5, 1.5, problem.n))
    parts = ca.substitute(slope[used] / g, problem.x, point)
    s = ca.mtimes(parts, problem.u[used])
    if not ca.depends_on(ca.jtimes(g, problem.x, problem.f), problem.u):
        return None
    both = ca.Function('both', [problem.x, problem.u, problem.p], [rate, s * g])
    for _ in range(5):
        given = [chance.uniform(0.5, 1.5, size.numel()) for size in (
            problem.x, problem.u, problem.p)]
        left, right = (float(value) for value in both(*given))
        if not abs(left - right) <= 1e-9 * (abs(left) + abs(right)):   # rounding
            return None
    return s, g


def build_curvatures(problem: Problem) -> list[ca.Function]:
    """Return for each constraint the function (x, u, p) -> c, dc/du (m,), d2c/du2 (m, m)."""
    x, u, p = problem.x, problem.u, problem.p
    slopes = [ca.gradient(row, u) for row in ca.vertsplit(problem.path)]
    return [ca.Function('curvatures', [x, u, p], [row, slope, ca.jacobian(slope, u)])
            for row, slope in zip(ca.vertsplit(problem.path), slopes, strict=True)]


def find_implied_bounds(problem: Problem, curvatures: ca.Function, at: tuple[Array, Array],
                        sign: int, level: float, free: Mask) -> Mask:
    """
    Find the bounds of inputs that follow from one path constraint.

    :param curvatures: of the constraint, from `build_curvatures`.
    :param at: (K, n), (K, m), states and inputs at some times.
    :param sign, level: 1 for c <= level, -1 for c >= level.
    :param free: (m,), inputs of the constraint.
    :return: (2, m), lower and upper bounds that touch the set of the constraint at all the given
        states. A bound outside of that set is never active, and not returned: elsewhere it may cut
        the set. The judgement is exact for a constraint that is quadratic in the free inputs;
        another one is approximated at the given inputs.
    """
    implied: Mask = np.zeros((2, problem.m), dtype=bool)
    for side, bound in enumerate((problem.u_lower, problem.u_upper)):
        for i in np.flatnonzero(free & np.isfinite(bound)):
            others = free.copy()
            others[i] = False
            pairs = [(x, np.where(np.arange(problem.m) == i, bound, u))
                     for x, u in zip(*at, strict=True)]
            implied[side, i] = all(
                _is_tangent([sign * each.full() for each in curvatures(x, u, problem.p_value)],
                            sign * level, others) for x, u in pairs)
    return implied


def _is_tangent(derivatives: list[Array], level: float, others: Mask) -> bool:
    """Return whether the minimum of a row over the `others` is its upper bound `level`."""
    (value,), slope, curvature = derivatives[0].ravel(), derivatives[1].ravel(), derivatives[2]
    if others.any():
        bend, tilt = curvature[np.ix_(others, others)], slope[others]
        if np.linalg.eigvalsh(bend)[0] <= 0:
            return False
        value = value - 0.5 * float(tilt @ np.linalg.solve(bend, tilt))
    return bool(abs(value - level) <= 1e-9 * max(abs(level), abs(value)))   # rounding
