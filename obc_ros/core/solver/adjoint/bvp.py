# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Indirect method: Pontryagin's boundary value problem, solved by Newton's method from a path nearby.

In every arc each input is at a bound or satisfies dH/du = 0, and z = (x, lam) satisfies

    dx/dt = f(x, u),   dlam/dt = -dH/dx,   x(0) = x0,   psi(x(T)) = 0,
    lam(T) = dV/dx + nu' dpsi/dx,   H(T) = 0 if T is free,

by collocation at three Gauss points in each interval (order 6). The lengths of the arcs are
unknown, too. The equation of each switching time is that H is continuous where an input jumps
from bound to bound, and dH/du = 0 where it meets a bound. Singular arcs, on which dH/du = 0 does
not determine u, and arcs on state bounds are not treated.

A step eliminates the inputs first, then the values at the Gauss points of each interval, for all
intervals at once. The remaining system has a banded matrix for the mesh points, bordered by nu
and the lengths of the arcs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, linalg, Mask
from obc_ros.core.numerics.collocation import (
    build_collocation,
    compute_gauss_points,
    evaluate_lagrange,
)
from obc_ros.core.numerics.newton import take_damped_steps
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues, cut_evenly
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.arcs.input_arcs import Arc
from obc_ros.core.solver.transcription.mesh import choose_cuts
from obc_ros.core.solver.transcription.program import ProblemScales

_TOLERANCE = 1e-12     # scaled residual at which Newton's method ends
_ENOUGH = 1e-8         # scaled residual that it must reach
_STAGES = 3            # Gauss points in an interval
_AT_ONCE = 2_000_000   # numbers in the matrices of intervals condensed at a time (16 MB)
_FEWEST = 6            # minimum number of intervals in an arc
_SHARE = 1e-6          # scaled residual of a rough solution; defect of an interval of a thin one
_DEFECT = 3e-7         # sum of the scaled defects of intervals that a refinement aims at


@dataclass(frozen=True, eq=False)
class _Rates:
    """
    The right-hand sides and their derivatives at K points, scaled.

    F (K, 2n) = dz/dt, H and L (K,), Hu = dH/du (K, m). `off` (K, m) is the residual of the
    equation of each input; du = `gain` dz + `move` makes it zero to first order. F_z, F_u,
    B = dHu/dz and Huu have the shape (K, ., .).
    """

    F: Array
    H: Array
    L: Array
    Hu: Array
    off: Array
    gain: Array
    move: Array
    F_z: Array
    F_u: Array
    B: Array
    Huu: Array

    @property
    def total(self) -> Array:
        """Return dF/dz with the inputs as functions of z, (K, 2n, 2n)."""
        return self.F_z + self.F_u @ self.gain

    @property
    def H_z(self) -> Array:
        """Return dH/dz with the inputs as functions of z, (K, 2n)."""
        n = self.F.shape[1] // 2
        partial = np.hstack([-self.F[:, n:], self.F[:, :n]])
        return np.asarray(partial + np.einsum('kj,kjz->kz', self.Hu, self.gain))


