# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
One step of the receding horizon, solved by its deadline.

Sequential quadratic programming with the Hessian of the Lagrangian, whose multipliers are those of
the step before, or with that of the cost (Gauss-Newton) if the former finds no solution. At the
end the inputs are applied to the model with the feedback of the regulator and within their bounds.
Every candidate is thus a motion of the model with admissible inputs, and the one with the smallest
cost and penalty is returned. The start is such a motion too, so that a step may end at any time.
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

STEP_TOLERANCE = 1e-6      # relative residual of the optimality conditions of an optimal plan
_MOST = 30            # quadratic programs of a step
_ABOVE = 10.0         # the penalty over the largest multiplier expected
_CURVED = 12           # programs with second derivatives, before those of the cost alone
_TRIED = 3            # last iterates that are applied to the model if none is optimal
_RAISES = 2           # times that the penalty is raised by 10
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
    """Errors E (N + 1, n), inputs V (N, m), cost, sum of the excesses, and its linearization."""

    E: Array
    V: Array
    cost: float
    excess: float
    matrix: ca.DM
    numbers: list[Array]
    hessian: ca.DM

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
    compiled : bool
        Whether functions are compiled if there is a compiler.

    """

    def __init__(self, problem: RecedingProblem, cache_dir: Path | None = None, *,
                 compiled: bool = True) -> None:
        self.problem = problem
        self.words = 'not prepared'
        self._directory, self._compiled = cache_dir, compiled
        self._program = HorizonProgram(problem)
        self._penalty = self._choose_penalty()
        self._largest_penalty = self._penalty * 10.0**_RAISES
        self._ready = False
        self._multipliers: tuple[float, Array, Array] | None = None

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
        functions = program.linearize, program.rollout, program.multiply
        self._linearize, self._rollout, self._multiply = functions
        self.words = 'interpreted: as asked'
        if self._compiled:
            found = [compile_function(each, self._directory) for each in functions]
            self._linearize, self._rollout, self._multiply = (each.function for each in found)
            self.words = '; '.join(dict.fromkeys(each.words for each in found))
        self._hessian = program.full_hessian
        self._qp = ca.conic('qp', 'hpipm', {
            'h': self._hessian.sparsity(), 'a': program.pattern[0]},
            {**_OPTIONS, **program.options, 'error_on_fail': False})
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
        found = []
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
        finite = [each for each in found if each is not None]
        regulator = None if finite else search.follow(np.zeros((N, m)), np.zeros((N, n)))
        return finite if regulator is None else [regulator]

    def _recall(self, stamp: float) -> tuple[Array, Array] | None:
        """Return the multipliers of the last optimal plan from a time on, None if it is over."""
        if self._multipliers is None:
            return None
        begun, lam, mu = self._multipliers
        k = round((stamp - begun) / self.problem.period)
        if not 0 <= k < len(lam):
            return None
        rest = np.minimum(np.arange(len(lam)) + k, len(lam) - 1)
        return lam[rest], mu[rest]

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
        times = stamp + self.problem.period * np.arange(self.problem.horizon + 1)
        self.shifts = np.outer(self.problem.drift, times)
        self.count = 0
        self.curved = True
        self.multiplier = 0.0
        self._filled: tuple[_Candidate, float, tuple[Array, ...]] | None = None
        N, n, _, r, _ = self.program.sizes
        self.lam, self.mu = solver._recall(stamp) or (np.zeros((N, n)), np.zeros((N, r)))
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
        matrix, column, hessian = self.solver._linearize(
            E.T, V.T, self.shifts, self.lam.T, self.mu.T)
        numbers = self.program.split(column.full().ravel())
        excess = float(sum(map(np.sum, self.excesses(numbers))))
        return _Candidate(E, V, cost, excess, matrix, numbers, hessian)

    def excesses(self, numbers: list[Array]) -> tuple[Array, Array]:
        """Return the excesses of the soft rows, (N, r) and (rows of the last stage,)."""
        soft = self.problem.soft
        last = list(soft.of_states)
        return tuple(np.maximum(0.0, np.maximum(lower - c, c - upper)) for c, lower, upper in (
            (numbers[2], soft.lower, soft.upper),
            (numbers[4], soft.lower[last], soft.upper[last])))  # type: ignore[return-value]

    def run(self, x0: Array, starts: list[_Candidate], deadline: float,
            begun: float) -> StepResult:
        """Improve the best start until it is optimal or the time is over."""
        if not starts:
            return StepResult(None, 'diverged', _WORDS['diverged'], 0, math.inf, {},
                              self.solver._penalty, 0.0, time.monotonic() - begun)
        at = best = min(starts, key=lambda each: each.value(self.solver._penalty))
        residual = kept = math.inf   # of the present iterate, and of the best motion
        status, longest = 'iterations', 0.0
        tried: list[_Candidate] = []
        while self.count < _MOST:
            now = time.monotonic()
            if now + longest > deadline:
                status = 'time'
                break
            solved = self._solve_program(at)
            if solved is None and self.curved:
                at = self._forget_curvature(best)
                solved = self._solve_program(at)
            if solved is None:
                status = 'failed'
                break
            self._take_multipliers()
            at = self.judge(*solved)
            if self.curved and self.count == _CURVED:
                at = self._forget_curvature(best)
            tried.append(at)
            residual = self.measure_residual(at)
            moved = self.follow(at.V, at.E[:-1]) if residual <= STEP_TOLERANCE else None
            longest = max(longest, time.monotonic() - now)
            if moved is not None:
                if (moved.excess > _KEPT * (1.0 + self.problem.horizon)
                        and self.solver._penalty < 0.5 * self.solver._largest_penalty):
                    self.solver._penalty *= 10.0   # the excess may be due to the penalty
                    continue
                at, best, status = moved, moved, 'optimal'
                kept = residual
                self.keep_multipliers()
                break
        if status != 'optimal':
            motions = [self.follow(each.V, each.E[:-1]) for each in tried[-_TRIED:]]
            best = min([best, *(each for each in motions if each is not None)],
                       key=lambda each: each.value(self.solver._penalty))
        return self.report(best, status, kept, begun)

    def keep_multipliers(self) -> None:
        """Keep the multipliers for the next step."""
        self.curved = True
        self._take_multipliers()
        self.solver._multipliers = self.stamp, self.lam, self.mu

    def _take_multipliers(self) -> None:
        """Take the multipliers of the last program for the Hessian of the next one."""
        if not self.curved or self.lam_a is None:
            return
        model, soft, which = self.program.multiplier_rows
        self.lam = self.lam_a[model]
        self.mu = np.zeros_like(self.mu)
        for column, row in enumerate(which):
            self.mu[:, row] += self.lam_a[soft[:, column]]

    def _forget_curvature(self, at: _Candidate) -> _Candidate:
        """Return a candidate with the Hessian of the cost alone, which is convex."""
        self.curved = False
        self.lam, self.mu = np.zeros_like(self.lam), np.zeros_like(self.mu)
        return self.judge(at.E, at.V)

    def _solve_program(self, at: _Candidate) -> tuple[Array, Array] | None:
        """Solve the quadratic program about a candidate; None if there is no finite answer."""
        self.count += 1
        N, n, m, r, last = self.program.sizes
        lower, upper, x_low, x_high, g = self._fill(at)
        solver = self.solver
        guess = self._unknowns(at)
        answer = solver._qp(h=at.hessian, g=g + self._turn(at, guess), a=at.matrix, lba=lower,
                            uba=upper, lbx=x_low, ubx=x_high, x0=guess)
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

    def _turn(self, at: _Candidate, z: Array) -> Array:
        """Return the gradient of the cost at a candidate less that of the program's Hessian."""
        parts = self.solver._multiply(at.matrix, z, 0.0, at.hessian).full().ravel()
        turned: Array = parts[:len(z)] - parts[2 * len(z):3 * len(z)]
        return turned

    def _unknowns(self, at: _Candidate) -> Array:
        stage, end = self.excesses(at.numbers)
        return np.concatenate([np.hstack([at.E[:-1], at.V, stage]).ravel(), end, at.E[-1], end])

    def _fill(self, at: _Candidate) -> tuple[Array, ...]:
        """Return what `_compute_bounds` returns, which is kept for the last candidate."""
        if self._filled is None or self._filled[0] is not at or (
                self._filled[1] != self.solver._penalty):
            self._filled = at, self.solver._penalty, self._compute_bounds(at)
        return self._filled[2]

    def _compute_bounds(self, at: _Candidate) -> tuple[Array, ...]:
        """Return the bounds of the rows and unknowns, and the gradient."""
        N, n, m, r, last = self.program.sizes
        up, down, up_last, down_last = self.program.sides
        soft = self.problem.soft
        gap, rest, _, rest_last, _, _ = at.numbers
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
        return lower, upper, x_low, x_high, g

    def measure_residual(self, at: _Candidate) -> float:
        """
        Return the relative residual of the optimality conditions of a candidate.

        With its own linearization: the gradient of the Lagrangian, and the products of
        multipliers and distances from limits, each over 1 + the largest term of its sum.
        """
        if self.lam_a is None or self.lam_x is None:
            return math.inf
        lower, upper, x_low, x_high, g = self._fill(at)
        z = self._unknowns(at)
        gaps = float(np.abs(at.numbers[5]).max()) / (1.0 + float(np.abs(at.E).max()))
        outside = float(np.maximum(0.0, np.maximum(x_low - z, z - x_high)).max())
        Hz, turned, _, rows = np.split(self.solver._multiply(
            at.matrix, z, self.lam_a, at.hessian).full().ravel(),
            [len(z), 2 * len(z), 3 * len(z)])
        size = 1.0 + max(float(np.abs(each).max(initial=0.0)) for each in (Hz, self.lam_a))
        slope = float(np.abs(Hz + g + turned + self.lam_x).max()) / size
        products = max(_complement(rows, lower, upper, self.lam_a),
                       _complement(z, x_low, x_high, self.lam_x)) / (
                           1.0 + abs(at.value(self.solver._penalty)))
        soft = self.lam_a[np.isneginf(lower) | np.isposinf(upper)]
        self.multiplier = float(np.abs(soft).max(initial=0.0))
        return max(slope, products, gaps, outside)

    def report(self, at: _Candidate, status: str, residual: float, begun: float) -> StepResult:
        """Return the result of a candidate."""
        problem, soft = self.problem, self.problem.soft
        stage, end = self.excesses(at.numbers)
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


_OPTIONS: dict[str, Any] = {
    'print_time': False, 'inf': 1e5, 'hpipm': {
        'iter_max': 60, 'mode': 'speed', 'res_g_max': 1e-8, 'res_b_max': 1e-8,
        'res_d_max': 1e-8, 'res_m_max': 1e-8}}
