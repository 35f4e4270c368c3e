# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Minimum time of the double integrator p'' = w, w within [low, high], in closed form (Example 2.3).

An extremal switches between the limits at most once. With w = w1 for a time t1 and then w = w2
for t2,

    v0 + w1 t1 + w2 t2 = vf,   p0 + v0 t1 + w1 t1^2 / 2 + vf t2 - w2 t2^2 / 2 = pf.

This is a quadratic equation for each of the two orders of the limits. T is the minimum sum of
nonnegative roots. From H = 1 + lam_p v + lam_v w = 0 and lam_v = 0 at the switch follows
lam_p = -1 / v there.
"""

from dataclasses import dataclass
from math import copysign, inf, sqrt

_ROUNDING = 1e-14


@dataclass(frozen=True)
class Arcs:
    """
    Acceleration `first` for `t1` and then `second` for `t2` [s]; costates of p and of v at T.

    A solution with one arc has t2 = 0.
    """

    first: float
    t1: float
    second: float
    t2: float
    lam_p: float
    lam_v: float

    @property
    def T(self) -> float:
        """Return the duration [s]."""
        return self.t1 + self.t2


def solve_least_time(p0: float, v0: float, pf: float, vf: float, low: float,
                     high: float) -> Arcs | None:
    """
    Return the time-optimal arcs from (p0, v0) to (pf, vf), low < high.

    None is returned if no solution of this form has finite costates.
    """
    best = (inf, 0.0, 0.0, 0.0, 0.0)
    for w1, w2 in ((low, high), (high, low)):
        if abs(w2) >= abs(w1):
            durations = _durations(p0, v0, pf, vf, w1, w2)
        else:
            # The same problem in reversed time: from the goal, with negative speeds.
            durations = [(t1, t2) for t2, t1 in _durations(pf, -vf, p0, -v0, w2, w1)]
        best = min([best, *((t1 + t2, w1, t1, w2, t2) for t1, t2 in durations)])
    T, w1, t1, w2, t2 = best
    if not 0 < T < inf:
        return None
    if t1 > 0 and t2 > 0:
        speed = vf - w2 * t2
        # lam_v has the sign of -(w2 - w1) on the last arc.
        return Arcs(w1, t1, w2, t2, -1 / speed, t2 / speed) if (w2 - w1) * speed < 0 else None
    w, other = (w1, w2) if t1 > 0 else (w2, w1)
    # One arc: lam_p = 0 gives lam_v w = -1; w, not the other limit, must minimise lam_v w.
    return Arcs(w, T, w, 0.0, 0.0, -1 / w) if w * (w - other) > 0 else None


def _durations(p0: float, v0: float, pf: float, vf: float, w1: float,
               w2: float) -> list[tuple[float, float]]:
    """Return the nonnegative pairs (t1, t2) that solve both equations; w2 is not 0."""
    ratio = w1 / w2
    roots = _roots(w1 * (1 - ratio) / 2, v0 * (1 - ratio),
                   p0 - pf + (vf + v0) * (vf - v0) / (2 * w2))
    found = []
    for t1 in roots:
        t2 = (vf - v0 - w1 * t1) / w2
        least = -_ROUNDING * (abs(t1) + (abs(vf) + abs(v0)) / abs(w2))
        if t1 >= least and t2 >= least:
            found.append((max(t1, 0.0), max(t2, 0.0)))
    return found


def _roots(a: float, b: float, c: float) -> tuple[float, ...]:
    """Return the real roots of a t^2 + b t + c."""
    if a == 0:
        return (-c / b,) if b else ()
    discriminant = b * b - 4 * a * c
    if discriminant < -_ROUNDING * (b * b + abs(4 * a * c)):
        return ()
    q = -(b + copysign(sqrt(max(discriminant, 0.0)), b)) / 2
    return (q / a, c / q) if q else (0.0,)
