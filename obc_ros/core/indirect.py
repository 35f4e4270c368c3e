# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Pontryagin's boundary value problem, solved directly by Newton's method from a path nearby.

In every arc each input is at a bound or makes dH/du = 0; x and lam obey

    dx/dt = f(x, u),   dlam/dt = -dH/dx,   x(0) = x0,   psi(x(T)) = 0,
    lam(T) = dV/dx + nu' dpsi/dx,   H(T) = 0 where T is free,

by collocation at three Gauss points in each interval (order 6). The lengths of the arcs are
unknown, too: where an input jumps H does not, where it meets a bound dH/du = 0 there.
Arcs on which dH/du vanishes without determining u, or on a bound of the state, are not treated.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.arcs import Arc
from obc_ros.core.blocks import assemble, Block, Piece, Program
from obc_ros.core.extremal import Extremal
from obc_ros.core.mesh import gauss_points
from obc_ros.core.problem import Problem
from obc_ros.core.transcription import collocation, Scales

Array = NDArray[np.float64]
Index = NDArray[np.int64]
# f, dH/dx, dH/du and H at x, u, lam; the equation of an input that is free or held.
Parts = Callable[[ca.SX, ca.SX, ca.SX], list[ca.SX]]
Inputs = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]

_STAGES = 3
_FEWEST = 6        # intervals in an arc
_MOST_STEPS = 30
_TOLERANCE = 1e-11


@dataclass(frozen=True, eq=False)
class BoundaryValues:
    """
    A solution of the boundary value problem.

    `t` (N + 1,), `x`, `lam` (N + 1, n) at mesh points, `lengths` of the arcs, `nu` (q,), and the
    largest scaled residual that is left.
    """

    t: Array
    x: Array
    lam: Array
    inner_t: Array
    inner_lam: Array
    u: Array
    lengths: Array
    nu: Array
    residual: float

    def costates_at(self, times: Array) -> Array:
        """Return lam at any times, by the polynomials of the collocation."""
        k = np.clip(np.searchsorted(self.t, times, 'right') - 1, 0, len(self.inner_lam) - 1)
        part = (times - self.t[k]) / (self.t[k + 1] - self.t[k])
        points = np.append(0.0, gauss_points(_STAGES))
        values = np.concatenate([self.lam[:-1, None], self.inner_lam], axis=1)[k]
        result = np.zeros_like(values[:, 0])
        for i, point in enumerate(points):
            others = np.delete(points, i)
            weight = np.prod((part[:, None] - others) / (point - others), axis=1)
            result += weight[:, None] * values[:, i]
        return result


