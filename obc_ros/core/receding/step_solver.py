# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
One step of the receding horizon, solved by its deadline: see docs/receding_horizon_theory.md.

The start is a motion of the model with admissible inputs, too, so that a step may end at any time.
"""

from collections import deque
from dataclasses import dataclass
import math
from pathlib import Path
import time

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.formulation import RecedingProblem
from obc_ros.core.receding.horizon_program import HorizonProgram
from obc_ros.core.receding.step_kernel import HorizonMotion, StepKernel
from obc_ros.core.text.errors import StatementError

STEP_TOLERANCE = 1e-6      # relative residual of the optimality conditions of an optimal plan
_GAP = 1e-8           # relative gap of the model in a plan that exceeds limits
_MOST = 30            # quadratic programs of a step
_CURVED = 12           # programs with second derivatives, before those of the cost alone
_TRIED = 3            # last iterates that are applied to the model if none is optimal
_LEAST_ROOM = 1e-3    # distance of the set point from a limit, relative to 1 + its size
_KEPT = 1e-9          # excess that is not told, relative to 1 + the size of the limit

_WORDS = {
    'optimal': 'optimal',
    'time': 'stopped by the deadline; the best plan so far',
    'iterations': f'stopped after {_MOST} quadratic programs; the best plan so far',
    'failed': 'the quadratic program failed; the best plan so far',
    'diverged': 'no motion from this state on which model and limits are finite'}


@dataclass(frozen=True, eq=False)
class Plan:
    """
    A motion of the model over the horizon, whose input is held over each period [s].

    :ivar stamp: time of the first state [s].
    :ivar x, u: (N + 1, n) and (N, m), the inputs within their bounds. An angle is continuous along
        the plan, within half a turn of the set point at its start.
    :ivar cost: without the penalty.
    """

    stamp: float
    period: float
    x: Array
    u: Array
    cost: float

    @property
    def end(self) -> float:
        """Return the time of the last state [s]."""
        return self.stamp + len(self.u) * self.period

    @property
    def is_finite(self) -> bool:
        """Return whether all states and inputs are finite numbers."""
        return bool(np.isfinite(self.x).all() and np.isfinite(self.u).all())


@dataclass(frozen=True, eq=False)
class StepResult:
    """
    What a step of the receding horizon came to.

    :ivar plan: a motion of the model with admissible inputs; None if none is finite.
    :ivar status: 'optimal', 'time', 'iterations', 'failed' or 'diverged'.
    :ivar iterations: quadratic programs solved.
    :ivar residual: relative residual of the optimality conditions of the plan; inf if unknown.
    :ivar slack: largest excess of each softened limit that is exceeded, in its unit.
    :ivar seconds: wall time.
    """

    plan: Plan | None
    status: str
    words: str
    iterations: int
    residual: float
    slack: dict[str, float]
    seconds: float


class StepSolver:
    """
    Solver of the steps of one problem.

    :param cache_dir: directory of compiled functions; default: `find_cache_directory`.
    :param compiled: whether functions are compiled if there is a compiler.
    """

    def __init__(self, problem: RecedingProblem, cache_dir: Path | None = None, *,
                 compiled: bool = True) -> None:
        self.problem = problem
        self._directory, self._compiled = cache_dir, compiled
        self._kernel: StepKernel | None = None
        soft = problem.soft
        self._sizes = 1.0 + np.where(np.isfinite(soft.upper), np.abs(soft.upper),
                                     np.abs(soft.lower))
        rooms = np.minimum(soft.upper - soft.at_set_point, soft.at_set_point - soft.lower)
        self._rooms = np.maximum(rooms, _LEAST_ROOM * self._sizes)
        self._slope = 2.0 * float(np.linalg.norm(problem.P, 2))
        self._multipliers: tuple[float, Array, Array] | None = None

    def prepare(self) -> str:
        """Build, compile and run everything once; return a sentence on the compilation."""
        if self._kernel is None:
            self._kernel = StepKernel(HorizonProgram(self.problem), self._directory,
                                      self._compiled)
            self.solve(self.problem.xe)
        return self._kernel.words

    def solve(self, x0: Array, start: Plan | None = None, deadline: float = math.inf,
              stamp: float = 0.0) -> StepResult:
        """
        Return the plan from a state.

        :param start: a plan to start from, such as the one before; it may begin earlier and end
            earlier or later. Without it the regulator is the start.
        :param deadline: time of `time.monotonic` at which the result is returned [s]. A quadratic
            program that was begun is ended; the duration of one is expected beforehand.
        :param stamp: time of the state [s], which places a moving set point.
        :raises StatementError: if the state is not n finite numbers.
        """
        begun = time.monotonic()
        x0 = np.asarray(x0, dtype=float)
        if x0.shape != self.problem.xe.shape or not np.isfinite(x0).all():
            raise StatementError(f'state: wanted {len(self.problem.xe)} finite numbers')
        self.prepare()
        assert self._kernel is not None
        search = _Search(self, self._kernel, self.problem.error(x0, stamp), stamp)
        return search.run(self._start(search, start), deadline, begun)

    def _start(self, search: '_Search', plan: Plan | None) -> HorizonMotion | None:
        """Return the motion along an earlier plan, or under the regulator; None: not finite."""
        N, n, m = self.problem.horizon, len(self.problem.xe), len(self.problem.ue)
        E, V = np.zeros((N + 1, n)), np.zeros((N, m))
        if plan is not None and plan.is_finite and plan.x.shape[1] == n and plan.u.shape[1] == m:
            k = round((search.stamp - plan.stamp) / plan.period)
            if 0 <= k < len(plan.u):
                left = min(len(plan.u) - k, N)
                moved = (plan.stamp + np.arange(k, k + left) * plan.period)[:, None]
                E[:left] = plan.x[k:k + left] - self.problem.xe - moved * self.problem.drift
                V[:left] = plan.u[k:k + left] - self.problem.ue
                turns = np.round((search.e0 - E[0]) / math.tau) * math.tau
                E[:left] += np.where(self.problem.system.angles, turns, 0.0)
                if (found := search.follow(E, V)) is not None:
                    return found
        return search.follow(np.zeros_like(E), np.zeros_like(V))

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

    def choose_penalties(self, e0: Array) -> Array:
        """
        Return sigma (r,): bounds of the slope of the cost-to-go along a plan from e0 (n,).

        docs/receding_horizon_theory.md says how, and why larger ones make things worse.
        """
        return self._slope * np.maximum(self._rooms, np.linalg.norm(e0))


class _Search:
    def __init__(self, solver: StepSolver, kernel: StepKernel, e0: Array, stamp: float) -> None:
        self.solver, self.problem, self.kernel = solver, solver.problem, kernel
        self.e0, self.stamp = e0, stamp
        times = stamp + self.problem.period * np.arange(self.problem.horizon + 1)
        self.shifts = np.outer(times, self.problem.drift)
        self.penalties = solver.choose_penalties(e0)
        self.count = 0
        self.curved = True
        kernel.begin(e0, self.shifts)
        kernel.lam[:], kernel.mu[:] = solver._recall(stamp) or (0.0, 0.0)

    def follow(self, E: Array, V: Array) -> HorizonMotion | None:
        """Return the motion with the inputs V (N, m) about E (N + 1, n); None: not finite."""
        self.kernel.E[:], self.kernel.V[:] = E, V
        return self.kernel.follow()

    def run(self, start: HorizonMotion | None, deadline: float, begun: float) -> StepResult:
        """Improve a start until it is optimal or the time is over."""
        if start is None:
            return StepResult(None, 'diverged', _WORDS['diverged'], 0, math.inf, {},
                              time.monotonic() - begun)
        best, kernel = start, self.kernel
        status, longest, kept = 'iterations', 0.0, math.inf
        tried: deque[tuple[Array, Array]] = deque(maxlen=_TRIED)
        self._linearize_at(best)
        while self.count < _MOST:
            now = time.monotonic()
            if now + longest > deadline:
                status = 'time'
                break
            if not self._solve_program(best):
                status = 'failed'
                break
            residual = kernel.measure_residual()
            tried.append((kernel.E.copy(), kernel.V.copy()))
            moved = kernel.follow() if residual <= STEP_TOLERANCE else None
            if moved is not None:
                best, kept = moved, residual
                self._keep_multipliers()
                # Larger gaps of the model let a motion exceed a limit.
                if kernel.gap <= _GAP or not (moved.worst > _KEPT * self.solver._sizes).any():
                    break
            if self.curved and self.count >= _CURVED:
                self._forget_curvature(best)
            longest = max(longest, time.monotonic() - now)
        if math.isfinite(kept):
            status = 'optimal'
        else:
            motions = [self.follow(*each) for each in tried]
            best = min([best, *(each for each in motions if each is not None)],
                       key=lambda each: each.cost + float(self.penalties @ each.excess))
        return self._report(best, status, kept, begun)

    def _solve_program(self, best: HorizonMotion) -> bool:
        """Solve the program about the iterate, and linearize about its answer; False: it fails."""
        self.count += 1
        solved = self.kernel.solve()
        if not solved and self.curved:
            self._forget_curvature(best)
            self.count += 1
            solved = self.kernel.solve()
        if solved:
            if self.curved:
                self.kernel.take_multipliers()
            self.kernel.linearize(self.penalties)
        return solved

    def _linearize_at(self, motion: HorizonMotion) -> None:
        self.kernel.E[:], self.kernel.V[:] = motion.E, motion.V
        self.kernel.linearize(self.penalties)

    def _forget_curvature(self, motion: HorizonMotion) -> None:
        """Begin at a motion again, with the Hessian of the cost alone, which is convex."""
        self.curved = False
        self.kernel.lam[:] = self.kernel.mu[:] = 0.0
        self._linearize_at(motion)

    def _keep_multipliers(self) -> None:
        kernel = self.kernel
        kernel.take_multipliers()
        self.solver._multipliers = self.stamp, kernel.lam.copy(), kernel.mu.copy()

    def _report(self, at: HorizonMotion, status: str, residual: float, begun: float) -> StepResult:
        problem, soft = self.problem, self.problem.soft
        slack = {name: value for name, value, size in zip(
            soft.names, at.worst.tolist(), self.solver._sizes, strict=True)
            if value > _KEPT * size}
        words = _WORDS[status]
        if slack:
            words += '; exceeds ' + ', '.join(f'{name} by {value:.3g}'
                                              for name, value in slack.items())
        # v + ue is rounded.
        u = np.clip(at.V + problem.ue, problem.limits.u_lower, problem.limits.u_upper)
        plan = Plan(self.stamp, problem.period, at.E + self.shifts + problem.xe, u, at.cost)
        return StepResult(plan, status, words, self.count, residual, slack,
                          time.monotonic() - begun)
