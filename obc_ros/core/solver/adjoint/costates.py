# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Integration of states and costates along a given input, with the Hamiltonian.

dx/dt = f(x, u) forward from x(0), and dlam/dt = -dH/dx backward from
lam(T) = dV/dx + nu' dpsi/dx, both by Runge-Kutta steps of order 6 in equal parts of each interval
of the input. If errors grow too much in a single sweep, because the system is unstable, the
sweeps restart at every mesh point from the values of the transcription.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.collocation import (
    build_collocation,
    build_stage_matrices,
    compute_gauss_points,
    evaluate_lagrange,
)
from obc_ros.core.numerics.vectorized import Chain, VectorizedFunction
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.solver.transcription.intervals import step_of
from obc_ros.core.solver.transcription.mesh import Path
from obc_ros.core.solver.transcription.program import TranscriptionOutcome

_STIFF = 1e-4   # relative error of an interval above which explicit steps are not trusted
_MANY = 64      # parts of each interval of a collocation whose cost is corrected


@dataclass(frozen=True, eq=False)
class Extremal:
    """
    States, inputs and costates on a fine grid: K parts, `parts` in each of N intervals.

    :ivar t: (K + 1,), times [s].
    :ivar x, x_end: (K, n), state at the start and at the end of each part.
    :ivar ua, ub: (K, m), input at the start and at the end of each part.
    :ivar lam, lam_end: (K, n), costate at the start and at the end of each part. Between two parts
        it jumps by the multiplier impulses of state constraints.
    :ivar cost: J.
    :ivar defect: largest difference between the states of a single sweep and those of the
        transcription, relative to the size of each state.
    :ivar local: (N,), the same in each interval, for sweeps that restart at each mesh point.
    :ivar nu: (q,), multipliers of the terminal constraints.
    :ivar density_x, density_path: (K, 2, n), (K, 2, l), or None, densities of the multipliers of
        the bounds of x and of the path constraints, at the start and at the end of each part; > 0
        at an upper bound.
    """

    parts: int
    t: Array
    x: Array
    x_end: Array
    ua: Array
    ub: Array
    lam: Array
    lam_end: Array
    cost: float
    defect: float
    local: Array
    nu: Array
    density_x: Array | None = None
    density_path: Array | None = None

    @property
    def points(self) -> tuple[Array, Array, Array]:
        """Return x, u and lam at the starts of all parts and at the end, (K + 1, .) each."""
        x, u, lam = (np.vstack([start, end[-1:]]) for start, end in (
            (self.x, self.x_end), (self.ua, self.ub), (self.lam, self.lam_end)))
        return x, u, lam


def _largest(error: Array, size: Array) -> Array:
    """Return the largest |error| / size of each row, infinite if one is not a number."""
    with np.errstate(invalid='ignore', over='ignore'):   # where states explode
        return np.asarray(np.nan_to_num(
            np.abs(error / size).max(axis=1), nan=np.inf, posinf=np.inf))


def cut_inputs(t: Array, ua: Array, ub: Array, parts: int) -> tuple[Array, Array, Array]:
    """
    Cut intervals into equal parts; return t, ua and ub of these.

    :param t: (N + 1,), times [s].
    :param ua, ub: (N, m), inputs at the start and at the end of each interval, linear in between.
    """
    c = np.arange(parts)[:, None] / parts
    a, b = ua[:, None, :], ub[:, None, :]
    ua, ub = ((a + (b - a) * part).reshape(-1, ua.shape[1]) for part in (c, c + 1 / parts))
    return np.append((t[:-1, None] + np.diff(t)[:, None] * c[:, 0]).ravel(), t[-1]), ua, ub


def find_new_samples(t: Array, values: Iterable[Array | None], part: float) -> Mask:
    """Return which samples differ from those before in time, or by a part of the largest value."""
    new = np.append(True, np.diff(t) > 0)
    for each in values:
        if each is not None and each.size:
            change = np.abs(np.diff(each, axis=0)).max(axis=1)
            new[1:] |= change > part * np.abs(each).max()
    return new


