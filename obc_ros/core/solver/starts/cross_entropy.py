# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Cross-entropy starts: rollouts of random inputs that end near the terminal constraints.

A descent from a straight line may fail, for example if the target is inside the turning circle of
a car. Here random inputs are integrated, and those that end nearest to psi = 0 are the centres of
the next generation (the cross-entropy method: R. Y. Rubinstein, Methodol. Comput. Appl. Probab. 1,
1999).

The module is long because its generations and its quick and thorough searches share one sampler.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice, pairwise, zip_longest
from typing import NamedTuple

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.least_time_form import get_final_time
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.adjoint.costates import CostateIntegrator
from obc_ros.core.solver.bench import Bench, Candidate
from obc_ros.core.solver.options import DEFAULTS, Options, RolloutOptions
from obc_ros.core.solver.starts.start import Known, Proposal, StartPool
from obc_ros.core.solver.trace import GUESS
from obc_ros.core.solver.transcription.mesh import (
    build_path,
    build_uniform_mesh,
    label_paths,
    Path,
)
from obc_ros.core.solver.transcription.program import SolveEffort, TranscriptionOutcome


class _Look(NamedTuple):
    """Effort of a search: samples, parents, generations, Runge-Kutta steps of a rollout."""

    drawn: int
    fittest: int
    generations: int
    steps: int


