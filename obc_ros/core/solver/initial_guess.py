# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Initial guesses from the statement of a problem alone, and scales of states, inputs, time and cost.

Scales are powers of 2, so that scaling adds no rounding error. The module is long because guesses
and the ranges around them are read from the same numbers.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count, product

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.samples import interpolate_columns
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.least_time_form import get_final_time
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.adjoint.costates import CostateIntegrator
from obc_ros.core.solver.exact.reachable_set import bound_first_reach, bound_reach
from obc_ros.core.solver.options import DEFAULTS, GuessOptions
from obc_ros.core.solver.transcription.intervals import compute_amplification
from obc_ros.core.solver.transcription.mesh import build_path, Path
from obc_ros.core.solver.transcription.program import ProblemScales

_POINTS = 21       # points of a guess
_TURNS = 2 * np.pi, 360.0   # possible periods of an input that is an angle [rad], [deg]


def round_to_power(size: Array | float) -> Array:
    """Return the power of 2 nearest to a size."""
    return np.asarray(np.exp2(np.round(np.log2(np.clip(size, 1e-8, 1e12)))))


def estimate_scales(problem: Problem, path: Path) -> ProblemScales:
    """
    Estimate the scales of states, inputs and time from the largest values of a path.

    Bounds give the scales of what is 0 on the path. The scale of the cost is 1.
    """
    def size(values: Array, lower: Array, upper: Array) -> Array:
        seen = np.max(np.abs(values), axis=0, initial=0.0)
        span = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
        largest = np.where(seen > 0, seen, np.where(span > 0, span, 1.0))
        return round_to_power(largest)

    return ProblemScales(size(path.x, problem.x_lower, problem.x_upper),
                         size(np.vstack([path.ua, path.ub]), problem.u_lower, problem.u_upper),
                         float(np.exp2(np.round(np.log2(path.t[-1])))), 1.0)


