# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Shortest paths of a car that goes forwards and backwards (Reeds and Shepp, 1990).

Minimise the length of (x, y, theta) from start to goal subject to |curvature| <= 1 / radius,
cusps allowed. One of 48 words of at most five arcs and straight lines is shortest.

Every word is a chain of circles that touch or are joined by a line. Let rho e^(i theta) be the
vector from the first circle's centre to the last's in the frame of the start, with radius 1. The
middle of the chain depends on rho only, the first arc is t = theta + kappa(rho) >= 0, and the last
arc completes the turn phi:

    v = phi - t + beta   (first and last circle on the same side),
    v = t - phi + beta   (on opposite sides).

`_same_side` and `_opposite` contain the words that start with L+. The others are their images
under time reversal (theta, phi -> pi - theta, -phi), under reflection (left and right exchanged),
and under travel from goal to start. The formulas are derived, not copied: (8.3), (8.4) and
(8.11) are misprinted in the paper.

J. A. Reeds, L. A. Shepp, Optimal paths for a car that goes both forwards and backwards, Pacific
J. Math. 145(2), 1990. H. J. Sussmann, G. Tang, Shortest paths for the Reeds-Shepp car,
SYCON-91-10, 1991.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import acos, asin, atan2, cos, hypot, inf, isfinite, pi, remainder, sin, sqrt
from typing import NamedTuple

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.tables import Tabulated

# Word up to the sign of v, kappa, beta, sign of v, sum of the middle lengths, middle lengths.
_Row = tuple[str, float, float, float, float, tuple[float, ...]]

_TWO_PI = 2 * pi
_MIRROR = str.maketrans('LR', 'RL')
# Angles below 0 (or above pi) by less than this are accepted; the arc is driven the other way. The
# path still ends at the goal. It is the shortest if rounding has moved an angle out of its
# interval; for short straight parts the error reaches the square root of the unit of rounding.
_LOOSE = 1e-6
# A straight part that is negative by less than this has length 0.
_SHORT = 1e-13


class Segment(NamedTuple):
    """One arc or line: `steering` 'L', 'S' or 'R'; `length` [m], negative when backwards."""

    steering: str
    length: float


@dataclass(frozen=True, repr=False)
class _ShownPath(Tabulated):
    length: float
    radius: float
    word: str
    start: tuple[float, ...]
    goal: tuple[float, ...]

    def _title(self) -> str:
        return 'CarPath'


class CarPath(NamedTuple):
    """Shortest path of a car from pose to pose, (x, y, theta) [m, m, rad]."""

    start: tuple[float, float, float]
    goal: tuple[float, float, float]
    radius: float   # minimum turning radius [m]
    length: float   # sum of the segments' absolute lengths [m]
    segments: tuple[Segment, ...]   # none has length zero

    def __repr__(self) -> str:
        """Return length, word, start and goal as a table."""
        return repr(self._shown())

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        return self._shown()._repr_html_()

    @property
    def word(self) -> str:
        """Return the segments' letters and signs: 'L+R-L+' is left, back to the right, left."""
        return ''.join(s.steering + ('+' if s.length > 0 else '-') for s in self.segments)

    def sample(self, n: int) -> Array:
        """
        Return n points of the path, equally spaced in arc length, including both ends.

        :param n: at least 2.
        :return: (n, 3), x, y [m] and theta [rad]. theta is continuous; it ends at the goal's theta
            plus a multiple of 2 pi.
        :raises StatementError: if n is not an integer of at least 2.
        """
        if not isinstance(n, (int, np.integer)) or isinstance(n, bool) or n < 2:
            raise StatementError(f'a path is sampled at 2 or more points, not at {n!r}')
        points = self.at(np.arange(n, dtype=float) * (self.length / (n - 1)))
        x, y, theta = self.goal
        theta += _TWO_PI * round((float(points[-1, 2]) - theta) / _TWO_PI)
        points[0] = self.start
        points[-1] = x, y, theta
        return points

    def at(self, s: Array) -> Array:
        """Return the poses (k, 3) at arc lengths (k,) from the start [m]."""
        points = np.empty((len(s), 3))
        begins, pieces = self._pieces()
        piece = np.array(begins[1:]).searchsorted(s, 'right')
        theta, rate, side, x, along_x, y, along_y = (
            np.array(pieces).reshape(-1, 7).T.take(piece, axis=1))
        # An arc is centre + side (sin, -cos) of the heading, a line is linear in s.
        theta += rate * s
        points[:, 0] = x + along_x * s + side * np.sin(theta)
        points[:, 1] = y + along_y * s - side * np.cos(theta)
        points[:, 2] = theta
        return points

    def _shown(self) -> _ShownPath:
        return _ShownPath(self.length, self.radius, self.word, self.start, self.goal)

    def _pieces(self) -> tuple[list[float], list[float]]:
        """Return where segments begin, and (theta, rate, side, x, along_x, y, along_y) of each."""
        x, y, theta = self.start
        s = 0.0
        begins, pieces = list[float](), list[float]()
        for steering, length in self.segments or (Segment('S', 0.0),):
            begins.append(s)
            forward = 1.0 if length > 0 else -1.0
            c, d = cos(theta), sin(theta)
            if steering == 'S':
                ax, ay = forward * c, forward * d
                pieces += (theta, 0.0, 0.0, x - ax * s, ax, y - ay * s, ay)
                x, y = x + length * c, y + length * d
            else:
                side = self.radius if steering == 'L' else -self.radius
                x, y, rate = x - side * d, y + side * c, forward / side
                pieces += (theta - rate * s, rate, side, x, 0.0, y, 0.0)
                theta += length / side
                x, y = x + side * sin(theta), y - side * cos(theta)
            s += abs(length)
        return begins, pieces