def _choose_effort(options: RolloutOptions, *, short: bool) -> _Look:
    """Return the effort of a long or a short search; one of 16 samples becomes a parent."""
    part = 2 if short else 1
    return _Look(options.samples // part, options.samples // (16 * part),
                 options.generations - short, options.pieces * options.steps // part)


def ends_at_target(bench: Bench, _: Known) -> bool:
    """Return whether there are terminal constraints, at which rollouts can end."""
    return bool(bench.problem.q) and not bench.quick and not bench.programs.twin


def start_from_rollouts(bench: Bench, pool: StartPool, _: Known) -> Proposal:
    """
    Solve from rollouts; propose the outcomes with a small discretisation error.

    The remaining rollouts, which may lead to other minima, are proposed with them.
    """
    problem = bench.problem
    found: list[TranscriptionOutcome] = []
    pool.forget()
    options, intervals = bench.options.rollouts, 2 * bench.options.coarse.intervals
    most = bench.options.coarse.iterations
    paths = label_paths(search_rollouts(
        problem, bench.programs.integrator, get_final_time(problem), settings=bench.options),
        'cross-entropy rollout')
    for number, path in enumerate(islice(paths, 2 * options.tried)):   # some more after a path
        vain = number >= options.tried and not found
        if vain or bench.meter.stopped or not bench.meter.allows(intervals):
            break
        usual = 2 * found[0].iterations if found else most
        with bench.trace.attempt(GUESS, path.origin) as attempt:
            outcome = bench.collocate(
                build_uniform_mesh(problem, intervals, bench.stages), path,
                effort=SolveEffort(min(usual, most), known=pool.known_minima))
            pool.known_minima.record_end(
                outcome.objective, outcome.infeasibility,
                outcome.path if outcome.converged else None)
            attempt.end(*outcome.judge(), cost=outcome.objective)
        if bench.is_accurate(outcome):
            found.append(outcome)
    why = f'{len(found)} rollouts led to a path with a small discretisation error'
    return Proposal(tuple(found), rest=chain(paths, pool.rest) if found else None, why=why)


def may_interleave(bench: Bench, known: Known) -> bool:
    """Return whether rollouts are used in multistart."""
    return known.best is not None and known.best.record is not None and not (
        bench.programs.twin or known.uneven and bench.problem.q)


def interleave_rollouts(bench: Bench, pool: StartPool, known: Known) -> Proposal:
    """
    Propose rollouts between the initial guesses of a pool, in turn.

    Rollouts end once some in a row led to no new minimum. A long search is made, for expensive
    rollouts, too, after much work or if coarse solves fail; a short one if the dynamics are bent.
    """
    assert known.best is not None
    seen = search_rollouts_briefly(bench, known.best, known.bent or known.uneven)
    aside = bench.whole.effort - known.begun
    rollouts = _promising(
        bench, known.best, seen, lambda: bench.whole.effort - aside > bench.options.multistart.hard
        or pool.is_rough(bench), known.bent)
    patience = (2 if known.bent else 1) * bench.options.multistart.after
    return Proposal(rest=_interleave(pool, pool.rest, label_paths(
        rollouts, 'cross-entropy rollout'), patience), wanted=bool(seen))


def _interleave(pool: StartPool, starts: Iterator[Path], rollouts: Iterator[Path],
                patience: int) -> Iterator[Path]:
    """Yield rollouts and starts in turn, then starts only."""
    vain, known = 0, pool.known_minima.minima
    for start in rollouts:
        yield replace(start, rollout=True)
        vain, known = 0 if pool.known_minima.minima > known else vain + 1, pool.known_minima.minima
        yield next(starts)
        if vain == patience:
            break
    yield from starts


def _promising(bench: Bench, last: Candidate, seen: list[Path], rough: Callable[[], bool],
               bent: bool) -> Iterator[Path]:
    """Yield rollouts of the brief search, and of a longer one if that is worth it."""
    yield from seen[:1]
    if last.record is not None and bench.problem.q and not bench.programs.twin:
        outcome = last.record.outcome
        problem, T = _within(bench.problem, outcome.path), outcome.path.t[-1]
        rest = bench.programs.guesser.rest(bench.problem)
        short = not rough()
        if bent or not short:
            search = partial(search_rollouts, problem, bench.programs.integrator, T, rest=rest,
                             short=short, settings=bench.options)
            for pair in zip_longest(search(outcome.objective), search()):
                yield from filter(None, pair)
    yield from seen[1:]


def _within(problem: Problem, path: Path) -> Problem:
    """Return the problem with missing input bounds set one range beyond those of a path."""
    u = np.vstack([path.ua, path.ub])
    low, high, wide = u.min(axis=0), u.max(axis=0), np.ptp(u, axis=0)
    return replace(
        problem, u_lower=np.where(np.isfinite(problem.u_lower), problem.u_lower, low - wide),
        u_upper=np.where(np.isfinite(problem.u_upper), problem.u_upper, high + wide))


def search_rollouts_briefly(bench: Bench, last: Candidate, bent: bool) -> list[Path]:
    """
    Return rollouts of a brief search, in order of distance from psi = 0 and of cost.

    Inputs are drawn at any distance from rest, near which cheaper paths often are. Without
    terminal constraints the cheapest rollouts are refined. Only those cheaper than the last
    outcome are returned, unless there are no terminal constraints and `bent` is set.
    """
    if last.record is None or bench.programs.twin:
        return []
    outcome, chance = last.record.outcome, np.random.default_rng(4)
    samples, brief = bench.options.rollouts.samples, 5   # `brief`: steps of each piece
    problem, most, T = _within(bench.problem, outcome.path), outcome.objective, outcome.path.t[-1]
    if problem.q:
        drawn = _glanced(bench, problem, T, chance, count=32)   # a glance
        return _Led(bench, problem, drawn, brief).seen(most)
    seen = list[Path]()
    for finer in (1, 2, 4) if bent else (1,):
        drawn = _glanced(bench, problem, T, chance, (3 if bent else 1) * samples)
        steps = finer * brief
        coarse = _drawn_again(bench, problem, drawn, steps, chance, parents=4 * (1 + bent))
        if coarse is None:
            break
        # Coarse steps may jump over a pole of f to states of low cost: finer ones confirm it.
        led = _Led(bench, problem, coarse.drawn, 4 * steps)
        seen = led.seen(np.inf if bent else most)
        if led.agrees(coarse):
            break
    return seen


def _drawn_again(bench: Bench, problem: Problem, drawn: '_Drawn', steps: int,
                 chance: np.random.Generator, parents: int) -> '_Led | None':
    """Return the best rollouts around each of the cheapest ones; None without any."""
    options, children = bench.options.rollouts, 48   # of each parent
    led = _Led(bench, problem, drawn, steps)
    best = led.order(np.inf)[:parents]
    for generation in range(options.generations // 2):
        if not best.size:
            return None
        led = _Led(bench, problem, led.drawn.around(
            problem, np.repeat(best, children), options.spread / 2**generation, chance), steps)
        best = led.best_of_each(children)
    return _Led(bench, problem, led.drawn.only(best), steps) if best.size else None


def _glanced(bench: Bench, problem: Problem, T: float, chance: np.random.Generator,
             count: int) -> '_Drawn':
    """Return random inputs, at a random distance from rest; half not moved to rest without psi."""
    rest = _part_at(problem, bench.programs.guesser.rest(bench.problem))
    part = _parts(chance, (count, bench.options.rollouts.pieces, problem.m))
    away = chance.uniform(0, 1, (count, 1, 1))
    if not problem.q:
        away[::2] = 1.0   # the cheapest inputs are often at bounds
    length, final = np.full(count, T), problem.final_time
    if final.free:
        length = np.clip(length * 2.0**chance.uniform(-1, 1, count), final.lower, final.upper)
    return _Drawn(rest + away * (part - rest), length)


class _Led:
    """Rollouts by the integrator of the driver, with costs and distances from psi = 0."""

    def __init__(self, bench: Bench, problem: Problem, drawn: '_Drawn', steps: int) -> None:
        self.drawn, integrator = drawn, bench.programs.integrator
        pieces = drawn.part.shape[1]
        self._u = np.repeat(_inputs(problem, drawn.part), steps, axis=1)
        self._t = drawn.length[:, None] * np.linspace(0.0, 1.0, steps * pieces + 1)
        self._x, running = integrator.forward_each(problem, self._t, self._u)
        V, psi = integrator.ends(problem, self._x[:, -1])
        sound = np.isfinite(self._x).all(axis=(1, 2)) & np.isfinite(psi).all(axis=1)
        self._cost = np.where(sound, running[:, -1] + V, np.inf)
        size = np.median(np.abs(psi[sound]), axis=0) if sound.any() else np.ones(problem.q)
        with np.errstate(invalid='ignore', over='ignore'):
            self.gap = _outside(problem, self._x)[:, -1] + (
                np.abs(psi) / np.where(size > 0, size, 1.0)).max(axis=1, initial=0.0)

    def order(self, most: float) -> Index:
        """Return the rollouts cheaper than `most`, ordered by distance from psi = 0, then cost."""
        cheaper = np.flatnonzero(self._cost < most)
        return cheaper[np.lexsort((self._cost[cheaper], self.gap[cheaper]))]

    def best_of_each(self, many: int) -> Index:
        """Return the cheapest of each `many` rollouts in a row, if within the state bounds."""
        dear = np.where(self.gap > 0, np.inf, self._cost).reshape(-1, many)
        best = np.argmin(dear, axis=1) + many * np.arange(len(dear))
        return np.asarray(best[np.isfinite(dear.ravel()[best])])

    def agrees(self, other: '_Led') -> bool:
        """Return whether costs with other steps agree, relative to the range of costs."""
        with np.errstate(invalid='ignore'):   # of infinite costs
            error = np.nan_to_num(np.abs(self._cost - other._cost), nan=np.inf)
            return bool(np.median(error) <= 0.3 * np.nan_to_num(np.ptp(self._cost)))

    def seen(self, most: float) -> list[Path]:
        """Return the rollouts cheaper than `most`, in order."""
        return [self.path(k) for k in self.order(most)]

    def path(self, k: int) -> Path:
        """Return the path of a rollout."""
        return build_path(self._t[k], self._x[k], self._u[k], self._u[k])


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Inputs (K, pieces, m), as parts of their range, and final times (K,) [s]."""

    part: Array
    length: Array

    def only(self, rows: Index) -> '_Drawn':
        """Return some of the inputs."""
        return _Drawn(self.part[rows], self.length[rows])

    def around(self, problem: Problem, rows: Index, width: float,
               chance: np.random.Generator) -> '_Drawn':
        """Return inputs drawn around those of some rows, with other final times if T is free."""
        final = problem.final_time
        noise = width * chance.normal(size=(len(rows), *self.part.shape[1:]))
        length = self.length[rows]
        if final.free:
            longer = np.exp(width * chance.normal(size=len(rows)))
            length = np.clip(length * longer, final.lower, final.upper)
        return _Drawn(np.clip(self.part[rows] + noise, 0, 1), length)


def search_rollouts(problem: Problem, integrator: CostateIntegrator, T: float,
                    most: float = np.inf, rest: Array | None = None, *, short: bool = False,
                    settings: Options = DEFAULTS) -> list[Path]:
    """
    Search for rollouts that end near psi = 0, by the cross-entropy method.

    :param problem, integrator: with terminal constraints; steps of its structure.
    :param T: final time, or the guess of a free one [s].
    :param most: maximum cost.
    :param rest: (m,), optional, input of low cost: half of the samples are near it.
    :param short: with less effort.
    :param settings: of the search.
    :return: the nearest to psi = 0 first.
    """
    options, far = settings.rollouts, settings.windows.reach
    look = _choose_effort(options, short=short)
    final, count = problem.final_time, look.drawn
    chance = np.random.default_rng(4)
    if final.free:
        shortest, longest = np.clip([T / far, T * far], final.lower, final.upper)
        spans = np.geomspace(shortest, longest * (1 + 1e-9), 5)   # four, with parents of their own
    else:
        shortest, longest, spans = T, T, np.array([T * (1 - 1e-9), np.inf])
    part = _parts(chance, (count, options.pieces, problem.m))
    if rest is not None:
        still = _part_at(problem, rest)
        away = np.where(np.arange(count) % 4 < 2, far ** -chance.uniform(0, 1, count), 1.0)
        part = still + away[:, None, None] * (part - still)
    drawn = _Drawn(part, np.exp(
        chance.uniform(np.log(shortest), np.log(longest), count)))
    rolled_out = _Rollouts(problem, integrator, spans, most, look.steps)
    kept: list[tuple[float, Path]] = []
    for generation in range(look.generations):
        ends, path = rolled_out(drawn)
        best = [end for span in ends for end in sorted(span)[:look.fittest // len(ends)]
                if np.isfinite(end.gap + end.cost) and end.step > 1]
        if not best:
            break
        kept += [(end.gap, path(end)) for end in best]
        parents = [best[i] for i in chance.integers(0, len(best), count)]
        k, step = np.array([(end.number, end.step) for end in parents]).T
        used = step / look.steps if final.free else np.ones(count)
        # The pieces that were used up to the end of the parent, over its final time.
        middle = (used[:, None] * (np.arange(options.pieces) + 0.5)).astype(np.int64)
        width = options.spread / 2**generation
        drawn = _Drawn(
            np.clip(drawn.part[k[:, None], middle] + width * chance.normal(size=part.shape), 0, 1),
            np.clip(drawn.length[k] * used * np.exp(width * chance.normal(size=count)),
                    shortest, longest))
    return [end for _, end in sorted(kept, key=lambda each: each[0])]


class _End(NamedTuple):
    """A possible end of a path: distance from psi = 0, cost so far, path and step."""

    gap: float
    cost: float
    number: int
    step: int


class _Rollouts:
    """Rollouts of inputs, each ended in each window of time where it is nearest to psi = 0."""

    def __init__(self, problem: Problem, integrator: CostateIntegrator, spans: Array, most: float,
                 steps: int) -> None:
        self._problem, self._spans, self._most, self._steps = problem, spans, most, steps
        self._integrator = integrator
        self._size: Array | None = None

    def __call__(self, drawn: _Drawn) -> tuple[list[list[_End]], Callable[[_End], Path]]:
        """Return for each window the best end of each rollout, and a function to its path."""
        problem, steps = self._problem, self._steps
        u = _inputs(problem, drawn.part)
        u = u[:, np.arange(steps) * u.shape[1] // steps]
        t = drawn.length[:, None] * np.linspace(0.0, 1.0, steps + 1)
        with np.errstate(invalid='ignore', over='ignore'):
            x, L = self._integrator.forward_each(problem, t, u)
            V, ends = (values.reshape(*x.shape[:2], *values.shape[1:]) for values in (
                self._integrator.ends(problem, x.reshape(-1, problem.n))))
            if self._size is None:
                seen = np.where(np.isfinite(ends), np.abs(ends), np.nan)
                size = np.nanquantile(seen, 0.8, axis=(0, 1))   # without the farthest rollouts
                self._size = np.where(size > 0, size, 1.0)
            gap = np.abs(ends / self._size).max(axis=2) + _outside(problem, x)
            cost = L + V
            gap = np.where(np.isfinite(gap) & (cost < self._most), gap, np.inf)
        found, each = [], np.arange(len(t))
        for begin, end in pairwise(self._spans):
            inside = np.where((t >= begin) & (t < end), gap, np.inf)
            step = np.argmin(inside, axis=1)
            found.append([_End(*row) for row in zip(
                inside[each, step].tolist(), cost[each, step].tolist(), each.tolist(),
                step.tolist(), strict=True)])

        def path(end: _End) -> Path:
            k, last = end.number, end.step
            return build_path(t[k, :last + 1], x[k, :last + 1], u[k, :last], u[k, :last])

        return found, path


def _parts(chance: np.random.Generator, shape: tuple[int, int, int]) -> Array:
    """Return random parts of ranges, (count, pieces, m); half of them 0, 1/2 or 1."""
    part = chance.choice([0.0, 0.5, 1.0], shape)
    part[::2] = chance.uniform(0, 1, part[::2].shape)
    return part


def _inputs(problem: Problem, part: Array) -> Array:
    """Return inputs (K, pieces, m) from parts of their range, which is that of their bounds."""
    middle = np.clip(np.zeros(problem.m), problem.u_lower, problem.u_upper)
    lower = np.where(np.isfinite(problem.u_lower), problem.u_lower, middle - 2.0)
    upper = np.where(np.isfinite(problem.u_upper), problem.u_upper, middle + 2.0)
    return np.asarray(lower + (upper - lower) * part)


def _part_at(problem: Problem, u: Array) -> Array:
    """Return an input (m,) as part of its range."""
    lower, upper = _inputs(problem, np.array([[0.0], [1.0]]))
    return np.asarray((u - lower) / np.where(upper > lower, upper - lower, 1.0))


def _outside(problem: Problem, x: Array) -> Array:
    """Return the largest relative violation of state bounds so far, (K, steps + 1)."""
    room = problem.x_upper - problem.x_lower
    room = np.where(np.isfinite(room) & (room > 0), room, 1 + np.abs(problem.x0))
    over = np.maximum(problem.x_lower - x, x - problem.x_upper) / room
    return np.asarray(np.maximum.accumulate(np.maximum(over, 0.0).max(axis=2), axis=1))