class Guesser:
    """The initial guesses of the problems of one structure."""

    def __init__(self, problem: Problem, options: GuessOptions = DEFAULTS.guesses) -> None:
        self._options = options
        x, u, p = problem.x, problem.u, problem.p
        slope = ca.jacobian(problem.psi, x)
        self._curved = ca.depends_on(slope, x)
        self._psi = VectorizedFunction([x, p], [problem.psi, slope], 1)
        self._rest = VectorizedFunction([x, u, p], [
            problem.f, ca.jacobian(problem.f, u), ca.jacobian(problem.f, x),
            ca.jacobian(problem.L, u)], 1)
        self._all = VectorizedFunction([x, u, p], [ca.vertcat(problem.f, problem.L, problem.path)],
                                       1)
        z = ca.vertcat(x, u)
        self._linear = not ca.depends_on(ca.jacobian(problem.f, z), z)
        self._last: tuple[Problem, Array, NDArray[np.bool_]] | None = None
        self._last_line: tuple[Problem, float, Path] | None = None

    def final_state(self, problem: Problem) -> tuple[Array, NDArray[np.bool_]]:
        """
        Find a final state near x(0) by Newton's method on psi = 0.

        :return: x: (n,), within the bounds; psi(x) = 0 only if the iteration converged; fixed:
            (n,), components that psi fixes.
        """
        if self._last is None or self._last[0] is not problem:
            self._last = problem, *self._final_state(problem)
        return self._last[1].copy(), self._last[2]

    def _final_state(self, problem: Problem) -> tuple[Array, NDArray[np.bool_]]:
        x = problem.x0.copy()
        if problem.has_clock:
            x[problem.stated] = get_final_time(problem)
        fixed = np.zeros(problem.n, dtype=bool)
        if not problem.q:
            return np.clip(x, problem.x_lower, problem.x_upper), fixed
        before = inverse = np.zeros((problem.n, problem.q))
        for _ in range(30):
            psi, slope = (out[0] for out in self._psi(x, problem.p_value))
            jacobian = slope.reshape(problem.n, problem.q).T
            if not (np.all(np.isfinite(psi)) and np.all(np.isfinite(jacobian))):
                return problem.x0.copy(), fixed
            if not np.array_equal(jacobian, before):
                before, inverse = jacobian, np.linalg.pinv(jacobian, rcond=1e-8)
            move = -inverse @ psi
            if self._curved:   # the step ends where the norm of psi starts to grow
                part = np.linspace(0.0, 1.0, _POINTS)[:, None]
                along, _ = self._psi(x + part * move, problem.p_value)
                left = np.linalg.norm(along @ inverse.T, axis=1)
                grows = np.append(~(left[1:] <= left[:-1] * (1 + 1e-9)), True)
                move = part[max(1, int(np.argmax(grows)))] * move
            x = np.clip(x + move, problem.x_lower, problem.x_upper)
            if np.max(np.abs(move)) <= 1e-9 * (1 + np.max(np.abs(x))):
                break
        return x, np.diag(inverse @ jacobian) > 1 - 1e-6

    def steady_input(self, problem: Problem, x: Array) -> Array:
        """Return the input (m,) within bounds that minimises |f(x, u)|, from u = 0."""
        lower, upper = problem.u_lower, problem.u_upper
        u = np.clip(np.zeros(problem.m), lower, upper)
        both = problem.boxed
        nudge = np.where(both & (u == lower) | both & (u == upper),
                         1e-2 * (np.where(both, lower, 0) + np.where(both, upper, 0) - 2 * u), 0)
        u = u + nudge
        for _ in range(10):
            f, slope, *_ = (out[0] for out in self._rest(x, u, problem.p_value))
            if not (np.all(np.isfinite(f)) and np.all(np.isfinite(slope))):
                return u
            move = -np.linalg.pinv(slope.reshape(problem.m, problem.n).T, rcond=1e-6) @ f
            new = np.clip(u + move, lower, upper)
            if np.max(np.abs(new - u), initial=0.0) <= 1e-9 * (1 + np.max(np.abs(u), initial=0)):
                break
            u = new
        return u

    def periods(self, problem: Problem) -> Array:
        """Return the period (m,) of each input that is an angle with room for a turn, else inf."""
        periods = np.full(problem.m, np.inf)
        chance = np.random.default_rng(2)
        x = problem.x0 + 0.1 * (1 + np.abs(problem.x0)) * chance.uniform(-1, 1, problem.n)
        u = np.clip(chance.uniform(-1, 1, problem.m), problem.u_lower, problem.u_upper)
        here, = self._all(x, u, problem.p_value)
        room = problem.u_upper - problem.u_lower
        for i, turn in product(range(problem.m), _TURNS):
            if room[i] < turn or problem.inputs[i] in problem.guess.u:
                continue
            parts = np.eye(problem.m)[i] * turn * np.array([[0.3], [1.0], [-2.0]])
            apart = np.abs(self._all(x, u + parts, problem.p_value)[0] - here)
            same = np.all(apart <= 1e-9 * (1 + np.abs(here)), axis=1)
            if not same[0] and same[1:].all():
                periods[i] = turn
        return periods

    def sizes(self, problem: Problem, path: Path) -> ProblemScales:
        """Estimate scales from an initial guess, also of states that are constant on it."""
        found = estimate_scales(problem, path)
        points = len(path.ua)
        values, = self._all(path.x[:points], path.ua, problem.p_value)
        f, L = values[:, :problem.n], values[:, problem.n]
        moved = path.t[-1] * np.abs(f).max(axis=0)
        limits = np.abs([problem.x_lower, problem.x_upper])
        limit = np.where(np.isfinite(limits), limits, 0.0).max(axis=0)
        still = ~np.ptp(path.x, axis=0).astype(bool)
        if still.any():
            moved = np.maximum(moved, self._within_reach(problem, path, found.u))
        guessed = np.where(limit > 0, limit, moved)
        still &= np.isfinite(guessed) & (guessed > 0)
        still &= guessed > np.abs(path.x[0])
        found = replace(found, x=np.where(still, round_to_power(guessed), found.x))
        cost = float(path.t[-1] * np.abs(L).mean()) or self._beside(problem, path, found)
        return replace(found, cost=float(round_to_power(cost)) if 0 < cost < 1 else 1.0)

    def _within_reach(self, problem: Problem, path: Path, u_size: Array) -> Array:
        """
        Return the reach (n,) of each state by inputs of a size, from the linearisation at x(0).

        If the dynamics are linear this is the reach in T, or in the time of the fastest growth.
        Otherwise it is that in the time of the fastest mode, from powers of the linearisation, so
        that it scales with the units of the statement.
        """
        A, B = self._linearised(problem, path)
        B, T = B * u_size, float(path.t[-1])
        if not (np.all(np.isfinite(A)) and np.all(np.isfinite(B))):
            return np.zeros(problem.n)
        poles = np.linalg.eigvals(A)
        if self._linear:
            return bound_reach(A, B, T / (1 + T * poles.real.max(initial=0.0)))
        return bound_first_reach(A, B, T / (1 + T * np.abs(poles).max(initial=0.0)))

    def _linearised(self, problem: Problem, path: Path) -> tuple[Array, Array]:
        """Return the derivatives of f by x and by u at the start of a path, (n, n), (n, m)."""
        _, by_u, by_x, _ = (out[0] for out in self._rest(path.x[0], path.ua[0], problem.p_value))
        return by_x.reshape(problem.n, -1).T, by_u.reshape(problem.m, -1).T

    def is_stiff(self, problem: Problem, intervals: int) -> bool:
        """
        Return whether explicit steps amplify a decaying mode of linear dynamics.

        The modes of nonlinear dynamics depend on the path: False.
        """
        if not self._linear:
            return False
        T = get_final_time(problem)
        A, _ = self._linearised(problem, self.line(problem, T))
        if not np.all(np.isfinite(A)):
            return False
        z = np.linalg.eigvals(A).astype(np.complex128) * (T / intervals)
        grown = intervals * np.log(compute_amplification(z))
        return bool(np.any((z.real < 0) & (grown > 1.0)))

    def _beside(self, problem: Problem, path: Path, sizes: ProblemScales) -> float:
        """Return the cost at states and inputs of typical size, for a path on which L is 0."""
        n, start, steady = problem.n, path.x[0], path.ua[0]
        away = np.diag(np.concatenate([sizes.x, sizes.u]))
        away = np.vstack([away, -away])
        x = np.clip(start + away[:, :n], problem.x_lower, problem.x_upper)
        u = np.clip(steady + away[:, n:], problem.u_lower, problem.u_upper)
        L = self._all(x, u, problem.p_value)[0][:, n]
        cost = path.t[-1] * np.abs(L[np.isfinite(L)]).max(initial=0.0)
        cost_of = ca.Function('V', [problem.x, problem.p], [problem.V])
        V = cost_of(np.vstack([start, x]).T, problem.p_value).full()[0]
        return float(cost + np.abs(V - V[0])[np.isfinite(V)].max(initial=0.0))

    def line(self, problem: Problem, T: float) -> Path:
        """
        Return the straight line from x(0) to psi = 0 with steady inputs.

        The `initial_guess` of the problem replaces states and inputs that it contains.
        """
        last = self._last_line
        if last is None or last[0] is not problem or last[1] != T:
            last = self._last_line = problem, T, self._line(problem, T)
        return last[2]

    def rest(self, problem: Problem) -> Array:
        """Return the input (m,) at the start of the last line of a problem."""
        last = self._last_line
        path = (last[2] if last is not None and last[0] is problem
                else self.line(problem, get_final_time(problem)))
        return np.asarray(path.ua[0])

    def _line(self, problem: Problem, T: float) -> Path:
        end, _ = self.final_state(problem)
        s = np.linspace(0.0, 1.0, _POINTS)
        x = problem.x0 + s[:, None] * (end - problem.x0)
        if problem.has_clock:
            x[:, problem.stated] = T * s
        u = np.tile(self.steady_input(problem, (problem.x0 + end) / 2), (_POINTS, 1))
        for names, given, values in ((problem.states, problem.guess.x, x),
                                     (problem.inputs, problem.guess.u, u)):
            for name, column in given.items():
                column = np.atleast_1d(np.asarray(column, dtype=float))
                values[:, names.index(name)] = np.interp(
                    s, np.linspace(0.0, 1.0, len(column)), column)
        path = _path(T * s, x, np.clip(u, problem.u_lower, problem.u_upper))
        *_, slope = self._rest(x, u, problem.p_value)
        # At u = 0 the norm of the inputs, for example, is not differentiable.
        return path if np.isfinite(slope).all() else _path(
            T * s, x, self._along(problem, path, x))

    def driven(self, problem: Problem, integrator: CostateIntegrator, u: Array, T: float) -> Path:
        """Integrate under inputs u (21, m); states are frozen once they become very large."""
        t = np.linspace(0.0, T, _POINTS)
        u = np.clip(u, problem.u_lower, problem.u_upper)
        fine = np.linspace(0.0, T, 10 * (_POINTS - 1) + 1)
        inputs = interpolate_columns(fine, t, u)
        x, _ = integrator.forward(problem, fine, inputs[:-1], inputs[1:])
        x = x[::10]
        size = 1e3 * (1 + np.max(np.abs(problem.x0)))
        good = np.all(np.isfinite(x), axis=1) & (np.max(np.abs(x), axis=1) < size)
        last = int(np.argmin(good)) - 1 if not np.all(good) else len(x) - 1
        x = x[np.minimum(np.arange(_POINTS), last)]
        return _path(t, np.clip(x, problem.x_lower, problem.x_upper), u)

    def starts(self, problem: Problem, integrator: CostateIntegrator,
               spans: Callable[[], tuple[Array, Array] | None] = lambda: None) -> Iterator[Path]:
        """
        Yield initial guesses without end, the most promising first.

        These are the line, those of the `starts` of the problem, lines that are bent randomly, and
        paths integrated under the inputs of the line or random ones around them. If T is free, it
        is varied, too; a constant, such as a free parameter, is drawn from its bounds. `spans`
        returns the ranges of states (n,) and inputs (m,) on the paths found so far, which give the
        amplitudes, or None.
        """
        T = get_final_time(problem)
        line = self.line(problem, T)
        u = line.u
        chance = np.random.default_rng(1)
        span = problem.u_upper - problem.u_lower
        size = np.where(np.isfinite(span), span, 1 + np.abs(u[0]))
        lowest, highest = problem.start_box
        constant = np.isfinite(highest - lowest) & (highest > lowest) & [
            rate.is_zero() for rate in ca.vertsplit(problem.f)]
        given = bool(problem.guess.x or problem.guess.u)
        yield replace(line, origin='guess of the statement' if given else 'straight line')
        for k, guess in enumerate(problem.starts):
            other = replace(problem, guess=guess)
            yield replace(self.line(other, get_final_time(other)), origin=f'starts[{k}]')
        if given:   # it may be poor
            yield replace(self.line(replace(problem, guess=Guess()), T), origin='straight line')
        for number in count():
            length = T
            if number and problem.final_time.free:
                length = float(np.clip(T * 2.0 ** chance.uniform(-1, 1),
                                       problem.final_time.lower, problem.final_time.upper))
            known = spans()
            variety = _VARIETY if known is None or not problem.q else _BENT
            bends, noises = variety[number % len(variety)]
            bend, noise = bends * self._options.bend, noises * self._options.noise
            if known is not None:
                size = np.where(np.isfinite(span) | (known[1] == 0), size, known[1])
            inputs = u + noise * size * _wave(chance, problem.m, knots=True)
            if bend:
                far = self._sideways(problem, line) if known is None else np.maximum(
                    np.ptp(line.x, axis=0), known[0])
                x = line.x + bend * far * _wave(chance, problem.n, knots=False)
                x = np.where(constant, lowest + (highest - lowest) * _spread(number, problem.n), x)
                yield replace(_path(
                    line.t * (length / T), np.clip(x, problem.x_lower, problem.x_upper),
                    np.clip(inputs, problem.u_lower, problem.u_upper)), origin='bent line')
            elif noise or problem.final_time.free or number < len(_VARIETY):   # not the same again
                yield replace(self.driven(problem, integrator, inputs, length),
                              origin='path of random inputs' if noise else 'path of the inputs')

    def _sideways(self, problem: Problem, line: Path) -> Array:
        """Return the amplitude (n,) by which a line is bent if no path is known."""
        sizes, far = self.sizes(problem, line), np.ptp(line.x, axis=0)
        reach = self._within_reach(problem, line, sizes.u)
        moves = (far > 0) & (reach > 0)
        reach = reach * np.max(far[moves] / reach[moves]) if moves.any() else reach
        return np.where(far > 0, far, self._options.noise * np.where(reach > 0, reach, sizes.x))

    def scattered(self, problem: Problem, integrator: CostateIntegrator, starts: Iterator[Path],
                  cost: float) -> Iterator[Path]:
        """
        Yield lines to final states distributed evenly around x(0), as far as psi leaves them open.

        Each third one is of the other guesses `starts`. The cost of the best path limits the
        distance (`room`).
        """
        line = self.line(problem, get_final_time(problem))
        _, fixed = self.final_state(problem)
        room, _ = self.room(problem, integrator, cost)
        room[fixed] = 0.0
        part = np.linspace(0.0, 1.0, _POINTS)[:, None]
        for number in count(1):
            if room.any() and number % 3:
                away = room * (2 * _spread(number, problem.n) - 1)
                x = np.clip(line.x + part * away, problem.x_lower, problem.x_upper)
                yield replace(_path(line.t, x, self._along(problem, line, x)),
                              origin='line to another final state')
            else:
                yield next(starts)

    def room(self, problem: Problem, integrator: CostateIntegrator, cost: float) -> tuple[Array,
                                                                                          Array]:
        """
        Estimate the ranges of states and inputs of paths up to a cost.

        Each input alone is held at the values that cost as much, and the states are integrated.

        :return: x, u: (n,), (m,), distances from x(0), and from the steady input.
        """
        line = self.line(problem, get_final_time(problem))
        T, rest, found = float(line.t[-1]), line.ua[0], self.sizes(problem, line)
        cost = max(cost, found.cost)   # a path of almost no cost gives no range
        sizes = np.exp2(np.arange(-24, 24))[:, None]
        held = [rest]
        for way in np.vstack([np.eye(problem.m), -np.eye(problem.m)]):
            u = np.clip(rest + sizes * way, problem.u_lower, problem.u_upper)
            L = self._all(problem.x0, u, problem.p_value)[0][:, problem.n]
            dear = ~(T * np.abs(L - L[0]) <= cost)
            if dear.any() or np.array_equal(u[-1], u[-2]):   # else nothing bounds it
                held.append(u[max(0, int(np.argmax(np.append(dear, True))) - 1)])
        t = np.linspace(0.0, T, 10 * _POINTS)
        ends = np.array([integrator.forward(problem, t, tile, tile)[0][-1] for tile in (
            np.tile(u, (len(t) - 1, 1)) for u in held)])
        apart = np.abs(ends[1:] - ends[0])
        reach = np.max(np.where(np.isfinite(apart), apart, 0.0), axis=0, initial=0.0)
        # Final states are sought up to three times as far as held inputs lead.
        x, u = (3.0 * np.where(most > 0, most, size) for most, size in (
            (reach, found.x), (np.ptp(held, axis=0), found.u)))
        return x, u

    def _along(self, problem: Problem, line: Path, x: Array) -> Array:
        """Return inputs (21, m) near those of a line that fit dx/dt = f by least squares."""
        u = line.u
        f, slope, *_ = self._rest(x, u, problem.p_value)
        missing = np.gradient(x, line.t, axis=0) - f
        slope = slope.reshape(-1, problem.m, problem.n).swapaxes(1, 2)
        if not (np.all(np.isfinite(missing)) and np.all(np.isfinite(slope))):
            return u
        more = np.einsum('kmn,kn->km', np.linalg.pinv(slope, rcond=1e-6), missing)
        return np.asarray(np.clip(u + more, problem.u_lower, problem.u_upper))


