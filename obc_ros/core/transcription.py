# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Optimal control as a nonlinear program: Gauss collocation of x under inputs linear in time.

[0, T] is cut into phases and these into intervals. In an interval of length h, with
0 < c_1 < ... < c_s < 1 the Gauss points, x is the polynomial of degree s that starts at x_k and
meets dx/dt = f(x, u) at t_k + c_j h; this has order 2s at the mesh points. u runs linearly from
u_k+ to u_(k+1)-, so that bounds at mesh points are bounds everywhere and the input returned is the
input optimised: the cost found is never below the least one, and exceeds it by O(h^4) where
u* is smooth. Phases may have unknown lengths and inputs held at given values: arcs.
"""

from dataclasses import dataclass, replace
from functools import cached_property
import math
import time

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from obc_ros.core.blocks import assemble, Block, Index, Program
from obc_ros.core.problem import Problem
from obc_ros.core.solution import Report

Array = NDArray[np.float64]

LINEAR, CONSTANT, HELD = 'linear', 'constant', 'held'


@dataclass(frozen=True)
class Phase:
    """
    Intervals in a row, and for each input how it is found in them.

    `modes`: LINEAR (continuous, linear in each interval), CONSTANT (one unknown) or HELD (given).
    `joined`: whether an input starts at the value with which the phase before ended.
    """

    intervals: int
    modes: tuple[str, ...]
    joined: tuple[bool, ...]


@dataclass(frozen=True)
class Layout:
    """What fixes the form of the program: its phases, Gauss points, and what is unknown."""

    phases: tuple[Phase, ...]
    stages: int
    free_time: bool

    @property
    def intervals(self) -> int:
        """Return the number of intervals of all phases."""
        return sum(phase.intervals for phase in self.phases)

    @property
    def free_durations(self) -> bool:
        """Return whether the lengths of the phases are unknown."""
        return self.free_time or len(self.phases) > 1

    @cached_property
    def phase_of(self) -> Index:
        """Return the phase of each interval."""
        return np.repeat(np.arange(len(self.phases)), [p.intervals for p in self.phases])


@dataclass(frozen=True, eq=False)
class Mesh:
    """
    A layout with its numbers.

    Attributes
    ----------
    layout : Layout
    fractions : ndarray, shape (N,)
        Length of each interval as a part of its phase.
    held : ndarray, shape (number of phases, m)
        Values of the inputs that are HELD.

    """

    layout: Layout
    fractions: Array
    held: Array


@dataclass(frozen=True, eq=False)
class Path:
    """
    States and inputs over time: where a search starts or what it found.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        Mesh points.
    x : ndarray, shape (N + 1, n)
    inner : ndarray, shape (N, s, n)
        States at the Gauss points.
    ua, ub : ndarray, shape (N, m)
        Inputs at the start and at the end of each interval.
    durations : ndarray
        Lengths of the phases.

    """

    t: Array
    x: Array
    inner: Array
    ua: Array
    ub: Array
    durations: Array

    def states_at(self, times: Array) -> Array:
        """Return states at any times, linear between all known ones."""
        stages = self.inner.shape[1]
        c = gauss_points(stages) if stages else np.zeros(0)
        t = np.append(self.t[:-1, None] + np.diff(self.t)[:, None] * np.append(0.0, c),
                      self.t[-1])
        x = np.vstack([np.concatenate([self.x[:-1, None], self.inner], axis=1).reshape(
            -1, self.x.shape[1]), self.x[-1:]])
        return np.column_stack([np.interp(times, t, column) for column in x.T])

    def inputs_at(self, times: Array, after: bool) -> Array:
        """Return inputs at any times; `after` a jump or before it."""
        side = 'right' if after else 'left'
        k = np.clip(np.searchsorted(self.t, times, side) - 1, 0, len(self.ua) - 1)
        length = np.maximum(self.t[k + 1] - self.t[k], 1e-300)
        part = np.clip((times - self.t[k]) / length, 0.0, 1.0)[:, None]
        return (1 - part) * self.ua[k] + part * self.ub[k]


@dataclass(frozen=True, eq=False)
class Outcome:
    """
    What the solver of the nonlinear program returned.

    `nu` are the multipliers of psi; `node_bounds` (N + 1, n) and `inner_bounds` (N, s, n) those of
    the bounds of x, `node_path` (N + 1, l; the last row at T) and `inner_path` (N, s, l) those of
    the path constraints: each the change of J with the bound, > 0 at an upper bound.
    """

    mesh: Mesh
    path: Path
    converged: bool
    status: str
    objective: float
    infeasibility: float
    iterations: int
    nu: Array
    node_bounds: Array
    inner_bounds: Array
    node_path: Array
    inner_path: Array
    w: Array
    lam_w: Array
    lam_g: Array


@dataclass(frozen=True, eq=False)
class Scales:
    """Typical sizes of the states (n,), the inputs (m,), the time and the cost."""

    x: Array
    u: Array
    time: float
    cost: float


class Monitor:
    """
    Passes progress on and says when to stop.

    `stopped` is '' while nothing asked to stop, then 'cancelled' or 'timed_out'.
    """

    def __init__(self, time_limit: float = math.inf, report: Report | None = None) -> None:
        self.deadline = time.monotonic() + time_limit
        self.stopped = ''
        self.phase = 'transcription'
        self.iterations = 0
        self._report = report

    def remaining(self) -> float:
        """Return the time left [s]."""
        return self.deadline - time.monotonic()

    def step(self, cost: float, infeasibility: float) -> bool:
        """Count an iteration; return whether to stop."""
        self.iterations += 1
        if self._report is not None and self._report(
                self.phase, self.iterations, cost, infeasibility):
            self.stopped = 'cancelled'
        elif not self.stopped and time.monotonic() > self.deadline:
            self.stopped = 'timed_out'
        return bool(self.stopped)


class _Watch(ca.Callback):
    """IPOPT's iteration callback; the monitor and the scale of the cost change between solves."""

    def __init__(self, unknowns: int, rows: int, constants: int) -> None:
        ca.Callback.__init__(self)
        self._sizes = {'x': unknowns, 'f': 1, 'g': rows, 'lam_x': unknowns, 'lam_g': rows,
                       'lam_p': constants}
        self.monitor = Monitor()
        self.lower = self.upper = np.zeros(rows)
        self.cost_scale = 1.0
        self.construct('watch', {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        g = arg[2].full().ravel()
        violation = np.maximum(self.lower - g, g - self.upper)
        return [ca.DM(int(self.monitor.step(
            float(arg[1]) * self.cost_scale, float(np.max(violation, initial=0.0)))))]


def gauss_points(stages: int) -> Array:
    """Return the Gauss points in (0, 1)."""
    return (np.polynomial.legendre.leggauss(stages)[0] + 1) / 2


def _collocation(stages: int) -> tuple[Array, Array, Array, Array]:
    """Return points c, weights b, derivatives D (s, s + 1) and end values e (s + 1,)."""
    nodes, weights = np.polynomial.legendre.leggauss(stages)
    points = np.append(0.0, (nodes + 1) / 2)
    derivative, end = np.zeros((stages, stages + 1)), np.zeros(stages + 1)
    for i, point in enumerate(points):
        others = np.delete(points, i)
        basis = np.poly1d(np.poly(others) / np.prod(point - others))
        derivative[:, i], end[i] = np.polyder(basis)(points[1:]), basis(1.0)
    return points[1:], weights / 2, derivative, end


class Transcription:
    """
    The nonlinear program of a problem on a layout, for any numbers.

    Parameters
    ----------
    problem : Problem
        Its symbols and expressions are used, not its numbers.
    layout : Layout

    """

    def __init__(self, problem: Problem, layout: Layout) -> None:
        self.layout = layout
        self.n, self.m, self.q = problem.n, problem.m, problem.q
        self.l = int(problem.path.numel())
        self.c, self.b, self._D, self._e = _collocation(layout.stages)
        self._number(problem)
        self._program = self._assemble(problem)
        self._solvers: dict[bool, tuple[ca.Function, _Watch]] = {}

    def _number(self, problem: Problem) -> None:
        """Give every unknown and every constant its place."""
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
                joined = phase.joined[i] and k > 0
                count = 1 if mode == CONSTANT else phase.intervals + 1
                if joined:
                    places = np.append(self.at_ub[k - 1, i], first + np.arange(count - 1))
                else:
                    places = first + np.arange(count)
                first += count - int(joined)
                self.at_ua[span, i] = places[0] if mode == CONSTANT else places[:-1]
                self.at_ub[span, i] = places[0] if mode == CONSTANT else places[1:]
            k += phase.intervals
        self.held = held
        phases = len(layout.phases)
        self.at_duration = first + np.arange(phases)
        self.unknowns = first + (phases if layout.free_durations else 0)
        self.shared = len(problem.parameters) + n + m + 2
        self.constants = self.shared + N + len(held) + (0 if layout.free_durations else phases)
        base = self.unknowns + self.shared
        self.at_fraction = base + np.arange(N)
        for places in (self.at_ua, self.at_ub):
            places[places < 0] = base + N - 1 - places[places < 0]
        if not layout.free_durations:
            self.at_duration = base + N + len(held) + np.arange(phases)

    def _assemble(self, problem: Problem) -> Program:
        n, m, s, layout = self.n, self.m, self.layout.stages, self.layout
        sx, su = ca.SX.sym('sx', n), ca.SX.sym('su', m)
        st, sj = ca.SX.sym('st'), ca.SX.sym('sj')
        self._shared = ca.vertcat(problem.p, sx, su, st, sj)
        functions = ca.Function('functions', [problem.x, problem.u, problem.p],
                                [problem.f, problem.L, problem.path])
        xa, xb, inner = ca.SX.sym('xa', n), ca.SX.sym('xb', n), ca.SX.sym('inner', n, s)
        ua, ub = ca.SX.sym('ua', m), ca.SX.sym('ub', m)
        duration, fraction = ca.SX.sym('duration'), ca.SX.sym('fraction')
        h = st * duration * fraction
        rows, path, cost, end = [], [], ca.SX(0), self._e[0] * xa
        path.append(functions(sx * xa, su * ua, problem.p)[2])
        for j in range(s):
            f, L, c = functions(
                sx * inner[:, j], su * ((1 - self.c[j]) * ua + self.c[j] * ub), problem.p)
            slope = self._D[j, 0] * xa + ca.mtimes(inner, ca.DM(self._D[j, 1:]))
            rows.append(slope - h * f / sx)
            path.append(c)
            cost += self.b[j] * h * L / sj
            end += self._e[j + 1] * inner[:, j]
        N = layout.intervals
        none = np.zeros((1, 0), dtype=np.int64)
        interval = Block(
            ca.vertcat(xa, ca.vec(inner), xb, ua, ub, duration), fraction, self._shared,
            ca.vertcat(*rows, xb - end, *path), cost,
            np.hstack([self.at_x[:-1], self.at_inner.reshape(N, -1), self.at_x[1:], self.at_ua,
                       self.at_ub, self.at_duration[layout.phase_of][:, None]]),
            self.at_fraction[:, None] - self.unknowns)
        x, u = ca.SX.sym('x', n), ca.SX.sym('u', m)
        terminal = ca.Function('terminal', [problem.x, problem.p], [problem.psi, problem.V])
        psi, V = terminal(sx * x, problem.p)
        blocks = [interval, Block(x, ca.SX(0, 1), self._shared, psi, V / sj,
                                  self.at_x[-1:], none)]
        if self.l:
            last = self._ends(problem)
            c = functions(sx * x, su * u, problem.p)[2]
            blocks.append(Block(
                ca.vertcat(x, u), ca.SX(0, 1), self._shared, c, ca.SX(0),
                np.hstack([self.at_x[last + 1], self.at_ub[last]]),
                np.zeros((len(last), 0), dtype=np.int64)))
        if len(layout.phases) > 1:
            durations = ca.SX.sym('durations', len(layout.phases))
            blocks.append(Block(durations, ca.SX(0, 1), self._shared, ca.sum1(durations),
                                ca.SX(0), self.at_duration[None, :], none))
        return assemble(blocks, self.unknowns, self.shared, self.constants)

    def _ends(self, problem: Problem) -> Index:
        """Return the last intervals of the phases at whose ends path constraints are needed."""
        last = np.cumsum([phase.intervals for phase in self.layout.phases]) - 1
        return last if ca.depends_on(problem.path, problem.u) else last[-1:]

    def _solver(self, warm: bool) -> tuple[ca.Function, _Watch]:
        if warm not in self._solvers:
            rows = int(self._program.nlp['g'].numel())
            watch = _Watch(self.unknowns, rows, self.constants)
            ipopt = {'print_level': 0, 'sb': 'yes', 'linear_solver': 'mumps', 'tol': 1e-9,
                     'constr_viol_tol': 1e-9, 'compl_inf_tol': 1e-9, 'dual_inf_tol': 1e-6,
                     'bound_relax_factor': 0.0, 'honor_original_bounds': 'yes',
                     'max_iter': 1000, 'acceptable_tol': 1e-7, 'acceptable_iter': 20}
            if warm:
                ipopt |= {'warm_start_init_point': 'yes', 'mu_init': 1e-6,
                          'warm_start_bound_push': 1e-8, 'warm_start_mult_bound_push': 1e-8,
                          'warm_start_slack_bound_push': 1e-8, 'warm_start_bound_frac': 1e-8,
                          'warm_start_slack_bound_frac': 1e-8}
            options = {'print_time': False, 'error_on_fail': False, 'no_nlp_grad': True,
                       'calc_lam_p': False, 'calc_lam_x': False, 'calc_f': False,
                       'calc_g': False, 'show_eval_warnings': False, 'ipopt': ipopt,
                       'iteration_callback': watch, **self._program.derivatives}
            self._solvers[warm] = ca.nlpsol('nlp', 'ipopt', self._program.nlp, options), watch
        return self._solvers[warm]

    def times(self, mesh: Mesh, durations: Array) -> Array:
        """Return the mesh points, shape (N + 1,)."""
        h = mesh.fractions * durations[self.layout.phase_of]
        return np.append(0.0, np.cumsum(h))

    def start(self, mesh: Mesh, guess: Path, durations: Array, scales: Scales) -> Array:
        """Return the unknowns that follow a guess stretched to the given durations."""
        t = self.times(mesh, durations)
        stretch = guess.t[-1] / t[-1]
        w = np.zeros(self.unknowns)
        inner = (t[:-1, None] + np.diff(t)[:, None] * self.c).ravel()
        w[self.at_x] = guess.states_at(t * stretch) / scales.x
        w[self.at_inner] = (guess.states_at(inner * stretch) / scales.x).reshape(
            self.at_inner.shape)
        for places, times, after in ((self.at_ub, t[1:], False), (self.at_ua, t[:-1], True)):
            values = guess.inputs_at(times * stretch, after) / scales.u
            unknown = places < self.unknowns
            w[places[unknown]] = values[unknown]
        if self.layout.free_durations:
            w[self.at_duration] = durations / scales.time
        return w

    def _constants(self, problem: Problem, mesh: Mesh, scales: Scales, T: float) -> Array:
        held = [mesh.held[number, i] / scales.u[i] for number, i in self.held]
        given = [] if self.layout.free_durations else [T / scales.time]
        return np.concatenate([problem.p_value, scales.x, scales.u, [scales.time, scales.cost],
                               mesh.fractions, held, given])

    def _bounds(self, problem: Problem, scales: Scales, durations: tuple[float, float],
                margin: Array) -> tuple[Array, Array]:
        lower, upper = np.full(self.unknowns, -np.inf), np.full(self.unknowns, np.inf)
        x_lower, x_upper = problem.x_lower + margin, problem.x_upper - margin
        for places in (self.at_x, self.at_inner):
            lower[places], upper[places] = x_lower / scales.x, x_upper / scales.x
        lower[self.at_x[0]] = upper[self.at_x[0]] = problem.x0 / scales.x
        for places in (self.at_ua, self.at_ub):
            unknown = places < self.unknowns
            for bound, value in ((lower, problem.u_lower), (upper, problem.u_upper)):
                bound[places[unknown]] = np.broadcast_to(value / scales.u, places.shape)[unknown]
        if self.layout.free_durations:
            lower[self.at_duration], upper[self.at_duration] = durations
        return lower, upper

    def _row_bounds(self, problem: Problem, scales: Scales) -> tuple[Array, Array]:
        N, s = self.layout.intervals, self.layout.stages
        collocation, path = np.zeros(self.n * (s + 1)), (s + 1) * self.l
        lower = [np.tile(np.append(collocation, np.tile(problem.path_lower, s + 1)), N),
                 np.zeros(self.q)]
        upper = [np.tile(np.append(collocation, np.tile(problem.path_upper, s + 1)), N),
                 np.zeros(self.q)]
        if path:
            ends = self._program.rows[2] // self.l
            lower.append(np.tile(problem.path_lower, ends))
            upper.append(np.tile(problem.path_upper, ends))
        if len(self.layout.phases) > 1:
            time_ = problem.final_time
            span = (time_.lower, time_.upper) if time_.free else (time_.value, time_.value)
            lower.append(np.array([span[0] / scales.time]))
            upper.append(np.array([span[1] / scales.time]))
        return np.concatenate(lower), np.concatenate(upper)

    def solve(self, problem: Problem, mesh: Mesh, start: Array, scales: Scales,
              monitor: Monitor, *, multipliers: tuple[Array, Array] | None = None,
              margin: Array | None = None, least_duration: float = 0.0) -> Outcome:
        """
        Solve the program for the numbers of a problem of the same structure.

        Parameters
        ----------
        start : ndarray
            Unknowns, from `start` or of an earlier Outcome.
        multipliers : pair of ndarray, optional
            `lam_w` and `lam_g` of a neighbouring Outcome: warm start.
        margin : ndarray, shape (n,), optional
            By how much the bounds of x are tightened.

        """
        solver, watch = self._solver(multipliers is not None)
        final = problem.final_time
        single = self.layout.free_time and len(self.layout.phases) == 1
        span = ((final.lower / scales.time, final.upper / scales.time) if single
                else (least_duration / scales.time, np.inf))
        lower, upper = self._bounds(problem, scales, span,
                                    np.zeros(self.n) if margin is None else margin)
        row_lower, row_upper = self._row_bounds(problem, scales)
        watch.monitor, watch.cost_scale = monitor, scales.cost
        watch.lower, watch.upper = row_lower, row_upper
        arguments = {'x0': start, 'p': self._constants(problem, mesh, scales, final.value),
                     'lbx': lower, 'ubx': upper, 'lbg': row_lower, 'ubg': row_upper}
        if multipliers is not None:
            arguments['lam_x0'], arguments['lam_g0'] = multipliers
        result = solver(**arguments)
        stats = solver.stats()
        return self._outcome(problem, mesh, scales, result, stats, (row_lower, row_upper))

    def _outcome(self, problem: Problem, mesh: Mesh, scales: Scales, result: dict[str, ca.DM],
                 stats: dict[str, object], row_bounds: tuple[Array, Array]) -> Outcome:
        w, lam_w, g, lam_g = (
            result[key].full().ravel() for key in ('x', 'lam_x', 'g', 'lam_g'))
        everything = np.concatenate([w, self._constants(problem, mesh, scales,
                                                        problem.final_time.value)])
        durations = everything[self.at_duration] * scales.time
        path = Path(self.times(mesh, durations), w[self.at_x] * scales.x,
                    w[self.at_inner] * scales.x, everything[self.at_ua] * scales.u,
                    everything[self.at_ub] * scales.u, durations)
        N, s, l = self.layout.intervals, self.layout.stages, self.l
        lam = lam_g * scales.cost
        first = N * (self.n * (s + 1) + (s + 1) * l)
        local = lam[:first].reshape(N, -1)[:, self.n * (s + 1):].reshape(N, s + 1, l)
        node_path = np.vstack([local[:, 0], np.zeros((1, l))])
        if l:
            ends = lam[first + self.q:][:self._program.rows[2]].reshape(-1, l)
            for k, value in zip(self._ends(problem), ends, strict=True):
                node_path[k + 1] += value
        violation = np.maximum(row_bounds[0] - g, g - row_bounds[1])
        bounds = lam_w * scales.cost
        node_bounds = bounds[self.at_x] / scales.x
        node_bounds[0] = 0.0
        return Outcome(
            mesh, path, bool(stats['success']), str(stats['return_status']),
            float(result['f']) * scales.cost, float(np.max(violation, initial=0.0)),
            int(str(stats['iter_count'])), lam[first:first + self.q], node_bounds,
            bounds[self.at_inner] / scales.x, node_path, local[:, 1:], w, lam_w, lam_g)


def uniform(problem: Problem, intervals: int, stages: int = 3) -> Mesh:
    """Return a mesh of one phase, equal intervals and inputs linear in each."""
    phase = Phase(intervals, (LINEAR,) * problem.m, (False,) * problem.m)
    layout = Layout((phase,), stages, problem.final_time.free)
    return Mesh(layout, np.full(intervals, 1.0 / intervals), np.zeros((1, problem.m)))


def refined(mesh: Mesh, factor: int) -> Mesh:
    """Return the mesh with every interval cut into equal parts."""
    phases = tuple(replace(p, intervals=p.intervals * factor) for p in mesh.layout.phases)
    return Mesh(replace(mesh.layout, phases=phases),
                np.repeat(mesh.fractions / factor, factor), mesh.held)
