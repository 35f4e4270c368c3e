# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rise time, overshoot, settling time and peak input of steps of the set point."""

from collections.abc import Callable
from functools import cache
import math
from typing import NamedTuple

import numpy as np
from obc_ros.core.lqr.held_loop import HeldLoop
from obc_ros.core.numerics.arrays import Array, Complex, linalg

_SAMPLES = 1024  # samples of a step response
_MOST_PARTS = 32  # samples between two commands


class SetPointSteps(NamedTuple):
    """
    Figures of a unit step of the set point of each state that can be held at any value.

    `rise_time`, `overshoot` and `settling_time` (n,) and `peak_input` (m,) as in `Figures`.
    """

    rise_time: Array
    overshoot: Array
    settling_time: Array
    peak_input: Array


class _Fall(NamedTuple):
    """The decay of a unit error: times, error, its first and second derivative, and K x (N, m)."""

    t: Array
    x: Array
    rate: Array
    bend: Array
    u: Array


def compute_step_figures(A: Array, B: Array, K: Array, poles: Complex, period: float = 0.0,
                         states: int | None = None) -> SetPointSteps:
    """
    Return the step figures of the feedback u = -K x of dx/dt = A x + B u, or x+ = A x + B u.

    :param poles: (n,), those of the loop in the s plane.
    :param states: number of states whose steps are evaluated: those before the states of the
        controller.
    """
    n = len(A) if states is None else states
    M, rest = A - B @ K, (A - np.eye(len(A)) if period else A)[:n, :n]

    def fall(i: int, _: Array, length: float) -> _Fall:
        if period:
            step, dt = M, period
            count = max(2, min(_SAMPLES * 16, math.ceil(length / period)))
        else:
            dt = length / _SAMPLES
            step, count = linalg.expm(M * dt), _SAMPLES
        t, x = dt * np.arange(count + 1, dtype=float), _iterate(step, np.eye(len(M))[i], count)
        if period:
            rate = np.gradient(x[:, i], t)
            return _Fall(t, x[:, i], rate, rate * 0.0, x @ K.T)
        return _Fall(t, x[:, i], (x @ M.T)[:, i], x @ (M @ M)[i], x @ K.T)

    return _measure_steps(fall, rest, B[:n], poles)


def compute_held_steps(loop: HeldLoop, poles: Complex) -> SetPointSteps:
    """Return the step figures of a held loop, also between the samples; poles in the s plane."""
    n, size = len(loop.A), len(loop.K[0])

    @cache
    def between(parts: int) -> Array:
        return np.array([loop.move(loop.period * k / parts) for k in range(parts)])

    def fall(i: int, held: Array, length: float) -> _Fall:
        often = math.ceil(length / loop.period / (16 * _SAMPLES))   # periods in a step
        count = max(2, math.ceil(length / (often * loop.period)))
        parts = 1 if often > 1 else min(_MOST_PARTS, math.ceil(_SAMPLES / count))
        begin = np.concatenate([np.eye(size)[i], np.tile(held, (len(loop.matrix) - size)
                                                         // len(held))])
        states = _iterate(np.linalg.matrix_power(loop.matrix, often), begin, count)[:-1]
        t = often * loop.period / parts * np.arange(count * parts, dtype=float)
        x = (states @ between(parts)[:, i].T).ravel()
        rate = np.gradient(x, t)
        return _Fall(t, x, rate, rate * 0.0, -states @ loop.command.T)

    return _measure_steps(fall, loop.A[:n, :n], loop.B, poles)


def _measure_steps(fall: Callable[[int, Array, float], _Fall], rest: Array, B: Array,
                   poles: Complex) -> SetPointSteps:
    """Return the figures; rest e_i + B u = 0 holds state i at any value."""
    n, m = B.shape
    rise, over, settled = np.full((3, n), math.nan)
    peak: Array = np.full(m, math.nan)
    slowest = -poles.real.max()
    for i in range(n) if slowest > 0.0 else ():
        held: Array = np.asarray(np.linalg.lstsq(B, -rest[:, i], rcond=None)[0], dtype=float)
        if np.abs(B @ held + rest[:, i]).max() > 1e-9 * max(np.abs(rest).max(), 1e-300):
            continue
        length = 10.0 / slowest
        for _ in range(3):
            t, x, rate, bend, u = fall(i, held, length)
            last = _settling_time(t, x)
            if last > 0.1 * t[-1] or len(t) < _SAMPLES:
                break
            length = 4.0 * last if last > 0.0 else 0.1 * length
        rise[i], settled[i] = _rise_time(t, 1.0 - x, -rate), last
        over[i] = max(0.0, -_lowest(x, rate, bend))
        peak = np.fmax(peak, np.abs(u + held).max(axis=0))
    return SetPointSteps(rise, over, settled, peak)


def _lowest(x: Array, rate: Array, bend: Array) -> float:
    """Return the minimum, refined by a parabola at the lowest sample where it is convex."""
    k = int(np.argmin(x))
    inside = 0 < k < len(x) - 1 and bend[k] > 0.0
    return float(x[k] - (rate[k]**2 / (2.0 * bend[k]) if inside else 0.0))


def _iterate(step: Array, x: Array, count: int) -> Array:
    """Return x, step x, step^2 x, ..., shape (count + 1, n)."""
    found = x[None]
    while len(found) <= count:
        found = np.concatenate([found, found @ step.T])
        step = step @ step
    return found[:count + 1]


def _rise_time(t: Array, y: Array, rate: Array) -> float:
    """Return the time from the first crossing of 0.1 to the first of 0.9, or nan."""
    times = []
    for level in (0.1, 0.9):
        k = int(np.argmax(y >= level))
        if y[k] < level or k == 0:
            return math.nan
        times.append(_crossing(t[k - 1:k + 1], y[k - 1:k + 1] - level, rate[k - 1:k + 1]))
    return float(times[1] - times[0])


def _crossing(t: Array, y: Array, rate: Array) -> float:
    """Return the zero of the Hermite cubic with these values and slopes; y[0] < 0 <= y[1]."""
    h, rise = t[1] - t[0], y[1] - y[0]
    cubic = np.polynomial.Polynomial([
        y[0], h * rate[0], 3 * rise - h * (2 * rate[0] + rate[1]), h * rate.sum() - 2 * rise])
    slope, share = cubic.deriv(), -y[0] / rise
    for _ in range(3):
        share = min(max(share - cubic(share) / slope(share), 0.0), 1.0) if slope(share) else share
    return float(t[0] + h * share)


def _settling_time(t: Array, error: Array) -> float:
    """Return the time after which |error| stays below 0.02."""
    late = np.flatnonzero(np.abs(error) > 0.02)
    k = int(late[-1]) if late.size else 0
    if k + 1 >= len(t):
        return float(t[-1])
    share = (abs(error[k]) - 0.02) / (abs(error[k]) - abs(error[k + 1]))
    return float(t[k] + (t[k + 1] - t[k]) * share)
