# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Radau collocation on phases of unknown lengths, each with known active constraints.

Let q be the order of a state constraint c(x) <= b. On a boundary arc its derivatives below the
q-th are set to b, 0, ..., 0 at the start of the phase, and the q-th to 0 at all its points. If c
itself were held at the points, inputs could oscillate between them. With eta the multiplier of
the q-th derivative and lam~ the costates of this formulation, those of c(x) <= b itself are

    lam = lam~ + eta d(c^(q-1))/dx - eta' d(c^(q-2))/dx + ...,  density (-1)^q eta^(q)

With dc/dt = s g and dg/dt held at 0 (`constraint_orders`) they are

    lam = lam~ + eta dg/dx - (eta'/s) dc/dx,  density (eta'/s)'

(R. F. Hartl, S. P. Sethi, R. G. Vickson, A survey of the maximum principles for optimal control
problems with state constraints, SIAM Review 37, 1995, section 5). Inputs are polynomials through
the Radau points of each interval and may jump from phase to phase. Within a phase the solution is
smooth, so that the collocation converges with its full order.

The module is long because the unknowns and the rows of all phases share one layout.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.collocation import build_collocation, evaluate_lagrange
from obc_ros.core.numerics.ipopt import build_ipopt, Found, run_ipopt, Watch
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.structure import find_idle_inputs
from obc_ros.core.solver.arcs.constraint_orders import (
    BoundRates,
    build_curvatures,
    find_implied_bounds,
)
from obc_ros.core.solver.arcs.input_arcs import Arc, limit_shortening
from obc_ros.core.solver.arcs.phases import DEGREE, drop_negligible, Grazing, OUTWARDS, Phased
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.transcription.mesh import Path
from obc_ros.core.solver.transcription.program import ProblemScales

_LOOKS = np.linspace(0.0, 1.0, 9)[1:-1]   # samples of a phase at which a rate is checked for zero


