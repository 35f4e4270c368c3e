# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Least-squares fit of costates and constraint multipliers along a given path.

The multipliers of a transcription belong to its mesh points. Those of Pontryagin's principle are a
density on each arc on which a constraint is active, and impulses at its ends. Along a given path
lam, dH/du and H are linear in nu, in the densities (piecewise linear here) and in the impulses.
These are fitted with their signs so that dH/du = 0 for free inputs, dH/du has the right sign for
inputs at bounds, and H is constant.
Constraints c(u) on inputs alone do not enter dlam/dt: the costates of the transcription are kept,
and the densities are fitted at each time separately.
"""

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask, optimize
from obc_ros.core.numerics.collocation import build_collocation, build_stage_matrices
from obc_ros.core.numerics.samples import find_runs
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.certificate.certificate import LEAST_PART
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.arcs.mixed_constraints import compute_densities
from obc_ros.core.solver.arcs.state_contacts import AT_BOUND
from obc_ros.core.solver.transcription.intervals import step
from obc_ros.core.solver.transcription.program import TranscriptionOutcome

_Rows = tuple[Array, Array]   # A and b of A v = b or A v >= b
# A row, 1 at its upper bound or -1 at its lower one, and the first and last fine time there.
_Contact = tuple[int, int, int, int]


class Fitter:
    """The fit of costates and multipliers for the problems of one structure."""

    def __init__(self, problem: Problem) -> None:
        n, m, x, u, p = problem.n, problem.m, problem.x, problem.u, problem.p
        rows = ca.vertcat(x, problem.path)
        count = int(rows.numel())
        ua, ub, h = ca.SX.sym('ua', m), ca.SX.sym('ub', m), ca.SX.sym('h')
        ma, mb = ca.SX.sym('ma', count), ca.SX.sym('mb', count)
        rate = ca.Function('rate', [x, u, p], [problem.f, problem.L, rows])

        def with_rows(z: ca.SX, inputs: ca.SX) -> ca.SX:
            f, L, c = rate(z[:-1], inputs[:m], p)
            return ca.vertcat(f, L + ca.dot(inputs[m:], c))

        end, cost = step(with_rows, x, (ca.vertcat(ua, ma), ca.vertcat(ub, mb)), h)
        back = ca.gradient(cost, x)
        none = [ca.SX.zeros(count), ca.SX.zeros(count)]
        self._part = VectorizedFunction([x, ua, ub, h, p], ca.substitute(
            [ca.jacobian(end, x).T, back, ca.jacobian(back, ma).T, ca.jacobian(back, mb).T],
            [ma, mb], none))
        self._point = VectorizedFunction([x, u, p], [
            problem.L, problem.f, ca.gradient(problem.L, u), ca.jacobian(problem.f, u).T,
            ca.jacobian(rows, u).T, ca.jacobian(rows, x).T])
        self._rates_x = VectorizedFunction([x, u, p], [
            ca.jacobian(problem.f, x).T, ca.gradient(problem.L, x), ca.jacobian(rows, x).T])
        self._value = VectorizedFunction([x, u, p], [rows])
        self._last = VectorizedFunction([x, p], [
            ca.gradient(problem.V, x), ca.jacobian(problem.psi, x).T])
        self.n, self.m, self.q, self.rows = n, m, problem.q, count
        self._pure = np.array([not ca.depends_on(row, u) for row in ca.vertsplit(rows)])
        self._of_inputs = np.array([not ca.depends_on(row, x) for row in ca.vertsplit(rows)])

    def fit(self, problem: Problem, outcome: TranscriptionOutcome, course: Extremal) -> Extremal:
        """
        Fit costates and multipliers of a course by least squares.

        The multipliers of its outcome tell which constraints are active; without any the course
        itself is returned.
        """
        found = self._contacts(problem, outcome, course)
        if not found:
            return course
        if self._of_inputs[[row for row, *_ in found]].all():
            density = self._pointwise(problem, course, found)
            return replace(course, density_x=density[:, :, :self.n],
                           density_path=density[:, :, self.n:])
        # With path constraints the samples of a course are its mesh points: elsewhere a density
        # cannot bend.
        grid = course.parts if problem.path.numel() else 1
        hats, mass, signs = self._basis(found, course, grid)
        # Without parts the samples are those of a collocation of a stiff system.
        links = (self._links_of_stages(problem, outcome, course) if course.parts == 1 else
                 self._links_of_steps(problem, course))
        without, each, start = self._costates(problem, course, links, hats, mass)
        rows = self._equations(problem, course, hats, (without, each), start)
        if not all(np.all(np.isfinite(part)) for part in rows):
            return course
        values = _fit_signed(*rows, signs, self.q)[:each.shape[3]]
        lam = without + each @ values
        density = hats @ values[self.q:]
        return replace(course, lam=lam[:, 0], lam_end=lam[:, 1], nu=values[:self.q],
                       density_x=density[:, :, :self.n], density_path=density[:, :, self.n:])

    def _pointwise(self, problem: Problem, course: Extremal, found: list[_Contact]) -> Array:
        """Fit densities (K, 2, rows) of constraints on inputs alone to dH/du = 0 pointwise."""
        K = len(course.x)
        density = np.zeros((K, 2, self.rows))
        limits = np.zeros((2, K, self.rows))
        for row, sign, first, last in found:
            limits[int(sign > 0), first:last, row] = np.copysign(np.inf, sign)
        size = _sizes(problem, course.ua)
        for side, x, u, lam in ((0, course.x, course.ua, course.lam),
                                (1, course.x_end, course.ub, course.lam_end)):
            slope, c_u = self._slopes(problem, x, u, lam)
            density[:, side] = _pressing(slope * size, c_u * size, limits,
                                         *_at_bounds(problem, u, size))
        return density

    def _slopes(self, problem: Problem, x: Array, u: Array, lam: Array) -> tuple[Array, Array]:
        """Return the derivatives of L + lam' f and of x and c by u at some points."""
        _, _, L_u, f_u, c_u, _ = self._derivatives(problem, x, u)
        return L_u + np.einsum('knm,kn->km', f_u, lam), c_u

    def pressed(self, problem: Problem, answer: Solution) -> Solution:
        """
        Fit the multipliers of constraints on inputs alone pointwise to dH/du = 0.

        Where all inputs of such a constraint are at bounds its multiplier is not unique.
        """
        mine, mu = np.flatnonzero(self._of_inputs[self.n:]), answer.path_multipliers
        if not mine.size or mu is None:
            return answer
        others = np.setdiff1d(np.arange(mu.shape[1]), mine)
        c = self.at(problem, answer.x, answer.u)[:, self.n:][:, mine]
        lower, upper = problem.path_lower[mine], problem.path_upper[mine]
        near = AT_BOUND * np.abs(c).max(axis=0)
        limits = np.stack([np.where(c <= lower + near, -np.inf, 0.0),
                           np.where(c >= upper - near, np.inf, 0.0)])
        size = _sizes(problem, answer.u)
        slope, c_u = self._slopes(problem, answer.x, answer.u, answer.lam)
        slope += np.einsum('krm,kr->km', c_u[:, self.n + others], mu[:, others])
        mu = mu.copy()
        mu[:, mine] = _pressing(slope * size, c_u[:, self.n + mine] * size, limits,
                                *_at_bounds(problem, answer.u, size))
        return replace(answer, path_multipliers=mu)

    def slack(self, problem: Problem, course: Extremal) -> Array:
        """
        Return the complementarity products of path constraints that depend on inputs, (2, K).

        |mu| times the distance from the bound, summed over the constraints, at the start and at
        the end of each part of a course.
        """
        assert course.density_path is not None
        mixed = np.flatnonzero(~self._pure[self.n:])
        found = []
        for side, x, u in ((0, course.x, course.ua), (1, course.x_end, course.ub)):
            c, mu = self.at(problem, x, u)[:, self.n:], course.density_path[:, side]
            room = np.where(mu > 0, problem.path_upper - c, c - problem.path_lower)
            found.append(np.sum(np.abs(mu[:, mixed]) * np.where(
                mu == 0, 0.0, np.maximum(room, 0.0))[:, mixed], axis=1))
        return np.stack(found)

    def sizes(self, problem: Problem, course: Extremal, value: Array) -> Array:
        """
        Return the sizes of x and c along a course, (n + l,); `value` (K + 1, n + l): x and c.

        A constraint that is active throughout, such as x - 1 >= 0, is 0 but for rounding: it has
        at least `LEAST_PART` of the size of its terms.
        """
        x, u = course.x, course.ua
        *_, of_inputs, of_states = self._derivatives(problem, x, u)
        terms = (np.abs(of_states).max(axis=0) @ np.abs(x).max(axis=0)
                 + np.abs(of_inputs).max(axis=0) @ np.abs(u).max(axis=0))
        return np.asarray(np.maximum(np.abs(value).max(axis=0), LEAST_PART * terms))

    def at(self, problem: Problem, x: Array, u: Array) -> Array:
        """Return x and c at some points, shape (K, n + l)."""
        return self._value(x, u, problem.p_value)[0]

    def _contacts(self, problem: Problem, outcome: TranscriptionOutcome,
                  course: Extremal) -> list[_Contact]:
        """
        Return the intervals on which bounds of x and path constraints are active.

        The product of multiplier and distance is the barrier parameter at every node of a
        transcription, so that the larger of the two shows whether a constraint is active. The
        multipliers of an arc are proportional to the lengths of intervals, and small on a fine
        mesh. An equality is active at all times.
        """
        value = self.at(problem, *course.points[:2])
        sizes = self.sizes(problem, course, value)
        mass = np.hstack([outcome.node_bounds, outcome.node_path])
        slopes = self._derivatives(problem, course.x, course.ua)[4]
        weights = compute_densities(outcome, slopes[:, self.n:], course.ua)
        cost = outcome.scales.cost if outcome.scales else abs(outcome.objective)
        lower, upper = problem.row_bounds
        found = []
        for sign, bound in ((1, upper), (-1, lower)):
            size = np.maximum(sizes, np.where(np.isfinite(bound), np.abs(bound), 0.0))
            distance = np.abs(value - bound) / np.where(size > 0, size, 1.0)
            for row in np.flatnonzero(np.isfinite(bound)):
                near = (distance[:, row] <= AT_BOUND) | (lower[row] == upper[row])
                heavy = np.maximum(sign * mass[:, row], 0.0)
                apart = distance[::course.parts, row]
                # A node is farther from a bound if its multiplier exceeds its distance, scaled.
                near[::course.parts] |= (heavy * size[row] > apart * cost) & (apart < 1e-3)
                if not self._pure[row]:
                    near |= _touched(sign * weights[:, :, row - self.n], course.parts)
                runs = find_runs(near, 2 * course.parts)   # over gaps of two intervals
                if not self._pure[row]:
                    runs = _parted(runs, outcome, course.parts)
                found += [(int(row), sign, first, last) for first, last in runs]
        return found

    def _basis(self, found: list[_Contact], course: Extremal, grid: int
               ) -> tuple[Array, Array, Array]:
        """
        Return the functions whose multiples are fitted; densities bend at every `grid`-th time.

        :return: hats: (K, 2, rows, count), densities at the start and at the end of each part;
            mass: (K + 1, rows, count), impulses at the times between them; signs: (count,), of the
            multipliers.
        """
        K, parts = len(course.x), course.parts
        # Row, density, mass and sign of each unknown.
        basis: list[tuple[int, Array | float, Array | float, int]] = []
        places = np.arange(K + 1)
        ends = np.column_stack([places[:-1], places[1:]])
        for row, sign, first, last in found:
            first, last = first // grid, -(-last // grid)
            count = min((last - first) * grid // parts, 60) + (1 if grid > 1 else 2)
            knots = grid * np.unique(np.linspace(first, last, count).round().astype(int))
            first, last = first * grid, last * grid
            inside = (ends[:, :1] >= first) & (ends[:, 1:] <= last)
            if len(knots) > 1:
                basis += [(row, inside * np.interp(ends, knots, unit), 0.0, sign)
                          for unit in np.eye(len(knots))]
            if self._pure[row]:
                basis += [(row, 0.0, (places == place).astype(float), sign)
                          for place in sorted({first, last})]
        density = np.zeros((K, 2, self.rows, len(basis)))
        mass = np.zeros((K + 1, self.rows, len(basis)))
        for k, (row, hat, impulse, _) in enumerate(basis):
            density[:, :, row, k], mass[:, row, k] = hat, impulse
        return density, mass, np.array([sign for *_, sign in basis], dtype=float)

    def _links_of_steps(self, problem: Problem, course: Extremal) -> tuple[Array, ...]:
        """
        Return derivatives of the end of each part, and of the integral of L + density' c.

        :return: of the end by x at the start: (K, n, n), transposed; of the integral by x there:
            (K, n); of the latter by the densities at the start and at the end: (K, n, n + l) each.
        """
        found = self._part(course.x, course.ua, course.ub, np.diff(course.t)[:, None],
                           problem.p_value)
        shapes = (self.n, self.n), (self.n,), (self.n, self.rows), (self.n, self.rows)
        step_x, *others = (value.reshape(-1, *shape)
                           for value, shape in zip(found, shapes, strict=True))
        return step_x.swapaxes(1, 2), *others

    def _links_of_stages(self, problem: Problem, outcome: TranscriptionOutcome, course: Extremal
                         ) -> tuple[Array, ...]:
        """
        Return the same derivatives for intervals by collocation.

        Explicit steps backwards would amplify the decaying modes of a stiff system.
        """
        n, inner, h = self.n, outcome.path.inner, np.diff(course.t)
        K, stages = inner.shape[:2]
        c, b, D, last = build_collocation(stages)
        u = course.ua[:, None] + c[:, None] * (course.ub - course.ua)[:, None]
        f_x, L_x, c_x = (value.reshape(K, stages, -1, n) for value in self._rates_x(
            inner.reshape(-1, n), u.reshape(K * stages, -1), problem.p_value))
        start = np.broadcast_to(np.kron(D[:, :1], np.eye(n)), (K, stages * n, n))
        inside = -np.linalg.solve(
            build_stage_matrices(D, h, f_x), start).reshape(K, stages, n, n)
        end = last[0] * np.eye(n) + np.einsum('j,kjab->kab', last[1:], inside)
        weight = h[:, None] * b
        rows = np.einsum('kj,kjba,kjrb->kjar', weight, inside, c_x)
        return (end.swapaxes(1, 2), np.einsum('kj,kjba,kjrb->ka', weight, inside, L_x),
                np.einsum('j,kjar->kar', 1 - c, rows), np.einsum('j,kjar->kar', c, rows))

    def _costates(self, problem: Problem, course: Extremal, links: tuple[Array, ...],
                  hats: Array, mass: Array) -> tuple[Array, Array, _Rows]:
        """
        Return the constant part of lam (K, 2, n) and its derivatives by the unknowns (K, 2, n, .).

        These are nu and the multiples of the basis; the second axis is the start and the end of
        each part. The last result is the same at t = 0, before an impulse there: (n,), (n, .).
        """
        n, q, K = self.n, self.q, len(course.x)
        step_x, source, from_a, from_b = links
        response = sum(np.einsum('knr,kru->knu', part, density)
                       for part, density in ((from_a, hats[:, 0]), (from_b, hats[:, 1])))
        V_x, psi_x = self._last(course.x_end[-1:], problem.p_value)
        x, u, _ = course.points
        drops = np.einsum('krn,kru->knu', self._derivatives(problem, x, u)[5], mass)
        without, each = np.empty((K, 2, n)), np.empty((K, 2, n, q + drops.shape[2]))
        now = V_x[0]
        slope = np.hstack([psi_x.reshape(q, n).T, drops[-1]])
        for k in range(K - 1, -1, -1):
            without[k, 1], each[k, 1] = now, slope
            now = step_x[k] @ now + source[k]
            slope = step_x[k] @ slope
            slope[:, q:] += response[k]
            without[k, 0], each[k, 0] = now, slope
            slope = slope.copy()
            slope[:, q:] += drops[k]
        return without, each, (now, slope)

    def _derivatives(self, problem: Problem, x: Array, u: Array) -> tuple[Array, ...]:
        """Return L, f, L_u, f_u, c_u, c_x at some points; c is x and the path constraints."""
        n, m, r = self.n, self.m, self.rows
        return tuple(value.reshape(-1, *shape) for value, shape in zip(
            self._point(x, u, problem.p_value), ((), (n,), (m,), (n, m), (r, m), (r, n)),
            strict=True))

    def _equations(self, problem: Problem, course: Extremal, hats: Array,
                   lam: tuple[Array, Array], start: _Rows) -> tuple[Array, Array, Array, Array]:
        """
        Return A, b of A @ unknowns = b, and G, g of G @ unknowns >= g.

        The equations are dH/du = 0 for free inputs, transversality at t = 0 (`start`: lam there)
        and H = const; the inequalities are the signs of dH/du for inputs at bounds.
        """
        without, each = lam
        q, size = self.q, _sizes(problem, course.ua)
        weight = 0.1   # of H = const relative to dH/du = 0
        energies, signed = list[_Rows](), list[_Rows]()
        free = [_start_rows(problem, course, start)]
        for side, x, u in ((0, course.x, course.ua), (1, course.x_end, course.ub)):
            L, f, L_u, f_u, c_u, _ = self._derivatives(problem, x, u)
            slope = np.einsum('knm,knu->kmu', f_u, each[:, side])
            slope[:, :, q:] += np.einsum('krm,kru->kmu', c_u, hats[:, side])
            slope *= size[:, None]
            rest = (L_u + np.einsum('knm,kn->km', f_u, without[:, side])) * size
            low, high = _at_bounds(problem, u, size)
            inside = ~(low | high)
            free.append((slope[inside], -rest[inside]))
            energies.append((weight * np.einsum('kn,knu->ku', f, each[:, side]),
                             -weight * (L + np.einsum('kn,kn->k', f, without[:, side]))))
            signed += [(sign * slope[at], -sign * rest[at])
                       for at, sign in ((low & ~high, 1.0), (high & ~low, -1.0))]
        A, G = np.vstack([M for M, _ in free + energies]), np.vstack([M for M, _ in signed])
        final = problem.final_time
        if not final.free or course.t[-1] > final.upper * (1 - 1e-9):
            # H is constant but not zero: the constant is one more unknown.
            column = np.zeros((len(A), 1))
            column[sum(len(M) for M, _ in free):] = -weight
            A, G = np.hstack([A, column]), np.hstack([G, np.zeros((len(G), 1))])
        return (A, np.concatenate([b for _, b in free + energies]),
                G, np.concatenate([g for _, g in signed]))


def _start_rows(problem: Problem, course: Extremal, start: _Rows) -> _Rows:
    """
    Return A, b of the transversality condition at t = 0, per unit of time.

    Without it an impulse of a bound that is active at T and the multiplier of a periodic state
    could not be told apart.
    """
    without, each = start
    x, (lowest, highest) = course.x[0], problem.start_box
    free = (x > lowest) & (x < highest)
    pick = np.eye(problem.n)
    for i, j in problem.start.linked if problem.start else ():
        pick[i] += pick[j]   # the multiplier of the link acts on both
        free[i], free[j] = free[i] and free[j], False
    pick = pick[free] * (np.maximum(np.abs(x), 1e-6)[free, None] / course.t[-1])
    return pick @ each, -pick @ without


def _sizes(problem: Problem, u: Array) -> Array:
    """Return the scale of each input, (m,): the distance of its bounds, or its largest value."""
    span = problem.u_upper - problem.u_lower
    return np.asarray(np.where(np.isfinite(span), span, np.maximum(np.abs(u).max(axis=0), 1e-6)))


def _at_bounds(problem: Problem, u: Array, size: Array) -> tuple[Mask, Mask]:
    """Return where inputs (K, m) are at their lower and at their upper bounds."""
    low: Mask = u <= problem.u_lower + 1e-6 * size
    high: Mask = u >= problem.u_upper - 1e-6 * size
    return low, high


def _pressing(slope: Array, c_u: Array, limits: Array, low: Mask, high: Mask) -> Array:
    """
    Return mu (K, r) between limits (2, K, r) that minimises the norm of slope + c_u' mu (K, m).

    For an input at its lower bound (`low`) only negative entries count, at its upper bound
    positive ones. The minimum is found by sweeps over one row at a time, exact for one row.
    """
    mu = np.zeros(c_u.shape[:2])
    active = np.flatnonzero((limits != 0).any(axis=(0, 1)))
    for _ in range(60):   # several constraints may be active together
        before = mu.copy()
        for row in active:
            column = c_u[:, row]
            rest = slope + np.einsum('krm,kr->km', c_u, mu) - column * mu[:, row, None]
            mu[:, row] = np.clip(_least(rest, column, low, high), limits[0, :, row],
                                 limits[1, :, row])
        if np.all(np.abs(mu - before) <= 1e-12 * np.abs(mu).max(initial=0.0)):
            break
    return mu


def _least(rest: Array, column: Array, low: Mask, high: Mask) -> Array:
    """Return s (K,) that minimises rest + s column (K, m), in the norm of `_pressing`."""
    counts, part = np.ones_like(low), np.zeros(len(rest))
    for _ in range(2 + rest.shape[1]):
        with np.errstate(invalid='ignore', divide='ignore'):
            part = -np.sum(counts * rest * column, axis=1) / np.sum(counts * column**2, axis=1)
        part = np.asarray(np.where(np.isfinite(part), part, 0.0))
        now = rest + part[:, None] * column
        new = ~(low & (now > 0) | high & (now < 0) | low & high)
        if np.array_equal(new, counts):
            break
        counts = new
    return part


def _touched(weights: Array, parts: int) -> Mask:
    """Return the fine times of intervals in which a constraint has a large density."""
    heavy = weights.max(axis=1)
    touched = (heavy > 1e-4 * heavy.max()) & (heavy > 0)
    near = np.append(np.repeat(touched, parts), touched[-1])
    near[::parts][1:] |= touched
    return near


def _parted(runs: list[tuple[int, int]], outcome: TranscriptionOutcome,
            parts: int) -> list[tuple[int, int]]:
    """Split runs at the ends of phases: where an input jumps or has a kink, so has its density."""
    ends = parts * np.cumsum([phase.intervals for phase in outcome.mesh.layout.phases])[:-1]
    return [pair for first, last in runs for pair in pairwise(
        [first, *(int(end) for end in ends if first < end < last), last])]


def _fit_signed(A: Array, b: Array, G: Array, g: Array, signs: Array, free: int) -> Array:
    """
    Return v that minimises |A v - b|^2 + |min(G v - g, 0)|^2.

    `signs` are those of the entries after the first `free`; the last ones are free, too.
    """
    sign = np.zeros(A.shape[1])
    sign[free:free + len(signs)] = signs
    size = _column_sizes(A)
    ridge = 1e-8 * np.eye(A.shape[1])   # Tikhonov regularisation
    v: Array = optimize.lsq_linear(
        np.vstack([A / size, ridge]), np.concatenate([b, np.zeros(A.shape[1])]),
        (np.where(sign > 0, 0.0, -np.inf), np.where(sign < 0, 0.0, np.inf)),
        method='bvls').x / size
    beyond = G @ v - g
    if np.all(beyond >= -1e-7 * np.abs(beyond).max(initial=0.0)):   # rounding
        return v
    size = _column_sizes(np.vstack((A, G))) * np.where(sign < 0, -1.0, 1.0)
    try:
        return solve_signed_least_squares(A / size, b, G / size, g, sign != 0) / size
    except np.linalg.LinAlgError:   # numbers that overflow
        return v


def _column_sizes(A: Array) -> Array:
    """Return the norms of the columns of A, 1 for those that vanish."""
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    return np.where(size > 1e-12 * size.max(), size, 1.0)


def solve_signed_least_squares(A: Array, b: Array, G: Array, g: Array, positive: Mask) -> Array:
    """
    Return v that minimises |A v - b|^2 + |min(G v - g, 0)|^2 with v_i >= 0 where `positive`.

    It always exists, and is found by a primal-dual interior-point method with predictor and
    corrector (Mehrotra, SIAM J. Optim. 2, 1992) for dense matrices of small rank. If the minimum
    is not unique, the one on the central path is taken, far from inequalities that need not be
    active. The iteration therefore ends early; a correction of least norm then satisfies the
    equations to rounding errors.

    :param A, b: (r, n), (r,), equations; the columns of A and G should have similar sizes.
    :param G, g: (k, n), (k,), inequalities G v >= g that should hold as far as possible.
    :raises numpy.linalg.LinAlgError: if numbers are not finite, or overflow.
    """
    n, k, ridge = A.shape[1], len(g), 1e-8   # Tikhonov regularisation
    unit: float = max(np.abs(b).max(initial=0.0), np.abs(g).max(initial=0.0)) or 1.0
    # w = C v + soft z - c, where z are the multipliers and, of the soft rows, the violations.
    C = np.vstack((G, np.eye(n)[positive]))
    c = np.append(g / unit, np.zeros(int(positive.sum())))
    soft = np.append(np.ones(k), np.zeros(len(c) - k))
    H, right = A.T @ A + ridge**2 * np.eye(n), A.T @ b / unit
    v, z = np.zeros(n), np.ones(len(c))
    w = np.maximum(C @ v + soft * z - c, 1.0)
    for _ in range(60):
        off, slope = C @ v + soft * z - c - w, H @ v - right - C.T @ z
        mean = float(w @ z) / len(c)
        # b and g are of size 1.
        if mean <= 1e-12 and max(np.abs(off).max(), np.abs(slope).max()) <= 1e-10:
            break
        newton = _Newton(H, C, soft, w, z, off, slope)
        _, dz, dw = newton.step(-w * z)
        part = _reach(w, z, dw, dz)
        ahead = float((w + part * dw) @ (z + part * dz)) / len(c)
        dv, dz, dw = newton.step((ahead / mean)**3 * mean - w * z - dw * dz)
        part = 0.995 * _reach(w, z, dw, dz)   # of the way to the nearest bound
        v, z, w = v + part * dv, z + part * dz, w + part * dw
    violated = z[:k] > w[:k]
    rows, wanted = np.vstack((A, G[violated])), np.append(b, g[violated]) / unit
    near = v + np.linalg.lstsq(rows, wanted - rows @ v, rcond=ridge)[0]
    near[positive] = np.maximum(near[positive], 0.0)
    best: Array = min((v, near), key=lambda v: float(
        np.sum((A @ v - b / unit)**2) + np.sum(np.minimum(G @ v - g / unit, 0)**2)))
    return best * unit


class _Newton:
    """Newton steps of one iterate, for several right sides."""

    def __init__(self, H: Array, C: Array, soft: Array, w: Array, z: Array, off: Array,
                 slope: Array) -> None:
        self._C, self._soft, self._off, self._slope = C, soft, off, slope
        self._z, self._weight = z, 1 / (w + soft * z)
        matrix = H + C.T @ ((self._weight * z)[:, None] * C)
        tiny = np.finfo(float).eps * np.trace(matrix)
        self._inverse = np.linalg.inv(np.linalg.cholesky(matrix + tiny * np.eye(len(H))))

    def step(self, product: Array) -> tuple[Array, Array, Array]:
        """Return the steps of v, z and w after which w z is `product` more, to first order."""
        dz = self._weight * (product - self._z * self._off)
        dv = self._inverse.T @ (self._inverse @ (self._C.T @ dz - self._slope))
        dz = dz - self._weight * self._z * (self._C @ dv)
        return dv, dz, self._C @ dv + self._soft * dz + self._off


def _reach(w: Array, z: Array, dw: Array, dz: Array) -> float:
    """Return the largest part of a step, up to 1, that keeps w and z from being negative."""
    x, dx = np.concatenate((w, z)), np.concatenate((dw, dz))
    falls = dx < 0
    return min(1.0, float((-x[falls] / dx[falls]).min(initial=np.inf)))
