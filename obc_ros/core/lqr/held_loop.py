# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The loop that runs: a state feedback whose commands are held and act after a delay.

    x' = A x + B v,   v(t) = u_k for t in [t_k + delay, t_k + delay + period),
    u_k = -K (Phi (x_k, z_k) + Gamma_1 u_(k-1) + Gamma_2 u_(k-2) + ...),
    z_k = z_(k-1) + period / 2 C (x_(k-1) + x_k).

z are the integrals of the controller. Without a delay Phi = I and there are no Gamma.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, Complex, linalg
from obc_ros.core.numerics.rounding import EPS

_WHOLE = 1e-9         # of a period; a delay this near to a multiple of the period is rounded to it
_STEP = 2.0**0.125    # ratio of the periods that are tried
_TURN = 0.5           # radians of a mode between two of them
_SETTLED = 40.0       # time constants after which a mode is gone
_SMALL = 100          # commands that are on the way
_AT_ONCE = 16         # periods without a delay that are judged together, for speed
_ROUNDED = 1e3 * EPS  # of a modulus
_PER_COMMAND = 16     # points of the upper half circle
_EXACT = 1e-6         # relative accuracy of the longest period


@dataclass(frozen=True, eq=False)
class HeldLoop:
    """
    A plant, its feedback, and the times of its commands.

    :ivar A, B: (n, n) and (n, m), the plant in continuous time.
    :ivar C: (p, n), outputs whose integrals are fed back.
    :ivar K: (m, n + p), gain of the state and of the integrals.
    :ivar period, delay: time for which a command is held, and from a command to its effect [s].
    :ivar foreseen: period for which the prediction over the delay was computed [s].
    """

    A: Array
    B: Array
    C: Array
    K: Array
    period: float
    delay: float
    foreseen: float

    def push(self, extra: float = 0.0) -> tuple[int, Array, Array]:
        """
        Return k, B_k, B_(k+1) with x_(i+1) = Ad x_i + B_k u_(i-k) + B_(k+1) u_(i-k-1).

        :param extra: time that is added to the delay [s].
        """
        k, rest = split_delay(self.period, self.delay + extra)
        newer = discretize_plant(self.A, self.B, self.period - rest)[1]
        return k, newer, self.plant[1] - newer

    @cached_property
    def pushed(self) -> tuple[int, Array, Array]:
        """Return `push()`."""
        return self.push()

    @cached_property
    def plant(self) -> tuple[Array, Array]:
        """Return Ad (n, n) and Bd (n, m) of the plant whose input is held without a delay."""
        return discretize_plant(self.A, self.B, self.period)

    @cached_property
    def prediction(self) -> tuple[Array, tuple[Array, ...]]:
        """
        Return Phi (n + p, n + p) and the Gammas (n + p, m), the one of the last command first.

        A command that is held for several foreseen periods counts for each of them.
        """
        n, p, m = len(self.A), len(self.C), self.B.shape[1]
        if not self.delay:
            return np.eye(n + p), ()
        A, B = np.zeros((n + p, n + p)), np.zeros((n + p, m))
        A[:n, :n], A[n:, :n], B[:n] = self.A, self.C, self.B
        Phi, Gammas = predict_delayed_state(A, B, self.foreseen, self.delay)
        often = max(1, round(self.period / self.foreseen))
        return Phi, tuple(np.sum(Gammas[k:k + often], axis=0)
                          for k in range(0, len(Gammas), often))

    @property
    def command(self) -> Array:
        """Return the row blocks of u_k over (x_k, z_k, u_(k-1), ..., u_(k-d)), (m, size)."""
        Phi, Gammas = self.prediction
        m, known = len(self.K), [self.K @ Phi, *(self.K @ Gamma for Gamma in Gammas)]
        return -np.concatenate(
            [*known, np.zeros((m, (self._past - len(Gammas)) * m))], axis=1)

    @property
    def _past(self) -> int:
        k, rest = split_delay(self.period, self.delay)
        return max(k + bool(rest), len(self.prediction[1]))

    def move(self, time: float) -> Array:
        """
        Return the state of the plant at t_k + time over (x_k, z_k, u_(k-1), ..., u_(k-d)).

        :param time: from 0 to the period [s].
        """
        n, p, m = len(self.A), len(self.C), self.B.shape[1]
        k, rest = split_delay(self.period, self.delay)
        found = np.eye(n, n + p + self._past * m)
        for length, age in ((min(time, rest), k + 1), (max(0.0, time - rest), k)):
            if length:
                step, push = self.plant if length == self.period else discretize_plant(
                    self.A, self.B, length)
                found = step @ found + push @ self._recall(age)
        return found

    def _recall(self, age: int) -> Array:
        """Return the rows of u_(k-age)."""
        m = self.B.shape[1]
        if not age:
            return self.command
        begin = len(self.K[0]) + (age - 1) * m
        return np.eye(m, len(self.K[0]) + self._past * m, begin)

    @cached_property
    def matrix(self) -> Array:
        """Return the loop of (x_k, z_k, u_(k-1), ..., u_(k-d)), shape (n + p + d m, ..)."""
        n, p = self.A.shape[0], len(self.C)
        x = self.move(self.period)
        seen = np.eye(*x.shape)
        z = np.eye(p, x.shape[1], n) + 0.5 * self.period * self.C @ (seen + x)
        return np.concatenate(
            [x, z, *(self._recall(age) for age in range(self._past))])

    def build_equations(self, z: Complex) -> Complex:
        """
        Return the matrix of the equations of (x, z, u) over their values at points z.

        :param z: (N,), such as exp(jw period).
        :return: (N, n + p + m, n + p + m), its determinant is 0 at the modes of the loop.
        """
        (n, m), p = self.B.shape, len(self.C)
        Phi, Gammas = self.prediction
        F = np.zeros((len(z), n + p + m, n + p + m), dtype=complex)
        F[:, :n, :n] = -self.plant[0]
        F[:, range(n), range(n)] += z[:, None]
        F[:, :n, n + p:] = -weigh_inputs(z, self.pushed)
        F[:, n:n + p, :n] = -0.5 * self.period * (z + 1.0)[:, None, None] * self.C
        F[:, range(n, n + p), range(n, n + p)] = (z - 1.0)[:, None]
        F[:, n + p:, :n + p] = self.K @ Phi
        F[:, n + p:, n + p:] = np.eye(m)
        if Gammas:
            ages = np.cumprod(np.tile(1.0 / z[:, None], len(Gammas)), axis=1)
            F[:, n + p:, n + p:] += (ages @ np.array([
                (self.K @ Gamma).ravel() for Gamma in Gammas])).reshape(-1, m, m)
        return F

    @property
    def is_small(self) -> bool:
        """Return whether the modes are found in less than some 10 ms."""
        return (self._past * len(self.K)) <= _SMALL

    @property
    def is_finite(self) -> bool:
        """Return whether the motion in a period is within the range of double precision."""
        with np.errstate(all='ignore'):
            return all(np.isfinite(each).all() for each in self.plant)

    @property
    def modes_without_delay(self) -> Complex:
        """Return the modes in the z plane of the same gain without a delay, shape (n + p,)."""
        return np.asarray(np.linalg.eigvals(
            self.close_without_delay(np.array(self.period))), dtype=complex)

    def close_without_delay(self, periods: Array) -> Array:
        """Return the loops of (x_k, z_k) of the same gain without a delay, for some periods."""
        n, p = len(self.A), len(self.C)
        Ad, Bd = discretize_plant(self.A, self.B, periods)
        x = Ad @ np.eye(n, n + p) - Bd @ self.K
        integrated = 0.5 * periods[..., None, None] * (self.C @ (np.eye(n, n + p) + x))
        return np.concatenate([x, np.eye(p, n + p, n) + integrated], axis=-2)

    @cached_property
    def modes(self) -> Complex:
        """
        Return the modes of the loop in the z plane, shape (n + p,).

        Those at 0 that a delay adds are left out: if what is predicted comes true, the loop has
        the modes of the loop without delay. Otherwise they are the n + p slowest ones.
        """
        if self.delay and self.period == self.foreseen and not len(self.C):
            return self.modes_without_delay
        found = np.asarray(np.linalg.eigvals(self.matrix), dtype=complex)
        return found[np.argsort(-np.abs(found))[:len(self.K[0])]]

    @property
    def radius(self) -> float:
        """Return the spectral radius; the loop is stable if it is below 1."""
        return float(np.abs(self.modes).max()) if self.is_finite else math.inf