class PhasedProgram:
    """
    The nonlinear programs of one structure, for any arcs and numbers.

    :param switching: length m, inputs in which H is linear.
    :param sliding: as for `BoundRates`.
    """

    def __init__(self, problem: Problem, switching: Sequence[bool],
                 sliding: Mapping[int, float] | None = None) -> None:
        self.problem, self.switching = problem, np.array(switching)
        self.bounds = BoundRates(problem, sliding)
        self.idle = np.array(find_idle_inputs(problem))
        # Inputs of a phase without length are arbitrary, and with mixed constraints it would not
        # grow again: it keeps a tenth of its initial length.
        self.least = 0.1 if np.any(self.bounds.orders == 0) else 0.0
        x, u, p = problem.x, problem.u, problem.p
        self._rate = ca.Function('rate', [x, u, p], [problem.f, problem.L, problem.path])
        self._end = ca.Function('end', [x, p], [problem.V, problem.psi])
        self.end_slopes = ca.Function('slopes', [x, p], [ca.jacobian(problem.psi, x)])
        rows = ca.vertcat(x, problem.path)
        self.rows = ca.Function('rows', [x, u, p], [rows])
        self.rows_u = ca.Function('rows_u', [x, u, p], [ca.jacobian(rows, u)])
        points, self.weights, self.derivative, _ = build_collocation(DEGREE, 'radau')
        self.points = np.append(0.0, points)

    def slid(self, sliding: Mapping[int, float]) -> 'PhasedProgram':
        """Return the program in which a path slides along the bounds of some rows."""
        return PhasedProgram(self.problem, self.switching.tolist(), sliding) if sliding else self

    def shortest(self, arcs: Sequence[Arc]) -> Array:
        """Return lower bounds of the lengths of the phases of some arcs [s]."""
        return limit_shortening(arcs, ~self.switching, self.least)

    @cached_property
    def held(self) -> list[ca.Function]:
        """Return for each row its derivatives without inputs, and the first with inputs."""
        x, u, p = self.problem.x, self.problem.u, self.problem.p
        return [ca.Function('held', [x, u, p], [ca.vertcat(*chain[:-1]), chain[-1]])
                for chain in self.bounds.chains]

    def input_slopes(self, problem: Problem, x: Array, u: Array) -> Array:
        """Return the derivatives of the rows by u, (K, n + l, m), at x (K, n), u (K, m)."""
        found = self.rows_u.map(len(x))(x.T, u.T, problem.p_value).full()
        return np.asarray(found.reshape(self.bounds.count, len(x), problem.m).swapaxes(0, 1))

    @cached_property
    def curvatures(self) -> list[ca.Function]:
        """Return for each path constraint its derivatives by the inputs."""
        return build_curvatures(self.problem)

    def implied(self, problem: Problem, arc: Arc, path: Path) -> Mask:
        """
        Return which bounds of inputs follow from constraints held on an arc.

        :param arc: also bounds at which it holds inputs are judged.
        :param path: gives the states and the other inputs.
        :return: (2, m), lower and upper bounds.
        """
        bounds, found = self.bounds, np.zeros((2, problem.m), dtype=bool)
        t = arc.start + _LOOKS * (arc.end - arc.start)
        for row in np.flatnonzero(arc.on):
            if bounds.orders[row] == 0:
                path_row = int(row) - problem.n
                level = (problem.path_upper if arc.on[row] > 0 else problem.path_lower)[path_row]
                found |= find_implied_bounds(
                    problem, self.curvatures[path_row],
                    (path.states_at(t), path.inputs_at(t, after=True)), arc.on[row],
                    float(level), bounds.deciding[row])
        return found

    @cached_property
    def gradients(self) -> list[ca.Function]:
        """Return for each row the gradients of its derivatives without inputs, (n, order)."""
        x, p = self.problem.x, self.problem.p
        return [ca.Function('gradients', [x, p], [
            ca.horzcat(*[ca.gradient(each, x) for each in chain[:-1]])])
            for chain in self.bounds.chains]

    def solve(self, problem: Problem, arcs: Sequence[Arc], meshes: list[Array], guess: Path,
              sizes: ProblemScales, pinned: Mask, meter: Meter,
              grazing: Grazing = frozenset()) -> Phased:
        """
        Solve the program of some arcs by IPOPT.

        :param meshes: lengths of the intervals of each phase, as parts of it.
        :param pinned: (n,), components of x(T) that psi fixes.
        :param grazing: junctions and rows, as in `Phased.outwards`, at which the path meets or
            leaves a bound tangentially.
        """
        return _Solve(self, problem, list(arcs), meshes, sizes, pinned, grazing).run(
            guess, meter)


