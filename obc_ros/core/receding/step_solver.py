# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
One step of the receding horizon, solved by its deadline.

Sequential quadratic programming with the Hessian of the cost (Gauss-Newton). After each quadratic
program the inputs are applied to the model with the feedback of the regulator and within their
bounds. Every candidate is thus a motion of the model with admissible inputs, and the one with the
smallest cost and penalty is kept. The start is such a motion too, so that a step may end at any
time.
"""

from dataclasses import dataclass
import math
from pathlib import Path
import time
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.compiled_functions import compile_function
from obc_ros.core.receding.formulation import RecedingProblem
from obc_ros.core.receding.horizon_program import HorizonProgram
from obc_ros.core.receding.plan import Plan
from obc_ros.core.text.errors import StatementError

TOLERANCE = 1e-6      # relative residual of the optimality conditions of an optimal plan
_MOST = 30            # quadratic programs of a step
_ABOVE = 10.0         # the penalty over the largest multiplier expected
_RAISES = 2           # times that the penalty is raised by 10 in a step
_KEPT = 1e-9          # excess that is not told, relative to 1 + the size of the limit

_WORDS = {
    'optimal': 'optimal',
    'time': 'stopped by the deadline; the best plan so far',
    'iterations': f'stopped after {_MOST} quadratic programs; the best plan so far',
    'failed': 'the quadratic program failed; the best plan so far',
    'diverged': 'no finite motion of the model from this state'}


@dataclass(frozen=True, eq=False)
class StepResult:
    """
    What a step of the receding horizon came to.

    Attributes
    ----------
    plan : Plan or None
        A motion of the model with admissible inputs; None if none is finite.
    status : str
        'optimal', 'time', 'iterations', 'failed' or 'diverged'.
    words : str
        The status in words, with the limits that the plan exceeds.
    iterations : int
        Quadratic programs solved.
    residual : float
        Relative residual of the optimality conditions of the plan, computed from the problem and
        the multipliers without the solver of the quadratic program; inf if unknown.
    slack : dict of str to float
        Largest excess of each softened limit that is exceeded.
    penalty : float
        Weight sigma of the excesses. The penalty is exact if it is above `multiplier`.
    multiplier : float
        Largest sum of the multipliers of a softened limit.
    seconds : float
        Wall time.

    """

    plan: Plan | None
    status: str
    words: str
    iterations: int
    residual: float
    slack: dict[str, float]
    penalty: float
    multiplier: float
    seconds: float


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A motion of the model: E (N + 1, n), V (N, m), cost, and the sum of the excesses."""

    E: Array
    V: Array
    cost: float
    excess: float
    pieces: list[Array]

    def value(self, penalty: float) -> float:
        return self.cost + penalty * self.excess