def discretize_plant(A: Array, B: Array, time: float | Array) -> tuple[Array, Array]:
    """
    Return Ad, Bd of x(t + time) = Ad x(t) + Bd u for dx/dt = A x + B u with a constant u.

    :param time: time for which the input is held [s], or such times, of any shape.
    """
    n, m = B.shape
    M = np.zeros((n + m, n + m))
    M[:n, :n], M[:n, n:] = A, B
    flow = linalg.expm(M * np.asarray(time)[..., None, None])
    return flow[..., :n, :n], flow[..., :n, n:]


def predict_delayed_state(A: Array, B: Array, period: float,
                          delay: float) -> tuple[Array, tuple[Array, ...]]:
    """
    Return Phi, Gamma with x(t_k + delay) = Phi x_k + Gamma_1 u_(k-1) + Gamma_2 u_(k-2) + ...

    The times are in seconds; the matrix of the last command is first.
    """
    whole, rest = split_delay(period, delay)
    carried = np.eye(len(A))
    gammas: list[Array] = []
    # The oldest command acts for the rest of a period, every later one for a whole period.
    for length in ([rest] if rest else []) + [period] * whole:
        step, push = discretize_plant(A, B, length)
        gammas = [step @ gamma for gamma in gammas] + [push]
        carried = step @ carried
    return carried, tuple(reversed(gammas))


