# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Poles, stability margins and step figures of a state feedback u = -K x.

With T(s) = K (s I - A + B K)^-1 B the sensitivity at the plant's input is S = I - T. The loop gain
at input i, with the other loops closed, is L = 1 / S_ii - 1. One frequency sweep of the closed
loop therefore gives all margins.
"""

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, Complex, linalg

_POINTS = 400  # frequencies of the sweep, besides those near each mode
_SAMPLES = 1024  # samples of a step response
_AT_ONCE = 1_000_000  # numbers of T that are evaluated at once


@dataclass(frozen=True, eq=False)
class Figures:
    """
    Poles, margins and step figures of a closed loop.

    Attributes
    ----------
    poles : ndarray, shape (n,), complex
        [rad/s]; for a sampled loop the equivalent log(z) / period.
    damping, frequency : ndarray, shape (n,)
        Damping ratio and natural frequency [rad/s] of each pole.
    gain_margin, gain_reduction_margin : ndarray, shape (m,)
        Upper and lower limit of a factor of each loop gain; inf and 0: no limit.
    phase_margin : ndarray, shape (m,)
        [rad]; inf if the loop gain never crosses 1.
    disk_margin : ndarray, shape (m,)
        Largest alpha such that the loop is stable for every factor in the disk with the diameter
        (2 - alpha) / (2 + alpha) to (2 + alpha) / (2 - alpha).
    bandwidth : ndarray, shape (m,)
        [rad/s] highest frequency at which the loop gain crosses 1; 0: none.
    sensitivity_peak : float
        Largest singular value of S over frequency.
    rise_time, overshoot, settling_time : ndarray, shape (n,)
        Unit step of the set point of each state that can be held at any value: 10 % to 90 % [s],
        a fraction, to within 2 % [s]. nan: the state cannot be held, or the loop is not stable.
    peak_input : ndarray, shape (m,)
        Largest |u| over these steps; nan if there is none.

    """

    poles: Complex
    damping: Array
    frequency: Array
    gain_margin: Array
    gain_reduction_margin: Array
    phase_margin: Array
    disk_margin: Array
    bandwidth: Array
    sensitivity_peak: float
    rise_time: Array
    overshoot: Array
    settling_time: Array
    peak_input: Array


def compute_margins(A: Array, B: Array, K: Array, period: float = 0.0, states: int | None = None
                    ) -> Figures:
    """
    Return the figures of the feedback u = -K x of dx/dt = A x + B u, or of x+ = A x + B u.

    Parameters
    ----------
    A, B, K : ndarray, shape (n, n), (n, m), (m, n)
        A stable closed loop.
    period : float
        Sampling period [s]; 0: continuous time.
    states : int, optional
        Number of states whose steps are evaluated: those before the states of the controller.

    Returns
    -------
    Figures

    """
    M = A - B @ K
    modes, V = (np.asarray(part, dtype=complex) for part in np.linalg.eig(M))
    poles = np.sort_complex(_continuous(modes, period))
    frequency = np.abs(poles)
    damping = -poles.real / np.maximum(frequency, 1e-300)
    plant = _continuous(np.asarray(np.linalg.eigvals(A), dtype=complex), period)
    loop = _margins(_Transfer(M, B, K, modes, V, period), B.shape[1],
                    _grid(poles, plant, period), period)
    steps = compute_step_figures(A, B, K, poles, period, states)
    gain, reduction, phase, disk, bandwidth, sensitivity = loop
    rise, overshoot, settling, peak = steps
    return Figures(
        poles=poles, damping=damping, frequency=frequency, gain_margin=gain,
        gain_reduction_margin=reduction, phase_margin=phase, disk_margin=disk,
        bandwidth=bandwidth, sensitivity_peak=sensitivity, rise_time=rise, overshoot=overshoot,
        settling_time=settling, peak_input=peak)


def _continuous(modes: Complex, period: float) -> Complex:
    """Return modes in the s plane; a mode at z = 0, a delay, becomes a very fast one."""
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


def _grid(poles: Complex, plant: Complex, period: float) -> Array:
    """Return frequencies [rad/s] from below the slowest mode to above the fastest one."""
    sizes = np.abs(np.concatenate([poles, plant]))
    sizes = sizes[sizes > 1e-9 * sizes.max()]
    top = math.pi / period if period else 1e3 * sizes.max()
    sweep = np.geomspace(min(1e-3 * sizes.min(), 0.1 * top), top, _POINTS)
    around = np.abs(poles.imag)[:, None] + poles.real[:, None] * np.linspace(-4, 4, 17)
    near = around[(around > 0.0) & (around < top)]
    return np.unique(np.concatenate([sweep, near]))


def _margins(transfer: _Transfer, m: int, w: Array, period: float
             ) -> tuple[Array, Array, Array, Array, Array, float]:
    def sensitivity(w: Array) -> Array:
        S = np.eye(m) - transfer.whole(w)
        return np.asarray(np.sqrt(np.linalg.eigvalsh(S.conj().transpose(0, 2, 1) @ S)[:, -1]))

    up, down, phase, disk, band = np.empty((5, m))
    for i in range(m):
        def loop(w: Array, i: int = i) -> Complex:
            return transfer.loop(w, i)

        T = loop(w)
        up[i], down[i] = _gain_margins(loop, w, T, period)
        phase[i], band[i] = _phase_margin(loop, w, T)
        disk[i] = min(2.0, 2.0 / max(_peak(lambda w: np.abs(1.0 - 2.0 * loop(w)), w), 1e-300))
    return up, down, phase, disk, band, _peak(sensitivity, w, max(1, _AT_ONCE // (m * m)))


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


def _phase_margin(loop: Callable[[Array], Complex], w: Array, T: Complex) -> tuple[float, float]:
    """Return the phase margin and the highest crossover; |L| = 1 where |T| = |S|."""
    crossovers = _roots(lambda t: np.abs(t) - np.abs(1.0 - t), loop, w, T)
    if not crossovers.size:
        return math.inf, 0.0
    t = loop(crossovers)
    return float(np.abs(np.angle(-t / (1.0 - t))).min()), float(crossovers.max())


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


def compute_step_figures(A: Array, B: Array, K: Array, poles: Complex, period: float = 0.0,
                         states: int | None = None) -> tuple[Array, Array, Array, Array]:
    """
    Return rise time, overshoot, settling time and peak input, as in `Figures`.

    The parameters are those of `compute_margins`. `poles` are the closed-loop poles in the s
    plane.
    """
    states = len(A) if states is None else states
    n, m = B.shape
    rise, over, settled = np.full((3, states), math.nan)
    peak: Array = np.full(m, math.nan)
    M = A - B @ K
    rest = A - np.eye(n) if period else A
    slowest = -poles.real.max()
    if not slowest > 0.0:
        return rise, over, settled, peak
    for i in range(states):
        held = np.linalg.lstsq(B, -rest[:, i], rcond=None)[0]
        if np.abs(B @ held + rest[:, i]).max() > 1e-9 * max(np.abs(rest).max(), 1e-300):
            continue
        length = 10.0 / slowest
        for _ in range(3):
            t, x = _fall(M, i, length, period)
            last = _settling_time(t, x[:, i])
            if last > 0.1 * t[-1] or len(t) < _SAMPLES:
                break
            length = 4.0 * last if last > 0.0 else 0.1 * length
        rate = np.gradient(x[:, i], t) if period else (x @ M.T)[:, i]
        rise[i], settled[i] = _rise_time(t, 1.0 - x[:, i], -rate), last
        over[i] = max(0.0, -_lowest(x[:, i], rate, x @ (M @ M)[i] if not period else rate * 0.0))
        peak = np.fmax(peak, np.abs(x @ K.T + held).max(axis=0))
    return rise, over, settled, peak


def _lowest(x: Array, rate: Array, bend: Array) -> float:
    """Return the minimum, refined by a parabola at the lowest sample where it is convex."""
    k = int(np.argmin(x))
    inside = 0 < k < len(x) - 1 and bend[k] > 0.0
    return float(x[k] - (rate[k]**2 / (2.0 * bend[k]) if inside else 0.0))


def _fall(M: Array, i: int, length: float, period: float) -> tuple[Array, Array]:
    """Return times and the error of all states after a unit error of state i."""
    if period:
        step, dt = M, period
        count = max(2, min(_SAMPLES * 16, math.ceil(length / period)))
    else:
        dt = length / _SAMPLES
        step, count = linalg.expm(M * dt), _SAMPLES
    x = np.eye(len(M))[i:i + 1]
    while len(x) <= count:
        x = np.concatenate([x, x @ step.T])
        step = step @ step
    t: Array = dt * np.arange(count + 1, dtype=float)
    return t, x[:count + 1]


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
