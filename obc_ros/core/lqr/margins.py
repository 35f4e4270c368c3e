# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Poles, stability margins and step figures of a state feedback u = -K x; see docs/regulator.md.

One frequency sweep of the closed loop gives all margins.
"""

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import NamedTuple, Protocol

import numpy as np
from obc_ros.core.lqr.step_figures import compute_step_figures, SetPointSteps
from obc_ros.core.numerics.arrays import Array, Complex, linalg
from obc_ros.core.text.tables import Tabulated

_POINTS = 400  # frequencies of the sweep, besides those near each mode
_TURN = 0.25    # radians by which a delay turns between two of them
_AT_ONCE = 1_000_000  # numbers of T that are evaluated at once


@dataclass(frozen=True, eq=False, repr=False)
class Figures(Tabulated):
    """
    Poles, margins and step figures of a closed loop.

    :ivar poles: (n,), complex, [rad/s]; for a sampled loop the equivalent log(z) / period.
    :ivar damping, frequency: (n,), damping ratio and natural frequency [rad/s] of each pole.
    :ivar gain_margin, gain_reduction_margin: (m,), upper and lower limit of a factor of each loop
        gain; inf and 0: no limit.
    :ivar phase_margin: (m,), [rad]; inf if the loop gain never crosses 1.
    :ivar disk_margin: (m,), largest alpha such that the loop is stable for every factor in the
        disk with the diameter (2 - alpha) / (2 + alpha) to (2 + alpha) / (2 - alpha).
    :ivar delay_margin: (m,), delay of the input beyond that of the loop for which the loop is no
        longer stable [s]; inf: none. Of a plant that is given in discrete time it is exact in
        whole periods.
    :ivar bandwidth: (m,), [rad/s] highest frequency at which the loop gain crosses 1; 0: none.
    :ivar sensitivity_peak: largest singular value of S over frequency.
    :ivar rise_time, overshoot, settling_time: (n,), unit step of the set point of each state that
        can be held at any value: 10 % to 90 % [s], a fraction, to within 2 % [s]. nan: the state
        cannot be held, or the loop is not stable.
    :ivar peak_input: (m,), largest |u| over these steps; nan if there is none.
    """

    poles: Complex
    damping: Array
    frequency: Array
    gain_margin: Array
    gain_reduction_margin: Array
    phase_margin: Array
    disk_margin: Array
    delay_margin: Array
    bandwidth: Array
    sensitivity_peak: float
    rise_time: Array
    overshoot: Array
    settling_time: Array
    peak_input: Array


class Margins(NamedTuple):
    """The margins of the loop of each input, named and shaped as in `Figures`."""

    gain_margin: Array
    gain_reduction_margin: Array
    phase_margin: Array
    disk_margin: Array
    delay_margin: Array
    bandwidth: Array
    sensitivity_peak: float


class Transfer(Protocol):
    """T at frequencies (N,) [rad/s]: the answer u = -T w to disturbances at the plant's input."""

    def whole(self, w: Array) -> Complex:
        """Return T, shape (N, m, m)."""

    def loop(self, w: Array, i: int) -> Complex:
        """Return T_ii, shape (N,)."""


def compute_margins(A: Array, B: Array, K: Array, period: float = 0.0, states: int | None = None
                    ) -> Figures:
    """
    Return the figures of the feedback u = -K x of dx/dt = A x + B u, or of x+ = A x + B u.

    :param A, B, K: (n, n), (n, m), (m, n), a stable closed loop.
    :param period: sampling period [s]; 0: continuous time.
    :param states: number of states whose steps are evaluated: those before the states of the
        controller.
    """
    M = A - B @ K
    modes, V = (np.asarray(part, dtype=complex) for part in np.linalg.eig(M))
    poles = np.sort_complex(to_s_plane(modes, period))
    plant = to_s_plane(np.asarray(np.linalg.eigvals(A), dtype=complex), period)
    margins = sweep_loops(_Transfer(M, B, K, modes, V, period), B.shape[1],
                          choose_frequencies(poles, plant, period), period)
    return combine_figures(poles, margins, compute_step_figures(A, B, K, poles, period, states))