def find_shortest_path(start: Sequence[float] | Array, goal: Sequence[float] | Array,
                       radius: float) -> CarPath:
    """
    Return the shortest path from start to goal with turns of at least the given radius.

    :param start, goal: (x, y, theta) [m, m, rad].
    :param radius: minimum turning radius [m], > 0.
    :return: ``length`` [m], ``word``, ``segments``, ``sample(n)``.
    :raises StatementError: if a pose is not three finite numbers or the radius is not a positive
        one.
    """
    x0, y0, theta0 = first = _pose('start', start)
    x1, y1, theta1 = last = _pose('goal', goal)
    radius = check_positive('radius', radius)
    c, s = cos(theta0), sin(theta0)
    dx, dy = (x1 - x0) / radius, (y1 - y0) / radius
    # Farther away, in radii, angles have no correct digits.
    if max(abs(dx), abs(dy)) > 1e12:
        raise StatementError(f'{first} and {last} are too far apart for radius {radius}')
    length, parts = _solve(c * dx + s * dy, c * dy - s * dx, remainder(theta1 - theta0, _TWO_PI))
    return CarPath(first, last, radius, length * radius,
                   tuple([Segment(letter, part * radius) for letter, part in parts]))


def _solve(x: float, y: float, phi: float) -> tuple[float, list[tuple[str, float]]]:
    """Return the length and the parts of the shortest path of radius 1 from (0, 0, 0)."""
    s, c = sin(phi), cos(phi)
    # Vectors from the left circle of the start to the left and to the right circle of the goal,
    # for the problem and for its mirror image.
    chains = [(hypot(xi, eta), atan2(eta, xi), turn, turn_sign, mirrored) for
              xi, eta, turn, turn_sign, mirrored in (
                  (x - s, y - 1 + c, phi, 1.0, False), (x + s, -y - 1 + c, -phi, 1.0, True),
                  (x + s, y - 1 - c, phi, -1.0, False), (x - s, -y - 1 - c, -phi, -1.0, True))]
    best, found = inf, None
    for rho, theta, turn, sense, mirrored in chains:
        # (theta, phi) of the word, time reversed, travelled from the goal, and both.
        back = sense * (turn - theta)
        images = ((theta, turn, 0), (pi - theta, -turn, 1),
                  (back, sense * turn, 2), (pi - back, -sense * turn, 3))
        for row in (_same_side if sense > 0 else _opposite)(rho, best):
            _, kappa, beta, sign, middle, _ = row
            for angle, phi, image in images if sign <= 0 else images[:2]:
                t = remainder(angle + kappa, _TWO_PI)
                if t < 0 and _LOOSE - pi < t < -_LOOSE:
                    continue
                length = abs(t) + middle
                if length >= best:
                    continue
                v = remainder(sense * (phi - t) + beta, _TWO_PI)
                if v * sign < 0 and _LOOSE - pi < v * sign < -_LOOSE:
                    continue
                length += abs(v)
                if length < best:
                    # If travelled from the goal, opposite words start on the other side.
                    best, found = length, (row, image, mirrored ^ (sense * image < -1), t, v)
    assert found is not None  # one of the words L+S+L+, L-S-L-, R+S+R+, R-S-R- always exists
    return best, _parts(*found)