class StepSolver:
    """
    Solver of the steps of one problem.

    Parameters
    ----------
    problem : RecedingProblem
        The problem.
    cache_dir : Path, optional
        Directory of compiled functions; default: `find_cache_directory`.
    backend : str
        Solver of quadratic programs in CasADi: 'hpipm', 'fatrop', 'osqp', 'qrqp' or 'daqp'.
    compiled : bool
        Whether functions are compiled if there is a compiler.

    """

    def __init__(self, problem: RecedingProblem, cache_dir: Path | None = None, *,
                 backend: str = 'hpipm', compiled: bool = True) -> None:
        if backend not in _OPTIONS:
            raise StatementError(f"backend: '{backend}' is not one of {', '.join(_OPTIONS)}")
        self.problem = problem
        self.words = 'not prepared'
        self._directory, self._backend, self._compiled = cache_dir, backend, compiled
        self._program = HorizonProgram(problem)
        self._penalty = self._choose_penalty()
        self._ready = False

    def prepare(self) -> str:
        """
        Build, compile and run everything once; return a sentence on the compilation.

        Returns
        -------
        str
            Also in `words`.

        """
        if self._ready:
            return self.words
        program = self._program
        self._linearize, self._rollout = program.linearize, program.rollout
        self.words = 'interpreted: as asked'
        if self._compiled:
            both = [compile_function(each, self._directory)
                    for each in (program.linearize, program.rollout)]
            self._linearize, self._rollout = (each.function for each in both)
            self.words = '; '.join(dict.fromkeys(each.words for each in both))
        self._sparsity, self._places = program.pattern
        self._hessian = program.full_hessian
        options = _OPTIONS[self._backend]
        sized = self._backend in ('hpipm', 'fatrop')
        self._qp = ca.conic('qp', self._backend, {
            'h': self._hessian.sparsity(), 'a': self._sparsity},
            {**options, **(program.options if sized else {}), 'error_on_fail': False})
        self._ready = True
        self.solve(self.problem.xe)
        return self.words

    def solve(self, x0: Array, start: Plan | None = None, deadline: float = math.inf,
              stamp: float = 0.0) -> StepResult:
        """
        Return the plan from a state.

        Parameters
        ----------
        x0 : ndarray, shape (n,)
            State at `stamp`.
        start : Plan, optional
            A plan to start from, such as the one before; it may begin earlier and end earlier
            or later. Without it the regulator is the start.
        deadline : float
            Time of `time.monotonic` at which the result is returned [s]. A quadratic program that
            was begun is ended; the duration of one is expected beforehand.
        stamp : float
            Time of the state [s], which places a moving set point.

        Raises
        ------
        StatementError
            If the state is not n finite numbers.

        """
        begun = time.monotonic()
        x0 = np.asarray(x0, dtype=float)
        if x0.shape != self.problem.xe.shape or not np.isfinite(x0).all():
            raise StatementError(f'state: wanted {len(self.problem.xe)} finite numbers')
        self.prepare()
        search = _Search(self, self.problem.error(x0, stamp), stamp)
        return search.run(x0, self._starts(search, start), deadline, begun)

    def _starts(self, search: '_Search', start: Plan | None) -> list[_Candidate]:
        """Return the motions under the regulator and along an earlier plan that are finite."""
        N, n, m, _, _ = self._program.sizes
        zero = search.follow(np.zeros((N, m)), np.zeros((N, n)))
        found = [zero]
        if start is not None and start.is_finite and start.x.shape[1] == n \
                and start.u.shape[1] == m:
            k = round((search.stamp - start.stamp) / start.period)
            if 0 <= k < len(start.u):
                left = min(len(start.u) - k, N)
                E, V = np.zeros((N, n)), np.zeros((N, m))
                moved = (start.stamp + np.arange(k, k + left) * start.period)[:, None]
                E[:left] = start.x[k:k + left] - self.problem.xe - moved * self.problem.drift
                V[:left] = start.u[k:k + left] - self.problem.ue
                turns = np.round((search.e0 - E[0]) / math.tau) * math.tau
                E[:left] += np.where(self.problem.system.angles, turns, 0.0)
                found.append(search.follow(V, E))
        return [each for each in found if each is not None]

    def _choose_penalty(self) -> float:
        """Return sigma: above the slope of the cost-to-go at the limits of the set point."""
        soft = self.problem.soft
        if not soft.names:
            return 0.0
        finite = np.concatenate([soft.lower, soft.upper])
        size = float(np.abs(finite[np.isfinite(finite)]).max(initial=1.0))
        return _ABOVE * 2.0 * float(np.linalg.norm(self.problem.P, 2)) * size


