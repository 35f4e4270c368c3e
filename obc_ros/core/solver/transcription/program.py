# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Transcription to a nonlinear program, with inputs linear in time between mesh points.

In an interval of length h, dx/dt = f(x, u) is discretised by one of two schemes: Gauss
collocation with a polynomial of degree s through s points (order 2s, for stiff systems and state
bounds), or an explicit Runge-Kutta step of order 6 (fewer unknowns). u is linear from u_k+ to
u_(k+1)-, so that bounds at mesh points hold everywhere, and the returned input is the optimised
one. Up to the discretisation error of the states the cost is not below the minimum; it exceeds it
by O(h^4) where u* is smooth. Phases may have unknown lengths, and inputs held at given values
(arcs).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, Mask
from obc_ros.core.numerics.collocation import build_collocation, compute_gauss_points
from obc_ros.core.numerics.instructions import find_dependence
from obc_ros.core.numerics.ipopt import build_ipopt, Found, run_ipopt, Watch
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.ocp.certificate.certificate import COUNTS_AS_MET
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Verdict
from obc_ros.core.solver.nlp.interior_point import StoppingRule
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.transcription.banded_program import Stages
from obc_ros.core.solver.transcription.block_program import assemble, Block, BlockProgram, Piece
from obc_ros.core.solver.transcription.intervals import Pieces
from obc_ros.core.solver.transcription.local_minima import LocalMinima
from obc_ros.core.solver.transcription.mesh import HELD, Layout, Mesh, Path, STEPPED

_ENOUGH = 'iterations used up, or near a known minimum'
# Why a solve ended, by the status of the interior-point method and of IPOPT.
_ENDS = {
    'stopped': _ENOUGH, 'too slow': 'converges too slowly',
    'no step': 'no step improves the iterate',
    'User_Requested_Stop': _ENOUGH,
    'Infeasible_Problem_Detected': 'locally infeasible'}


@dataclass(frozen=True, eq=False)
class TranscriptionOutcome:
    """
    The result of a transcription.

    :ivar mesh, path: the mesh, and the last iterate on it.
    :ivar converged, status: whether the tolerances are met, and why the solve ended.
    :ivar objective, infeasibility: cost, and largest scaled violation of a row.
    :ivar nu: (q,), multipliers of psi.
    :ivar costates: (N + 1, n), at mesh points, before any jump there; the first row is nan without
        collocation.
    :ivar node_bounds, inner_bounds: (N + 1, n), (N, s, n), multipliers of the bounds of x at mesh
        points and Gauss points, > 0 at an upper bound.
    :ivar node_path, inner_path: (N + 1, l), (N, s, l), the same for the path constraints; the last
        row is that at T.
    :ivar sides_path: (N, 2, l), multipliers of the path constraints at the start and at the end of
        each interval, which differ at the ends of phases.
    :ivar w, lam_w, lam_g, mu: unknowns, multipliers and barrier parameter of the program, for a
        warm start.
    :ivar scales: scales of these.
    """

    mesh: Mesh
    path: Path
    converged: bool
    status: str
    objective: float
    infeasibility: float
    iterations: int
    nu: Array
    costates: Array
    node_bounds: Array
    inner_bounds: Array
    node_path: Array
    inner_path: Array
    sides_path: Array
    w: Array
    lam_w: Array
    lam_g: Array
    mu: float
    scales: 'ProblemScales | None' = None

    def judge(self) -> tuple[Verdict, str]:
        """Return the verdict on the iterate, and why the solve ended if it did not converge."""
        if self.converged:
            return Verdict.CONVERGED, ''
        reason = _ENDS.get(self.status, self.status.replace('_', ' ').lower())
        return Verdict.NOT_CONVERGED, f'{reason}, infeasibility {self.infeasibility:.1e}'

    def tightening_costs(self) -> Array:
        """Return the derivative of J by the tightening of each bound of x and of c, (n + l,)."""
        parts = ((self.node_bounds, self.inner_bounds), (self.node_path, self.inner_path))
        return np.concatenate([np.abs(a).sum(0) + np.abs(b).sum((0, 1)) for a, b in parts])

    def impulses(self, parts: int) -> Array:
        """
        Return the multiplier impulses of the bounds of x, by which lam drops, (N * parts + 1, n).

        Each interval has `parts`. Multipliers at Gauss points belong to the nearest end of one.
        """
        mass = np.zeros((len(self.path.ua) * parts + 1, self.path.x.shape[1]))
        mass[::parts] = self.node_bounds
        for j, c in enumerate(compute_gauss_points(self.inner_bounds.shape[1])):
            place = round(c * parts)
            mass[place:place + (len(mass) - 1):parts] += self.inner_bounds[:, j]
        return mass


