# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Minimum times of Exercise 2.6 from the maximum principle, for L = M = 1, without a list of words.

Positions are complex, x + i y. With constant (lambda_1, lambda_2) = r (cos alpha, sin alpha) and
the inputs that minimise H,

    H = 1 - r |cos(theta - alpha)| - |lambda_3| = 0,

v changes its sign where |lambda_3| = 1, and omega where lambda_3 = 0.

- r < 1: lambda_3 has no zero. The robot turns in one direction only, by the angle T: `_one_way`.
- r > 1: both kinds of sign change alternate, at the distance u = asin(1/r): `_rows`.
- r = 1: they alternate with u = pi/2, but where omega changes its sign the robot may first drive
  straight on and then turn to either side: `_lines`.

For r >= 1 one number, u or the length of the line, determines all arcs between the first and the
last. It is found from the distance between the centres of the first and the last circle, which
these arcs have to span; all roots are searched for. The two headings then determine the first and
the last arc. Every path found in this way leads to the goal, and all extremals are among these
paths: T is the time of the fastest.

Optimal paths have at most two arcs of length u (Sussmann and Tang, 1991), and one of pi/2 at
either end of the line. One more of each is tried.
"""

from collections.abc import Sequence
from itertools import product
from math import pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from obc_ros.core.numerics.arrays import Array, Complex

BETWEEN, AT_ENDS = 3, 2  # largest numbers of arcs of length u, and of pi/2 at an end of the line
U = np.linspace(0.0, pi / 2, 65)  # a change of sign between two of these is a root
BISECTIONS = 50
SIGNS = (1, -1)


def find_least_times(goals: ArrayLike) -> Array:
    """Return the minimum times [s] from 0 to goals (N, 3), x, y [m], theta; |v|, |omega| <= 1."""
    x, y, theta = np.asarray(goals, dtype=float).T
    goal = x + 1j * y
    times: Array = np.min([_one_way(goal, theta), _rows(goal, theta), _lines(goal, theta)], axis=0)
    return times


def _one_way(goal: Complex, theta: Array) -> Array:
    """
    Return the turning time to goals that are reached by turning in one direction; inf for others.

    Turning left for a time T with any |v(t)| <= 1 reaches a convex set of positions. The support
    function of this set in the direction beta is the integral of |cos(t - beta)|. Its excess over
    the position is minimal where the derivative with respect to beta is 0, for one combination of
    the signs of the two cosines.
    """
    least = np.full(theta.shape, np.inf)
    left = np.remainder(theta, 2 * pi)
    for T, place in ((left, goal), (2 * pi - left, goal.conj())):
        room = np.full(theta.shape, np.inf)
        for first, last in product(SIGNS, SIGNS):
            beta = np.angle(place - 1j * first + 1j * last * np.exp(1j * T))
            support = _swept(T - beta) + _swept(beta)
            room = np.minimum(room, support - (np.exp(-1j * beta) * place).real)
        least = np.where(room >= -1e-12, np.minimum(least, T), least)
    return least


def _swept(t: Array) -> Array:
    """Return the integral of |cos| from 0 to t."""
    halves = np.rint(t / pi)
    return np.asarray(2 * halves + (1 - 2 * np.remainder(halves, 2)) * np.sin(t))


def _rows(goal: Complex, theta: Array) -> Array:
    """Return the time of the fastest path whose middle consists of arcs of one length u."""
    least = np.full(theta.shape, np.inf)
    for count, side, way, phase in product(range(1, BETWEEN + 1), SIGNS, SIGNS, range(2)):
        sides = [side * (-1)**k for k in range(count)]
        ways = np.array([way * (-1)**((k + phase) // 2) for k in range(count)])
        ends = _Ends(goal, theta, -sides[0], -sides[-1])
        # Does the middle with arcs u span less than the distance between the centres?
        below = np.abs(ends.offset(*_driven(sides, np.multiply.outer(ways, U)))) < \
            ends.distance[:, None]
        index, cell = np.nonzero(below[:, 1:] != below[:, :-1])
        low, high, begins = U[cell], U[cell + 1], below[index, cell]
        for _ in range(BISECTIONS):
            u = (low + high) / 2
            apart = np.abs(ends.offset(*_driven(sides, np.multiply.outer(ways, u))))
            before = (apart < ends.distance[index]) == begins
            low, high = np.where(before, u, low), np.where(before, high, u)
        middle = _driven(sides, np.multiply.outer(ways, high))
        np.minimum.at(least, index, count * high + ends.time(*middle, index))
    return least


def _lines(goal: Complex, theta: Array) -> Array:
    """Return the time of the fastest path with a line and arcs of pi/2 at its ends."""
    least = np.full(theta.shape, np.inf)
    for before, after, side, other, way in product(
            range(AT_ENDS + 1), range(AT_ENDS + 1), SIGNS, SIGNS, SIGNS):
        # From the line outwards: the side changes each time, the direction at every cusp.
        sides = [side * (-1)**k for k in range(before)][::-1]
        others = [other * (-1)**k for k in range(after)]
        turns = [way * pi / 2 * (-1)**((k + 1) // 2) for k in range(max(before, after))]
        start, heading = _driven(sides, turns[:before][::-1])
        end, turned = _driven(others, turns[:after])
        ends = _Ends(goal, theta, side * (-1)**before, other * (-1)**after)
        along, heading = np.exp(1j * heading), heading + turned
        offset = ends.offset(start + along * end, heading)
        # |offset + length along| = distance
        across, ahead = (offset / along).imag, (offset / along).real
        root = np.sqrt(np.where(ends.distance < abs(across), np.nan, ends.distance**2 - across**2))
        for length in (root - ahead, -root - ahead):
            time = np.abs(length) + pi / 2 * (before + after) + ends.time(
                start + along * (length + end), np.full(theta.shape, heading))
            least = np.fmin(least, time)
    return least


class _Ends:
    """The first and the last arc of paths between given poses, on given sides."""

    def __init__(self, goal: Complex, theta: Array, first: int, last: int) -> None:
        self._first, self._last = 1j * first, 1j * last
        self._theta = theta
        self._between = goal + self._last * np.exp(1j * theta) - self._first
        self.distance = np.abs(self._between)

    def offset(self, place: Any, heading: Any) -> Any:
        """Return the vector between the centres if the middle leads to this pose."""
        return place + self._last * np.exp(1j * heading) - self._first

    def time(self, place: Complex, heading: Array, index: Any = ...) -> Array:
        """Return the duration of the two arcs around such a middle, for some of the goals."""
        first = np.angle(self._between[index] * np.conj(self.offset(place, heading)))
        last = np.angle(np.exp(1j * (self._theta[index] - first - heading)))
        return np.asarray(np.abs(first) + np.abs(last))


def _driven(sides: Sequence[int], lengths: ArrayLike) -> tuple[Any, Any]:
    """Return position and heading after arcs from 0; a length < 0 is driven backwards."""
    place, heading = 0j, 0.0
    for side, length in zip(sides, np.asarray(lengths), strict=True):
        turn = side * length
        place = place + np.exp(1j * heading) * side * (np.exp(1j * turn) - 1) / 1j
        heading = heading + turn
    return place, heading