class _Search:
    """The search of one step: numbers of the step, and the parts of the solver."""

    def __init__(self, solver: StepSolver, e0: Array, stamp: float) -> None:
        self.solver, self.problem, self.e0, self.stamp = solver, solver.problem, e0, stamp
        self.program = solver._program
        N = self.problem.horizon
        times = stamp + self.problem.period * np.arange(N + 1)
        self.shifts = np.outer(self.problem.drift, times)
        self.count = 0
        self.multiplier = 0.0
        self.lam_a: Array | None = None
        self.lam_x: Array | None = None

    def follow(self, V: Array, E: Array) -> _Candidate | None:
        """Return the motion with the inputs V about E; None if it is not finite."""
        moved, inputs = (each.full().T for each in self.solver._rollout(self.e0, V.T, E.T))
        return self.judge(moved, inputs) if np.isfinite(moved).all() else None

    def judge(self, E: Array, V: Array) -> _Candidate:
        """Return a motion with its cost and its excesses."""
        z = np.hstack([E[:-1], V])
        cost = float(np.einsum('ki,ij,kj->', z, self.program.hessian, z)
                     + E[-1] @ self.problem.P @ E[-1])
        pieces = [each.full() for each in self.solver._linearize(E.T, V.T, self.shifts)]
        return _Candidate(E, V, cost, float(sum(map(np.sum, self.excesses(pieces)))), pieces)

    def excesses(self, pieces: list[Array]) -> tuple[Array, Array]:
        """Return the excesses of the soft rows, (N, r) and (rows of the last stage,)."""
        soft = self.problem.soft
        last = list(soft.of_states)
        return tuple(np.maximum(0.0, np.maximum(lower - c.T, c.T - upper)) for c, lower, upper in (
            (pieces[1], soft.lower, soft.upper),
            (pieces[2][:, 0], soft.lower[last], soft.upper[last])))  # type: ignore[return-value]

    def run(self, x0: Array, starts: list[_Candidate], deadline: float,
            begun: float) -> StepResult:
        """Improve the best start until it is optimal or the time is over."""
        if not starts:
            return StepResult(None, 'diverged', _WORDS['diverged'], 0, math.inf, {},
                              self.solver._penalty, 0.0, time.monotonic() - begun)
        at = best = min(starts, key=lambda each: each.value(self.solver._penalty))
        residual = kept = math.inf   # of the present iterate, and of the best motion
        status, raises, longest = 'iterations', 0, 0.0
        while self.count < _MOST:
            now = time.monotonic()
            if now + longest > deadline:
                status = 'time'
                break
            solved = self._solve_program(at)
            if solved is None:
                status = 'failed'
                break
            at = self.judge(*solved)
            residual = self.measure_residual(at)
            moved = self.follow(at.V, at.E[:-1])
            longest = max(longest, time.monotonic() - now)
            if residual <= TOLERANCE and moved is not None:
                if moved.excess > _KEPT * (1.0 + self.problem.horizon) and raises < _RAISES:
                    self.solver._penalty *= 10.0   # the excess may be due to the penalty
                    raises += 1
                    continue
                at, best, status = moved, moved, 'optimal'
                kept = residual
                break
            if moved is not None and moved.value(self.solver._penalty) < best.value(
                    self.solver._penalty):
                best, kept = moved, math.inf
        return self.report(best, status, kept, begun)

    def _solve_program(self, at: _Candidate) -> tuple[Array, Array] | None:
        """Solve the quadratic program about a candidate; None if there is no finite answer."""
        self.count += 1
        N, n, m, r, last = self.program.sizes
        A, lower, upper, x_low, x_high, g = self._fill(at)
        solver = self.solver
        guess = self._unknowns(at)
        answer = solver._qp(h=solver._hessian, g=g, a=A, lba=lower, uba=upper, lbx=x_low,
                            ubx=x_high, x0=guess)
        z = answer['x'].full().ravel()
        self.lam_a = _keep_finite(answer['lam_a'].full().ravel(), lower, upper)
        self.lam_x = _keep_finite(answer['lam_x'].full().ravel(), x_low, x_high)
        if not (np.isfinite(z).all() and np.isfinite(self.lam_a).all()
                and np.isfinite(self.lam_x).all()):
            self.lam_a = self.lam_x = None
            return None
        stages = z[:N * (n + m + r)].reshape(N, n + m + r)
        E = np.vstack([stages[:, :n], z[N * (n + m + r) + last:][:n]])
        return E, stages[:, n:n + m]

    def _unknowns(self, at: _Candidate) -> Array:
        stage, end = self.excesses(at.pieces)
        return np.concatenate([np.hstack([at.E[:-1], at.V, stage]).ravel(), end, at.E[-1], end])

    def _fill(self, at: _Candidate) -> tuple[ca.DM, Array, Array, Array, Array, Array]:
        """Return the matrix, the bounds of the rows and unknowns, and the gradient."""
        N, n, m, r, last = self.program.sizes
        F, c, c_last, A, B, C, D, C_last = at.pieces
        flat = np.concatenate([each.ravel(order='F') for each in (A, B, C, D, C_last)]
                              + [[1.0, -1.0]])
        matrix = ca.DM(self.solver._sparsity, flat[self.solver._places])
        up, down, up_last, down_last = self.program.sides
        soft = self.problem.soft
        gap = (np.einsum('kji,kj->ki', A.T.reshape(N, n, n), at.E[:-1])
               + np.einsum('kji,kj->ki', B.T.reshape(N, m, n), at.V) - F.T)
        rest = (np.einsum('kji,kj->ki', C.T.reshape(N, n, r), at.E[:-1])
                + np.einsum('kji,kj->ki', D.T.reshape(N, m, r), at.V) - c.T) if r else c.T
        rest_last = C_last @ at.E[-1] - c_last[:, 0]
        of = list(soft.of_states)
        high, low = rest[:, up] + soft.upper[up], rest[:, down] + soft.lower[down]
        high_last = rest_last[up_last] + soft.upper[of][up_last]
        low_last = rest_last[down_last] + soft.lower[of][down_last]
        none, end = np.zeros(last), (N - 1) * (n + len(up) + len(down)) + n
        lower = np.concatenate([
            np.insert(np.hstack([gap, np.full_like(high, -np.inf), low]).ravel(), end, none),
            np.full_like(high_last, -np.inf), low_last])
        upper = np.concatenate([
            np.insert(np.hstack([gap, high, np.full_like(low, np.inf)]).ravel(), end, none),
            high_last, np.full_like(low_last, np.inf)])
        box = self.problem.input_box
        free, free_end = np.full(n, np.inf), np.full(last + n, np.inf)
        x_low = np.concatenate([np.tile(np.concatenate([-free, box[0], np.zeros(r)]), N),
                                -free_end, none])
        x_high = np.concatenate([np.tile(np.concatenate([free, box[1], np.full(r, np.inf)]), N),
                                 free_end, np.full(last, np.inf)])
        x_low[:n] = x_high[:n] = self.e0
        sigma = self.solver._penalty
        g = np.concatenate([np.tile(np.concatenate([np.zeros(n + m), np.full(r, sigma)]), N),
                            np.zeros(last + n), np.full(last, sigma)])
        return matrix, lower, upper, x_low, x_high, g

    def measure_residual(self, at: _Candidate) -> float:
        """
        Return the relative residual of the optimality conditions of a candidate.

        With its own linearization: the gradient of the Lagrangian, and the products of
        multipliers and distances from limits, each over 1 + the largest term of its sum.
        """
        if self.lam_a is None or self.lam_x is None:
            return math.inf
        matrix, lower, upper, x_low, x_high, g = self._fill(at)
        z = self._unknowns(at)
        gaps = float(np.abs(at.pieces[0].T - at.E[1:]).max()) / (1.0 + float(np.abs(at.E).max()))
        outside = float(np.maximum(0.0, np.maximum(x_low - z, z - x_high)).max())
        Hz = (self.solver._hessian @ z).full().ravel()
        turned = (matrix.T @ self.lam_a).full().ravel()
        size = 1.0 + max(float(np.abs(each).max(initial=0.0)) for each in (Hz, self.lam_a))
        slope = float(np.abs(Hz + g + turned + self.lam_x).max()) / size
        rows = (matrix @ z).full().ravel()
        products = max(_complement(rows, lower, upper, self.lam_a),
                       _complement(z, x_low, x_high, self.lam_x)) / (
                           1.0 + abs(at.value(self.solver._penalty)))
        soft = self.lam_a[np.isneginf(lower) | np.isposinf(upper)]
        self.multiplier = float(np.abs(soft).max(initial=0.0))
        return max(slope, products, gaps, outside)

    def report(self, at: _Candidate, status: str, residual: float, begun: float) -> StepResult:
        """Return the result of a candidate."""
        problem, soft = self.problem, self.problem.soft
        stage, end = self.excesses(at.pieces)
        worst = stage.max(axis=0, initial=0.0)
        for place, i in enumerate(soft.of_states):
            worst[i] = max(worst[i], end[place])
        sizes = 1.0 + np.where(np.isfinite(soft.upper), np.abs(soft.upper), np.abs(soft.lower))
        slack = {name: float(value) for name, value, size in zip(
            soft.names, worst, sizes, strict=True) if value > _KEPT * size}
        words = _WORDS[status]
        if slack:
            words += '; exceeds ' + ', '.join(f'{name} by {value:.3g}'
                                              for name, value in slack.items())
        plan = Plan(self.stamp, problem.period, at.E + self.shifts.T + problem.xe,
                    at.V + problem.ue, at.cost, slack, residual,
                    float(at.E[-1] @ problem.P @ at.E[-1]))
        return StepResult(plan, status, words, self.count, residual, slack, self.solver._penalty,
                          self.multiplier, time.monotonic() - begun)


