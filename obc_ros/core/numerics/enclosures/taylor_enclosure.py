# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Rigorous enclosures of the solutions of a system without inputs, by Taylor series.

A step begins at a point with a bound of the accumulated error. A box that satisfies Picard's
condition in interval arithmetic encloses all solutions during the step. The box bounds the
remainder of the Taylor series, and the logarithmic norm of the Jacobian, which bounds the growth
of the accumulated error (R. E. Moore, Interval Analysis, 1966; G. Dahlquist, 1958).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import exp, factorial, inf

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.enclosures.interval_arithmetic import (
    add_intervals,
    enclose_outputs,
    Interval,
    multiply_intervals,
)
from obc_ros.core.numerics.instructions import Instructions

Box = tuple[Array, Array]

_ORDER = 8           # of the Taylor series
_LOCAL = 1e-10       # largest relative error that a step may add
_MOST_STEPS = 400
_MOST_INSTRUCTIONS = 4000   # of each time derivative
_HALVINGS, _INFLATED = 30, 6   # halvings of a step, inflations of its box
_ROOM = 0.05         # relative inflation of a box
_SWEEPS = 8          # of balancing the units
_TINY = 1e-200       # smallest unit: the rounding of sums that are exactly 0 is below it
_ROUNDING = 1e-12    # relative rounding error of norms and exponentials


@dataclass(frozen=True)
class TaylorStep:
    """A step from `begin` to `end` [s]: boxes of the states during it and at its end."""

    begin: float
    end: float
    during: Box
    after: Box


