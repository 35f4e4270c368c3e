# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Weights for a specified step response: step (2) of Bryson and Ho's method (section 2.5).

The first weights are the inverse squares of given scales. The search multiplies the scale of all
inputs (the trade-off of the table), the scale of all states but the positions (damping), and the
scales of single positions and inputs. It ends when the specifications are met, or reports those
that it could not meet together.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
import math
from typing import NamedTuple

import numpy as np
from obc_ros.core.lqr.lqr import lqr, LqrDesign
from obc_ros.core.lqr.step_figures import compute_step_figures
from obc_ros.core.lqr.weights import from_bryson, Weights
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import RefusedDesignError, StatementError

_SCALES = np.geomspace(1e-3, 1e3, 13)  # factors of all inputs: rows of the table
_DAMPINGS = (1.0, 0.1, 0.3, 3.0, 10.0)
_STEPS = (4.0, 2.0, 1.3, 1.1)          # factors of the search, in this order
_MOST = 500                            # designs tried for each group of specifications
_MET = 1.0 + 1e-6


@dataclass(frozen=True)
class StepSpecifications:
    """
    Largest figures of unit steps of the set point of the positions; 0 or empty: not specified.

    :ivar rise_time: from 10 % to 90 %, of the slowest position [s].
    :ivar overshoot: as a fraction.
    :ivar peak_input: (m,) |u - ue|, in the units of the inputs.
    """

    rise_time: float = 0.0
    overshoot: float = 0.0
    peak_input: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Trial:
    """Weights that were tried: the factor of the inputs, the design and its step figures."""

    scale: float
    weights: Weights
    design: LqrDesign
    rise_time: float
    overshoot: float
    peak_input: Array


@dataclass(frozen=True, eq=False)
class Suggestion:
    """
    The weights nearest to the specifications.

    :ivar message: the figures reached, or the specifications that were not met together.
    :ivar table: the trade-off over the scale of all inputs, from small inputs to large ones.
    """

    success: bool
    message: str
    best: Trial
    table: tuple[Trial, ...]


class Specification(NamedTuple):
    """One specification: its name, its value, and the index of the figure that it limits."""

    name: str
    value: float
    figure: int   # among the peaks of the inputs, the rise time and the overshoot


def suggest(A: Array, B: Array, wanted: StepSpecifications, *, x_max: Sequence[float] = (),
            u_max: Sequence[float] = (), inputs: Sequence[str] = ()) -> Suggestion:
    """
    Return weights whose regulator meets specifications of its step response.

    :param x_max, u_max: initial scales (n,) and (m,) in the units of states and inputs; empty: 1
        each.
    :return: the nearest weights, also if not all specifications are met.
    :raises StatementError: if a specification or a scale cannot be used, or no state can be held
        at another value.
    :raises RefusedDesignError: if no gain is found for the first weights.
    """
    return _Search(A, B, wanted, x_max, u_max, inputs).run()