class Indirect:
    """The boundary value problem of one structure, for any arcs and numbers."""

    def __init__(self, problem: Problem) -> None:
        x, u, p, lam = problem.x, problem.u, problem.p, ca.SX.sym('lam', problem.n)
        H = problem.L + ca.dot(lam, problem.f)
        Hx, Hu = ca.gradient(H, x), ca.gradient(H, u)
        self._rates = VectorizedFunction([x, lam, u, p], [
            ca.vertcat(problem.f, -Hx), H, problem.L, Hu, ca.jacobian(problem.f, x).T,
            ca.jacobian(Hx, x).T, ca.jacobian(Hu, ca.vertcat(x, lam)).T, ca.jacobian(Hu, u).T])
        nu = ca.SX.sym('nu', problem.q)
        last = ca.gradient(problem.V + ca.dot(nu, problem.psi), x)
        self._end = VectorizedFunction([x, nu, p], [
            problem.psi, ca.jacobian(problem.psi, x).T, last, ca.jacobian(last, x).T,
            problem.V], 1)

    def rates(self, problem: Problem, scales: ProblemScales, z: Array, u: Array,
              free: Mask, level: Array) -> _Rates:
        """
        Evaluate the right-hand sides at scaled points.

        `free` (K, m): inputs with dH/du = 0; the others are at `level` (K, m), scaled.
        """
        n, m, two_n = problem.n, problem.m, 2 * problem.n
        size = np.concatenate([scales.x, scales.cost / scales.x])
        x_lam = z * size
        F, H, L, Hu, fx, Hxx, B, Huu = self._rates(
            x_lam[:, :n], x_lam[:, n:], u * scales.u, problem.p_value)
        K, time, cost = len(z), scales.time, scales.cost
        F, Hu = F * (time / size), Hu * (scales.u * time / cost)
        H, L = H[:, 0] * time / cost, L[:, 0] * time / cost
        B = B.reshape(K, m, two_n) * (time / cost * np.outer(scales.u, size))
        Huu = Huu.reshape(K, m, m) * (time / cost * np.outer(scales.u, scales.u))
        fx = fx.reshape(K, n, n) * (time * np.outer(1 / scales.x, scales.x))
        F_z = np.zeros((K, two_n, two_n))
        F_z[:, :n, :n], F_z[:, n:, n:] = fx, -fx.transpose(0, 2, 1)
        F_z[:, n:, :n] = -Hxx.reshape(K, n, n) * (time / cost * np.outer(scales.x, scales.x))
        F_u = np.concatenate([B[:, :, n:], -B[:, :, :n]], axis=2).transpose(0, 2, 1)
        off = np.where(free, Hu, u - level)
        whole = np.where(free[:, :, None], Huu, np.eye(m))
        right = np.concatenate([np.where(free[:, :, None], B, 0.0), off[:, :, None]], axis=2)
        solved = -_solved(whole, right)
        return _Rates(
            F=F, H=H, L=L, Hu=Hu, off=off, gain=solved[:, :, :-1], move=solved[:, :, -1],
            F_z=F_z, F_u=F_u, B=B, Huu=Huu)

    def end(self, problem: Problem, scales: ProblemScales, z: Array, nu: Array
            ) -> tuple[Array, ...]:
        """Return psi, dpsi/dx, dV/dx + nu' dpsi/dx and its derivative, and V, scaled."""
        n, q, sx, cost = problem.n, problem.q, scales.x, scales.cost
        psi, psi_x, last, last_x, V = self._end(
            (z[:n] * sx)[None], (nu * cost)[None], problem.p_value)
        return (psi[0], psi_x[0].reshape(q, n) * sx, last[0] * sx / cost,
                last_x[0].reshape(n, n) * np.outer(sx, sx) / cost, V[0] / cost)

    @np.errstate(all='ignore')
    def solve(self, problem: Problem, arcs: Sequence[Arc], course: Extremal, points: Array,
              scales: ProblemScales, *, rough: bool = False) -> BoundaryValues | None:
        """
        Solve the boundary value problem from a path with costates.

        :param problem: without state bounds or path constraints. Where x(0) is free, that of
            `course` is kept.
        :param points: mesh points [s] on which the intervals are based.
        :param rough: accept a rough solution, which is sufficient for the ends of the arcs.
        :return: None if Newton's method did not converge.
        """
        system = _Equations(self, problem.pin_start(course.x[0]), arcs, scales,
                            *_cut(arcs, points, _FEWEST // 2 if rough else _FEWEST))
        start = system.start(course)
        return system.solve(start, _SHARE) if rough else system.refine(start)

    @np.errstate(all='ignore')
    def refined(self, problem: Problem, found: BoundaryValues, points: Array, scales: ProblemScales
                ) -> BoundaryValues | None:
        """
        Refine a rough solution to full accuracy; arguments and result as in `solve`.

        The intervals are those between `points`, not those of the solution: these may come from a
        neighbouring problem, and the result must not depend on it.
        """
        system = self._like(problem, found, scales, *_cut(found.arcs, points, _FEWEST))
        return system.refine(system.near(found))

    @np.errstate(all='ignore')
    def thinned(self, problem: Problem, found: BoundaryValues,
                scales: ProblemScales) -> BoundaryValues:
        """Return a solution on fewer intervals, as an initial guess of neighbouring problems."""
        system = self._like(problem, found, scales, *found.intervals)
        try:
            wanted = np.maximum(system.defects(found) / _SHARE, 1e-12)**(1 / 6)
            # In all arcs together, each of length 1.
            places, arc_of = cut_evenly(wanted, system.arc_of, system.fractions)
            system = system.on(np.diff(places), arc_of)
            return system.result(system.near(found), found.residual)
        except np.linalg.LinAlgError:
            return found   # dH/du = 0 does not determine u between its points

    @np.errstate(all='ignore')
    def follow(self, problem: Problem, known: BoundaryValues, levels: Array, scales: ProblemScales
               ) -> BoundaryValues | None:
        """
        Solve from the solution of a neighbouring problem with the same arcs.

        :param levels: (arcs, m), values of the inputs at bounds; nan where they are free.
        :return: rough; None if Newton's method did not converge.
        """
        arcs = [replace(arc, levels=tuple(row))
                for arc, row in zip(known.arcs, levels, strict=True)]
        system = _Equations(self, problem, arcs, scales, *known.intervals)
        return system.solve(system.near(known), _SHARE)

    def _like(self, problem: Problem, found: BoundaryValues, scales: ProblemScales,
              fractions: Array, arc_of: Index) -> '_Equations':
        """Return the equations for the arcs of a solution, and for its x(0) where it is free."""
        return _Equations(self, problem.pin_start(found.z[0, 0, :problem.n]), found.arcs,
                          scales, fractions, arc_of)


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """
    Scaled z (N + 1, 2n) at mesh points; y (N, s, 2n) and u (N, s, m) at Gauss points.

    `at_ends` (P, 2, m): u at the end of each arc and at the start of the next; `theta`: the
    lengths of the P arcs and nu.
    """

    z: Array
    y: Array
    u: Array
    at_ends: Array
    theta: Array

    def moved(self, part: float, step: '_Unknowns') -> '_Unknowns':
        return _Unknowns(**{name: values + part * getattr(step, name)
                            for name, values in vars(self).items()})


# The residuals, the rates at Gauss points and at the ends of arcs, and the unknowns there.
_Linearised = tuple[list[Array], _Rates, _Rates, _Unknowns]


class _Equations:
    """
    The equations for given arcs, and Newton's method.

    `fractions` (N,) are the lengths of the intervals as parts of their arcs `arc_of` (N,).
    """

    def __init__(self, parts: Indirect, problem: Problem, arcs: Sequence[Arc],
                 scales: ProblemScales, fractions: Array, arc_of: Index) -> None:
        self.parts, self.problem, self.arcs, self.scales = parts, problem, arcs, scales
        self.fractions, self.arc_of = fractions, arc_of
        self.size = np.concatenate([scales.x, scales.cost / scales.x])
        levels = np.array([arc.levels for arc in arcs])
        self.free, self.level = np.isnan(levels), np.nan_to_num(levels) / scales.u
        # The input that switches at the end of each arc but the last.
        self.switches = np.argmax((self.free[:-1] != self.free[1:])
                                  | (self.level[:-1] != self.level[1:]), axis=1)
        self.ends = np.append(np.flatnonzero(np.diff(self.arc_of)) + 1, len(self.arc_of))
        _, weights, derivative, _ = build_collocation(_STAGES)
        self.a, self.b = np.linalg.inv(derivative[:, 1:]), weights

    def on(self, fractions: Array, arc_of: Index) -> '_Equations':
        return _Equations(self.parts, self.problem, self.arcs, self.scales, fractions, arc_of)

    def solve(self, now: _Unknowns, tolerance: float = _TOLERANCE) -> BoundaryValues | None:
        """Solve by damped Newton steps from `now`; None if they do not converge."""
        def step(at: _Linearised, before: float) -> _Unknowns | None:
            norm = _norm(at[0])
            # At rounding errors the residual does not decrease any more.
            small = not norm > tolerance or norm < _ENOUGH and norm > 0.1 * before
            return None if small else self._step(*at)

        try:
            left, _, _, now = take_damped_steps(
                self._equations(now), step, lambda at, way, part: self._equations(
                    at[3].moved(part, way)), lambda at: _norm(at[0]), (1.0, 0.5, 0.25, 0.1), 12)
            norm = _norm(left)
            good = norm < max(tolerance, _ENOUGH) and bool(np.all(now.theta[:len(self.arcs)] > 0))
            return self.result(now, norm) if good else None
        except (np.linalg.LinAlgError, ValueError):
            return None  # a singular matrix, as on singular arcs, or numbers that are not finite

    def refine(self, start: _Unknowns) -> BoundaryValues | None:
        """Solve from `start`, then on finer intervals until the defects are small enough."""
        system, found = self, self.solve(start)
        for _ in range(2):   # refinements
            if found is None:
                break
            defects, share = system.defects(found), _DEFECT / len(system.arc_of)
            if defects.max() <= 2 * share:
                break
            counts = choose_cuts(defects, share, 6.0)
            system = system.on(np.repeat(system.fractions / counts, counts),
                               np.repeat(system.arc_of, counts))
            better = system.solve(system.near(found))
            if better is None:
                break
            found = better
        return found

    def defects(self, found: BoundaryValues) -> Array:
        """Return the scaled defect of z in the middle of each interval, times its length, (N,)."""
        N = len(found.h)
        z, u = (values / size for values, size in zip(
            found.at(np.arange(N), np.full(N, 0.5)), (self.size, self.scales.u), strict=True))
        u = u + self._rates(z, u, self.arc_of).move
        h = found.h[:, None]
        slope = (15 / 8 * np.diff(found.z, axis=1)[:, 0] - 7 / 16 * h * found.dz.sum(axis=1)
                 + h**2 / 32 * np.diff(found.ddz, axis=1)[:, 0]) / self.size
        off = slope - h / self.scales.time * self._rates(z, u, self.arc_of).F
        return np.asarray(np.abs(off).max(axis=1))

    def near(self, found: BoundaryValues) -> _Unknowns:
        """Return the unknowns interpolated from a solution on other intervals."""
        h = self.fractions * found.lengths[self.arc_of]
        t = np.append(0.0, np.cumsum(h))[:-1]
        z, _ = found.at(*found.where(t, self.arc_of))
        inner = (t[:, None] + h[:, None] * compute_gauss_points(_STAGES)).ravel()
        y, u = found.at(*found.where(inner, np.repeat(self.arc_of, _STAGES)))
        N, scales = len(h), self.scales
        last = np.flatnonzero(np.diff(found.arc_of, append=-1))
        following = np.append(found.u[last[:-1] + 1, 0], found.u[-1:, 1], axis=0)
        return _Unknowns(
            np.vstack([z, found.z[-1:, 1]]) / self.size, (y / self.size).reshape(N, _STAGES, -1),
            (u / scales.u).reshape(N, _STAGES, -1),
            np.stack([found.u[last, 1], following], axis=1) / scales.u,
            np.append(found.lengths / scales.time, found.nu / scales.cost))

    def start(self, course: Extremal) -> _Unknowns:
        """Return the unknowns interpolated from a course."""
        n, scales = self.problem.n, self.scales
        lengths = np.array([arc.end - arc.start for arc in self.arcs])
        h = self.fractions * lengths[self.arc_of]
        t = np.append(0.0, np.cumsum(h))
        known = np.vstack([np.hstack([course.x, course.lam]), np.hstack(
            [course.x_end[-1:], course.lam_end[-1:]])]) / self.size
        middle, u = (course.t[:-1] + course.t[1:]) / 2, (course.ua + course.ub) / 2 / scales.u
        inner = t[:-1, None] + h[:, None] * compute_gauss_points(_STAGES)
        inputs = np.where(self.free[self.arc_of][:, None], interpolate_columns(inner, middle, u),
                          self.level[self.arc_of][:, None])
        ends, off = np.cumsum(lengths), 1e-6 * t[-1]
        at_ends = interpolate_columns(np.column_stack([ends - off, ends + off]), middle, u)
        z = interpolate_columns(t, course.t, known)
        z[0, :n] = self.problem.x0 / scales.x
        return _Unknowns(z, interpolate_columns(inner, course.t, known), inputs, at_ends,
                         np.append(lengths / scales.time, course.nu / scales.cost))

    def _equations(self, now: _Unknowns) -> _Linearised:
        """Return the residuals of each group of equations, and the rates at all points."""
        N, P = len(self.arc_of), len(self.arcs)
        rows = np.repeat(self.arc_of, _STAGES)
        inner = self._rates(now.y.reshape(N * _STAGES, -1), now.u.reshape(N * _STAGES, -1), rows)
        following = np.minimum(np.arange(P) + 1, P - 1)
        sides = self._rates(np.repeat(now.z[self.ends], 2, axis=0),
                            now.at_ends.reshape(2 * P, -1),
                            np.column_stack([np.arange(P), following]).ravel())
        h = (self.fractions * now.theta[self.arc_of])[:, None]
        F = inner.F.reshape(now.y.shape)
        stages = now.z[:-1, None] + h[:, None] * np.einsum('ij,kjz->kiz', self.a, F) - now.y
        nodes = now.z[:-1] + h * np.einsum('j,kjz->kz', self.b, F) - now.z[1:]
        psi, _, last, _, _ = self.parts.end(self.problem, self.scales, now.z[-1], now.theta[P:])
        border = np.concatenate([psi, self._switches(now, sides)[0]])
        left = [inner.off, sides.off, stages, nodes,
                self.problem.x0 / self.scales.x - now.z[0, :self.problem.n],
                last - now.z[-1, self.problem.n:], border]
        return left, inner, sides, now

    def _rates(self, z: Array, u: Array, arc: Index) -> _Rates:
        return self.parts.rates(self.problem, self.scales, z, u, self.free[arc], self.level[arc])

    def _switches(self, now: _Unknowns, sides: _Rates) -> tuple[Array, Array]:
        """
        Return the residuals of the equations of the lengths, and their derivatives by z.

        At the end of each arc but the last: H is continuous, or dH/du = 0 for an input that
        meets or leaves a bound. At T: H = 0, or the sum of the lengths is T.
        """
        P, final, H_z = len(self.arcs), self.problem.final_time, sides.H_z
        H = sides.H + np.einsum('kj,kj->k', sides.Hu, sides.move)
        values, slopes = np.empty(P), np.zeros((P, now.z.shape[1]))
        b, i = np.arange(P - 1), self.switches
        jumps = self.free[b, i] == self.free[b + 1, i]
        held = 2 * b + self.free[b, i]
        comes = sides.Hu[held, i] + np.einsum('kj,kj->k', sides.Huu[held, i], sides.move[held])
        comes_z = sides.B[held, i] + np.einsum('kj,kjz->kz', sides.Huu[held, i], sides.gain[held])
        values[:-1] = np.where(jumps, H[2 * b] - H[2 * b + 1], comes)
        slopes[:-1] = np.where(jumps[:, None], H_z[2 * b] - H_z[2 * b + 1], comes_z)
        if final.free:
            values[-1], slopes[-1] = H[-2], H_z[-2]
        else:
            values[-1] = now.theta[:P].sum() - final.value / self.scales.time
        return values, slopes

    def _step(self, left: list[Array], inner: _Rates, sides: _Rates, now: _Unknowns) -> _Unknowns:
        n, P = self.problem.n, len(self.arcs)
        stages, over, by_length, rest = self._condensed(left, inner, now)
        psi, psi_x, _, last_x, _ = self.parts.end(
            self.problem, self.scales, now.z[-1], now.theta[P:])
        N, two_n = len(over), 2 * n
        right = np.zeros(((N + 1) * two_n, 1 + len(now.theta)))
        right[:n, 0], right[-n:, 0] = left[4], left[5]
        right[n:-n, 0] = rest.ravel()
        k = np.arange(N)
        body = right[n:-n].reshape(N, two_n, -1)
        body[k, :, 1 + self.arc_of] = by_length
        right[-n:, 1 + P:] = psi_x.T
        found = _banded(over, last_x, right).reshape(N + 1, two_n, -1)
        values, slopes = self._switches(now, sides)
        ends = np.einsum('pz,pzc->pc', slopes, found[self.ends])
        if not self.problem.final_time.free:
            ends[-1, 1:P + 1] += 1.0
        border = np.vstack([psi_x @ found[-1, :n], ends])
        theta = np.linalg.solve(border[:, 1:], -np.append(psi, values) - border[:, 0])
        z = found[:, :, 0] + found[:, :, 1:] @ theta
        y = (stages[:, :, :-2] @ z[:-1, :, None])[:, :, 0] + stages[:, :, -1]
        y += stages[:, :, -2] * theta[self.arc_of][:, None]
        y = y.reshape(now.y.shape)
        u = np.einsum('kjz,kz->kj', inner.gain, y.reshape(-1, two_n)) + inner.move
        at_ends = np.einsum('kjz,kz->kj', sides.gain,
                            np.repeat(z[self.ends], 2, axis=0)) + sides.move
        return _Unknowns(z, y, u.reshape(now.u.shape), at_ends.reshape(now.at_ends.shape), theta)

    def _condensed(self, left: list[Array], inner: _Rates, now: _Unknowns) -> tuple[Array, ...]:
        """
        Return the steps at the Gauss points and at the end of each interval.

        They are linear in the step at its start and in the step of the length of its arc, plus a
        constant: an array (N, s 2n, 2n + 2) at the Gauss points, and these three parts at the
        end. The matrices grow with the square of the states, so that only some intervals are
        condensed at a time.
        """
        N, s, two_n = now.y.shape
        h = (self.fractions * now.theta[self.arc_of])[:, None, None]
        given = (h, self.fractions, left[2], left[3], inner.F.reshape(N, s, two_n),
                 inner.total.reshape(N, s, two_n, two_n),
                 np.einsum('kzj,kj->kz', inner.F_u, inner.move).reshape(N, s, two_n))
        count = max(1, _AT_ONCE // (s * two_n)**2)
        parts = [self._condensed_some(*(each[k:k + count] for each in given))
                 for k in range(0, N, count)]
        return tuple(map(np.concatenate, zip(*parts, strict=True)))

    def _condensed_some(self, h: Array, fractions: Array, left: Array, left_at_end: Array,
                        F: Array, total: Array, moved: Array) -> tuple[Array, Array, Array, Array]:
        N, s, two_n = F.shape
        matrix = -np.einsum('ij,kjzw->kizjw', self.a, h[..., None] * total).reshape(
            N, s * two_n, s * two_n)
        matrix[:, np.arange(s * two_n), np.arange(s * two_n)] += 1.0
        right = np.zeros((N, s, two_n, two_n + 2))
        right[:, :, np.arange(two_n), np.arange(two_n)] = 1.0
        right[..., -2] = fractions[:, None, None] * np.einsum('ij,kjz->kiz', self.a, F)
        right[..., -1] = left + h * np.einsum('ij,kjz->kiz', self.a, moved)
        stages = np.linalg.solve(matrix, right.reshape(N, s * two_n, -1))
        weighted = (self.b[:, None, None] * total).transpose(0, 2, 1, 3)
        ends = h * (weighted.reshape(N, two_n, -1) @ stages)
        ends[:, np.arange(two_n), np.arange(two_n)] += 1.0
        by_length = ends[:, :, -2] + fractions[:, None] * np.einsum('j,kjz->kz', self.b, F)
        rest = ends[:, :, -1] + left_at_end + h[:, :, 0] * np.einsum('j,kjz->kz', self.b, moved)
        return stages, ends[:, :, :-2], by_length, rest

    def result(self, now: _Unknowns, residual: float) -> BoundaryValues:
        """Return the solution that the unknowns represent."""
        P, N, scales = len(self.arcs), len(self.arc_of), self.scales
        lengths = now.theta[:P] * scales.time
        h = self.fractions * lengths[self.arc_of]
        z = np.stack([now.z[:-1], now.z[1:]], axis=1)
        # Inputs at the ends of intervals: from those at the Gauss points, then by Newton.
        outer = evaluate_lagrange(compute_gauss_points(_STAGES), np.array([0.0, 1.0]))
        u = np.einsum('ej,kjm->kem', outer, now.u).reshape(2 * N, -1)
        arcs = np.repeat(self.arc_of, 2)
        for _ in range(4):
            ends = self._rates(z.reshape(2 * N, -1), u, arcs)
            u = u + ends.move
            if np.abs(ends.move).max() < _TOLERANCE:
                break
        size = self.size
        dz = ends.F * size / scales.time
        ddz = np.einsum('kzw,kw->kz', ends.total, ends.F) * size / scales.time**2
        du = np.einsum('kjz,kz->kj', ends.gain, ends.F) * scales.u / scales.time
        inner = self._rates(now.y.reshape(N * _STAGES, -1), now.u.reshape(N * _STAGES, -1),
                            np.repeat(self.arc_of, _STAGES))
        *_, V = self.parts.end(self.problem, scales, now.z[-1], now.theta[P:])
        cost = (inner.L.reshape(N, -1) @ self.b) @ h / scales.time + V[0]
        by_u = ends.F_u * np.outer(size, 1 / (scales.u * scales.time))
        return BoundaryValues(
            arc_of=self.arc_of, h=h, lengths=lengths,
            levels=np.array([arc.levels for arc in self.arcs]), z=z * size,
            dz=dz.reshape(z.shape), ddz=ddz.reshape(z.shape), u=u.reshape(N, 2, -1) * scales.u,
            du=du.reshape(N, 2, -1), by_u=by_u.reshape(N, 2, len(size), -1),
            nu=now.theta[P:] * scales.cost, cost=float(cost * scales.cost), residual=residual)


def _solved(matrix: Array, right: Array) -> Array:
    """Solve with matrices (K, m, m); m = 1 and m = 2 by Cramer's rule, which is faster."""
    m = matrix.shape[1]
    if m > 2:
        return np.asarray(np.linalg.solve(matrix, right))
    det = (matrix[:, 0, 0] if m == 1 else
           matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0])
    if not det.all():
        raise np.linalg.LinAlgError('Singular matrix')
    if m == 2:
        turned = np.stack([matrix[:, 1, 1], -matrix[:, 0, 1], -matrix[:, 1, 0],
                           matrix[:, 0, 0]], axis=1).reshape(-1, 2, 2)
        right = turned @ right
    return np.asarray(right / det[:, None, None])


def _norm(left: list[Array]) -> float:
    return math.sqrt(sum(float(np.vdot(part, part)) for part in left))


def _banded(over: Array, last_x: Array, right: Array) -> Array:
    """
    Return the steps at all mesh points for each column on the right.

    The right-hand side is x_0, then z_(k+1) - over_k z_k for each interval, then
    lam_N - last_x x_N.
    """
    N, two_n, _ = over.shape
    n = two_n // 2
    half = 3 * n - 1
    bands = np.zeros((2 * half + 1, (N + 1) * two_n))

    def put(row: Array, column: Array, values: Array | float) -> None:
        bands[half + row - column, column] = values

    first, each = np.arange(n), np.arange(two_n)
    put(first, first, 1.0)
    base = two_n * np.arange(N)[:, None, None]
    put(n + base + each[:, None], base + each, -over)
    put((n + base[:, 0] + each), (base[:, 0] + two_n + each), 1.0)
    end = N * two_n
    put(end + n + first[:, None], end + first, -last_x)
    put(end + n + first, end + n + first, 1.0)
    return np.asarray(linalg.solve_banded((half, half), bands, right))


def _cut(arcs: Sequence[Arc], points: Array, fewest: int) -> tuple[Array, Index]:
    """Return the intervals between points, as parts of their arcs, and the arc of each."""
    fractions = []
    for arc in arcs:
        inside = (points - arc.start) / (arc.end - arc.start)
        inside = inside[(inside > 1e-3) & (inside < 1 - 1e-3)]
        fractions.append(np.full(fewest, 1 / fewest) if len(inside) < fewest else
                         np.diff(np.concatenate([[0.0], inside, [1.0]])))
    return (np.concatenate(fractions),
            np.repeat(np.arange(len(arcs)), [len(part) for part in fractions]))