@dataclass(frozen=True, eq=False)
class ProblemScales:
    """Scales of the states (n,), the inputs (m,), the time [s] and the cost."""

    x: Array
    u: Array
    time: float
    cost: float


@dataclass(frozen=True)
class SolveEffort:
    """
    How much is done for a solve of a program.

    :ivar rough: relative error of the cost at which the iteration may end; 0: the usual tolerance.
    :ivar once: try the faster method only.
    :ivar known: local minima; the iteration ends once it is seen to lead to one of them.
    """

    most: int = 500
    rough: float = 0.0
    once: bool = False
    known: LocalMinima | None = None


@dataclass(frozen=True, eq=False)
class Nearby:
    """
    What is known of a solution near the initial guess.

    :ivar scales: scales of the unknowns and of the cost; estimated from the guess if left out.
    :ivar warm: outcome of a neighbouring problem on this mesh: initial point and multipliers.
    :ivar guide: outcome of this problem on another mesh, from which multipliers are interpolated.
    :ivar shortest: (phases,), or float, lower bound of the lengths of the phases [s].
    """

    scales: ProblemScales | None = None
    warm: TranscriptionOutcome | None = None
    guide: TranscriptionOutcome | None = None
    shortest: Array | float = 0.0


@dataclass(frozen=True, eq=False)
class TightenedLimits:
    """
    Bounds of a program besides those of its problem.

    :ivar shortest, longest: (phases,), bounds of the lengths of the phases [s].
    :ivar margin: (n + l,), tightening of the bounds of x and of the path constraints, >= 0.
    :ivar pinned: (n,), components of x(T) that psi fixes, which need no bounds at T.
    :ivar end: (n,), these, and a given time among the states; nan for the other components.
    """

    shortest: Array
    longest: Array
    margin: Array
    pinned: Mask
    end: Array

    def of_states(self, problem: Problem, s: Array) -> Array:
        """
        Return the tightening of the bounds of x.

        It vanishes towards an end at which x is given on a bound, since large inputs would be
        needed to reach it within a short interval.

        :param problem: with x(0) and the bounds.
        :param s: (K,), times as parts of the horizon.
        :return: (K, n).
        """
        margin, s = self.margin[:problem.n], s[:, None]
        beside = np.minimum(problem.x0 - problem.x_lower, problem.x_upper - problem.x0)
        beside = problem.given_at_start & (beside < 9.0 * margin)   # x(0) counts as on the bound
        part = 0.1   # of the horizon, in which a margin grows from 0
        begins = np.where(beside, np.minimum(s / part, 1)**4, 1)
        ends = np.where(self.pinned, np.minimum((1 - s) / part, 1)**4, 1)
        return np.asarray(margin * begins * ends)


USUAL = SolveEffort()


