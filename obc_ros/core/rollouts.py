# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Starts that obey the dynamics and end near the terminal constraints: the best of many inputs.

Where an end lies aside of every straight line, such as inside of a car's turning circle, a search
that starts from a line ends at paths that come no nearer from there. Inputs drawn at random lead
all around; those that come nearest are drawn around again (the cross-entropy method: R. Y.
Rubinstein, Methodol. Comput. Appl. Probab. 1, 1999).
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.batch import Batch
from obc_ros.core.familiar import Familiar
from obc_ros.core.mesh import Path, uniform
from obc_ros.core.problem import Problem
from obc_ros.core.transcription import Outcome

if TYPE_CHECKING:
    from obc_ros.core.search import Search

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_DRAWN, _BEST, _GENERATIONS = 384, 24, 5   # inputs drawn, drawn around again, how often
_KEPT = 6             # paths of each generation
_PIECES = 6           # of constant input in each
_STEPS = 96           # of Runge and Kutta
_LONGER = 8.0         # times the guess of a free T, and the least part of it
_SPREAD = 0.4         # of their range: how far around the best is drawn; less each time
_TYPICAL = 0.8        # of what is seen of a constraint, a quantile
_NEAR, _LIKE = 0.1, 0.03   # relative: gaps that are near, costs of paths that are alike
_TRIED, _TRIED_MOST = 8, 16   # paths from which a search is started: while none led anywhere
_INTERVALS, _ITERATIONS = 32, 150