class Tube:
    """Enclosures of the solutions of y' = g(y, p) with p in a box."""

    def __init__(self, y: ca.SX, p: ca.SX, g: ca.SX, p_box: Box) -> None:
        self._p = p_box
        terms, total = [g], 0
        for _ in range(_ORDER - 1):
            terms.append(ca.jtimes(terms[-1], y, g))
            total = ca.Function('size', [y, p], [terms[-1]]).n_instructions()
            if total > _MOST_INSTRUCTIONS:
                break
        self.fits = total <= _MOST_INSTRUCTIONS
        self._terms = [Instructions(ca.Function('term', [y, p], [ca.densify(term)]))
                       for term in terms]
        self._slope = ca.Function('slope', [y, p], [ca.densify(ca.jacobian(g, y))])
        self._slopes = Instructions(self._slope)

    def steps(self, start: Box, stops: Array) -> Iterator[TaylorStep]:
        """
        Yield steps from time 0 to the last of `stops`.

        :param start: (n,), lower and upper bounds of y at time 0.
        :param stops: increasing times [s] > 0, each of which is the end of a step.
        :yield: the steps end before the last stop if no further step can be enclosed.
        """
        if not self.fits:
            return
        y = 0.5 * (start[0] + start[1])
        size = self._first_sizes(y, float(stops[-1]))
        error = len(y) * float(np.max((start[1] - start[0]) / size, initial=0.0))
        t, h = 0.0, float(stops[-1])
        for _ in range(_MOST_STEPS):
            left = float(stops[np.searchsorted(stops, t, side='right')]) - t
            found = None
            for _ in range(_HALVINGS):
                last = h >= left
                found = self._step(y, error, size, left if last else h)
                if found is not None:
                    break
                h = min(h, left) / 2
            if found is None:
                return
            end = t + left if last else t + h
            y, error, during = found
            size = size * max(1.0, float(np.max(np.abs(y) / size)))   # error * size stays a bound
            radius = error * size
            yield TaylorStep(t, end, during, (np.nextafter(y - radius, -inf),
                                              np.nextafter(y + radius, inf)))
            if end >= stops[-1]:
                return
            t, h = end, 2 * min(h, left)

    def _first_sizes(self, y: Array, T: float) -> Array:
        """Return the initial unit of each component."""
        box = np.array([(each.low, each.high) for each in enclose_outputs(
            self._terms[0], [(y, y), self._p])])
        moved = T * np.abs(np.where(np.isfinite(box), box, 0.0)).max(axis=1)
        size = np.abs(y) + moved
        largest = float(size.max(initial=0.0))
        size = np.where(size > _TINY, size, largest if largest > _TINY else 1.0)
        slope = self._slope(y, self._p[0]).full()
        scaled = slope * size / size[:, None]
        if not np.isfinite(scaled).all():
            return np.asarray(size)
        # In balanced units the logarithmic norm of an undamped oscillator is 0.
        balanced = size * _balance(scaled)
        return np.asarray(balanced * float(np.max(size / balanced)))

    def _step(self, y: Array, error: float, size: Array, h: float
              ) -> tuple[Array, float, Box] | None:
        """Return the end of a step, its error in units of the sizes, and the box during it."""
        box = self._enclosed(y, error * size, h)
        if box is None:
            return None
        series = [Interval(each, each) for each in y.tolist()]
        for k in range(1, _ORDER + 1):
            last = k == _ORDER
            term = enclose_outputs(self._terms[k - 1], [box if last else (y, y), self._p])
            part = h**k / factorial(k)
            factor = Interval(part * (1 - _ROUNDING), part * (1 + _ROUNDING))
            series = [add_intervals(each, multiply_intervals(factor, more))
                      for each, more in zip(series, term, strict=True)]
        low, high = np.array([(each.low, each.high) for each in series]).T
        if not np.isfinite([low, high]).all():
            return None
        middle = 0.5 * (low + high)
        local = float(np.max((high - low) / size))
        if local > _LOCAL:
            return None
        growth = exp(min(self._growth(box, size) * h, 500.0))
        # The Euclidean norm, which bounds each component.
        error = (error * growth + local * len(y)) * (1 + _ROUNDING)
        return (middle, error, box) if np.isfinite(error) else None

    def _enclosed(self, y: Array, radius: Array, h: float) -> Box | None:
        """Return a box that encloses all solutions from y +- radius during h."""
        low, high = y - radius, y + radius
        for _ in range(_INFLATED):
            rates = enclose_outputs(self._terms[0], [(low, high), self._p])
            moved = [multiply_intervals(Interval(0.0, h), rate) for rate in rates]
            pad = 4 * np.spacing(np.abs(low) + np.abs(high))   # rounding of the sums below
            a = y - radius + [each.low for each in moved] - pad
            b = y + radius + [each.high for each in moved] + pad
            if not np.isfinite([a, b]).all():
                return None
            if np.all(a >= low) and np.all(b <= high):
                return low, high
            room = _ROOM * (b - a) + pad
            low, high = np.minimum(low, a) - room, np.maximum(high, b) + room
        return None

    def _growth(self, box: Box, size: Array) -> float:
        """Return a bound of the logarithmic norm of the Jacobian, in units of the sizes."""
        n = len(size)
        found = enclose_outputs(self._slopes, [box, self._p])
        low, high = (np.array(ends).reshape(n, n, order='F') for ends in zip(
            *((each.low, each.high) for each in found), strict=True))
        if not np.isfinite([low, high]).all():
            return inf
        middle = 0.5 * (low + high) * size / size[:, None]
        radius = 0.5 * (high - low) * size / size[:, None]
        bound = float(np.linalg.eigvalsh(0.5 * (middle + middle.T))[-1])
        spread = float(np.linalg.norm(radius)) + _ROUNDING * float(np.linalg.norm(middle))
        return bound + spread


def _balance(matrix: Array) -> Array:
    """Return units in which the off-diagonal parts of row i and column i have the same size."""
    size = np.abs(matrix - np.diag(np.diag(matrix)))
    units = np.ones(len(matrix))
    for _ in range(_SWEEPS):
        for i in range(len(units)):
            row, column = size[i] @ units / units[i], units[i] * (size[:, i] / units).sum()
            if row > 0 and column > 0:
                units[i] *= np.sqrt(row / column)
    return units