class Transcription:
    """
    The nonlinear program of a problem on a layout, for any numbers.

    :param problem: its symbols and expressions are used, not its numbers.
    :param pieces: of the same problem and scheme, for any other layout.
    """

    def __init__(self, problem: Problem, layout: Layout, pieces: Pieces | None = None) -> None:
        self.layout, self._solvers = layout, dict[str, tuple[ca.Function, Watch]]()
        self._pieces = pieces or Pieces(problem, layout.stages, layout.free_durations)
        self.n, self.m, self.q = problem.n, problem.m, problem.q
        self.l = int(problem.path.numel())
        self.c = compute_gauss_points(layout.stages)
        self._links = 0 if problem.start is None else len(problem.start.linked)
        self._number(problem)
        self._uses = find_dependence(problem.path, ca.vertcat(problem.x, problem.u))
        # The last intervals of the phases at whose ends path constraints are needed.
        last: Index = np.cumsum([phase.intervals for phase in layout.phases]) - 1
        self._ends = last if ca.depends_on(problem.path, problem.u) else last[-1:]
        self._path = ca.Function('path', [problem.x, problem.u, problem.p], [problem.path])

    def _number(self, problem: Problem) -> None:
        """Assign a place to each unknown and each constant."""
        layout, n, m = self.layout, self.n, self.m
        N, stride = layout.intervals, n * (1 + layout.stages)
        self.at_x = stride * np.arange(N + 1)[:, None] + np.arange(n)
        self.at_inner = (self.at_x[:-1, None, :] + n * (1 + np.arange(layout.stages))[:, None])
        first = N * stride + n
        self.at_ua = np.zeros((N, m), dtype=np.int64)
        self.at_ub = np.zeros((N, m), dtype=np.int64)
        held: list[tuple[int, int]] = []
        k = 0
        for number, phase in enumerate(layout.phases):
            span = np.arange(k, k + phase.intervals)
            for i, mode in enumerate(phase.modes):
                if mode == HELD:
                    self.at_ua[span, i] = self.at_ub[span, i] = -1 - len(held)
                    held.append((number, i))
                    continue
                if mode == STEPPED:
                    self.at_ua[span, i] = self.at_ub[span, i] = first + np.arange(phase.intervals)
                    first += phase.intervals
                    continue
                places = first + np.arange(phase.intervals + 1)
                first += len(places)
                self.at_ua[span, i], self.at_ub[span, i] = places[:-1], places[1:]
            k += phase.intervals
        self.held = held
        phases = len(layout.phases)
        self.at_duration = first + np.arange(phases)
        self.unknowns = first + (phases if layout.free_durations else 0)
        self.shared = len(problem.parameters) + n + m + 2
        self.constants = self.shared + N + len(held) + (0 if layout.free_durations else phases)
        base = self.unknowns + self.shared
        self.at_fraction = base + np.arange(N)
        for inputs in (self.at_ua, self.at_ub):
            inputs[inputs < 0] = base + N - 1 - inputs[inputs < 0]
        if not layout.free_durations:
            self.at_duration = base + N + len(held) + np.arange(phases)
        # The state, input or time that each unknown represents.
        self.which = np.full(self.unknowns + self.constants, n + m)
        self.which[self.at_x] = self.which[self.at_inner] = np.arange(n)
        self.which[self.at_ua] = self.which[self.at_ub] = n + np.arange(m)
        self.which = self.which[:self.unknowns]

    def _index(self) -> tuple[Index, Index]:
        """Return the places of the local variables and of the constants of each interval."""
        layout = self.layout
        duration = self.at_duration[layout.phase_of][:, None]
        own, free = [self.at_fraction[:, None]], list[Index]()
        (free if layout.free_durations else own).append(duration)
        v = [self.at_x[:-1], self.at_ua, self.at_ub, *free,
             self.at_inner.reshape(layout.intervals, -1), self.at_x[1:]]
        return np.hstack(v), np.hstack(own) - self.unknowns

    @cached_property
    def _staged(self) -> Stages | None:
        """Return the banded program: one phase, Runge-Kutta steps, no path constraints, links."""
        layout = self.layout
        if (len(layout.phases) > 1 or layout.stages or self.l or self.held or self._links
                or STEPPED in layout.phases[0].modes):
            return None
        inputs = np.vstack([self.at_ua[:1], self.at_ub])
        return Stages(self._pieces.interval, self._pieces.end, *self._index(),
                      self.at_x[-1], np.hstack([self.at_x, inputs]), self.unknowns, self.shared)

    @cached_property
    def _program(self) -> BlockProgram:
        return assemble(self._blocks(), self.unknowns, self.shared, self.constants)

    def _blocks(self) -> list[Block]:
        """Return intervals, the end, path constraints at ends of phases, lengths, the start."""
        layout, pieces = self.layout, self._pieces
        none = np.zeros((1, 0), dtype=np.int64)
        blocks = [Block(pieces.interval, *self._index()), Block(pieces.end, self.at_x[-1:], none)]
        if self.l:
            places = np.hstack([self.at_x[self._ends + 1], self.at_ub[self._ends]])
            blocks.append(Block(pieces.limits, places, np.zeros((len(places), 0), dtype=np.int64)))
        if len(layout.phases) > 1:
            durations = ca.SX.sym('durations', len(layout.phases))
            blocks.append(Block(
                Piece(durations, ca.SX(0, 1), pieces.shared, ca.sum1(durations), ca.SX(0)),
                self.at_duration[None, :], none))
        if pieces.links is not None:
            blocks.append(Block(pieces.links, self.at_x[:1], none))
        return blocks

    def _solver(self, start: str) -> tuple[ca.Function, Watch]:
        if start not in self._solvers:
            rows = int(self._program.nlp['g'].numel())
            watch = Watch(self.unknowns, rows, self.constants)
            self._solvers[start] = build_ipopt(
                start, self._program.nlp, watch=watch,
                derivatives=self._program.derivatives), watch
        return self._solvers[start]

    def times(self, mesh: Mesh, durations: Array) -> Array:
        """Return the mesh points [s], shape (N + 1,)."""
        return np.append(0.0, np.cumsum(mesh.fractions * durations[self.layout.phase_of]))

    def start(self, mesh: Mesh, guess: Path, durations: Array, scales: ProblemScales) -> Array:
        """Return the unknowns of a guess, stretched in time to `durations` (phases,) [s]."""
        t = self.times(mesh, durations)
        stretch = guess.t[-1] / t[-1]
        w = np.zeros(self.unknowns)
        w[self.at_x] = guess.states_at(t * stretch) / scales.x
        if self.at_inner.size:
            inner = (t[:-1, None] + np.diff(t)[:, None] * self.c).ravel()
            w[self.at_inner] = (guess.states_at(inner * stretch) / scales.x).reshape(
                self.at_inner.shape)
        for places, times, after in ((self.at_ub, t[1:], False), (self.at_ua, t[:-1], True)):
            values = guess.inputs_at(times * stretch, after) / scales.u
            unknown = places < self.unknowns
            w[places[unknown]] = values[unknown]
        if self.layout.free_durations:
            w[self.at_duration] = durations / scales.time
        return w

    def multipliers(self, mesh: Mesh, guide: TranscriptionOutcome, scales: ProblemScales) -> Array:
        """Return `lam_g` of steps, without path constraints, from an outcome on another mesh."""
        t = self.times(mesh, guide.path.durations)[1:]
        costates = np.vstack([guide.costates[1], guide.costates[1:]])
        lam = interpolate_columns(t, guide.path.t, costates)
        return np.append((-lam * scales.x).ravel(), guide.nu) / scales.cost

    def _constants(self, problem: Problem, mesh: Mesh, scales: ProblemScales) -> Array:
        held = [mesh.held[number, i] / scales.u[i] for number, i in self.held]
        given = [] if self.layout.free_durations else [problem.final_time.value / scales.time]
        return np.concatenate([problem.p_value, scales.x, scales.u, [scales.time, scales.cost],
                               mesh.fractions, held, given])

    def _bounds(self, problem: Problem, mesh: Mesh, scales: ProblemScales,
                limits: TightenedLimits) -> tuple[Array, Array]:
        size = np.concatenate([scales.x, scales.u, [scales.time]])
        lower, upper = ((np.concatenate([x, u, [0.0]]) / size)[self.which] for x, u in (
            (problem.x_lower, problem.u_lower), (problem.x_upper, problem.u_upper)))
        if limits.margin[:self.n].any():
            phases = len(self.layout.phases)
            s = self.times(mesh, np.full(phases, 1 / phases))
            margin = limits.of_states(problem, s) / scales.x
            for places, rows in ((self.at_x, margin), (self.at_inner, np.minimum(
                    margin[:-1], margin[1:])[:, None])):
                lower[places] += rows
                upper[places] -= rows
        lower[self.at_x[-1, limits.pinned]] = -np.inf
        upper[self.at_x[-1, limits.pinned]] = np.inf
        mesh.hold(lower, upper, self.at_x, slice(self.n))
        first = self.at_x[0]
        low, high = (each / scales.x for each in problem.start_box)
        # x(0) is within tightened bounds if possible.
        inner = np.maximum(low, lower[first]), np.minimum(high, upper[first])
        fits = ~problem.given_at_start & (inner[0] <= inner[1])
        lower[first], upper[first] = np.where(fits, inner, (low, high))
        if self.layout.free_durations:
            lower[self.at_duration] = limits.shortest / scales.time
            upper[self.at_duration] = limits.longest / scales.time
        return lower, upper

    def _settled(self, problem: Problem, mesh: Mesh) -> Mask:
        """Return the equalities c(u) that held inputs satisfy in each phase, (phases, l)."""
        phases = self.layout.phases
        held = np.array([[mode == HELD for mode in phase.modes] for phase in phases])
        loose = (self._uses[:, self.n:] & ~held[:, None]).any(axis=2)
        loose |= self._uses[:, :self.n].any(axis=1) | (problem.path_lower != problem.path_upper)
        if loose.all():
            return np.zeros_like(loose)
        values = np.array([self._path(problem.x0, u, problem.p_value).full()[:, 0]
                           for u in mesh.held])
        met = np.abs(values - problem.path_lower) <= 1e-9 * (1 + np.abs(values))
        return np.asarray(met & ~loose)

    def _decided(self, problem: Problem, x: Array, margin: Array) -> Mask:
        """
        Return the path constraints that a given state alone decides and that leave no room, (l,).

        A row without unknowns is met or it is not; where rounding errors, or a tightened bound,
        decide that, no iterate would be feasible. `x`: nan where it is not given.
        """
        given = ~np.isnan(x)
        if not self.l or not given.any():
            return np.zeros(self.l, dtype=bool)
        value = self._path(np.where(given, x, 0.0), np.zeros(self.m), problem.p_value).full()[:, 0]
        near = COUNTS_AS_MET * (1 + np.abs(value))
        lower, upper = problem.path_lower, problem.path_upper
        met = (value >= lower - near) & (value <= upper + near)
        room = (value > lower + margin + near) & (value < upper - margin - near)
        free = np.append(~given, np.ones(self.m, dtype=bool))
        return np.asarray(met & ~room & ~self._uses[:, free].any(axis=1))

    def solvable(self, problem: Problem, mesh: Mesh) -> bool:
        """Return whether there are at least as many unknowns as equations."""
        layout = self.layout
        equations = self.n * (layout.stages + 1) * layout.intervals + self.q
        equalities = (problem.path_lower == problem.path_upper) & ~self._settled(problem, mesh)
        intervals = np.array([phase.intervals for phase in layout.phases])
        known = int(problem.given_at_start.sum()) + self._links
        return self.unknowns - known >= equations + int(intervals @ equalities.sum(axis=1))

    def _row_bounds(self, problem: Problem, mesh: Mesh, scales: ProblemScales,
                    limits: TightenedLimits) -> tuple[Array, Array]:
        N, s = self.layout.intervals, self.layout.stages
        collocation, margin = np.zeros(self.n * (s + 1)), limits.margin[self.n:]
        lower, upper = list[Array](), list[Array]()
        # Inputs that are linear in an interval cannot satisfy an equality at all its points.
        loose = np.where(problem.path_lower == problem.path_upper, np.inf, 0.0)
        for rows, path, inner in ((lower, problem.path_lower + margin, -loose),
                                  (upper, problem.path_upper - margin, loose)):
            rows.append(np.tile(np.concatenate([collocation, path, np.tile(path + inner, s)]), N))
            rows.append(np.zeros(self.q))
            if self.l:
                rows.append(np.tile(path, self._program.rows[2] // self.l))
        if len(self.layout.phases) > 1:
            lower.append(np.array([problem.final_time.earliest / scales.time]))
            upper.append(np.array([problem.final_time.latest / scales.time]))
        for rows in (lower, upper):
            rows.append(np.zeros(self._links))
        bounds = np.concatenate(lower), np.concatenate(upper)
        each = self.n * (s + 1) + self.l * (s + 1)
        places = each * np.arange(N)[:, None] + self.n * (s + 1) + np.arange(self.l)
        mesh.hold(*bounds, places, slice(self.n, None))
        # Equalities that always hold would make the equations dependent.
        settled = self._settled(problem, mesh)
        start = np.where(problem.given_at_start, problem.x0, np.nan)
        last = len(bounds[0]) - self._links - (len(self.layout.phases) > 1) - self.l
        spare = [places[settled[self.layout.phase_of]],
                 places[0, self._decided(problem, start, margin)],
                 last + np.flatnonzero(self._decided(problem, limits.end, margin))]
        if settled.any() and len(settled) * self.l == self._program.rows[2]:
            spare.append(each * N + self.q + np.flatnonzero(settled))
        for values, none in zip(bounds, (-np.inf, np.inf), strict=True):
            values[np.concatenate(spare)] = none
        return bounds

    def solve(self, problem: Problem, mesh: Mesh, start: Array, scales: ProblemScales,
              limits: TightenedLimits, meter: Meter, *, near: Nearby | None = None,
              effort: SolveEffort = USUAL) -> TranscriptionOutcome:
        """
        Solve the program for the numbers of a problem of the same structure.

        :param start: unknowns, from `start` or of an earlier outcome.
        :param meter: counts every iteration and may end the solve; it knows their maximum.
        :param near: if the start is near the solution.
        :param effort: `once`: IPOPT is not called if the banded program applies, and the solve
            ends at known minima.
        """
        lower, upper = self._bounds(problem, mesh, scales, limits)
        constants = self._constants(problem, mesh, scales)
        warm, guide = (near.warm, near.guide) if near else (None, None)
        multipliers = (warm.lam_w, warm.lam_g) if warm else None
        once, known = effort.once, effort.known
        if self._staged is not None:
            lam_g = warm.lam_g if warm else (
                self.multipliers(mesh, guide, scales) if guide else None)

            def seen(f: float, worst: float) -> bool:
                again = known is not None and known.record_iterate(f * scales.cost, worst)
                return meter.step(f * scales.cost, worst) or once and again

            found = self._staged.run(
                start, constants, (lower, upper), StoppingRule(rough=effort.rough, once=once),
                seen, near=near is not None, lam_g=lam_g, mu=guide.mu if guide else 0.0)
            if found.converged or once or meter.stopped or meter.spent:
                return self._outcome(problem, mesh, scales, found, (0.0, 0.0))
        rows = self._row_bounds(problem, mesh, scales, limits)
        solver, watch = self._solver('warm' if multipliers else 'near' if near else 'far')
        watch.begin(meter.step, *rows, scales.cost)
        begun = meter.iterations - 1   # the start is reported as an iteration, too
        found = run_ipopt(
            solver, start, (lower, upper), rows, multipliers=multipliers, constants=constants)
        # A program that IPOPT refuses leaves the number of its iterations undefined.
        found = replace(found, iterations=min(max(found.iterations, 0), meter.iterations - begun))
        return self._outcome(problem, mesh, scales, found, rows)

    def _outcome(self, problem: Problem, mesh: Mesh, scales: ProblemScales, found: Found,
                 row_bounds: tuple[Array | float, Array | float]) -> TranscriptionOutcome:
        w, lam_w, g, lam_g = found.w, found.lam_w, found.g, found.lam_g
        everything = np.append(w, self._constants(problem, mesh, scales))
        durations = everything[self.at_duration] * scales.time
        ua, ub = (everything[places] * scales.u for places in (self.at_ua, self.at_ub))
        times = problem.final_time.place_end(self.times(mesh, durations))
        path = Path(times, w[self.at_x] * scales.x, w[self.at_inner] * scales.x, ua, ub, durations)
        N, s, l = self.layout.intervals, self.layout.stages, self.l  # noqa: E741  # as in Outcome
        lam, bounds = lam_g * scales.cost, lam_w * scales.cost
        first = N * (self.n * (s + 1) + (s + 1) * l)
        local = lam[:first].reshape(N, -1)[:, self.n * (s + 1):].reshape(N, s + 1, l)
        node_path = np.vstack([local[:, 0], np.zeros((1, l))])
        sides = np.stack([node_path[:-1], node_path[1:]], axis=1)
        if l:
            ends = lam[first + self.q:][:self._program.rows[2]].reshape(-1, l)
            for k, value in zip(self._ends, ends, strict=True):
                node_path[k + 1] += value
                sides[k, 1] = value
        violation = float(np.maximum(row_bounds[0] - g, g - row_bounds[1]).max(initial=0.0))
        node_bounds = bounds[self.at_x] / scales.x
        node_bounds[0] = 0.0
        rows = lam[:first].reshape(N, -1)[:, self.n * s:self.n * (s + 1)]
        start = np.full(self.n, np.nan)
        if s:   # from the rows of the first interval
            _, _, derivative, end = build_collocation(s)
            each = lam[:self.n * (s + 1)].reshape(s + 1, self.n)
            start = derivative[:, 0] @ each[:s] - end[0] * each[s]
        costates = np.vstack([start / scales.x, -rows / scales.x])
        return TranscriptionOutcome(
            mesh=mesh, path=path, converged=found.converged, status=found.status,
            objective=found.f * scales.cost, infeasibility=violation,
            iterations=found.iterations, nu=lam[first:first + self.q], costates=costates,
            node_bounds=node_bounds, inner_bounds=bounds[self.at_inner] / scales.x,
            node_path=node_path, inner_path=local[:, 1:], sides_path=sides, w=w, lam_w=lam_w,
            lam_g=lam_g, mu=found.mu, scales=scales)
