# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Weights for a wanted response: step (2) of Bryson and Ho's method (section 2.5), by search.

The first weights are the inverse squares of given scales. Multiplied are the scale of all inputs
(the trade-off of the table), that of all states that are no positions (damping), and that of each
position and input alone, until the wishes are met, or it is plain which exclude each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
import math
from typing import NamedTuple

import numpy as np
from obc_ros.core.lqr.lqr import lqr, LqrDesign
from obc_ros.core.lqr.margins import compute_step_figures
from obc_ros.core.lqr.weights import from_bryson, Weights
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import RefusedDesignError, StatementError

_SCALES = np.geomspace(1e-3, 1e3, 13)  # of the inputs: rows of the table
_DAMPINGS = (1.0, 0.1, 0.3, 3.0, 10.0)
_STEPS = (4.0, 2.0, 1.3, 1.1)          # of the search, factors
_MOST = 500                            # designs tried for each group of wishes
_MET = 1.0 + 1e-6


@dataclass(frozen=True)
class Wishes:
    """
    What is wanted of unit steps of the positions.

    Attributes
    ----------
    rise_time : float
        Longest 10 % to 90 % rise time of the slowest position [s]; 0: no wish.
    overshoot : float
        Largest overshoot, as a fraction; 0: no wish.
    peak_input : tuple of float
        (m,) largest |u - ue|, in the inputs' units; empty: no wish; an entry of 0 likewise.

    """

    rise_time: float = 0.0
    overshoot: float = 0.0
    peak_input: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Trial:
    """Weights that were tried: the factors, the design and what its steps do."""

    scale: float
    weights: Weights
    design: LqrDesign
    rise_time: float
    overshoot: float
    peak_input: Array


@dataclass(frozen=True, eq=False)
class Suggestion:
    """
    The weights nearest to the wishes.

    Attributes
    ----------
    success : bool
        Whether all wishes are met.
    message : str
        What was found, or which wishes exclude each other.
    best : Trial
        The suggested weights.
    table : tuple of Trial
        What the scale of all inputs trades off, from small inputs to large ones.

    """

    success: bool
    message: str
    best: Trial
    table: tuple[Trial, ...]


class Wish(NamedTuple):
    """One wish: its name in words, its value, and which figure of a trial it is of."""

    name: str
    value: float
    figure: int


_RISE, _OVERSHOOT = -2, -1  # figures; from 0 on: the peak of that input


def suggest(A: Array, B: Array, wishes: Wishes, *, x_max: Sequence[float] = (),
            u_max: Sequence[float] = (), inputs: Sequence[str] = ()) -> Suggestion:
    """
    Return weights whose regulator answers steps of the set point as wished.

    Parameters
    ----------
    A, B : ndarray, shape (n, n) and (n, m)
        The plant.
    wishes : Wishes
        What is wanted.
    x_max, u_max : sequence of float
        Starting scales (n,) and (m,) in the units of states and inputs; empty: 1 each.
    inputs : sequence of str
        Names of the inputs, for the words.

    Raises
    ------
    StatementError
        If a wish or a scale cannot be used, or no state can be held at another value.
    RefusedDesignError
        If no weights at all can be proved to stabilise.

    """
    return _Search(A, B, _checked(wishes, B.shape[1]), x_max, u_max, inputs).run()