class Indirect:
    """The boundary value problem of a problem's structure, for any arcs and numbers."""

    def __init__(self, problem: Problem) -> None:
        n, m, q = problem.n, problem.m, problem.q
        self.n, self.m, self.q = n, m, q
        names = {'sx': n, 'su': m, 'st': 1, 'sj': 1}
        sx, su, st, sj = (ca.SX.sym(name, size) for name, size in names.items())
        self.shared = ca.vertcat(problem.p, sx, su, st, sj)
        lam, sl, sh = ca.SX.sym('lam', n), sj / sx, sj / st
        H = problem.L + ca.dot(lam, problem.f)
        parts = ca.Function('parts', [problem.x, problem.u, lam, problem.p], [
            problem.f, ca.gradient(H, problem.x), ca.gradient(H, problem.u), H])
        free, level = ca.SX.sym('free', m), ca.SX.sym('level', m)

        def at(x: ca.SX, u: ca.SX, costate: ca.SX) -> list[ca.SX]:
            return list(parts.call([sx * x, su * u, sl * costate, problem.p]))

        def inputs(Hu: ca.SX, u: ca.SX, free: ca.SX, level: ca.SX) -> ca.SX:
            return free * Hu * su / sh + (1 - free) * (u - level / su)

        xa, la, xb, lb = (ca.SX.sym(name, n) for name in ('xa', 'la', 'xb', 'lb'))
        ua, ub = ca.SX.sym('ua', m), ca.SX.sym('ub', m)
        first = ca.SX.sym('first', n)
        self.start = Piece(xa, first, self.shared, xa - first, ca.SX(0))
        self.interval = self._interval(at, inputs, (xa, la, xb, lb), (free, level), (sx, sl, st))
        nu = ca.SX.sym('nu', q)
        terminal = ca.Function('terminal', [problem.x, nu, problem.p], [
            problem.psi, ca.gradient(problem.V + ca.dot(nu, problem.psi), problem.x)])
        psi, wanted = terminal.call([sx * xb, nu, problem.p])
        self.end = Piece(ca.vertcat(xb, lb, nu), ca.SX(0, 1), self.shared,
                         ca.vertcat(psi, lb - wanted / sl), ca.SX(0))
        free_b, level_b = ca.SX.sym('free_b', m), ca.SX.sym('level_b', m)
        jump, meets, before = ca.SX.sym('jump'), ca.SX.sym('meets', m), ca.SX.sym('before')
        _, _, Hu_a, H_a = at(xa, ua, la)
        _, _, Hu_b, H_b = at(xa, ub, la)
        _, _, Hu_held, _ = at(xa, before * ua + (1 - before) * ub, la)
        self.switch = Piece(
            ca.vertcat(xa, la, ua, ub),
            ca.vertcat(free, level, free_b, level_b, jump, meets, before), self.shared,
            ca.vertcat(inputs(Hu_a, ua, free, level), inputs(Hu_b, ub, free_b, level_b),
                       jump * (H_a - H_b) / sh + ca.dot(meets, Hu_held * su) / sh), ca.SX(0))
        self.last_time = Piece(ca.vertcat(xa, la, ua), ca.vertcat(free, level), self.shared,
                               ca.vertcat(inputs(Hu_a, ua, free, level), H_a / sh), ca.SX(0))

    def _interval(self, at: Parts, inputs: Inputs, ends: tuple[ca.SX, ...],
                  modes: tuple[ca.SX, ca.SX], sizes: tuple[ca.SX, ca.SX, ca.SX]) -> Piece:
        """Return the collocation of x, lam and the inputs in an interval."""
        n, m, s = self.n, self.m, _STAGES
        xa, la, xb, lb = ends
        sx, sl, st = sizes
        X, Z, U = ca.SX.sym('X', n, s), ca.SX.sym('Z', n, s), ca.SX.sym('U', m, s)
        length, fraction = ca.SX.sym('length'), ca.SX.sym('fraction')
        h = st * length * fraction
        _, _, derivative, last = collocation(s)
        rows, x_end, lam_end = [], last[0] * xa, last[0] * la
        for j in range(s):
            f, Hx, Hu, _ = at(X[:, j], U[:, j], Z[:, j])
            slopes = ca.DM(derivative[j, 1:])
            rows.append(derivative[j, 0] * xa + ca.mtimes(X, slopes) - h * f / sx)
            rows.append(derivative[j, 0] * la + ca.mtimes(Z, slopes) + h * Hx / sl)
            rows.append(inputs(Hu, U[:, j], *modes))
            x_end += last[j + 1] * X[:, j]
            lam_end += last[j + 1] * Z[:, j]
        return Piece(
            ca.vertcat(xa, la, ca.vec(X), ca.vec(Z), ca.vec(U), xb, lb, length),
            ca.vertcat(fraction, *modes), self.shared,
            ca.vertcat(*rows, xb - x_end, lb - lam_end), ca.SX(0))

    def solve(self, problem: Problem, arcs: Sequence[Arc], course: Extremal, points: Array,
              scales: Scales) -> BoundaryValues | None:
        """
        Return a solution near a course with the given arcs; None if Newton finds none.

        `points`: times between which intervals are short enough.
        """
        return _System(self, problem, arcs, points, scales).solve(course)


def _cut(arc: Arc, points: Array) -> Array:
    """Return the lengths of the intervals of an arc as parts of it."""
    inside = (points - arc.start) / (arc.end - arc.start)
    inside = inside[(inside > 1e-3) & (inside < 1 - 1e-3)]
    if len(inside) < _FEWEST:
        inside = np.linspace(0.0, 1.0, _FEWEST + 1)[1:-1]
    return np.diff(np.concatenate([[0.0], inside, [1.0]]))


