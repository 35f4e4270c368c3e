# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The certificate: residuals of Pontryagin's conditions (Theorem 2.1).

They are computed from the problem and the solution alone, without any part of the solver. A
residual has no unit. The appendix of docs/certificate.md defines residuals and scaling factors,
and gives the reasons.

States that only rounding errors move from the origin have s_i = 0. A linked state has the s_i of
the other one. For a terminal constraint with the multiplier 0, `dynamics` has the change of the
inputs that corrects the defects (`defect_correction`), since the costates do not contain it.

The module is long because all residuals share the scaling factors (`_Scales`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.certificate.cost_summands import CostSummands
from obc_ros.core.ocp.certificate.defect_correction import find_correction
from obc_ros.core.ocp.certificate.hamiltonian_minimum import HamiltonianScales as InputScales
from obc_ros.core.ocp.certificate.hamiltonian_minimum import InputMinimum, Points
from obc_ros.core.ocp.certificate.replay import (
    build_intervals,
    LEAST_COST,
    PARTS,
    ReplayIntegrator,
)
from obc_ros.core.ocp.problem import ByStructure, Problem
from obc_ros.core.ocp.solution import Certificate, Condition, Solution
from obc_ros.core.ocp.structure import make_differentiable

COUNTS_AS_MET = 1e-6   # relative: a smaller violation of a constraint counts as none
# A coarse mesh, a local minimum of H or a wrong multiplier gives residuals far above these. A
# solution whose cost is right to six digits is below them.
TOLERANCES: dict[str, float] = {
    Condition.DYNAMICS: 1e-6, Condition.START: 1e-6, Condition.END: COUNTS_AS_MET,
    Condition.BOUNDS: COUNTS_AS_MET,
    Condition.COSTATE: 1e-4, Condition.MINIMUM: 1e-4, Condition.TRANSVERSALITY: 1e-4,
    Condition.HAMILTONIAN: 1e-4, Condition.FINAL_TIME: 1e-4, Condition.COST: 1e-6}
REPLAY_ERROR = 1e-7   # estimated integration error of all intervals together, of x and cost
_COSTATE_ERROR = 0.1 * TOLERANCES[Condition.COSTATE]   # of lam; the other is a tenth, too
LEAST_PART = 1e-2   # scale of a path constraint, relative to the sum of its terms, at least
ACTIVE = 1e-5   # distance of an active constraint from its bound, relative to its scale
_FORCELESS = 1e-6  # relative to lam: below it a terminal multiplier counts as 0
# A summand of L or V below this part of its size counts as 0.
_VANISHES = LEAST_COST * TOLERANCES[Condition.MINIMUM]
# A cost is right to 1e-5, to first order. Costates 1e4 times as large as the cost belong to an
# abnormal extremal, if inputs are at bounds: else they are the price of an end that is nearly
# out of reach.
_OF_COST, _ABNORMAL = 0.1, 1e-4
# States, and f relative to its part from the inputs, that count as rounding errors.
_ROUNDING = 1e-9, 1e-10
_MOST_OF_MOTION = 100.0  # integrals of |f_i|: largest scale of a state with a free initial value


def certify(problem: Problem, solution: Solution) -> Certificate:
    """
    Return the residuals of the necessary conditions for a solution.

    :param solution: its t (N,), x (N, n), u (N, m), lam (N, n), nu (q,) or empty, hamiltonian
        (N,), objective, interpolation and multipliers are read, nothing else.
    :return: see the head of this file. All residuals are infinite if arrays have wrong shapes or
        hold a number that is not finite.
    """
    absent = {key for key, asked in ((Condition.FINAL_TIME, problem.final_time.free),
                                     (Condition.MINIMUM, not problem.held)) if not asked}
    keys = [key for key in TOLERANCES if key not in absent]
    tolerances = {key: TOLERANCES[key] for key in keys}
    if not _fits(problem, solution):
        return Certificate(dict.fromkeys(keys, np.inf), tolerances)
    judge = _Judge(problem, solution, _functions(problem))
    if not np.isfinite(judge.scales.cost):   # no scale at all, for example V = 1/x at x(T) = 0
        return Certificate(dict.fromkeys(keys, np.inf), tolerances)
    found = judge.residuals()
    return Certificate({key: float(found[key]) if np.isfinite(found[key]) else np.inf
                        for key in keys}, tolerances, judge.excess)


class _Functions:
    """The compiled functions of a problem's structure."""

    def __init__(self, problem: Problem) -> None:
        problem = make_differentiable(problem)
        x, u, p = problem.x, problem.u, problem.p
        self.integrator = ReplayIntegrator(problem)
        self.minimum = InputMinimum(problem)
        self.rate = None if problem.start is None else VectorizedFunction([x, u, p], [problem.f])
        self.summands = CostSummands(problem)
        self.end = VectorizedFunction([x, p], [problem.V, ca.gradient(problem.V, x), problem.psi,
                                               ca.jacobian(problem.psi, x).T])
        if problem.path.numel():
            rate = ca.SX.sym('rate', problem.m)
            path_x = ca.jacobian(problem.path, x)
            self.path_x = VectorizedFunction([x, u, p], [path_x.T])
            self.path_u = VectorizedFunction([x, u, p], [ca.jacobian(problem.path, u).T])
            self.path_rate = VectorizedFunction([x, u, rate, p], [
                ca.mtimes(path_x, problem.f) + ca.mtimes(ca.jacobian(problem.path, u), rate)])


_functions = ByStructure(_Functions, 32)


def _fits(problem: Problem, solution: Solution) -> bool:
    """Return whether the arrays have their shapes, are finite, and t increases."""
    N = len(solution.t)
    shapes = [(solution.t, (N,)), (solution.x, (N, problem.n)), (solution.u, (N, problem.m)),
              (solution.lam, (N, problem.n)), (solution.hamiltonian, (N,))]
    if solution.state_multipliers is not None:
        shapes.append((solution.state_multipliers, (N, problem.n)))
    if solution.path_multipliers is not None:
        shapes.append((solution.path_multipliers, (N, problem.path.numel())))
    if solution.nu.size:
        shapes.append((solution.nu, (problem.q,)))
    return (N >= 2 and solution.interpolation in ('linear', 'zoh')
            and all(np.shape(array) == shape and bool(np.all(np.isfinite(array)))
                    for array, shape in shapes)
            and bool(np.all(np.diff(solution.t) >= 0)) and solution.t[-1] > solution.t[0])


@dataclass(frozen=True, eq=False)
class _Scales:
    x: Array
    u: Array
    lam: float
    H: float
    cost: float
    spent: float


class _Judge:
    """The residuals of one solution; a method for each condition."""

    def __init__(self, problem: Problem, solution: Solution, functions: _Functions) -> None:
        self.problem, self.solution, self.functions = problem, solution, functions
        self.excess = np.nan   # of the last residuals
        self.p = problem.p_value
        self.duration = float(solution.t[-1] - solution.t[0])
        self.rows = np.flatnonzero(np.diff(solution.t) > 0)
        self.intervals = build_intervals(problem, solution, self.rows)
        self.x_scale = self._x_scale()
        self.lam_size = float((np.abs(solution.lam) * self.x_scale).max())
        summands = functions.summands.measure(solution.t, solution.x, solution.u, self.p)
        size = float(summands.sizes.sum()) if summands.vanish(_VANISHES) else 0.0
        self._integrate(LEAST_COST * (size or summands.unit), 1.0 if size else 1e-3)
        if size and self._spent() > _VANISHES * size:   # between the samples it does not vanish
            self._integrate(LEAST_COST * summands.unit, 1e-3)

    def _integrate(self, least: float, share: float) -> None:
        """Replay with lower bounds of the scale of the cost, and of the others relative to it."""
        solution, integrator = self.solution, self.functions.integrator
        self.least, self.share = least, share
        lam = max(self.lam_size, share * least if self.lam_size else 1.0)
        scale = np.append(self.x_scale, lam / self.x_scale)
        n, lam_end = self.problem.n, solution.lam[self.rows + 1]
        allowed = np.repeat([REPLAY_ERROR, _COSTATE_ERROR, REPLAY_ERROR], [n, n, 1])
        run = self.intervals, self.p, scale, allowed / len(self.rows), least
        ahead = integrator.replay(*run)
        self.costates_from = partial(integrator.there_and_back, ahead, self.intervals, lam_end,
                                     *run[1:])
        self.growth = partial(integrator.growth, ahead, *run[:3])
        self.replay, self.lam_defect = self.costates_from()
        self.points = self._points()
        # Row 0: at the end of the replay. Row 1: at the last sample.
        self.end = self.functions.end(np.stack([self.replay.x[-1, -1], solution.x[-1]]), self.p)
        self.scales = self._scales()

    def residuals(self) -> dict[str, float]:
        """
        Return all residuals.

        Where states decay fast, costates and their rounding errors grow from the start of an
        interval to its end. The defect at the start, of an integration from the end, counts
        instead if it is smaller. It is computed only where it may be within the tolerance.
        """
        found = self._residuals()
        allowed = TOLERANCES[Condition.COSTATE]
        if (self.replay.converged and allowed < found[Condition.COSTATE]
                and not found[Condition.COSTATE] > allowed * self.growth()):
            ahead = self.replay, self.lam_defect, self.points, self.scales, self.excess
            self.replay, self.lam_defect = self.costates_from(back=True)
            self.points = self._points()
            self.scales = self._scales()
            other = self._residuals() if self.replay.converged else found
            if other[Condition.COSTATE] < found[Condition.COSTATE]:
                return other
            self.replay, self.lam_defect, self.points, self.scales, self.excess = ahead
        return found

    def _residuals(self) -> dict[str, float]:
        with np.errstate(all='ignore'):
            excess, upper_active, lower_active = self._bounds()
            largest, loss = self._gap()
            found: dict[str, float] = {
                Condition.DYNAMICS: self._dynamics(),
                Condition.START: self._start(),
                Condition.END: self._end(),
                Condition.BOUNDS: excess,
                Condition.COSTATE: self._costate(upper_active, lower_active),
                Condition.MINIMUM: self._minimum(largest, loss),
                Condition.TRANSVERSALITY: max(
                    self._transversality(upper_active[-1], lower_active[-1]),
                    self._start_transversality(upper_active[0], lower_active[0])),
                Condition.HAMILTONIAN: self._hamiltonian(),
                Condition.FINAL_TIME: self._final_time(),
                Condition.COST: self._cost(),
            }
            self.excess = self._excess(loss, found)
        return found

    def _excess(self, loss: float, found: Mapping[str, float]) -> float:
        """Return the estimate of the excess cost, see docs/certificate.md; nan if infinite."""
        if found[Condition.MINIMUM] > TOLERANCES[Condition.MINIMUM]:
            loss = self._gap(everywhere=True)[1]
        excess = loss + self._owed() + self.scales.lam * (
            found[Condition.COSTATE] + found[Condition.TRANSVERSALITY]
        ) + self.scales.H * self.duration * found[Condition.FINAL_TIME]
        return float(excess) if np.isfinite(excess) else np.nan

    def _points(self) -> Points:
        """Return H, its derivatives and its terms at the quarters of all intervals."""
        course, tau = self.replay, np.linspace(0, 1, PARTS + 1)[None, :, None]
        # `_costate` judges the defect of lam; here lam passes through its samples.
        lam = course.lam - tau*(course.lam[:, -1:] - self.solution.lam[self.rows + 1, None])
        mu = (1 - tau)*self.intervals.ma[:, None] + tau*self.intervals.mb[:, None]
        # Multipliers of infinite bounds are ignored.
        mu = np.clip(mu, np.where(np.isfinite(self.problem.path_lower), -np.inf, 0.0),
                     np.where(np.isfinite(self.problem.path_upper), np.inf, 0.0))
        return self.functions.minimum.points(
            self.problem, *(array.reshape(mu.shape[0]*mu.shape[1], -1 if array.size else 0)
                            for array in (course.x, course.u, lam, mu)))

    def _by_interval(self, values: Array) -> Array:
        return np.asarray(values.reshape(len(self.rows), PARTS + 1))

    def _x_scale(self) -> Array:
        size = np.abs(self.solution.x).max(axis=0)
        if size.max() <= _ROUNDING[0] and self._at_rest():
            size = np.zeros_like(size)
        problem, solution, rate_of = self.problem, self.solution, self.functions.rate
        if problem.start is not None and rate_of is not None:   # their motion limits the sizes
            rate = np.abs(rate_of(solution.x, solution.u, self.p)[0])
            motion = np.diff(solution.t) @ (rate[:-1] + rate[1:]) / 2
            moves = ~problem.given_at_start & (motion > 0)
            size = np.where(moves, np.minimum(size, _MOST_OF_MOTION * motion), size)
            lower, upper = problem.start_box
            size = np.where(self._constants(), np.minimum(size, upper - lower), size)
            for i, j in problem.start.linked:
                size[j] = size[i]
        return np.asarray(np.maximum(size, 1e-2 * min(1.0, float(size.max())) or 1.0))

    def _at_rest(self) -> bool:
        """Return whether x(0) = 0 and the inputs hold x = 0, up to rounding errors."""
        if self.problem.x0[self.problem.given_at_start].any():
            return False
        x, u, f = self.problem.x, self.problem.u, self.problem.f
        size = ca.SX.sym('size', self.problem.m)
        load = VectorizedFunction([x, u, size, self.problem.p], [
            f, ca.mtimes(ca.fabs(ca.jacobian(f, u)), size)])
        left, most = load(np.zeros_like(self.solution.x), self.solution.u, self._u_scale(), self.p)
        return bool(np.all(np.abs(left) <= _ROUNDING[1] * most))

    def _u_scale(self) -> Array:
        half = 0.5 * (self.problem.u_upper - self.problem.u_lower)
        size = np.maximum(np.abs(self.solution.u).max(axis=0), 1e-2)
        return np.where(np.isfinite(half) & (half > 0), half, size)

    def _spent(self) -> float:
        running = float(self.intervals.h @ np.abs(self._by_interval(self.points.L)).mean(axis=1))
        return running + abs(float(self.end[0][1, 0]))

    def _scales(self) -> _Scales:
        lam, spent, share = self.lam_size, self._spent(), self.share
        cost = max(spent, 1e-3 * lam, self.least)
        H = max(float(self.points.size.max()), share * cost / self.duration)
        return _Scales(x=self.x_scale, u=self._u_scale(), lam=max(lam, share * cost), H=H,
                       cost=cost, spent=spent)

    def _dynamics(self) -> float:
        if not self.replay.converged:
            return np.inf
        defect, size = np.abs(self._jumps()), self.scales.x
        rounding = 0.0 if self.problem.start is None else float(
            (np.spacing(np.abs(self.solution.x).max(axis=0)) / size).max())
        return max(float((defect / size).max(axis=1).sum()), 1e-2 * self._correction(), rounding)

    def _constants(self) -> Mask:
        """Return the states that are constant with a free value of their own, (n,)."""
        problem = self.problem
        if problem.start is None:
            return np.zeros(problem.n, dtype=bool)
        free = ~problem.given_at_start
        free[[j for _, j in problem.start.linked]] = False
        return np.asarray(free & [rate.is_zero() for rate in ca.vertsplit(problem.f)])

    def _psi_sizes(self, slopes: Array) -> Array:
        """Return the sizes (q,) of the terminal constraints with gradients (q, n)."""
        size = np.abs(slopes)
        others = size @ np.where(self._constants(), 0.0, self.scales.x)
        return np.where(others > 0, others, size @ self.scales.x)

    def _correction(self) -> float:
        """Return the change of the inputs that corrects the defects, if some nu_j vanish."""
        if not self.problem.q:
            return 0.0
        slopes = self.end[3][0].reshape(self.problem.q, -1)
        sizes = self._psi_sizes(slopes)
        if not np.any(np.abs(self._nu()) * sizes <= _FORCELESS * self.scales.lam):
            return 0.0
        jumps = self._jumps()
        after = np.zeros((len(self.rows), self.problem.n))
        np.add.at(after, np.maximum(np.searchsorted(self.rows, np.arange(len(jumps)), 'right') - 1,
                                    0), jumps)
        return find_correction(
            self.problem, self.replay.x[:, PARTS // 2], self.replay.u[:, PARTS // 2],
            self.intervals.h, after, (slopes, np.where(sizes > 0, sizes, 1.0)), self.scales.u)

    def _start(self) -> float:
        gap = np.abs(self._missed_at_start()) / self.scales.x
        gaps = [gap.max(), abs(self.solution.t[0]) / self.duration]
        if self.problem.start is not None:
            x, size = self.solution.x[0], self.scales.x
            gaps += [abs(x[i] - x[j]) / min(size[i], size[j])
                     for i, j in self.problem.start.linked]
        return float(max(gaps))

    def _missed_at_start(self) -> Array:
        """Return x(0) less the nearest value that its bounds allow, (n,)."""
        x, (lower, upper) = self.solution.x[0], self.problem.start_box
        return np.asarray(x - np.clip(x, lower, upper))

    def _end(self) -> float:
        final = self.problem.final_time
        late = 0.0 if final.free else abs(float(self.solution.t[-1]) - final.value) / final.value
        _, _, psi, psi_x = self.end
        if not self.problem.q:
            return late
        size, missed = self._psi_sizes(psi_x[0].reshape(self.problem.q, -1)), np.abs(psi[0])
        worth = float(np.abs(self.solution.nu) @ missed) if self.solution.nu.size else 0.0
        return max(late, float((missed / np.where(size > 0, size, 1.0)).max()),
                   1e-3 * worth / max(self.scales.spent, self.least))

    def _bounds(self) -> tuple[float, Mask, Mask]:
        """Return the largest excess, and which constraints are active, (K, n + l): x, path."""
        problem, at = self.problem, self.points
        value, slope = np.hstack([at.x, at.c]), at.f
        if problem.path.numel():
            rate = (self.intervals.ub - self.intervals.ua) / self.intervals.h[:, None]
            slope = np.hstack([slope, self.functions.path_rate(
                at.x, at.u, np.repeat(rate, PARTS + 1, axis=0), self.p)[0]])
        lower, upper = problem.row_bounds
        size = np.concatenate([self.scales.x, np.abs(at.c).max(axis=0)])
        u_size = np.abs(self.scales.u)
        for bound in (lower, upper):
            size = np.maximum(size, np.where(np.isfinite(bound), np.abs(bound), 0.0))
        zero = (problem.path_lower == 0) & (problem.path_upper == 0)
        if problem.path.numel():
            terms = self._terms()
            size[problem.n:] = np.where(
                zero, terms, np.maximum(size[problem.n:], LEAST_PART * terms))
        for bound in (problem.u_lower, problem.u_upper):
            u_size = np.maximum(u_size, np.where(np.isfinite(bound), np.abs(bound), 0.0))
        size = np.where(size > 0, size, 1.0)
        u_excess = np.maximum(problem.u_lower - self.solution.u,
                              self.solution.u - problem.u_upper)
        excess = float((u_excess / u_size).max(initial=0.0))
        K = len(self.rows)
        upper_active = np.zeros((K, len(size)), dtype=bool)
        lower_active = np.zeros((K, len(size)), dtype=bool)
        h = self.intervals.h / PARTS
        for row in np.flatnonzero(np.isfinite(lower) | np.isfinite(upper)):
            g, dg = self._by_interval(value[:, row]), self._by_interval(slope[:, row])
            high, low = _highest(g, dg, h), -_highest(-g, -dg, h)
            over = np.maximum(high - upper[row], lower[row] - low) / size[row]
            excess = max(excess, float(over.max()))
            # A bound that is exceeded is active.
            upper_active[:, row] = high >= upper[row] - ACTIVE*size[row]
            lower_active[:, row] = low <= lower[row] + ACTIVE*size[row]
        return excess, upper_active, lower_active

    def _terms(self) -> Array:
        """Return the largest sum of the terms of each path constraint, (l,)."""
        at, u = self.points, np.abs(self.solution.u).max(axis=0)
        x_slope, u_slope = (np.abs(slope(at.x, at.u, self.p)[0]).reshape(
            len(at.x), -1, len(size)) for slope, size in (
                (self.functions.path_x, self.scales.x), (self.functions.path_u, u)))
        return np.asarray((x_slope @ self.scales.x + u_slope @ u).max(axis=0))

    def _costate(self, upper: Mask, lower: Mask) -> float:
        solution, k, held = self.solution, self.rows, self.intervals
        if not self.replay.converged:
            return np.inf
        h = held.h[:, None]
        mass = np.hstack([0.5*h*(held.sa + held.sb), 0.5*h*(held.ma + held.mb)])
        left = self._unexplained(self.lam_defect, solution.x[k + 1], held.ub, upper, lower, mass)
        total = float(left.sum())
        jumps = np.flatnonzero(np.diff(solution.t) == 0)
        if jumps.size:
            # A jump lies between the interval that ends there and the one that begins there.
            after = np.minimum(np.searchsorted(k, jumps), len(k) - 1)
            before = np.maximum(np.searchsorted(k, jumps) - 1, 0)
            total += float(self._unexplained(
                solution.lam[jumps] - solution.lam[jumps + 1], solution.x[jumps],
                solution.u[jumps], upper[before] | upper[after], lower[before] | lower[after],
                np.zeros((len(jumps), mass.shape[1]))).sum())
        return total

    def _unexplained(self, defect: Array, x: Array, u: Array, upper: Mask, lower: Mask,
                     mass: Array) -> Array:
        """
        Return the part of each costate defect that no admissible multiplier accounts for.

        `defect` (K, n) is lam before less lam after, `mass` (K, n + l) the integrals of the
        returned multipliers.
        """
        n = self.problem.n
        rest = defect * (self.scales.x / self.scales.lam)
        possible = np.flatnonzero(upper.any(axis=0) | lower.any(axis=0) | mass.any(axis=0))
        lost = np.zeros(len(rest))
        columns = {int(row): self._column(int(row), x, u) for row in possible}
        for row, column in columns.items():
            # A nonzero multiplier of an inactive constraint is an error.
            size = np.abs(column).max(axis=1)
            lost += size * np.where(upper[:, row], 0.0, np.maximum(mass[:, row], 0.0))
            lost += size * np.where(lower[:, row], 0.0, np.maximum(-mass[:, row], 0.0))
        extra = np.zeros((len(rest), n + self.problem.path.numel()))
        for _ in range(20 if len(columns) > 1 else 1):
            for row, column in columns.items():
                norm = np.maximum(np.einsum('ki,ki->k', column, column), 1e-300)
                wanted = extra[:, row] + np.einsum('ki,ki->k', rest, column) / norm
                least = np.where(lower[:, row], -np.inf, np.where(
                    upper[:, row], -np.maximum(mass[:, row], 0.0), 0.0))
                most = np.where(upper[:, row], np.inf, np.where(
                    lower[:, row], np.maximum(-mass[:, row], 0.0), 0.0))
                new = np.clip(wanted, least, most)
                rest = rest - (new - extra[:, row])[:, None] * column
                extra[:, row] = new
        return np.asarray(np.abs(rest).max(axis=1) + lost)

    def _column(self, row: int, x: Array, u: Array) -> Array:
        """Return the scaled gradient of a state bound or path constraint, shape (K, n)."""
        n = self.problem.n
        if row < n:
            column = np.zeros((len(x), n))
            column[:, row] = 1.0
        else:
            column = self.functions.path_x(x, u, self.p)[0][:, (row - n)*n:(row - n + 1)*n]
        return np.asarray(column * (self.scales.x / self.scales.lam))

    def _gap(self, everywhere: bool = False) -> tuple[float, float]:
        """
        Return the largest H - min H at a sample, and the integral of H - min H.

        :param everywhere: search for the minimum between samples too: it may be far from u.
        """
        searched = np.arange(len(self.points.x))
        if not everywhere:
            searched = np.append(searched[::PARTS + 1], searched[-1])
        gap = self._by_interval(self.functions.minimum.gap(
            self.problem, self.points, searched, InputScales(self.scales.u, self.scales.H)))
        samples = gap[:, :1] if self.solution.interpolation == 'zoh' else gap[:, [0, -1]]
        samples = samples[~self.problem.edges_in(self.solution.t)[self.rows]]   # beside it
        weights = np.array([7, 32, 12, 32, 7]) / 90
        return float(samples.max(initial=0.0)), float(self.intervals.h @ (gap @ weights))

    def _minimum(self, largest: float, loss: float) -> float:
        scale = max(self.scales.cost, 1e-3 * self.scales.H * self.duration)
        return max(largest / self.scales.H, 10.0 * loss / scale)

    def _transversality(self, upper: Mask, lower: Mask) -> float:
        q, solution = self.problem.q, self.solution
        _, V_x, _, psi_x = self.end
        rest = solution.lam[-1] - V_x[1]
        if q:
            rest = rest - psi_x[1].reshape(q, -1).T @ self._nu()
        return float(self._unexplained(
            rest[None], solution.x[-1:], self.intervals.ub[-1:], upper[None], lower[None],
            np.zeros((1, len(upper))))[0])

    def _start_transversality(self, upper: Mask, lower: Mask) -> float:
        """Return the largest entry of lam(0) for which neither x(0) nor a bound accounts."""
        problem, solution, n = self.problem, self.solution, self.problem.n
        if problem.start is None:
            return 0.0
        x, (lowest, highest) = solution.x[0], problem.start_box
        near = ACTIVE * self.scales.x
        upper, lower = upper.copy(), lower.copy()
        # Active in the first interval, and at its start.
        upper[:n] &= x >= problem.x_upper - ACTIVE * np.maximum(self.scales.x, np.abs(x))
        lower[:n] &= x <= problem.x_lower + ACTIVE * np.maximum(self.scales.x, np.abs(x))
        upper[:n] |= x >= np.where(problem.given_at_start, -np.inf, highest - near)
        lower[:n] |= x <= np.where(problem.given_at_start, np.inf, lowest + near)
        rest = -solution.lam[0]
        for i, j in problem.start.linked:   # the multiplier of the link acts on both
            rest[i] += rest[j]
            upper[i], lower[i] = upper[i] or upper[j], lower[i] or lower[j]
            upper[j] = lower[j] = True
        return float(self._unexplained(
            rest[None], solution.x[:1], self.intervals.ua[:1], upper[None], lower[None],
            np.zeros((1, len(upper))))[0])

    def _hamiltonian(self) -> float:
        H, given = self._by_interval(self.points.H)[:, [0, -1]], self.solution.hamiltonian
        error = np.abs(H - np.column_stack([given[self.rows], given[self.rows + 1]]))
        if self.solution.interpolation == 'zoh':
            H, error = H[:, 0], error[:, 0]
        else:
            H = self._without_edges(H)
        return float(max(np.ptp(H), error.max()) / self.scales.H)

    def _without_edges(self, H: Array) -> Array:
        """Return H (K, 2) at the ends of intervals, less its changes across edges."""
        over = self.problem.edges_in(self.solution.t)[self.rows]
        change = np.cumsum(np.where(over, H[:, 1] - H[:, 0], 0.0))
        return np.column_stack([H[:, 0] - np.append(0.0, change[:-1]), H[:, 1] - change])

    def _final_time(self) -> float:
        final, T = self.problem.final_time, float(self.solution.t[-1])
        if not final.free:
            return 0.0
        outside = max(final.lower - T, T - final.upper, 0.0) / self.duration
        H = float(self.points.H[-1]) / self.scales.H
        wrong = max(H, 0.0) if final.upper * (1 - 1e-9) <= T else abs(H)
        if final.lower * (1 + 1e-9) >= T:
            wrong = max(-H, 0.0) if final.lower < final.upper else 0.0
        return max(wrong, outside)

    def _cost(self) -> float:
        J = float(self.replay.cost.sum() + self.end[0][0, 0])
        error = abs(J - self.solution.objective)
        # Whether an input is at a bound during an interval.
        held, near = self.intervals, ACTIVE * self.scales.u
        bang = any(bool(np.any((np.abs(held.ua - bound) <= near) & (
            np.abs(held.ub - bound) <= near))) for bound in (
                self.problem.u_lower, self.problem.u_upper))
        abnormal = _ABNORMAL * self.scales.lam if bang else 0.0
        unit = max(self.scales.spent, abnormal, self.least)
        return max(error / self.scales.cost, _OF_COST * (error + self._owed()) / unit)

    def _owed(self) -> float:
        """Return the first-order cost of correcting the errors of start, path and end."""
        lam = self.solution.lam
        owed = abs(float(lam[0] @ self._missed_at_start() + np.sum(lam[1:] * self._jumps())))
        if self.problem.q:
            owed += float(np.abs(self._nu()) @ np.abs(self.end[2][0]))
        return owed

    def _jumps(self) -> Array:
        """Return the defects of x, (N - 1, n): each sample less the end of the replay to it."""
        jumps = np.diff(self.solution.x, axis=0)
        jumps[self.rows] = self.solution.x[self.rows + 1] - self.replay.x[:, -1]
        return np.asarray(jumps)

    def _nu(self) -> Array:
        """Return the terminal multipliers (q,), by least squares if the solution has none."""
        if self.solution.nu.size:
            return self.solution.nu
        slopes = self.end[3][1].reshape(self.problem.q, -1) * self.scales.x
        rest = (self.solution.lam[-1] - self.end[1][1]) * self.scales.x
        return np.asarray(np.linalg.lstsq(slopes.T, rest, rcond=None)[0])


def _highest(value: Array, slope: Array, h: Array) -> Array:
    """
    Return the largest value of the cubics through samples, shape (K,).

    `value`, `slope` (K, parts + 1) at equally spaced times, `h` (K,) apart.
    """
    a, b = value[:, :-1], value[:, 1:]
    da, db = slope[:, :-1] * h[:, None], slope[:, 1:] * h[:, None]
    # The cubic's derivative in tau is q0 + 2 q1 tau + 3 q2 tau^2.
    q1, q2 = 3*(b - a) - 2*da - db, 2*(a - b) + da + db
    root = np.sqrt(np.maximum(q1**2 - 3*q2*da, 0.0))
    # The maximum, in the form that does not cancel for small q2.
    bottom = root - q1
    tau = np.clip(np.where(bottom > 0, da / np.where(bottom > 0, bottom, 1.0), 0.0), 0.0, 1.0)
    inner = a + tau*(da + tau*(q1 + tau*q2))
    return np.asarray(np.maximum(value.max(axis=1), inner.max(axis=1)))