class _Search:
    """The designs tried so far, and those next to the best one."""

    def __init__(self, A: Array, B: Array, wishes: Wishes, x_max: Sequence[float],
                 u_max: Sequence[float], inputs: Sequence[str]) -> None:
        self.A, self.B = A, B
        n, m = B.shape
        self.start = from_bryson(n, m, x_max or (1.0,) * n, u_max or (1.0,) * m)
        self.names = tuple(inputs) or tuple(f'input {i}' for i in range(m))
        first = self._design(self.start)
        rise = compute_step_figures(A, B, first.K, first.E)[0]
        self.positions = np.flatnonzero(np.isfinite(rise))
        if not self.positions.size:
            raise StatementError('no state of this system can be held at another value: there is '
                                 'no step to judge')
        self.wanted = _wanted(wishes, self.names)
        # Factors: of all inputs, of all states that are no positions, of each position and input.
        self.trials: dict[tuple[float, ...], Trial | None] = {}
        self.neutral = (1.0, 1.0) + (1.0,) * (len(self.positions) + m)

    def run(self) -> Suggestion:
        table = [self._try((float(scale), *self.neutral[1:])) for scale in _SCALES]
        for damping in _DAMPINGS:
            for scale in _SCALES:
                self._try((float(scale), damping, *self.neutral[2:]))
        best = self._improved(self.wanted)
        rows = tuple(trial for trial in table if trial is not None)
        if all(_excess(best, wish) <= _MET for wish in self.wanted):
            return Suggestion(True, self._met(best), best, rows)
        return Suggestion(False, self._excluded(), best, rows)

    def _improved(self, wanted: list[Wish]) -> Trial:
        """Follow the trial nearest to some wishes, one factor at a time, in ever smaller steps."""
        best = min((key for key, trial in self.trials.items() if trial is not None),
                   key=lambda key: self._misfit(key, wanted))
        most = len(self.trials) + _MOST
        for step in _STEPS:
            moved = True
            while moved and len(self.trials) < most:
                moved = False
                for i in range(len(best)):
                    for factor in (step, 1.0 / step):
                        key = (*best[:i], best[i] * factor, *best[i + 1:])
                        if self._misfit(key, wanted) < self._misfit(best, wanted) - 1e-9:
                            best, moved = key, True
        trial = self.trials[best]
        assert trial is not None
        return trial

    def _try(self, key: tuple[float, ...]) -> Trial | None:
        if key not in self.trials:
            self.trials[key] = self._trial(key)
        return self.trials[key]

    def _trial(self, key: tuple[float, ...]) -> Trial | None:
        scale, damping, *rest = key
        x = np.full(len(self.A), damping)
        x[self.positions] = rest[:len(self.positions)]
        u = scale * np.array(rest[len(self.positions):])
        weights = Weights(self.start.Qx / x**2, self.start.Qu / u**2)
        try:
            design = self._design(weights)
        except RefusedDesignError:
            return None
        rise, overshoot, _, peak = compute_step_figures(self.A, self.B, design.K, design.E)
        rise, overshoot = rise[self.positions], overshoot[self.positions]
        if not np.isfinite(rise).all():
            return None
        return Trial(scale, weights, design, float(rise.max()), float(overshoot.max()), peak)

    def _design(self, weights: Weights) -> LqrDesign:
        return lqr(self.A, self.B, weights.Qx, weights.Qu)

    def _misfit(self, key: tuple[float, ...], wanted: list[Wish]) -> float:
        """Return by how much a trial misses wishes, then how far it is from the start."""
        trial = self._try(key)
        if trial is None:
            return math.inf
        missed = sum(max(0.0, math.log(max(_excess(trial, wish), 1e-9) / _MET)) for wish in wanted)
        distance = sum(abs(math.log(factor)) for factor in key)
        return 100.0 + missed if missed else 0.01 * distance

    def _met(self, best: Trial) -> str:
        words = ', '.join(f'{wish.name} {_figure(best, wish):.3g} (wanted {wish.value:.3g})'
                          for wish in self.wanted)
        return f'all wishes are met: {words}' if words else 'no wish: these are the given scales'

    def _excluded(self) -> str:
        """Name the fewest wishes that are not met together, and what was reached for each."""
        for count in range(1, len(self.wanted) + 1):
            for group in combinations(self.wanted, count):
                trial = self._improved(list(group))
                if any(_excess(trial, wish) > _MET for wish in group):
                    return self._exclusion(group)
        return 'the wishes were met in part only: no weights were found that meet them together'

    def _exclusion(self, group: tuple[Wish, ...]) -> str:
        trials = [trial for trial in self.trials.values() if trial is not None]
        clauses = []
        for wish in group:
            others = [other for other in group if other is not wish]
            kept = [_figure(trial, wish) for trial in trials
                    if all(_excess(trial, other) <= _MET for other in others)]
            if kept:
                names = ' and '.join(other.name for other in others)
                condition = f'with {names} kept, ' if names else ''
                clauses.append(f'{condition}the least {wish.name} found was {min(kept):.3g}')
        wanted = ' and '.join(f'{wish.name} {wish.value:.3g}' for wish in group)
        verb = 'exclude each other' if len(group) > 1 else 'is out of reach'
        return f'{wanted} {verb}: {"; ".join(clauses)}'


def _wanted(wishes: Wishes, names: tuple[str, ...]) -> list[Wish]:
    wanted = [Wish('rise time', wishes.rise_time, _RISE),
              Wish('overshoot', wishes.overshoot, _OVERSHOOT)]
    wanted += [Wish(f'peak of {name}', value, i) for i, (name, value) in enumerate(
        zip(names, wishes.peak_input, strict=False))]
    return [wish for wish in wanted if wish.value]


def _figure(trial: Trial, wish: Wish) -> float:
    if wish.figure == _RISE:
        return trial.rise_time
    return trial.overshoot if wish.figure == _OVERSHOOT else float(trial.peak_input[wish.figure])


def _excess(trial: Trial, wish: Wish) -> float:
    """Return a figure of a trial relative to what is wanted."""
    return _figure(trial, wish) / wish.value


def _checked(wishes: Wishes, m: int) -> Wishes:
    for name, value in (('rise_time', wishes.rise_time), ('overshoot', wishes.overshoot),
                        *((f'peak_input[{i}]', each) for i, each in enumerate(wishes.peak_input))):
        if not (math.isfinite(value) and value >= 0.0):
            raise StatementError(f'{name} = {value:g}: wanted 0 (no wish) or a positive number')
    if len(wishes.peak_input) not in (0, m):
        raise StatementError(f'peak_input has {len(wishes.peak_input)} numbers; wanted {m}')
    return wishes