def split_delay(period: float, delay: float) -> tuple[int, float]:
    """Return the number of whole periods in a delay [s], and the remainder [s]."""
    whole = math.floor(delay / period + _WHOLE)
    rest = delay - whole * period
    return whole, rest if rest > _WHOLE * period else 0.0


def weigh_inputs(z: Complex, push: tuple[int, Array, Array]) -> Complex:
    """Return B(z) (N, n, m) of x = (z - Ad)^-1 B(z) u at points z (N,), from `HeldLoop.push`."""
    k, newer, older = push
    ages = np.stack([z**-k, z**-(k + 1)], axis=1)
    found = ages @ np.stack([newer.ravel(), older.ravel()])
    return np.asarray(found.reshape(-1, *newer.shape), dtype=complex)


def find_longest_period(loop: HeldLoop) -> float:
    """
    Return the longest period of the commands [s] up to which a loop stays stable.

    :param loop: the controller, at a period at which it is stable.
    :return: every period from that of the loop to this one is stable, as far as the modes of the
        plant turn by less than half a radian between two periods that are tried. inf: there is no
        longest one. The period of the loop: it is not stable there.
    """
    at_once = 1 if loop.delay else _AT_ONCE
    stable, longer = loop.period, _longer_periods(loop)
    while len(tried := np.fromiter(islice(longer, at_once), float)):
        stable, unstable = _find_last_stable(loop, stable, tried)
        if unstable < math.inf:
            break
    else:
        return math.inf
    while unstable - stable > _EXACT * unstable:
        between = np.linspace(stable, unstable, at_once + 2)[1:-1]
        stable, found = _find_last_stable(loop, stable, between)
        unstable = min(found, unstable)
    return stable


def _find_last_stable(loop: HeldLoop, stable: float, periods: Array) -> tuple[float, float]:
    """Return the last period before one without stability, and that one; inf: all are stable."""
    if loop.delay:
        are_stable = np.array([
            _is_stable(replace(loop, period=each)) for each in periods.tolist()])
    else:
        with np.errstate(all='ignore'):
            closed = loop.close_without_delay(periods)
        are_stable = np.asarray(np.isfinite(closed).all(axis=(1, 2)))
        modes = np.linalg.eigvals(closed[are_stable])
        are_stable[are_stable] = np.abs(modes).max(axis=1) < 1.0 + _ROUNDED
    until = [stable, *periods.tolist(), math.inf]
    first = len(periods) if are_stable.all() else int(np.argmin(are_stable))
    return until[first], until[first + 1]


def _is_stable(loop: HeldLoop) -> bool:
    return loop.is_finite and (
        loop.radius < 1.0 + _ROUNDED if loop.is_small else _winds_around(loop))


def _winds_around(loop: HeldLoop) -> bool:
    """
    Return whether all modes are inside the circle, from the determinant F on it.

    F has n + p zeros more than poles, which are all at 0. It winds around 0 as often as it has
    more zeros than poles inside the circle.
    """
    size = len(loop.K[0])
    modes = np.concatenate([np.log(loop.modes_without_delay), np.linalg.eigvals(loop.A)
                            * loop.period])
    turns = np.linspace(0.0, math.pi, _PER_COMMAND * (len(loop.prediction[1]) + size))
    slow = np.abs(modes[np.abs(modes) > 1e-9]).min(initial=1.0)
    around = np.abs(modes.imag)[:, None] + modes.real[:, None] * np.linspace(-4.0, 4.0, 17)
    near = around[(around > 0.0) & (around < math.pi)]
    angles = np.unique(np.concatenate([turns, np.geomspace(1e-3 * slow, math.pi, 200), near]))
    F = np.linalg.det(loop.build_equations(np.exp(1j * angles)))
    return bool(abs(np.angle(F[1:] / F[:-1]).sum() - size * math.pi) < 0.5 * math.pi)


def _longer_periods(loop: HeldLoop) -> Iterator[float]:
    """Yield periods up to one at which every mode of the plant has settled or has grown."""
    n = len(loop.A)
    plant, closed = np.linalg.eigvals(loop.A), np.linalg.eigvals(loop.A - loop.B @ loop.K[:, :n])
    slow = np.abs(np.concatenate([plant.real, closed.real]))
    last = _SETTLED / slow[slow > 1e-9 * slow.max()].min() if slow.any() else math.inf
    period = loop.period
    while period < last:
        turning = np.abs(plant.imag[plant.real * period > -_SETTLED]).max(initial=0.0)
        period = min(_STEP * period, period + _TURN / max(turning, 1e-300))
        yield period