def combine_figures(poles: Complex, margins: Margins, steps: SetPointSteps) -> Figures:
    """Return the figures of a loop from its poles in the s plane, its margins and its steps."""
    frequency = np.abs(poles)
    return Figures(poles=poles, damping=-poles.real / np.maximum(frequency, 1e-300),
                   frequency=frequency, **margins._asdict(), **steps._asdict())


def to_s_plane(modes: Complex, period: float) -> Complex:
    """
    Return modes in the s plane; a mode at z = 0, a delay, becomes a very fast one.

    :param period: sampling period [s]; 0: the modes are in the s plane.
    """
    if not period:
        return modes
    small = np.abs(modes) < 1e-12
    return np.asarray(np.log(modes + 1e-12 * small) / period, dtype=complex)


class _Transfer:
    """T = K (s I - M)^-1 B over frequency, from the modes of M or from its Schur form."""

    def __init__(self, M: Array, B: Array, K: Array, modes: Complex, V: Complex, period: float
                 ) -> None:
        self._period = period
        self._is_modal = bool(np.linalg.cond(V) < 1e7)
        self._inner: Complex = modes
        if not self._is_modal:
            self._inner, V = (
                np.asarray(each, dtype=complex) for each in linalg.schur(M, 'complex'))
        self._left: Complex = K.astype(complex) @ V
        self._right = np.asarray(np.linalg.solve(V, B.astype(complex)), dtype=complex)

    def _points(self, w: Array) -> Complex:
        s = np.asarray(1j * w, dtype=complex)
        return np.exp(s * self._period) if self._period else s

    def whole(self, w: Array) -> Complex:
        """Return T at frequencies (N,) [rad/s], shape (N, m, m)."""
        points = self._points(w)
        if self._is_modal:
            return np.asarray((self._left / (points[:, None, None] - self._inner)) @ self._right,
                              dtype=complex)
        return self._left @ self._solved(points, self._right).transpose(1, 0, 2)

    def loop(self, w: Array, i: int) -> Complex:
        """Return T_ii, shape (N,)."""
        points = self._points(w)
        if self._is_modal:
            return np.asarray((1.0 / (points[:, None] - self._inner))
                              @ (self._left[i] * self._right[:, i]))
        return np.asarray(self._left[i] @ self._solved(points, self._right[:, [i]])[..., 0])

    def _solved(self, points: Complex, right: Complex) -> Complex:
        """Return (s I - R)^-1 right for a triangular R, shape (n, N, columns)."""
        R, count = self._inner, right.shape[1]
        x = np.empty((len(R), len(points), count), dtype=complex)
        for k in reversed(range(len(R))):
            known = R[k, k + 1:] @ x[k + 1:].reshape(len(R) - k - 1, len(points) * count)
            x[k] = (right[k] + known.reshape(-1, count)) / (points[:, None] - R[k, k])
        return x


def choose_frequencies(poles: Complex, plant: Complex, period: float, delay: float = 0.0) -> Array:
    """
    Return frequencies from below the slowest mode to above the fastest one.

    :param poles, plant: modes of the closed loop and of the plant in the s plane.
    :param period, delay: sampling period, 0 in continuous time, and delay of the loop [s].
    :return: [rad/s], increasing.
    """
    sizes = np.abs(np.concatenate([poles, plant]))
    sizes = sizes[sizes > 1e-9 * sizes.max()]
    top = math.pi / period if period else 1e3 * sizes.max()
    sweep = np.geomspace(min(1e-3 * sizes.min(), 0.1 * top), top, _POINTS)
    around = np.abs(poles.imag)[:, None] + poles.real[:, None] * np.linspace(-4, 4, 17)
    near = around[(around > 0.0) & (around < top)]
    turns = np.arange(1.0, top * delay / _TURN) * (_TURN / delay) if delay else near
    return np.unique(np.concatenate([sweep, near, turns]))