def from_rollouts(search: 'Search', T: float) -> list[Outcome]:
    """Return outcomes to be believed from starts that inputs drawn at random lead to, if any."""
    problem = search.problem
    if search.quick or not problem.q or search.kit.twin:
        return []
    found: list[Outcome] = []
    search.familiar = Familiar()
    paths = iter(nearest(problem, T))
    for path in islice(paths, _TRIED_MOST):
        tried = search.looked_from >= _TRIED and not found
        if tried or search.monitor.stopped or not search.monitor.allows(_INTERVALS):
            break
        search.looked_from += 1
        usual = 2 * found[0].iterations if found else _ITERATIONS
        outcome = search.collocate(uniform(problem, _INTERVALS, search.stages), path,
                                   most=min(usual, _ITERATIONS), known=search.familiar)
        search.familiar.ended(outcome.objective, outcome.infeasibility, outcome.converged)
        if search.believed(outcome):
            found.append(outcome)
    if found:   # where other starts led to nothing, others of these may lead to other minima
        search.intervals, search.starts = _INTERVALS, chain(paths, search.starts)
    return found


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Inputs (K, pieces, m), as parts of their range, and for how long they are held, (K,)."""

    part: Array
    length: Array


def nearest(problem: Problem, T: float) -> list[Path]:
    """
    Return paths that obey the dynamics from x(0) on and end near psi = 0.

    Of those that end nearest the cheaper ones come first, unlike each other.
    """
    final = problem.final_time
    chance = np.random.default_rng(4)
    least, most = (np.clip([T / _LONGER, T * _LONGER], final.lower, final.upper) if final.free
                   else (T, T))
    shape = _DRAWN, _PIECES, problem.m
    part = chance.choice([0.0, 0.5, 1.0], shape)
    part[::2] = chance.uniform(0, 1, part[::2].shape)
    drawn = _Drawn(part, np.exp(chance.uniform(np.log(least), np.log(most), _DRAWN)))
    rolled_out = _Rollouts(problem)
    kept: list[tuple[float, float, Path]] = []
    for generation in range(_GENERATIONS):
        gap, last, cost, paths = rolled_out(drawn)
        order = np.argsort(gap)[:_BEST]
        kept += [(gap[k], cost[k], paths(k)) for k in order[:_KEPT]
                 if np.isfinite(gap[k] + cost[k]) and last[k] > 1]
        chosen = order[chance.integers(0, len(order), _DRAWN)]
        ended = drawn.length * (np.maximum(last, 2) / _STEPS if final.free else 1.0)
        width = _SPREAD / 2**generation
        drawn = _Drawn(
            np.clip(drawn.part[chosen] + width * chance.normal(size=shape), 0, 1),
            np.clip(ended[chosen] * np.exp(width * chance.normal(size=_DRAWN)), least, most))
    return _unlike(kept)


def _unlike(kept: list[tuple[float, float, Path]]) -> list[Path]:
    """Return paths of (gap, cost, path): in turn the nearest, and the cheapest of near ones."""
    by_gap = sorted(kept, key=lambda each: each[0])
    near = max(_NEAR, 2 * by_gap[0][0]) if kept else 0.0
    cheap: list[tuple[float, float, Path]] = []
    for each in sorted(kept, key=lambda each: each[1]):
        if each[0] <= near and not (
                cheap and abs(each[1] - cheap[-1][1]) <= _LIKE * abs(each[1])):
            cheap.append(each)
    inturn = [each for pair in zip(by_gap, cheap, strict=False) for each in pair]
    return [path for _, _, path in inturn + by_gap[len(cheap):]]


class _Rollouts:
    """What inputs lead to: how near to psi = 0, when, and on which path."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._rate = Batch([problem.x, problem.u, problem.p], [problem.f, problem.L])
        self._ends = Batch([problem.x, problem.p], [problem.psi, problem.V])
        self._size: Array | None = None

    def __call__(self, drawn: _Drawn) -> tuple[Array, Index, Array, Callable[[int], Path]]:
        """Return the gap (K,), the step (K,) at which it is least, the cost by then, and paths."""
        problem, final = self._problem, self._problem.final_time
        u = _inputs(problem, drawn.part)
        x, L = _rolled_out(problem, self._rate, u, drawn.length)
        t = drawn.length[:, None] * np.linspace(0.0, 1.0, _STEPS + 1)
        ends, V = (values.reshape(*x.shape[:2], -1) for values in self._ends(
            x.reshape(-1, problem.n), problem.p_value))
        with np.errstate(invalid='ignore', over='ignore'):
            if self._size is None:
                seen = np.where(np.isfinite(ends), np.abs(ends), np.nan)
                size = np.nanquantile(seen, _TYPICAL, axis=(0, 1))
                self._size = np.where(size > 0, size, 1.0)
            off = np.abs(ends / self._size).max(axis=2) + _outside(problem, x)
        may_end = t >= (final.lower if final.free else final.value) * (1 - 1e-9)
        off = np.where(np.isfinite(off) & may_end, off, np.inf)
        last = np.argmin(off, axis=1)
        each = np.arange(len(off))
        return (off[each, last], last, L[each, last] + V[each, last, 0],
                lambda k: _path(t[k], x[k], u[k], int(last[k])))


def _inputs(problem: Problem, part: Array) -> Array:
    """Return inputs (K, pieces, m) of their parts of a range: of the bounds, if there are any."""
    middle = np.clip(np.zeros(problem.m), problem.u_lower, problem.u_upper)
    lower = np.where(np.isfinite(problem.u_lower), problem.u_lower, middle - 2.0)
    upper = np.where(np.isfinite(problem.u_upper), problem.u_upper, middle + 2.0)
    return np.asarray(lower + (upper - lower) * part)


def _rolled_out(problem: Problem, rate: Batch, u: Array, length: Array) -> tuple[Array, Array]:
    """Return states (K, steps + 1, n) and the running cost under inputs held in turn."""
    h = length[:, None] / _STEPS
    z = np.column_stack([np.tile(problem.x0, (len(u), 1)), np.zeros(len(u))])
    path, n = [z], problem.n
    with np.errstate(all='ignore'):
        for k in np.arange(_STEPS) * u.shape[1] // _STEPS:
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
    held = u[np.arange(_STEPS) * len(u) // _STEPS][:last]
    return Path(t[:last + 1], x[:last + 1], np.zeros((last, 0, x.shape[1])), held, held,
                t[last:last + 1])
