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

from math import copysign, inf, sqrt

import numpy as np
from obc_ros.core.ocp.least_time_form import Affine, Target
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Optimality, Solution, Status
from obc_ros.core.solver.exact.bang_bang import describe_switches

_ROUNDING = 1e-14
_SAMPLES = 17   # of an arc

Arcs = list[tuple[float, float]]   # the acceleration of each arc and its duration [s]


def solve_by_two_arcs(problem: Problem, aim: Target, plant: Affine) -> Solution | None:
    """
    Return the minimum-time solution of x_i' = a x_j + ci, x_j' = b u + cj, with p = x_i.

    The bounds of T are ignored. None is returned for another system or q != 2, or if no solution
    of this form has finite costates.
    """
    A, B, c = plant.A, plant.B, plant.c
    if A.shape != (2, 2) or B.shape != (2, 1) or len(aim.d) != 2:
        return None
    i, j = (0, 1) if A[0, 1] else (1, 0)
    if A[i, i] or A[j, j] or A[j, i] or not A[i, j] or B[i, 0] or not B[j, 0]:
        return None
    (c00, c01), (c10, c11) = aim.C.tolist()
    d0, d1 = aim.d.tolist()
    det = c00 * c11 - c01 * c10
    if abs(det) <= 1e-12 * (c00 * c00 + c01 * c01 + c10 * c10 + c11 * c11):
        return None
    final = ((d0 * c11 - d1 * c01) / det, (d1 * c00 - d0 * c10) / det)
    a, b, ci, cj = float(A[i, j]), float(B[j, 0]), float(c[i]), float(c[j])
    x0, limits = problem.x0.tolist(), (float(problem.u_lower[0]), float(problem.u_upper[0]))
    inputs = {a * (b * limit + cj): limit for limit in limits}
    if len(inputs) < 2:
        return None
    begin, p, v = 0.0, x0[i], a * x0[j] + ci
    found = _find_arcs(p, v, final[i], a * final[j] + ci, min(inputs), max(inputs))
    if found is None:
        return None
    arcs, lam_p, lam_v = found
    grid = np.arange(_SAMPLES) / (_SAMPLES - 1)
    t = np.empty(len(arcs) * _SAMPLES)
    x, u, lam = np.empty((len(t), 2)), np.empty((len(t), 1)), np.empty((len(t), 2))
    for k, (w, duration) in enumerate(arcs):
        rows, s = slice(k * _SAMPLES, (k + 1) * _SAMPLES), duration * grid
        t[rows] = begin + s
        x[rows, i] = p + s * (v + w / 2 * s)
        x[rows, j] = (v - ci + w * s) / a
        u[rows, 0] = inputs[w]
        begin, p, v = begin + duration, p + duration * (v + w / 2 * duration), v + w * duration
    x[-1] = final
    lam[:, i] = aim.rate * lam_p
    lam[:, j] = aim.rate * a * (lam_v + lam_p * (begin - t))
    slope = lam[:, i] * (a * x[:, j] + ci) + lam[:, j] * (b * u[:, 0] + cj)
    return Solution(
        status=Status.SOLVED, message=describe_switches(begin, len(arcs) - 1),
        objective=aim.rate * begin + aim.V, t=t, x=x, u=u, lam=lam,
        hamiltonian=aim.rate + slope, nu=np.linalg.solve(aim.C.T, lam[-1]), interpolation='zoh',
        switching_times=np.array([duration for _, duration in arcs[:-1]]),
        optimality=Optimality('global', 'closed form of the double integrator'))


def _find_arcs(p0: float, v0: float, pf: float, vf: float, low: float, high: float
               ) -> tuple[Arcs, float, float] | None:
    """Return the time-optimal arcs from (p0, v0) to (pf, vf), and the costates of p and v at T."""
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
        return ([(w1, t1), (w2, t2)], -1 / speed, t2 / speed) if (w2 - w1) * speed < 0 else None
    w, other = (w1, w2) if t1 > 0 else (w2, w1)
    # One arc: lam_p = 0 gives lam_v w = -1; w, not the other limit, must minimise lam_v w.
    return ([(w, T)], 0.0, -1 / w) if w * (w - other) > 0 else None


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