class _Solve:
    """One program for given arcs, meshes and numbers."""

    def __init__(self, program: PhasedProgram, problem: Problem, arcs: list[Arc],
                 meshes: list[Array], sizes: ProblemScales, pinned: Mask,
                 grazing: Grazing) -> None:
        self.pinned, self.grazing = pinned, grazing
        self.outwards: dict[tuple[int, int], slice] = {}   # places of their rates in g
        self.program, self.problem, self.arcs, self.meshes = program, problem, arcs, meshes
        counts = np.array([len(mesh) for mesh in meshes])
        self.sizes, self.K, self.fractions = sizes, int(counts.sum()), np.concatenate(meshes)
        self.phase_of = np.repeat(np.arange(len(counts)), counts)
        self.first = np.append(0, np.cumsum(counts))   # intervals at which phases begin
        self.g: list[ca.MX] = []
        self.lower: list[Array] = []
        self.upper: list[Array] = []

    def _add(self, g: ca.MX, lower: Array, upper: Array) -> slice:
        """Add constraints, (rows, columns); return the places of their multipliers."""
        start = sum(len(each) for each in self.lower)
        self.g.append(ca.vec(g))
        shape = int(g.shape[0]), int(g.shape[1])
        for kept, values in ((self.lower, lower), (self.upper, upper)):
            kept.append(np.broadcast_to(values, shape).ravel(order='F'))
        return slice(start, start + shape[0] * shape[1])

    def build(self) -> None:
        """Build the program."""
        problem, program, sizes = self.problem, self.program, self.sizes
        n, m, K, d = problem.n, problem.m, self.K, DEGREE
        self.X, self.U = ca.MX.sym('X', n, 1 + K * d), ca.MX.sym('U', m, K * d)
        self.T = ca.MX.sym('T', 1, len(self.meshes))
        x = ca.repmat(sizes.x, 1, 1 + K * d) * self.X
        u = ca.repmat(sizes.u, 1, K * d) * self.U
        part = sizes.time * self.fractions
        h = self.T[self.phase_of.tolist()] * ca.DM(part).T
        h = ca.reshape(ca.repmat(h, d, 1), 1, -1)
        p = problem.p_value
        f, L, c = program._rate.map(K * d)(x[:, 1:], u, ca.repmat(p, 1, K * d))
        starts = (np.arange(K) * d).tolist()
        slopes = [sum(program.derivative[j, r] * x[:, [s + r for s in starts]]
                      for r in range(d + 1)) for j in range(d)]
        order = (np.arange(d) * K + np.arange(K)[:, None]).ravel()
        slope = ca.horzcat(*slopes)[:, order.tolist()]
        scaled = (ca.repmat(h, n, 1) * f - slope) / ca.repmat(sizes.x, 1, K * d)
        self.at_defects = self._add(scaled, np.zeros((1, 1)), np.zeros((1, 1)))
        weights = np.tile(program.weights, K)
        V, psi = program._end(x[:, -1], p)
        self.J = (ca.dot(ca.DM(weights), (h * L).T) + V) / sizes.cost
        self._hold(x, u, c)
        none = np.zeros((1, 1))
        self.at_psi = self._add(psi, none, none) if problem.q else slice(0, 0)
        for i, j in () if problem.start is None else problem.start.linked:
            self._add((x[i, 0] - x[j, 0]) / sizes.x[i], none, none)
        final = problem.final_time
        self._add(ca.sum2(self.T), *(np.full((1, 1), each / sizes.time)
                                     for each in (final.earliest, final.latest)))

    def _hold(self, x: ca.MX, u: ca.MX, c: ca.MX) -> None:
        """Add the equations of active constraints, and bounds where they are not active."""
        problem, d = self.problem, DEGREE
        (lower, upper), n = problem.row_bounds, problem.n
        x_low = np.tile(problem.x_lower, (1 + self.K * d, 1))
        x_high = np.tile(problem.x_upper, (1 + self.K * d, 1))
        start, free = problem.start_box, ~problem.given_at_start
        x_low[0] = np.where(free, np.maximum(start[0], problem.x_lower), start[0])
        x_high[0] = np.where(free, np.minimum(start[1], problem.x_upper), start[1])
        c_low = np.tile(problem.path_lower, (self.K * d, 1))
        c_high = np.tile(problem.path_upper, (self.K * d, 1))
        self.at_held: list[tuple[int, int, slice]] = []   # phase, row, multipliers
        self.at_met: list[tuple[int, int, slice]] = []
        for phase, arc in enumerate(self.arcs):
            a, b = int(self.first[phase]) * d, int(self.first[phase + 1]) * d
            for row in np.flatnonzero(arc.on):
                bound = (upper if arc.on[row] > 0 else lower)[row]
                self._on(x, u, int(row), bound, phase)
                if row < n:
                    x_low[max(a, 1):b + 1, row], x_high[max(a, 1):b + 1, row] = -np.inf, np.inf
                else:
                    c_low[max(a - 1, 0):b, row - n] = -np.inf
                    c_high[max(a - 1, 0):b, row - n] = np.inf
            for row in np.flatnonzero(arc.met if a else ()):
                bound = (upper if arc.met[row] > 0 else lower)[row]
                self._meet(x, u, int(row), bound, phase)
                if row < n:
                    x_low[a, row], x_high[a, row] = -np.inf, np.inf
                else:
                    c_low[a - 1, row - n], c_high[a - 1, row - n] = -np.inf, np.inf
        for phase, constant in self._constant():
            a, b = (int(k) * d for k in self.first[phase:phase + 2])
            # The bound is kept at the end of the phase: its multiplier there keeps the inputs at
            # their bounds before.
            if constant < n:
                x_low[max(a, 1):b, constant], x_high[max(a, 1):b, constant] = -np.inf, np.inf
            else:
                c_low[max(a - 1, 0):b - 1, constant - n] = -np.inf
                c_high[max(a - 1, 0):b - 1, constant - n] = np.inf
        known = self._known_at_end()
        c_low[-1:, known], c_high[-1:, known] = -np.inf, np.inf
        spare = self._spare()
        x_low[(self.K - len(self.meshes[-1])) * d:, spare] = -np.inf
        x_high[(self.K - len(self.meshes[-1])) * d:, spare] = np.inf
        for phase in range(len(self.arcs)):
            # Only the cost determines singular inputs: they are linear in each interval.
            self._bend(u, self._loose(phase), range(*self.first[phase:phase + 2].tolist()), 1)
            self._begin(u, phase)
        self._bend(u, self._idle, [self.K - 1], DEGREE - 2)
        self.x_bounds = x_low / self.sizes.x, x_high / self.sizes.x
        self.at_path = slice(0, 0)
        if c_low.size:
            self.at_path = self._add(c, c_low.T, c_high.T)

    def _kept(self, phase: int, row: int) -> bool:
        """Return whether all inputs that occur in a row are at their bounds in a phase."""
        deciding = self.program.bounds.deciding[row]
        return 0 <= phase < len(self.arcs) and not np.isnan(
            np.array(self.arcs[phase].levels))[deciding].any()

    def _known_at_end(self) -> Mask:
        """Return which path constraints have a value at T that psi alone determines."""
        problem, program = self.problem, self.program
        known = np.zeros(program.bounds.count - problem.n, dtype=bool)
        end = self.guess.x[-1]
        for row in np.flatnonzero(program.bounds.orders[problem.n:] > 0) if problem.q else ():
            slope = program.gradients[int(row) + problem.n](end, problem.p_value).full()[:, 0]
            psi_x = program.end_slopes(end, problem.p_value).full()
            rest = slope - psi_x.T @ np.linalg.lstsq(psi_x.T, slope, rcond=None)[0]
            known[row] = np.abs(rest).max() <= 1e-9 * np.abs(slope).max()
        return known

    def _constant(self) -> list[tuple[int, int]]:
        """Return phases and rows that are constant in them since inputs at bounds hold them."""
        bounds, found = self.program.bounds, []
        for phase, arc in enumerate(self.arcs):
            held = ~np.isnan(arc.levels)
            for row in np.flatnonzero(bounds.orders == 1):
                if held[bounds.deciding[row]].all():
                    t = arc.start + _LOOKS * (arc.end - arc.start)
                    x, u = self.guess.states_at(t), self.guess.inputs_at(t, after=True)
                    u = np.where(held, arc.levels, u)
                    if not np.any(self.program.held[int(row)].map(len(t))(
                            x.T, u.T, self.problem.p_value)[1].full()):
                        found.append((phase, int(row)))
        return found

    def _spare(self) -> Mask:
        """Return which states fixed by psi have a rate without free inputs in the last phase."""
        free = np.isnan(self.arcs[-1].levels)
        bounds = self.program.bounds
        moved = (bounds.deciding & free).any(axis=1) | (bounds.orders != 1)
        spare: Mask = self.pinned & ~moved[:self.problem.n]
        return spare

    def _loose(self, phase: int) -> Mask:
        """Return which inputs are singular in a phase."""
        arc, bounds = self.arcs[phase], self.program.bounds
        loose = self.program.switching & np.isnan(arc.levels)
        for row in np.flatnonzero(arc.on):
            # A linear constraint determines one of its inputs from the others, another one all.
            fixed = np.flatnonzero(bounds.deciding[row] & np.isnan(arc.levels))
            loose[fixed[-1:] if bounds.straight[row] else fixed] = False
        return np.asarray(loose)

    def _bend(self, u: ca.MX, inputs: Mask, intervals: Iterable[int], degree: int) -> None:
        """Require inputs to be polynomials of at most a degree in some intervals."""
        powers = np.vander(self.program.points[1:], degree + 1).T
        bent, rows = np.linalg.svd(powers)[2][degree + 1:], np.flatnonzero(inputs)
        for k in intervals if rows.size else ():
            values = u[rows.tolist(), k * DEGREE:(k + 1) * DEGREE]
            none = np.zeros((1, 1))
            self._add(ca.mtimes(values, bent.T) / ca.DM(self.sizes.u[rows]), none, none)

    @cached_property
    def _idle(self) -> Mask:
        """
        Return which free inputs are not determined at T, the last of the points.

        Their value there is extrapolated; otherwise it would be arbitrary, also on a path
        constraint.
        """
        arc, bounds = self.arcs[-1], self.program.bounds
        free = np.isnan(arc.levels)
        idle: Mask = self.program.idle & free & ~self._loose(-1)
        for row in np.flatnonzero(arc.on):
            decided = bounds.deciding[row] & free
            if bounds.orders[row] or not idle[decided].all():
                idle = idle & ~decided
        return idle

    def _first(self, u: ca.MX, phase: int) -> ca.MX:
        """Return the inputs (m,) at the start of a phase, which is not a Radau point."""
        first = evaluate_lagrange(self.program.points[1:], 0.0)
        a = int(self.first[phase]) * DEGREE
        return ca.mtimes(u[:, a:a + DEGREE], ca.DM(first))

    def _begin(self, u: ca.MX, phase: int) -> None:
        """Require free inputs to be within their bounds at the start of a phase."""
        lower, upper = self.u_bounds[phase]
        size = self.sizes.u
        free = np.flatnonzero(np.isnan(self.arcs[phase].levels) & (
            np.isfinite(lower) | np.isfinite(upper)) & ~self._free(phase))
        if free.size:
            self._add((self._first(u, phase) / ca.DM(size))[free.tolist()],
                      (lower / size)[free, None], (upper / size)[free, None])

    def _on(self, x: ca.MX, u: ca.MX, row: int, bound: float, phase: int) -> None:
        """Require a row to be at its bound in a phase."""
        p, order = self.problem.p_value, int(self.program.bounds.orders[row])
        a, b = (int(k) * DEGREE for k in self.first[phase:phase + 2])
        held, sign = self.program.held[row], self.arcs[phase].on[row]
        # Next to a phase with its inputs at bounds, a mixed constraint is continuous.
        if not order and self._kept(phase - 1, row):
            self._inside((held(x[:, a], u[:, a - 1], p)[1] - bound) * sign, row, bound, phase)
        if not order and self._kept(phase + 1, row):
            self._inside((held(x[:, b], self._first(u, phase + 1), p)[1] - bound) * sign, row,
                         bound, -1 - phase)
        if order and a and not self._also(phase - 1, row, sign):
            value = np.append(bound, np.zeros(order - 1))[:, None]
            entry = held(x[:, a], u[:, a - 1], p)
            self._add(entry[0], value, value)
            self._inside(entry[1] * sign * (-1)**order, row, bound, phase)
        if order and phase + 1 < len(self.arcs) and not self._also(phase + 1, row, sign):
            self._inside(held(x[:, b], self._first(u, phase + 1), p)[1] * sign, row, bound,
                         -1 - phase)
        deciding = self.program.bounds.deciding[row]
        if b == self.K * DEGREE and not order and self._idle[deciding].any():
            b -= 1
        last = held.map(b - a)(x[:, a + 1:b + 1], u[:, a:b], ca.repmat(p, 1, b - a))[1]
        level = np.full((1, 1), 0.0 if order else bound)
        self.at_held.append((phase, row, self._add(last, level, level)))

    def _meet(self, x: ca.MX, u: ca.MX, row: int, bound: float, phase: int) -> None:
        """Require a row to touch its bound at the start of a phase."""
        p, order = self.problem.p_value, int(self.program.bounds.orders[row])
        a, sign, held = int(self.first[phase]) * DEGREE, self.arcs[phase].met[row], (
            self.program.held[row])
        before, after = (held(x[:, a], each, p) for each in (
            u[:, a - 1], self._first(u, phase)))
        level = np.full((1, 1), bound)
        self.at_met.append((phase, row, self._add(before[0][0], level, level)))
        size = (max(abs(bound), self.size[row]) or 1.0) / self.sizes.time
        if order == 1:
            self._inside(-sign * before[1], row, bound, phase)
            self._add(after[1] * sign / size, np.full((1, 1), -np.inf),
                      np.full((1, 1), OUTWARDS))
        else:   # without it the path would cross the bound, at a lower cost
            self._add(before[0][1] / size, np.zeros((1, 1)), np.zeros((1, 1)))

    def _also(self, phase: int, row: int, sign: int) -> bool:
        """Return whether a bound of a row is active in a phase."""
        on = self.arcs[phase].on
        return bool(on) and on[row] == sign

    def _inside(self, outwards: ca.MX, row: int, bound: float, place: int) -> None:
        """
        Require a path to meet or leave a bound from inside, which the points do not ensure.

        A rate of up to OUTWARDS outwards is allowed, since inputs at their bounds may leave no
        other way. At a `grazing` junction the rate is set to zero, and the bounds of its inputs
        are dropped there.
        """
        size = max(abs(bound), self.size[row]) or 1.0
        rate = size / self.sizes.time**int(self.program.bounds.orders[row])
        most = OUTWARDS if self.program.bounds.orders[row] else 0.0
        span = (0.0, 0.0) if (place, row) in self.grazing else (-np.inf, most)
        self.outwards[place, row] = self._add(
            outwards / rate, *(np.full((1, 1), each) for each in span))

    def _free(self, place: int) -> Mask:
        """Return which inputs a grazing junction determines, so that they need no bounds there."""
        rows = [row for where, row in self.grazing if where == place]
        return np.asarray(self.program.bounds.deciding[rows].any(axis=0))

    def run(self, guess: Path, meter: Meter) -> Phased:
        """Solve the program."""
        self.guess = guess
        self.size = np.abs(self.program.rows.map(len(guess.x))(
            guess.x.T, guess.u.T, self.problem.p_value).full()).max(axis=1)
        # Of free inputs in each phase, without the bounds that are implied.
        self.u_bounds = [np.where([lower, upper], [[-np.inf], [np.inf]], [
            self.problem.u_lower, self.problem.u_upper]) for lower, upper in (
                self.program.implied(self.problem, arc, guess) for arc in self.arcs)]
        self.build()
        problem, sizes, K, d = self.problem, self.sizes, self.K, DEGREE
        w = ca.vertcat(ca.vec(self.X), ca.vec(self.U), ca.vec(self.T))
        g = ca.vertcat(*self.g)
        watch = Watch(int(w.numel()), int(g.numel()), 0)
        watch.begin(meter.step, np.concatenate(self.lower), np.concatenate(self.upper), sizes.cost)
        solver = build_ipopt('phases', {'x': w, 'f': self.J, 'g': g}, watch=watch)
        durations = np.array([arc.end - arc.start for arc in self.arcs])
        levels = np.array([arc.levels for arc in self.arcs])[np.repeat(self.phase_of, d)]
        limits = np.array(self.u_bounds)[np.repeat(self.phase_of, d)]
        u_low, u_high = (np.where(np.isnan(levels), limits[:, side], levels) for side in (0, 1))
        for phase, last in enumerate(self.first[1:] * d - 1):
            known = self._free(-1 - phase) & np.isnan(self.arcs[phase].levels)
            u_low[last, known], u_high[last, known] = -np.inf, np.inf
        longest = np.full(len(durations), 4 * durations.sum() / sizes.time)
        bounds = [np.concatenate([x.ravel(), (u / sizes.u).ravel(), T]) for x, u, T in (
            (self.x_bounds[0], u_low, self.program.shortest(self.arcs) / sizes.time),
            (self.x_bounds[1], u_high, longest))]
        t = np.append(0.0, np.cumsum(durations[self.phase_of] * self.fractions))
        times = (t[:-1, None] + np.diff(t)[:, None] * self.program.points[1:]).ravel()
        first = problem.pin_start(guess.x[0]).x0
        x = np.vstack([first, guess.states_at(times)]) / sizes.x
        # Inside of the interval, since the two sides of a jump differ.
        inside = times - 1e-6 * np.tile(np.append(np.zeros(d - 1), 1.0), K) * np.repeat(
            np.diff(t), d)
        u = np.clip(guess.inputs_at(inside, after=True), u_low, u_high) / sizes.u
        return self._phased(run_ipopt(
            solver, np.concatenate([x.ravel(), u.ravel(), durations / sizes.time]),
            (bounds[0], bounds[1]), (watch.lower, watch.upper)))

    def _phased(self, found: Found) -> Phased:
        problem, sizes, K, d = self.problem, self.sizes, self.K, DEGREE
        n, m, program = problem.n, problem.m, self.program
        w, lam_g = found.w, found.lam_g * sizes.cost
        x = w[:n * (1 + K * d)].reshape(-1, n) * sizes.x
        u = w[n * (1 + K * d):][:m * K * d].reshape(K, d, m) * sizes.u
        durations = w[-len(self.meshes):] * sizes.time
        h = durations[self.phase_of] * self.fractions
        raw = lam_g[self.at_defects].reshape(K, d, n) / sizes.x
        lam = np.empty((K, d + 1, n))
        lam[:, 1:] = raw / program.weights[:, None]
        # The costate at the start of an interval follows from the derivatives at 0.
        lam[:, 0] = -np.einsum('j,kjn->kn', program.derivative[:, 0], raw)
        area = h[:, None] * program.weights + 1e-300
        eta = np.zeros((K, d, program.bounds.count))
        if problem.path.numel():
            # Multipliers of pure state constraints are impulses, not densities.
            mixed = program.bounds.orders[n:] == 0
            slopes = program.input_slopes(problem, x[d::d], u[:, -1])[:, n:]
            eta[:, :, n:] = drop_negligible(
                mixed * lam_g[self.at_path].reshape(K, d, -1) / area[:, :, None],
                found.f * sizes.cost / h.sum(), slopes, u[:, -1])
        for phase, row, slot in self.at_held:
            span = slice(int(self.first[phase]), int(self.first[phase + 1]))
            eta[span, :, row] = np.resize(
                np.append(lam_g[slot], 0.0), area[span].shape) / area[span]
        places = (np.arange(K) * d)[:, None] + np.arange(d + 1)
        ends = np.cumsum(durations)
        arcs = [replace(arc, start=float(end - length), end=float(end))
                for arc, end, length in zip(self.arcs, ends, durations, strict=True)]
        astray = [(phase, row) for phase, row, slot in self.at_met
                  if lam_g[slot][0] * self.arcs[phase].met[row] < 0]
        outwards = {key: float(found.g[slot][0]) for key, slot in self.outwards.items()}
        return Phased(
            arcs=arcs, meshes=self.meshes, durations=durations, x=x[places], u=u, lam=lam,
            eta=eta, nu=lam_g[self.at_psi], cost=found.f * sizes.cost,
            converged=found.converged, outwards=outwards, astray=astray,
            pushed=self._pushed(found.lam_w, lam_g, x, lam))

    def _pushed(self, lam_w: Array, lam_g: Array, x: Array, lam: Array) -> Array:
        """Return `Phased.pushed`: scaled multipliers of bounds that are not held."""
        n, K, d, program = self.problem.n, self.K, DEGREE, self.program
        size = np.append(np.abs(x).max(axis=0), np.zeros(program.bounds.count - n))
        for row in np.flatnonzero(program.bounds.orders[n:] > 0) + n:
            slope = program.gradients[int(row)].map(K)(x[d::d].T, self.problem.p_value).full()
            slope = np.abs(slope.reshape(n, K, -1)[:, :, 0])
            size[row] = (slope * size[:n, None]).sum(axis=0).max()
        lam_x = lam_w[n:n * (1 + K * d)] * self.sizes.cost
        weights = np.zeros((K, d, len(size)))
        weights[:, :, :n] = lam_x.reshape(K, d, n) / self.sizes.x
        if len(size) > n:
            weights[:, :, n:] = lam_g[self.at_path].reshape(K, d, -1)
        weights[-1, -1] = 0.0   # at T it cannot be told from the multiplier of psi
        largest = (np.abs(lam).max(axis=(0, 1)) * size[:n]).max()
        return np.asarray(weights * size * (program.bounds.orders > 0) / (largest or 1.0))
