# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Poles, margins and step figures of the loop that runs, with its hold, delay and prediction.

The loop is opened at the plant's input, after the memory of the prediction: the controller knows
what it has sent, not what has arrived. With z = exp(jw period) the loop is one system of linear
equations in (x, z, u) for a disturbance at the plant's input. A longer delay of input i changes
its column of B(z) from b to b', and the loop has a pole at z if D = 1 + t (b' - b) = 0, where t is
the answer of -u_i to a disturbance of x. D winds around 0 as often as poles have left the circle.
"""

import math

import numpy as np
from obc_ros.core.lqr.held_loop import HeldLoop, weigh_inputs
from obc_ros.core.lqr.margins import (
    choose_frequencies,
    combine_figures,
    Figures,
    Margins,
    sweep_loops,
    to_s_plane,
)
from obc_ros.core.lqr.step_figures import compute_held_steps
from obc_ros.core.numerics.arrays import Array, Complex

_AT_ONCE = 1_000_000   # numbers of the systems that are solved at once
_TRIED = 8             # delays up to the estimated margin at which stability is verified
_BISECTIONS = 10
_NEWTON = 4
_SMALL_D = 0.25
_DENSER = 16            # parts of an interval in which D is small
_SMALL = 1e-6           # relative step of a difference


def compute_held_margins(loop: HeldLoop) -> Figures:
    """
    Return the figures of a loop whose commands are held and delayed.

    The poles are log(z) / period, without those at z = 0 that a delay adds. If the loop is not
    stable, the other figures are nan.
    """
    poles = np.sort_complex(to_s_plane(loop.modes, loop.period))
    steps, m = compute_held_steps(loop, poles), loop.B.shape[1]
    if not loop.radius < 1.0:
        none: Array = np.full(m, math.nan)
        return combine_figures(
            poles, Margins(none, none, none, none, none, none, math.nan), steps)
    plant = np.asarray(np.linalg.eigvals(loop.A), dtype=complex)
    w = choose_frequencies(poles, plant, loop.period, loop.delay)
    transfer = HeldTransfer(loop)
    found = sweep_loops(transfer, m, w, loop.period)
    late = [_find_delay_margin(loop, transfer, i, w, guess)
            for i, guess in enumerate(found.delay_margin.tolist())]
    return combine_figures(poles, found._replace(delay_margin=np.array(late)), steps)


class HeldTransfer:
    """T of a stable held loop, from the equations of (x, z, u) at z = exp(jw period)."""

    def __init__(self, loop: HeldLoop) -> None:
        self._loop = loop
        self._size = sum(loop.K.shape)
        self._count = max(1, _AT_ONCE // self._size**2)

    def whole(self, w: Array) -> Complex:
        """Return T at frequencies (N,) [rad/s], shape (N, m, m)."""
        n, m = self._loop.B.shape
        parts = []
        for z in self._parts(w):
            right = np.zeros((len(z), self._size, m), dtype=complex)
            right[:, :n] = weigh_inputs(z, self._loop.pushed)
            parts.append(-np.linalg.solve(self._loop.build_equations(z), right)[:, -m:])
        return np.concatenate(parts)

    def loop(self, w: Array, i: int) -> Complex:
        """Return T_ii, shape (N,)."""
        return self.push(w, i, self.answer(w, i))

    def answer(self, w: Array, i: int) -> Complex:
        """Return the answer of -u_i to a disturbance of x, shape (N, n)."""
        n, m = self._loop.B.shape
        of = np.zeros((1, self._size, 1))
        of[:, self._size - m + i] = -1.0
        return np.concatenate([
            np.linalg.solve(self._loop.build_equations(z).transpose(0, 2, 1), of)[:, :n, 0]
            for z in self._parts(w)])

    def push(self, w: Array, i: int, answer: Complex, extra: float = 0.0) -> Complex:
        """Return `answer` times the column of input i with a longer delay [s], shape (N,)."""
        k, newer, older = self._loop.push(extra) if extra else self._loop.pushed
        z = self._points(w)
        return np.asarray((answer @ newer[:, i] + answer @ older[:, i] / z) * z**-k)

    def _parts(self, w: Array) -> list[Complex]:
        z = self._points(w)
        return np.split(z, range(self._count, len(z), self._count))

    def _points(self, w: Array) -> Complex:
        return np.asarray(np.exp(1j * w * self._loop.period), dtype=complex)


def _find_delay_margin(loop: HeldLoop, transfer: HeldTransfer, i: int, w: Array, guess: float
                       ) -> float:
    """Return the least longer delay of input i without stability; `guess`: by the phase of T."""
    is_crossed = math.isfinite(guess)   # then the stability ends at some delay
    longest = guess if is_crossed else loop.period
    tried = longest * np.arange(_TRIED + 1) / _TRIED
    if is_crossed:
        tried = np.concatenate([tried, longest + max(loop.period, tried[1]) * 2.0**np.arange(
            _TRIED)])
    sweep = _Sweep(transfer, i, np.concatenate([[0.0], w]))
    high = next((k for k, extra in enumerate(tried) if not sweep.is_stable(extra)), 0)
    if not high:
        return math.inf
    ends = float(tried[high - 1]), float(tried[high])
    sweep = sweep.densify(sweep.bisect(*ends)[0])
    low, until = sweep.bisect(*ends)
    passed = np.abs(sweep.turn(until) - sweep.turn(low)) > math.pi   # where D went over 0
    return min((_refine(transfer, i, float(each), low) for each in sweep.w[:-1][passed]),
               default=low)


class _Sweep:
    """D of an input on the upper half of the circle, for longer delays."""

    def __init__(self, transfer: HeldTransfer, i: int, w: Array) -> None:
        self.w, self._i, self._transfer = w, i, transfer
        self._answer = transfer.answer(w, i)
        self._S = 1.0 - transfer.push(w, i, self._answer)

    def follow(self, extra: float) -> Complex:
        """Return D at the frequencies."""
        return np.asarray(
            self._S + self._transfer.push(self.w, self._i, self._answer, extra))

    def turn(self, extra: float) -> Array:
        """Return the angles by which D turns between the frequencies."""
        D = self.follow(extra)
        return np.angle(D[1:] / D[:-1])

    def is_stable(self, extra: float) -> bool:
        """Return whether D does not wind around 0."""
        return bool(abs(self.turn(extra).sum()) < 0.5 * math.pi)

    def bisect(self, low: float, high: float) -> tuple[float, float]:
        """Return a stable and an unstable delay next to each other."""
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.is_stable(middle) else (low, middle)
        return low, high

    def densify(self, extra: float) -> '_Sweep':
        """Return the sweep with more frequencies where D is small."""
        size = np.abs(self.follow(extra))
        lowest = 1 + np.flatnonzero((size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:])
                                    & (size[1:-1] < _SMALL_D))
        parts = np.linspace(0.0, 1.0, _DENSER + 1)
        more = [self.w[k] + (self.w[k + 1] - self.w[k]) * parts
                for at in lowest for k in (at - 1, at)]
        return _Sweep(self._transfer, self._i, np.unique(np.concatenate([self.w, *more])))


def _refine(transfer: HeldTransfer, i: int, w: float, extra: float) -> float:
    """Return the delay near `extra` for which D is 0 at a frequency near w (Newton's method)."""
    for _ in range(_NEWTON):
        sweep = _Sweep(transfer, i, w * np.array([1.0, 1.0 + _SMALL]))
        here, beside = sweep.follow(extra)
        later = sweep.follow(extra * (1.0 + _SMALL))[0]
        slope = np.array([(beside - here) / (_SMALL * w), (later - here) / (_SMALL * extra)])
        step = np.linalg.solve(np.stack([slope.real, slope.imag]), [-here.real, -here.imag])
        w, extra = w + float(step[0]), extra + float(step[1])
    return extra