class _System:
    """The equations for given arcs: places of unknowns and constants, and Newton's method."""

    def __init__(self, parts: Indirect, problem: Problem, arcs: Sequence[Arc], points: Array,
                 scales: Scales) -> None:
        self.parts, self.problem, self.arcs, self.scales = parts, problem, arcs, scales
        fractions = [_cut(arc, points) for arc in arcs]
        self.arc_of = np.repeat(np.arange(len(arcs)), [len(part) for part in fractions])
        self.fractions = np.concatenate(fractions)
        self.free = np.array([[float(math.isnan(v)) for v in a.levels] for a in arcs])
        self.level = np.nan_to_num([a.levels for a in arcs])
        self._number()

    def _number(self) -> None:
        n, m, s, N, P = self.parts.n, self.parts.m, _STAGES, len(self.arc_of), len(self.arcs)
        stride = 2 * n + s * (2 * n + m)
        base = stride * np.arange(N)[:, None]
        self.at_z = np.vstack([base + np.arange(2 * n), [stride * N + np.arange(2 * n)]])
        self.at_inner = base + 2 * n + np.arange(s * (2 * n + m))
        first = stride * N + 2 * n
        self.at_nu = first + np.arange(self.parts.q)
        first += self.parts.q
        self.at_switch = first + np.arange(2 * m * (P - 1)).reshape(P - 1, 2 * m)
        first += self.at_switch.size
        final = self.problem.final_time
        self.fixed_single = not final.free and P == 1
        self.at_end_u = first + np.arange(m if final.free else 0)
        first += len(self.at_end_u)
        self.at_length = first + np.arange(P)
        self.unknowns = first + (0 if self.fixed_single else P)
        self.shared = int(self.parts.shared.numel())
        self._extra: list[float] = []

    def _constant(self, values: Array) -> Index:
        """Give numbers their places in c."""
        start = self.unknowns + self.shared + len(self._extra)
        self._extra.extend(np.ravel(values).tolist())
        return np.arange(start, start + np.size(values)).reshape(np.shape(values))

    def _program(self) -> Program:
        parts, n, P = self.parts, self.parts.n, len(self.arcs)
        at_x0 = self._constant(self.problem.x0 / self.scales.x) - self.unknowns
        if self.fixed_single:
            self.at_length = self._constant(
                np.array([self.problem.final_time.value / self.scales.time]))
        own = self._constant(np.hstack([self.fractions[:, None], self.free[self.arc_of],
                                        self.level[self.arc_of]])) - self.unknowns
        blocks = [
            Block(parts.start, self.at_z[:1, :n], at_x0[None, :]),
            Block(parts.interval, np.hstack([self.at_z[:-1], self.at_inner, self.at_z[1:],
                                             self.at_length[self.arc_of][:, None]]), own),
            Block(parts.end, np.append(self.at_z[-1], self.at_nu)[None, :],
                  np.zeros((1, 0), dtype=np.int64))]
        if P > 1:
            own = self._constant(np.array([self._event(b) for b in range(P - 1)]))
            nodes = self.at_z[np.flatnonzero(np.diff(self.arc_of)) + 1]
            blocks.append(Block(parts.switch, np.hstack([nodes, self.at_switch]),
                                own - self.unknowns))
        if self.problem.final_time.free:
            own = self._constant(np.concatenate([self.free[-1], self.level[-1]])[None, :])
            blocks.append(Block(parts.last_time,
                                np.append(self.at_z[-1], self.at_end_u)[None, :],
                                own - self.unknowns))
        elif P > 1:
            lengths, total = ca.SX.sym('lengths', P), ca.SX.sym('total')
            own = self._constant(np.array([[self.problem.final_time.value / self.scales.time]]))
            blocks.append(Block(Piece(lengths, total, parts.shared, ca.sum1(lengths) - total,
                                      ca.SX(0)), self.at_length[None, :], own - self.unknowns))
        return assemble(blocks, self.unknowns, self.shared, self.shared + len(self._extra))

    def _event(self, b: int) -> Array:
        """Return the constants of the switch after arc b."""
        changed = np.flatnonzero((self.free[b] != self.free[b + 1])
                                 | (self.level[b] != self.level[b + 1]))
        i = int(changed[0])
        jump = self.free[b, i] == self.free[b + 1, i]
        meets = np.zeros(self.parts.m)
        meets[i] = float(not jump)
        return np.concatenate([self.free[b], self.level[b], self.free[b + 1], self.level[b + 1],
                               [float(jump)], meets, [float(self.free[b + 1, i])]])

    def solve(self, course: Extremal) -> BoundaryValues | None:
        """Return what Newton's method makes of a course."""
        program = self._program()
        scales = self.scales
        c = np.concatenate([self.problem.p_value, scales.x, scales.u,
                            [scales.time, scales.cost], self._extra])
        w = self._start(course)
        jac = program.derivatives['jac_g']
        value = ca.Function('g', [program.nlp['x'], program.nlp['p']], [program.nlp['g']])
        if jac.size1_out(1) != self.unknowns:
            return None
        solver = ca.Linsol('newton', 'csparse', jac.sparsity_out(1))
        residual = value(w, c).full().ravel()
        for _ in range(_MOST_STEPS):
            size = np.abs(residual).max()
            if not np.isfinite(size) or size < _TOLERANCE:
                break
            _, J = jac(w, c)
            try:
                step = solver.solve(J, -residual).full().ravel()
            except RuntimeError:
                # CasADi's only way to say that the matrix is singular, as on singular arcs.
                return None
            if not np.all(np.isfinite(step)):
                return None
            for part in (1.0, 0.5, 0.25, 0.1, 0.01):
                trial = value(w + part * step, c).full().ravel()
                if np.all(np.isfinite(trial)) and np.linalg.norm(trial) < np.linalg.norm(residual):
                    w, residual = w + part * step, trial
                    break
            else:
                break
        size = float(np.abs(residual).max())
        return self._result(w, c, size) if size < 1e3 * _TOLERANCE else None

    def _start(self, course: Extremal) -> Array:
        s, scales = _STAGES, self.scales
        lengths = np.array([a.end - a.start for a in self.arcs])
        h = self.fractions * lengths[self.arc_of]
        t = np.append(0.0, np.cumsum(h))
        seen = np.append(course.t[:-1], course.t[-1])
        x = np.vstack([course.x, course.x_end[-1:]]) / scales.x
        lam = np.vstack([course.lam, course.lam_end[-1:]]) * scales.x / scales.cost
        middle, u = (course.t[:-1] + course.t[1:]) / 2, (course.ua + course.ub) / 2 / scales.u

        def at(times: Array, known: Array, values: Array) -> Array:
            return np.column_stack([np.interp(times, known, column) for column in values.T])

        w = np.zeros(self.unknowns)
        w[self.at_z] = np.hstack([at(t, seen, x), at(t, seen, lam)])
        inner = (t[:-1, None] + h[:, None] * gauss_points(s)).ravel()
        w[self.at_inner] = np.hstack([
            values.reshape(len(h), -1) for values in (
                at(inner, seen, x), at(inner, seen, lam), at(inner, middle, u))])
        ends = np.cumsum(lengths)[:-1]
        w[self.at_switch] = np.hstack([at(ends - 1e-6 * t[-1], middle, u),
                                       at(ends + 1e-6 * t[-1], middle, u)])
        w[self.at_nu] = course.nu
        w[self.at_end_u] = u[-1][:len(self.at_end_u)]
        if not self.fixed_single:
            w[self.at_length] = lengths / scales.time
        return w

    def _result(self, w: Array, c: Array, residual: float) -> BoundaryValues:
        n, m, s, scales, N = (self.parts.n, self.parts.m, _STAGES, self.scales,
                              len(self.arc_of))
        both = np.concatenate([w, c])
        lengths = both[self.at_length] * scales.time
        h = self.fractions * lengths[self.arc_of]
        t = np.append(0.0, np.cumsum(h))
        z = w[self.at_z]
        inner = w[self.at_inner]
        lam_size = scales.cost / scales.x
        return BoundaryValues(
            t, z[:, :n] * scales.x, z[:, n:] * lam_size,
            t[:-1, None] + h[:, None] * gauss_points(s),
            inner[:, n * s:2 * n * s].reshape(N, s, n) * lam_size,
            inner[:, 2 * n * s:].reshape(N, s, m) * scales.u, lengths, w[self.at_nu], residual)
