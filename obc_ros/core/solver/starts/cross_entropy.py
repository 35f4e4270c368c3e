# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Starts that obey the dynamics and end near the terminal constraints: the best of many inputs.

Where an end lies aside of every straight line, such as inside of a car's turning circle, a search
that starts from a line ends at paths that come no nearer from there. Inputs drawn at random lead
all around; those that come nearest are drawn around again (the cross-entropy method: R. Y.
Rubinstein, Methodol. Comput. Appl. Probab. 1, 1999).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice, pairwise, zip_longest
from typing import NamedTuple

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.transcription.local_minima import Familiar
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, Path
from obc_ros.core.solver.transcription.program import TranscriptionOutcome


class _Look(NamedTuple):
    """How many inputs are drawn, around how many again, how often; steps of Runge and Kutta."""

    drawn: int
    fittest: int
    generations: int
    steps: int


class RolloutEnd(NamedTuple):
    """A path, and how near to psi = 0 it ends."""

    gap: float
    path: Path


_LONG, _SHORT = _Look(384, 24, 5, 96), _Look(192, 12, 4, 48)

_SPANS = 4            # of free times, in each of which the nearest are drawn around again
_PIECES = 6           # of constant input in each
_LONGER = 8.0         # times the guess of a free T, and the least part of it
_SPREAD = 0.4         # of their range: how far around the best is drawn; less each time
_TYPICAL = 0.8        # of what is seen of a constraint, a quantile
_LIKE, _ON_WAY = 0.5, 8   # of how far all paths are apart: of those that are alike; points to see
_GLANCE = 32          # inputs drawn for a first look, where an end is prescribed
# Where none is: how many, of how many kinds of path, and how many around each of these, again.
_OPEN = (384, 4, 48), (1152, 8, 48)
_GENERATIONS, _AMONG = 2, 24  # how often; and so many times the kinds are looked at
_STEPS, _STRETCH = (5, 10, 20), 2.0   # steps for each piece; times a free T
_FINER, _AGREE = 4, 0.3   # times as many steps, to believe it; else there are to be more
_TRIED, _TRIED_MOST = 8, 16   # paths from which a search is started: while none led anywhere
_INTERVALS, _ITERATIONS = 32, 150
_NEARER = 3   # halvings of how far half of the inputs are drawn from rest
_CHEAP = 2    # before dearer ones, which come nearer to psi = 0
_VAIN = 3, 6  # in a row that led to nothing new, once there is an answer, and where it is bent


def start_from_rollouts(search: Bench, T: float) -> list[TranscriptionOutcome]:
    """Return outcomes to be believed from starts that inputs drawn at random lead to, if any."""
    problem = search.problem
    if search.quick or not problem.q or search.kit.twin:
        return []
    found: list[TranscriptionOutcome] = []
    search.familiar = Familiar()
    paths = iter(search_rollouts(problem, T))
    for path in islice(paths, _TRIED_MOST):
        tried = search.looked_from >= _TRIED and not found
        if tried or search.monitor.stopped or not search.monitor.allows(_INTERVALS):
            break
        search.looked_from += 1
        search.tried += 1
        usual = 2 * found[0].iterations if found else _ITERATIONS
        outcome = search.collocate(build_uniform_mesh(problem, _INTERVALS, search.stages), path,
                                   most=min(usual, _ITERATIONS), known=search.familiar)
        search.familiar.ended(outcome.objective, outcome.infeasibility,
                              outcome.path if outcome.converged else None)
        if search.believed(outcome):
            found.append(outcome)
    if found:   # where other starts led to nothing, others of these may lead to other minima
        search.intervals, search.starts = _INTERVALS, chain(paths, search.starts)
    return found


def interleave_rollouts(search: Bench, starts: Iterator[Path], seen: list[RolloutEnd],
                        rough: Callable[[], bool], bent: bool) -> Iterator[Path]:
    """
    Yield starts, each after a path to near psi = 0 that obeys the dynamics, and costs less if any.

    Such paths no more once some of them have led to minima that are known. `seen`: at a glance;
    `rough`: whether they are to be looked for longer, and dearer ones, too; `bent`: a little
    longer.
    """
    vain, known = 0, search.familiar.minima
    for start in _promising(search, seen, rough, bent):
        search.familiar.daring = True
        yield start
        search.familiar.daring = False
        vain, known = 0 if search.familiar.minima > known else vain + 1, search.familiar.minima
        yield next(starts)
        if vain == _VAIN[bent]:
            break
    yield from starts