class _Search:
    """The designs tried so far, by their factors."""

    def __init__(self, A: Array, B: Array, wanted: StepSpecifications, x_max: Sequence[float],
                 u_max: Sequence[float], inputs: Sequence[str]) -> None:
        self.A, self.B = A, B
        n, m = B.shape
        self.wanted = _list_specifications(
            wanted, tuple(inputs) or tuple(f'input {i}' for i in range(m)))
        self.start = from_bryson(n, m, x_max or (1.0,) * n, u_max or (1.0,) * m)
        first = self._design(self.start)
        rise = compute_step_figures(A, B, first.K, first.E)[0]
        self.positions = np.flatnonzero(np.isfinite(rise))
        if not self.positions.size:
            raise StatementError('no state of this system can be held at another value: no step '
                                 'response is defined')
        # Factors: all inputs, all states but the positions, each position, each input.
        self.trials: dict[tuple[float, ...], Trial | None] = {}
        self.neutral = (1.0, 1.0) + (1.0,) * (len(self.positions) + m)

    def run(self) -> Suggestion:
        table = [self._try((float(scale), *self.neutral[1:])) for scale in _SCALES]
        for damping in _DAMPINGS:
            for scale in _SCALES:
                self._try((float(scale), damping, *self.neutral[2:]))
        best = self._improved(self.wanted)
        rows = tuple(trial for trial in table if trial is not None)
        if all(_excess(best, each) <= _MET for each in self.wanted):
            return Suggestion(True, self._describe(best), best, rows)
        return Suggestion(False, self._describe_conflict(), best, rows)

    def _improved(self, wanted: list[Specification]) -> Trial:
        """Improve the nearest trial by a coordinate search over the factors."""
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

    def _misfit(self, key: tuple[float, ...], wanted: list[Specification]) -> float:
        """Return the violation of the specifications, or without one the size of the factors."""
        trial = self._try(key)
        if trial is None:
            return math.inf
        missed = sum(max(0.0, math.log(max(_excess(trial, each), 1e-9) / _MET)) for each in wanted)
        distance = sum(abs(math.log(factor)) for factor in key)
        return 100.0 + missed if missed else 0.01 * distance

    def _describe(self, best: Trial) -> str:
        words = ', '.join(f'{each.name} {_figure(best, each):.3g} (wanted {each.value:.3g})'
                          for each in self.wanted)
        return (f'all specifications are met: {words}' if words else
                'no specification: these are the weights of the given scales')

    def _describe_conflict(self) -> str:
        """Name the smallest group of specifications that was not met, and the figures found."""
        for count in range(1, len(self.wanted) + 1):
            for group in combinations(self.wanted, count):
                trial = self._improved(list(group))
                if any(_excess(trial, each) > _MET for each in group):
                    return self._describe_group(group)
        return 'no weights were found that meet all specifications together'

    def _describe_group(self, group: tuple[Specification, ...]) -> str:
        trials = [trial for trial in self.trials.values() if trial is not None]
        clauses = []
        for one in group:
            others = [other for other in group if other is not one]
            kept = [_figure(trial, one) for trial in trials
                    if all(_excess(trial, other) <= _MET for other in others)]
            if kept:
                names = ' and '.join(other.name for other in others)
                condition = f' with {names} met' if names else ''
                clauses.append(f'the minimum {one.name} found{condition} is {min(kept):.3g}')
        wanted = ' and '.join(f'{one.name} {one.value:.3g}' for one in group)
        together = ' together' if len(group) > 1 else ''
        return f'no weights were found that meet {wanted}{together}: {"; ".join(clauses)}'


def _list_specifications(wanted: StepSpecifications, names: tuple[str, ...]
                         ) -> list[Specification]:
    for name, value in (('rise_time', wanted.rise_time), ('overshoot', wanted.overshoot),
                        *((f'peak_input[{i}]', each) for i, each in enumerate(wanted.peak_input))):
        if not (math.isfinite(value) and value >= 0.0):
            raise StatementError(
                f'{name} = {value:g}: wanted 0 (not specified) or a positive number')
    if len(wanted.peak_input) not in (0, len(names)):
        raise StatementError(
            f'peak_input has {len(wanted.peak_input)} numbers; wanted {len(names)}')
    given = [Specification('rise time', wanted.rise_time, -2),
             Specification('overshoot', wanted.overshoot, -1)]
    given += [Specification(f'peak of {name}', value, i) for i, (name, value) in enumerate(
        zip(names, wanted.peak_input, strict=False))]
    return [each for each in given if each.value]


def _figure(trial: Trial, wanted: Specification) -> float:
    return float((*trial.peak_input, trial.rise_time, trial.overshoot)[wanted.figure])


def _excess(trial: Trial, wanted: Specification) -> float:
    """Return a figure of a trial relative to its specification."""
    return _figure(trial, wanted) / wanted.value