def _same_side(rho: float, best: float) -> list[_Row]:
    """Return words whose first and last circle are both left, centres rho apart, below best."""
    rows: list[_Row] = []
    if rho < best:
        rows.append(('L+S+L', 0.0, 0.0, 1.0, rho, (rho,)))
    if rho <= 4:
        u = 2 * asin(rho / 4)
        rows.append(('L+R-L', pi - u / 2, -u, 0.0, u, (u,)))
    if rho * rho >= 8:
        r = sqrt(rho * rho - 4)
        middle = pi / 2 + r - 2
        if middle < best:
            rows.append(('L+R-S-L', atan2(r, -2.0), -pi / 2, -1.0, middle, (pi / 2, r - 2)))
    return rows


def _opposite(rho: float, best: float) -> list[_Row]:
    """Return words from a left circle to a right one, centres rho apart, below best."""
    rows: list[_Row] = []
    if rho <= 2:
        u = acos((2 + rho) / 4)
        rows.append(('L+R+L-R', u + pi / 2, -2 * u, -1.0, 2 * u, (u, u)))
    if rho >= 2 - _SHORT:
        r = sqrt(max(rho * rho - 4, 0.0))
        if r < best:
            rows.append(('L+S+R', atan2(2.0, r), 0.0, 1.0, r, (r,)))
        line = max(rho - 2, 0.0)
        if pi / 2 + line < best:
            rows.append(('L+R-S-R', pi / 2, pi / 2, -1.0, pi / 2 + line, (pi / 2, line)))
        if r <= 4:
            u = acos(min((20 - rho * rho) / 16, 1.0))
            kappa = pi / 2 + atan2(sin(u), 2 - cos(u))
            rows.append(('L+R-L-R', kappa, 0.0, 1.0, 2 * u, (u, u)))
        elif pi + r - 4 < best:
            middles = (pi / 2, r - 4, pi / 2)
            rows.append(('L+R-S-L-R', atan2(r, -2.0), 0.0, 1.0, pi + r - 4, middles))
    return rows


def _parts(row: _Row, image: int, mirrored: bool, t: float, v: float) -> list[tuple[str, float]]:
    """Return (letter, signed length) of the parts of a row's image."""
    word, middle = row[0], row[5]
    inner = [u if sign == '+' else -u for u, sign in zip(middle, word[3::2], strict=True)]
    letters = word[0::2].translate(_MIRROR) if mirrored else word[0::2]
    parts = [(a, -u if image % 2 else u) for a, u in zip(letters, (t, *inner, v), strict=True)
             if abs(u) > _SHORT]
    return parts[::-1] if image > 1 else parts


def _pose(name: str, pose: Sequence[float] | Array) -> tuple[float, float, float]:
    try:
        x, y, theta = pose
        finite = isfinite(x) and isfinite(y) and isfinite(theta)
    except (OverflowError, TypeError, ValueError):
        finite = False
    if not finite:
        raise StatementError(
            f'{name} must be three finite numbers x, y, theta; found {pose!r:.80}')
    return float(x), float(y), float(theta)


def check_positive(name: str, value: float) -> float:
    """Return a number as a float; raise StatementError if it is not finite and > 0."""
    try:
        good = isfinite(value) and value > 0
    except (OverflowError, TypeError, ValueError):
        good = False
    if not good:
        raise StatementError(f'{name} must be a finite number > 0; found {value!r:.80}')
    return float(value)