def _promising(search: Bench, seen: list[RolloutEnd], rough: Callable[[], bool],
               bent: bool) -> Iterator[Path]:
    """Yield what was seen at a glance, and what a longer look shows where that is worth it."""
    yield from (each.path for each in seen[:1])
    if search.last is not None and search.problem.q and not search.kit.twin:
        problem, outcome = _within(search.problem, search.last.outcome.path), search.last.outcome
        T = outcome.path.t[-1]
        rest = search.kit.guesser.rest(search.problem)
        look = _LONG if rough() else _SHORT if bent else None
        if look:
            cheap = iter(search_rollouts(problem, T, outcome.objective, rest, look))
            yield from islice(cheap, _CHEAP)
            for pair in zip_longest(search_rollouts(problem, T, np.inf, rest, look), cheap):
                yield from filter(None, pair)
    yield from _unlike(seen)[1:]


def _within(problem: Problem, path: Path) -> Problem:
    """Return the problem with bounds on its inputs, where it has none twice as far as a path."""
    u = np.vstack([path.ua, path.ub])
    low, high, wide = u.min(axis=0), u.max(axis=0), np.ptp(u, axis=0)
    return replace(
        problem, u_lower=np.where(np.isfinite(problem.u_lower), problem.u_lower, low - wide),
        u_upper=np.where(np.isfinite(problem.u_upper), problem.u_upper, high + wide))


def search_rollouts_briefly(search: Bench, bent: bool) -> list[RolloutEnd]:
    """
    Return some of what `search_rollouts` looks for longer, of inputs at any distance from rest.

    They are in order.

    What costs less than the path found last is often near rest. Where no end is prescribed all
    paths lead somewhere: what lies behind the cheapest of each kind, where `bent` whatever it
    costs.
    """
    if search.last is None or search.kit.twin:
        return []
    problem, chance = _within(search.problem, search.last.outcome.path), np.random.default_rng(4)
    most, T = search.last.outcome.objective, float(search.last.outcome.path.t[-1])
    if problem.q:
        led = _Led(search, problem, _glanced(search, problem, T, chance, _GLANCE), _STEPS[0])
        return led.seen(most)
    seen = list[RolloutEnd]()
    for steps in _STEPS if bent else _STEPS[:1]:
        drawn = _glanced(search, problem, T, chance, _OPEN[bent][0])
        coarse = _drawn_again(search, problem, drawn, steps, chance, *_OPEN[bent][1:])
        if coarse is None:
            break
        # Coarse steps jump over poles, beyond which nothing costs much.
        led = _Led(search, problem, coarse.drawn, _FINER * steps)
        seen = led.seen(np.inf if bent else most)
        if led.agrees(coarse):
            break
    return seen


def _drawn_again(search: Bench, problem: Problem, drawn: '_Drawn', steps: int,
                 chance: np.random.Generator, kinds: int, children: int) -> '_Led | None':
    """Return what the best of each kind of path leads to, drawn around again; None if nothing."""
    led = _Led(search, problem, drawn, steps)
    best = led.kinds(kinds)
    for generation in range(_GENERATIONS):
        if not best.size:
            return None
        led = _Led(search, problem, led.drawn.around(
            problem, np.repeat(best, children), _SPREAD / 2**generation, chance), steps)
        best = led.best_of_each(children)
    return _Led(search, problem, led.drawn.only(best), steps) if best.size else None


def _glanced(search: Bench, problem: Problem, T: float, chance: np.random.Generator,
             count: int) -> '_Drawn':
    """Return inputs at any distance from rest; half of them at none where psi is open."""
    rest = _part_at(problem, search.kit.guesser.rest(search.problem))
    part = _parts(chance, count, problem.m)
    away = chance.uniform(0, 1, (count, 1, 1))
    if not problem.q:
        away[::2] = 1.0   # the cheapest often keep to bounds
    length, final = np.full(count, T), problem.final_time
    if final.free:
        length = np.clip(length * _STRETCH**chance.uniform(-1, 1, count), final.lower, final.upper)
    return _Drawn(rest + away * (part - rest), length)