# Multiples of the bend of states and of the noise of inputs, for guesses in turn; without a bend
# the states are integrated from the inputs.
_VARIETY = ((1, 0), (0, 0), (1, 0), (2, 0), (0, 1), (1, 1))
# The same once a path to prescribed final states is known: guesses integrated from inputs lead to
# no other one.
_BENT = ((1, 0), (1, 0), (1, 1), (1, 0), (0, 1), (2, 0))


def _spread(number: int, columns: int) -> Array:
    """Return a point of the Kronecker sequence with generalised golden ratios in the unit cube."""
    ratio = 2.0
    for _ in range(60):
        ratio = (1 + ratio) ** (1 / (columns + 1))
    return np.asarray((0.5 + number * ratio ** -np.arange(1.0, columns + 1)) % 1)


def _wave(chance: np.random.Generator, columns: int, *, knots: bool) -> Array:
    """Return smooth random columns on 21 points: by `knots`, else 0 at both ends."""
    s = np.linspace(0.0, 1.0, _POINTS)
    if knots:
        at = np.linspace(0.0, 1.0, 4)
        return np.column_stack([np.interp(s, at, chance.uniform(-0.5, 0.5, 4))
                                for _ in range(columns)])
    modes = np.sin(np.pi * s[:, None] * np.arange(1, 4))
    return np.asarray(modes @ chance.normal(size=(3, columns)))


def _path(t: Array, x: Array, u: Array) -> Path:
    return build_path(t, x, u[:-1], u[1:])


def join_whole_turns(path: Path, periods: Array) -> Path:
    """
    Make piecewise constant inputs that are angles linear and continuous, by removing whole turns.

    `periods` (m,): period of each input; inf: it is no angle.
    """
    u = path.ua.copy()
    for i in np.flatnonzero(np.isfinite(periods)):
        u[:, i] = np.unwrap(u[:, i], period=periods[i])
        u[:, i] -= periods[i] * np.round(np.mean(u[:, i]) / periods[i])
    nodes = np.vstack([u[:1], (u[1:] + u[:-1]) / 2, u[-1:]])
    return replace(path, ua=nodes[:-1], ub=nodes[1:])