class CostateIntegrator:
    """Runge-Kutta steps of dynamics, cost and costates of one structure, for any numbers."""

    def __init__(self, problem: Problem) -> None:
        x, u, p, lam = problem.x, problem.u, problem.p, ca.SX.sym('lam', problem.n)
        ua, ub = ca.SX.sym('ua', problem.m), ca.SX.sym('ub', problem.m)
        h = ca.SX.sym('h')
        self._symbols, self._given, self._f = (lam, x, ua, ub, h, p), (x, u, p), problem.f
        end, cost = self._end_and_cost = step_of(problem).call([x, ua, ub, h, p])
        mu = ca.SX.sym('mu', int(problem.path.numel()))
        H = problem.L + ca.dot(lam, problem.f)
        Hu = ca.gradient(H + ca.dot(mu, problem.path), u)
        nu = ca.SX.sym('nu', problem.q)
        self._step = VectorizedFunction([x, ua, ub, h, p], [end, cost], 16)
        self._end = VectorizedFunction([x, nu, p], [
            problem.V, problem.psi, ca.gradient(problem.V + ca.dot(nu, problem.psi), x)], 1)
        self._hamiltonian = VectorizedFunction([x, u, lam, mu, p], [H, Hu, ca.jacobian(Hu, u)])

    @cached_property
    def _forward(self) -> Chain:
        """Return the step of x and the cost so far."""
        _, x, ua, ub, h, p = self._symbols
        end, cost = self._end_and_cost
        total = ca.SX.sym('total')
        return Chain(ca.vertcat(x, total), [ua, ub, h, p], ca.vertcat(end, total + cost))

    @cached_property
    def _rate(self) -> VectorizedFunction:
        """Return f and its derivatives by x, by rows."""
        return VectorizedFunction(self._given, [self._f, ca.jacobian(self._f, self._given[0]).T])

    @cached_property
    def _earlier(self) -> ca.SX:
        """Return lam at the start of a step."""
        end, cost = self._end_and_cost
        return ca.gradient(ca.dot(self._symbols[0], end) + cost, self._symbols[1])

    @cached_property
    def _backward(self) -> Chain:
        """Return the step of lam with its jump."""
        lam, *given = self._symbols
        jump = ca.SX.sym('jump', lam.numel())
        return Chain(lam, [*given, jump], self._earlier + jump)

    @cached_property
    def _back(self) -> VectorizedFunction:
        """Return the step of lam for many intervals at once."""
        return VectorizedFunction(self._symbols, [self._earlier])

    def forward(self, problem: Problem, t: Array, ua: Array, ub: Array) -> tuple[Array, Array]:
        """
        Integrate from x(0) under inputs that are linear in each part.

        :param t: (K + 1,), times [s].
        :param ua, ub: (K, m), inputs at the start and at the end of each part.
        :return: x: (K + 1, n), and the running cost so far: (K + 1,).
        """
        first = np.append(problem.x0, 0.0)
        path = np.vstack([first, self._forward(
            first, ua, ub, np.diff(t)[:, None], problem.p_value)])
        return path[:, :-1], path[:, -1]

    def forward_each(self, problem: Problem, t: Array, u: Array) -> tuple[Array, Array]:
        """
        Integrate from x(0) under each of R piecewise constant inputs.

        :param t, u: (R, K + 1), (R, K, m), times [s] and inputs.
        :return: x: (R, K + 1, n), and the running costs so far: (R, K + 1).
        """
        if len(u) <= 64:   # one after the other is faster
            first = np.append(problem.x0, 0.0)
            after = self._forward.each(first, u, u, np.diff(t)[:, :, None], problem.p_value)
            path = np.concatenate([np.broadcast_to(first, (len(u), 1, len(first))), after], axis=1)
            return path[:, :, :-1], path[:, :, -1]
        x, cost = [np.tile(problem.x0, (len(u), 1))], [np.zeros((len(u), 1))]
        for held, h in zip(u.swapaxes(0, 1), np.diff(t).T, strict=True):
            end, more = self._step(x[-1], held, held, h[:, None], problem.p_value)
            x.append(end)
            cost.append(cost[-1] + more)
        return np.stack(x, axis=1), np.hstack(cost)

    def stepped(self, problem: Problem, x: Array, ua: Array, ub: Array, h: Array) -> Array:
        """Return x (K, n) after K steps of lengths h (K,), each from its own x and inputs."""
        return self._step(x, ua, ub, h[:, None], problem.p_value)[0]

    def stepped_back(self, problem: Problem, lam: Array, x: Array, ua: Array, ub: Array,
                     h: Array) -> Array:
        """Return lam (K, n) before the steps of `stepped` from `lam` (K, n) after them."""
        return self._back(lam, x, ua, ub, h[:, None], problem.p_value)[0]

    def ends(self, problem: Problem, x: Array) -> tuple[Array, Array]:
        """Return V (K,) and psi (K, q) at K states."""
        V, psi, _ = self._end(x, np.zeros(problem.q), problem.p_value)
        return V[:, 0], psi

    def at_end(self, problem: Problem, x: Array, nu: Array) -> Array:
        """Return dV/dx + nu' dpsi/dx, (n,), the costate at a final state by transversality."""
        return np.asarray(self._end(x[None, :], nu[None, :], problem.p_value)[2][0])

    def hamiltonian(self, problem: Problem, x: Array, u: Array, lam: Array,
                    mu: Array | None = None) -> tuple[Array, Array, Array]:
        """
        Evaluate the Hamiltonian at K points.

        :param mu: (K, l), optional, multipliers of the path constraints; 0 if left out.
        :return: H: (K,), L + lam' f; Hu, Huu: (K, m), (K, m, m), derivatives of L + lam' f + mu' c
            with respect to u.
        """
        if mu is None:
            mu = np.zeros(int(problem.path.numel()))
        H, Hu, Huu = self._hamiltonian(x, u, lam, mu, problem.p_value)
        return H[:, 0], Hu, Huu.reshape(-1, problem.m, problem.m)

    def samples(self, problem: Problem, course: Extremal) -> Solution:
        """Return a course as samples, without status; two at a time at which a value jumps."""
        t = np.column_stack([course.t[:-1], course.t[1:]]).ravel()
        x, u, lam = (np.stack(pair, axis=1).reshape(len(t), -1) for pair in (
            (course.x, course.x_end), (course.ua, course.ub), (course.lam, course.lam_end)))
        u = np.clip(u, problem.u_lower, problem.u_upper)
        densities = [None if d is None else d.reshape(len(t), -1)
                     for d in (course.density_x, course.density_path)]
        new = find_new_samples(t, (u, lam, *densities), 1e-12)
        many = densities[0] is None and len(course.local) >= 64   # their ends are sufficient
        if problem.path.numel() or many:
            # A linear input meets a constraint c(x, u) once or twice in an interval.
            new &= (np.isin(np.arange(len(t)) % (2 * course.parts), (0, 2 * course.parts - 1)))
        densities = [d if d is None else d[new] for d in densities]
        t, x, u, lam = t[new], x[new], u[new], lam[new]
        H, _, _ = self.hamiltonian(problem, x, u, lam)
        return Solution(
            status=Status.NOT_CONVERGED, message='', objective=course.cost, t=t, x=x, u=u,
            lam=lam, hamiltonian=H, nu=course.nu, state_multipliers=densities[0],
            path_multipliers=densities[1])

    def extremal(self, problem: Problem, outcome: TranscriptionOutcome, parts: int) -> Extremal:
        """
        Integrate states and costates under the input of an outcome, `parts` steps per interval.

        Where explicit steps are too inaccurate for the system, the states and costates of the
        transcription are returned, with one part in each interval.
        """
        path = outcome.path
        t, ua, ub, anew, anew_end, J = self._restarted(problem, path, parts)
        size = np.maximum(np.abs(path.x).max(axis=0), 1e-3 * np.abs(path.x).max() + 1e-12)
        local = _largest(anew_end[parts - 1::parts] - path.x[1:], size)
        x, running = self.forward(problem.pin_start(path.x[0]), t, ua, ub)
        defect = _largest(x[parts::parts] - path.x[1:], size)
        if local.max() > _STIFF and path.inner.shape[1]:
            # The error may be that of the explicit steps.
            local = _largest(self._errors(problem, path), size)
            return self._at_nodes(outcome, float(defect.max()), local)
        single = bool(defect.max() < 1e-5)
        x, x_end, J = (x[:-1], x[1:], running[-1]) if single else (anew, anew_end, J)
        V, _, last = self._end(x_end[-1:], outcome.nu[None, :], problem.p_value)
        lam, lam_end = self._costates(problem, outcome, (t, x, ua, ub), last[0], parts, single)
        if not single and path.inner.shape[1]:
            found, swept = outcome.costates[:-1], lam[::parts] + outcome.impulses(parts)[:-1:parts]
            with np.errstate(all='ignore'):
                gap = (np.abs(swept - found) * size).max() / max(
                    (np.abs(found) * size).max(), 1e-300)
            if not gap <= _STIFF:   # explicit steps lead to other costates
                return self._at_nodes(outcome, float(defect.max()), local)
        return Extremal(
            parts=parts, t=t, x=x, x_end=x_end, ua=ua, ub=ub, lam=lam, lam_end=lam_end,
            cost=float(J + V[0, 0]), defect=float(defect.max()), local=local, nu=outcome.nu)

    def closed(self, problem: Problem, outcome: TranscriptionOutcome) -> float:
        """
        Return the cost of an outcome corrected for its discretisation error, to first order.

        The state of a transcription at a mesh point differs from the state to which its input
        leads from the mesh point before. The costate times this gap is its effect on the cost.
        Corrected costs can be compared on coarse meshes, the others cannot.
        """
        path, parts = outcome.path, _MANY if outcome.path.inner.shape[1] else 4
        *_, x_end, J = self._restarted(problem, path, parts)
        ends = x_end[parts - 1::parts]
        V, psi, _ = self._end(ends[-1:], outcome.nu[None, :], problem.p_value)
        gaps = outcome.costates[1:-1] * (ends[:-1] - path.x[1:-1])
        return float(J + V[0, 0] + outcome.nu @ psi[0] + gaps.sum())

    def _at_nodes(self, outcome: TranscriptionOutcome, defect: float, local: Array) -> Extremal:
        """Return the states and costates of the collocation at its mesh points."""
        path = outcome.path
        costates, mass = outcome.costates, outcome.impulses(1)
        return Extremal(
            parts=1, t=path.t, x=path.x[:-1], x_end=path.x[1:], ua=path.ua, ub=path.ub,
            lam=(costates - mass)[:-1], lam_end=costates[1:], cost=outcome.objective,
            defect=defect, local=local, nu=outcome.nu)

    def _errors(self, problem: Problem, path: Path) -> Array:
        """
        Return the errors (N, n) of x at the ends of the intervals of a collocation.

        The error e of a polynomial X satisfies de/dt = f_x e + f(X, u) - dX/dt to first order.
        This is solved by a Radau method with one more stage, which damps what decays fast.
        """
        K, stages, n = path.inner.shape
        known = np.append(0.0, compute_gauss_points(stages))
        c, _, D, _ = build_collocation(stages + 1, 'radau')
        samples, h = np.concatenate([path.x[:-1, None], path.inner], axis=1), np.diff(path.t)
        x, slope = (np.einsum('rs,ksn->krn', evaluate_lagrange(known, c, order), samples)
                    for order in (0, 1))
        u = path.ua[:, None] + c[:, None] * (path.ub - path.ua)[:, None]
        f, f_x = self._rate(x.reshape(-1, n), u.reshape(len(c) * K, -1), problem.p_value)
        defect = h[:, None, None] * f.reshape(x.shape) - slope
        return np.asarray(np.linalg.solve(
            build_stage_matrices(D, h, f_x.reshape(K, len(c), n, n)),
            defect.reshape(K, -1, 1))[:, -n:, 0])

    def _restarted(self, problem: Problem, path: Path, parts: int
                   ) -> tuple[Array, Array, Array, Array, Array, float]:
        """Return t, ua, ub, x, x_end and J of sweeps that restart at every mesh point."""
        t, ua, ub = cut_inputs(path.t, path.ua, path.ub, parts)
        h, K = np.diff(t)[:, None], len(ua)
        x, x_end, J = np.empty((K, problem.n)), np.empty((K, problem.n)), 0.0
        now = path.x[:-1]
        for part in range(parts):
            here = slice(part, None, parts)
            x[here] = now
            now, cost = self._step(now, ua[here], ub[here], h[here], problem.p_value)
            x_end[here] = now
            J += float(cost.sum())
        return t, ua, ub, x, x_end, J

    def _costates(self, problem: Problem, outcome: TranscriptionOutcome,
                  course: tuple[Array, Array, Array, Array], last: Array, parts: int,
                  single: bool) -> tuple[Array, Array]:
        """Return costates at the starts and at the ends of all parts."""
        t, x, ua, ub = course
        h, mass = np.diff(t), outcome.impulses(parts)
        if single:
            lam = self._backward(last, x[::-1], ua[::-1], ub[::-1], h[::-1, None],
                                 problem.p_value, mass[-2::-1])[::-1]
            # Each backward step ends before the jump at the start of its part.
            return lam - mass[:-1], np.vstack([lam[1:], last])
        lam, lam_end = np.empty_like(x), np.empty_like(x)
        now = np.vstack([outcome.costates[1:-1], last])
        for part in range(parts - 1, -1, -1):
            here = slice(part, None, parts)
            lam_end[here] = now
            lam[here], = self._back(now, x[here], ua[here], ub[here], h[here, None],
                                    problem.p_value)
            now = lam[here] + mass[:-1][here]
        return lam, lam_end