def _keep_finite(lam: Array, lower: Array, upper: Array) -> Array:
    """Return multipliers without those of infinite limits, which the solver takes as finite."""
    kept: Array = np.where((lam > 0.0) & np.isposinf(upper) | (lam < 0.0) & np.isneginf(lower),
                           0.0, lam)
    return kept


def _complement(values: Array, lower: Array, upper: Array, lam: Array) -> float:
    """Return the largest product of a multiplier with the distance from its limit."""
    above = np.where(np.isfinite(upper), upper - values, np.inf)
    below = np.where(np.isfinite(lower), values - lower, np.inf)
    with np.errstate(invalid='ignore'):
        products = np.where(lam > 0.0, lam * above, np.where(lam < 0.0, -lam * below, 0.0))
    return float(np.abs(products).max(initial=0.0))


_OPTIONS: dict[str, dict[str, Any]] = {
    'hpipm': {'print_time': False, 'inf': 1e5, 'hpipm': {
        'iter_max': 60, 'mode': 'speed', 'res_g_max': 1e-8, 'res_b_max': 1e-8,
        'res_d_max': 1e-8, 'res_m_max': 1e-8}},
    'fatrop': {'print_time': False, 'structure_detection': 'manual',
               'fatrop': {'print_level': 0, 'tol': 1e-9}},
    'osqp': {'print_time': False, 'osqp': {'verbose': False, 'eps_abs': 1e-9, 'eps_rel': 1e-9}},
    'qrqp': {'print_time': False, 'print_iter': False, 'print_header': False,
             'print_info': False},
    'daqp': {'print_time': False}}