class _Led:
    """What inputs lead to by the steps of a search: at what cost, and how far off."""

    def __init__(self, search: Bench, problem: Problem, drawn: '_Drawn', steps: int) -> None:
        self.drawn, integrator = drawn, search.kit.integrator
        self._u = np.repeat(_inputs(problem, drawn.part), steps, axis=1)
        self._t = drawn.length[:, None] * np.linspace(0.0, 1.0, steps * _PIECES + 1)
        self._x, running = integrator.forward_each(problem, self._t, self._u)
        V, psi = integrator.ends(problem, self._x[:, -1])
        sound = np.isfinite(self._x).all(axis=(1, 2)) & np.isfinite(psi).all(axis=1)
        self._cost = np.where(sound, running[:, -1] + V, np.inf)
        size = np.median(np.abs(psi[sound]), axis=0) if sound.any() else np.ones(problem.q)
        with np.errstate(invalid='ignore', over='ignore'):
            self.gap = _outside(problem, self._x)[:, -1] + (
                np.abs(psi) / np.where(size > 0, size, 1.0)).max(axis=1, initial=0.0)

    def order(self, most: float) -> Index:
        """Return which cost less than `most`: the nearest first, of these the cheapest."""
        cheaper = np.flatnonzero(self._cost < most)
        return cheaper[np.lexsort((self._cost[cheaper], self.gap[cheaper]))]

    def kinds(self, most: int) -> Index:
        """Return the cheapest of each kind of path, so many at most, among the cheapest."""
        order = self.order(np.inf)[:_AMONG * most]
        seen = [RolloutEnd(float(rank), self.path(k)) for rank, k in enumerate(order)]
        return np.array([order[int(each.gap)] for each, *_ in _alike(seen)[:most]], dtype=np.int64)

    def best_of_each(self, many: int) -> Index:
        """Return the cheapest of so many in turn, inside of the bounds of the state."""
        dear = np.where(self.gap > 0, np.inf, self._cost).reshape(-1, many)
        best = np.argmin(dear, axis=1) + many * np.arange(len(dear))
        return np.asarray(best[np.isfinite(dear.ravel()[best])])

    def agrees(self, other: '_Led') -> bool:
        """Return whether other steps lead to nearly the same, beside how far costs are apart."""
        with np.errstate(invalid='ignore'):   # of costs without end
            error = np.nan_to_num(np.abs(self._cost - other._cost), nan=np.inf)
            return bool(np.median(error) <= _AGREE * np.nan_to_num(np.ptp(self._cost)))

    def seen(self, most: float) -> list[RolloutEnd]:
        """Return the paths that cost less than `most`, in order."""
        return [RolloutEnd(float(self.gap[k]), self.path(k)) for k in self.order(most)]

    def path(self, k: int) -> Path:
        """Return the path under one of the inputs."""
        none = np.zeros((self._u.shape[1], 0, self._x.shape[2]))
        return Path(self._t[k], self._x[k], none, self._u[k], self._u[k], self._t[k, -1:])


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Inputs (K, pieces, m), as parts of their range, and for how long they are held, (K,)."""

    part: Array
    length: Array

    def only(self, rows: Index) -> '_Drawn':
        """Return some of the inputs."""
        return _Drawn(self.part[rows], self.length[rows])

    def around(self, problem: Problem, rows: Index, width: float,
               chance: np.random.Generator) -> '_Drawn':
        """Return inputs drawn around those of these rows, for other times where T is free."""
        final = problem.final_time
        noise = width * chance.normal(size=(len(rows), *self.part.shape[1:]))
        length = self.length[rows]
        if final.free:
            longer = np.exp(width * chance.normal(size=len(rows)))
            length = np.clip(length * longer, final.lower, final.upper)
        return _Drawn(np.clip(self.part[rows] + noise, 0, 1), length)


def search_rollouts(problem: Problem, T: float, most: float = np.inf, rest: Array | None = None,
                    look: _Look = _LONG) -> list[Path]:
    """
    Return paths that obey the dynamics from x(0) on and end near psi = 0, at a cost below `most`.

    In turn the nearest of those that cost about the same. `rest`: inputs that cost little, around
    which they are drawn at any distance.
    """
    final, count = problem.final_time, look.drawn
    chance = np.random.default_rng(4)
    if final.free:
        shortest, longest = np.clip([T / _LONGER, T * _LONGER], final.lower, final.upper)
        spans = np.geomspace(shortest, longest * (1 + 1e-9), _SPANS + 1)
    else:
        shortest, longest, spans = T, T, np.array([T * (1 - 1e-9), np.inf])
    part = _parts(chance, count, problem.m)
    if rest is not None:
        still = _part_at(problem, rest)
        away = np.where(np.arange(count) % 4 < 2, 2.0 ** -chance.uniform(0, _NEARER, count), 1.0)
        part = still + away[:, None, None] * (part - still)
    drawn = _Drawn(part, np.exp(
        chance.uniform(np.log(shortest), np.log(longest), count)))
    rolled_out = _Rollouts(problem, spans, most, look.steps)
    kept: list[RolloutEnd] = []
    for generation in range(look.generations):
        ends, path = rolled_out(drawn)
        best = [end for span in ends for end in sorted(span)[:look.fittest // len(ends)]
                if np.isfinite(end.gap + end.cost) and end.step > 1]
        if not best:
            break
        kept += [RolloutEnd(end.gap, path(end)) for end in best]
        parents = [best[i] for i in chance.integers(0, len(best), count)]
        k, step = np.array([(end.number, end.step) for end in parents]).T
        used = step / look.steps if final.free else np.ones(count)
        # Over as long as it took, the pieces that were held then.
        middle = (used[:, None] * (np.arange(_PIECES) + 0.5)).astype(np.int64)
        width = _SPREAD / 2**generation
        drawn = _Drawn(
            np.clip(drawn.part[k[:, None], middle] + width * chance.normal(size=part.shape), 0, 1),
            np.clip(drawn.length[k] * used * np.exp(width * chance.normal(size=count)),
                    shortest, longest))
    return _unlike(kept)


def _unlike(kept: list[RolloutEnd]) -> list[Path]:
    """Return paths, in turn the nearest of those that go the same way."""
    return [each.path for turn in zip_longest(*_alike(kept)) for each in turn if each is not None]


def _alike(kept: list[RolloutEnd]) -> list[list[RolloutEnd]]:
    """Return paths parted by the way they go, the nearest first."""
    kept = sorted(kept, key=lambda each: each.gap)
    alike: list[list[RolloutEnd]] = []
    if not kept:
        return alike
    way = np.stack([_way(path) for _, path in kept])
    left = np.arange(len(way))
    with np.errstate(over='ignore', invalid='ignore'):   # of paths that went far
        way /= np.maximum(way.std(axis=0).max(axis=0), 1e-300)
        way = way.reshape(len(way), -1)
        while left.size:   # the nearest that is left, and all like it
            near = np.mean((way[left] - way[left[0]])**2, axis=1) < _LIKE**2
            near[0] = True
            alike.append([kept[k] for k in left[near]])
            left = left[~near]
    return alike


def _way(path: Path) -> Array:
    """Return states on the way, and how long it takes, (8, n + 1)."""
    last = len(path.x) - 1
    way = np.full((_ON_WAY, path.x.shape[1] + 1), np.log(path.t[-1]))
    way[:, :-1] = path.x[[last * k // _ON_WAY for k in range(1, _ON_WAY + 1)]]
    return way


class _End(NamedTuple):
    """Where a path may end: how near to psi = 0, after what cost, which path, at which step."""

    gap: float
    cost: float
    number: int
    step: int


class _Rollouts:
    """What inputs lead to: where in each span of time paths come nearest to psi = 0."""

    def __init__(self, problem: Problem, spans: Array, most: float, steps: int) -> None:
        self._problem, self._spans, self._most, self._steps = problem, spans, most, steps
        self._rate = VectorizedFunction([problem.x, problem.u, problem.p], [problem.f, problem.L])
        self._ends = VectorizedFunction([problem.x, problem.p], [problem.psi, problem.V])
        self._size: Array | None = None

    def __call__(self, drawn: _Drawn) -> tuple[list[list[_End]], Callable[[_End], Path]]:
        """Return for each span of time the nearest end of each path, and what returns paths."""
        problem = self._problem
        u = _inputs(problem, drawn.part)
        x, L = _rolled_out(problem, self._rate, u, drawn.length, self._steps)
        t = drawn.length[:, None] * np.linspace(0.0, 1.0, self._steps + 1)
        ends, V = (values.reshape(*x.shape[:2], -1) for values in self._ends(
            x.reshape(-1, problem.n), problem.p_value))
        with np.errstate(invalid='ignore', over='ignore'):
            if self._size is None:
                seen = np.where(np.isfinite(ends), np.abs(ends), np.nan)
                size = np.nanquantile(seen, _TYPICAL, axis=(0, 1))
                self._size = np.where(size > 0, size, 1.0)
            gap = np.abs(ends / self._size).max(axis=2) + _outside(problem, x)
            cost = L + V[:, :, 0]
            gap = np.where(np.isfinite(gap) & (cost < self._most), gap, np.inf)
        found, each = [], np.arange(len(t))
        for begin, end in pairwise(self._spans):
            inside = np.where((t >= begin) & (t < end), gap, np.inf)
            step = np.argmin(inside, axis=1)
            found.append([_End(*row) for row in zip(
                inside[each, step].tolist(), cost[each, step].tolist(), each.tolist(),
                step.tolist(), strict=True)])
        return found, lambda end: _path(t[end.number], x[end.number], u[end.number], end.step)


def _parts(chance: np.random.Generator, count: int, m: int) -> Array:
    """Return inputs drawn as parts of their range, (count, pieces, m): half at ends or middle."""
    part = chance.choice([0.0, 0.5, 1.0], (count, _PIECES, m))
    part[::2] = chance.uniform(0, 1, part[::2].shape)
    return part


def _inputs(problem: Problem, part: Array) -> Array:
    """Return inputs (K, pieces, m) of their parts of a range: of the bounds, if there are any."""
    middle = np.clip(np.zeros(problem.m), problem.u_lower, problem.u_upper)
    lower = np.where(np.isfinite(problem.u_lower), problem.u_lower, middle - 2.0)
    upper = np.where(np.isfinite(problem.u_upper), problem.u_upper, middle + 2.0)
    return np.asarray(lower + (upper - lower) * part)


def _part_at(problem: Problem, u: Array) -> Array:
    """Return an input (m,) as part of its range."""
    lower, upper = _inputs(problem, np.array([[0.0], [1.0]]))
    return np.asarray((u - lower) / np.where(upper > lower, upper - lower, 1.0))


def _rolled_out(problem: Problem, rate: VectorizedFunction, u: Array, length: Array,
                steps: int) -> tuple[Array, Array]:
    """Return states (K, steps + 1, n) and the running cost under inputs held in turn."""
    h = length[:, None] / steps
    z = np.column_stack([np.tile(problem.x0, (len(u), 1)), np.zeros(len(u))])
    path, n = [z], problem.n
    with np.errstate(all='ignore'):
        for k in np.arange(steps) * u.shape[1] // steps:
            held, p = u[:, k], problem.p_value
            a = np.hstack(rate(z[:, :n], held, p))
            b = np.hstack(rate((z + h / 2 * a)[:, :n], held, p))
            c = np.hstack(rate((z + h / 2 * b)[:, :n], held, p))
            d = np.hstack(rate((z + h * c)[:, :n], held, p))
            z = z + h / 6 * (a + 2 * b + 2 * c + d)
            path.append(z)
    both = np.stack(path, axis=1)
    return both[:, :, :n], both[:, :, n]


def _outside(problem: Problem, x: Array) -> Array:
    """Return by how much paths have left the bounds of the state, (K, steps + 1), up to then."""
    room = problem.x_upper - problem.x_lower
    room = np.where(np.isfinite(room) & (room > 0), room, 1 + np.abs(problem.x0))
    over = np.maximum(problem.x_lower - x, x - problem.x_upper) / room
    return np.asarray(np.maximum.accumulate(np.maximum(over, 0.0).max(axis=2), axis=1))


def _path(t: Array, x: Array, u: Array, last: int) -> Path:
    """Return the part of a path up to a step."""
    steps = len(t) - 1
    held = u[np.arange(steps) * len(u) // steps][:last]
    return Path(t[:last + 1], x[:last + 1], np.zeros((last, 0, x.shape[1])), held, held,
                t[last:last + 1])