def sweep_loops(transfer: Transfer, m: int, w: Array, period: float) -> Margins:
    """
    Return the margins of the m inputs of a stable loop.

    :param w: frequencies, fine enough that T is smooth between two of them [rad/s].
    :param period: sampling period [s]; 0: continuous time.
    """
    def sensitivity(w: Array) -> Array:
        S = np.eye(m) - transfer.whole(w)
        return np.asarray(np.sqrt(np.linalg.eigvalsh(S.conj().transpose(0, 2, 1) @ S)[:, -1]))

    up, down, phase, disk, late, band = np.empty((6, m))
    for i in range(m):
        def loop(w: Array, i: int = i) -> Complex:
            return transfer.loop(w, i)

        T = loop(w)
        up[i], down[i] = _gain_margins(loop, w, T, period)
        phase[i], late[i], band[i] = _phase_margin(loop, w, T)
        disk[i] = min(2.0, 2.0 / max(_peak(lambda w: np.abs(1.0 - 2.0 * loop(w)), w), 1e-300))
    return Margins(up, down, phase, disk, late, band,
                   _peak(sensitivity, w, max(1, _AT_ONCE // (m * m))))


def _gain_margins(loop: Callable[[Array], Complex], w: Array, T: Complex, period: float
                  ) -> tuple[float, float]:
    """Return the limits of a real factor g of L; 1 + g L = 0 for g = -S / T."""
    ends = np.array([0.0, math.pi / period]) if period else np.array([0.0])
    crossings = np.append(_roots(lambda t: (t * (1.0 - t.conj())).imag, loop, w, T), ends)
    t = loop(crossings)
    t = t[np.abs(t) > 1e-12]
    g = -((1.0 - t) / t).real
    g = np.maximum(g[g > -1e-9], 0.0)
    above, below = g[g > 1.0], g[g < 1.0]
    return (float(above.min(initial=math.inf)), float(below.max(initial=0.0)))


def _phase_margin(loop: Callable[[Array], Complex], w: Array, T: Complex
                  ) -> tuple[float, float, float]:
    """Return phase and delay margin and the highest crossover; |L| = 1 where |T| = |S|."""
    crossovers = _roots(lambda t: np.abs(t) - np.abs(1.0 - t), loop, w, T)
    if not crossovers.size:
        return math.inf, math.inf, 0.0
    t = loop(crossovers)
    angle = np.angle(-t / (1.0 - t))
    return (float(np.abs(angle).min()), float((angle % math.tau / crossovers).min()),
            float(crossovers.max()))


def _roots(what: Callable[[Complex], Array], loop: Callable[[Array], Complex], w: Array,
           T: Complex) -> Array:
    """Return the frequencies at which a function of the loop changes its sign."""
    values = what(T)
    at = np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))
    low, high, sign = w[at], w[at + 1], np.signbit(values[at])
    for _ in range(7):
        inside = low + (high - low) * _PARTS[:, None]
        changed = np.signbit(what(loop(inside.ravel())).reshape(inside.shape)) != sign
        first = np.argmax(changed, axis=0)
        low, high = (np.take_along_axis(inside, np.maximum(first - 1, 0)[None], 0)[0],
                     np.take_along_axis(inside, first[None], 0)[0])
        if np.all(high - low <= 1e-12 * high):
            break
    return 0.5 * (low + high)


_PARTS = np.linspace(0.0, 1.0, 65)


def _peak(figure: Callable[[Array], Array], w: Array, at_once: int = _AT_ONCE) -> float:
    """Return the largest value of a function of frequency; `at_once`: frequencies in a call."""
    values = np.concatenate([figure(w[k:k + at_once]) for k in range(0, len(w), at_once)])
    best = float(values.max())
    at = int(values.argmax())
    low, high = w[max(at - 1, 0)], w[min(at + 1, len(w) - 1)]
    for _ in range(3):
        inside = low + (high - low) * _PARTS
        values = figure(inside)
        at = int(values.argmax())
        best = max(best, float(values[at]))
        low, high = inside[max(at - 1, 0)], inside[min(at + 1, 64)]
    return best
