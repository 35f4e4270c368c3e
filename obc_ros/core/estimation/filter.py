# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The Kalman filter between arbitrary instants; for a nonlinear system the extended Kalman filter.

Prediction: with A = df/dx at the present mean, one matrix exponential gives exp(A h), the integral
of exp(A s) f and that of exp(A s) Qw exp(A's) over a step h. For a nonlinear system the mean
follows the Rosenbrock-Euler method, whose error in a step is of third order in h. Joseph's form of
the update keeps P symmetric and positive semidefinite.

A step has |A| h <= 1, so that the series of the exponential needs no scaling. For the few states
of a plant the calls take more time than the arithmetic: CasADi evaluates into fixed buffers, and
NumPy is called rarely.

Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation,
2001, section 5.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, lapack, special
from obc_ros.core.numerics.rounding import EPS, norm
from obc_ros.core.riccati.checks import check_definite, check_semidefinite
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, StatementError

LARGEST_STEP = 0.02    # [s] of a linearisation of a nonlinear system
_MOST_STEPS = 2000     # of one prediction
_TAIL = 0.5 * (1.0 - 0.95)


def _is_finite(M: Array) -> bool:
    # The norm takes a third of the time, but also exceeds the range for entries above 1e154.
    return math.isfinite(norm(M)) or bool(np.isfinite(M).all())


@dataclass(frozen=True, eq=False)
class Belief:
    """An estimate: mean x (n,) and covariance P (n, n) of its error."""

    x: Array
    P: Array

    @property
    def is_finite(self) -> bool:
        """Return whether no entry has left the range of double precision."""
        return _is_finite(self.x) and _is_finite(self.P)


@dataclass(frozen=True, eq=False)
class Update:
    """
    What a measurement did.

    :ivar belief: after the measurement; as before it if the measurement is an outlier.
    :ivar innovation: (q,), y - h(x), angles in [-pi, pi].
    :ivar normalized: (q,), the innovation divided by its standard deviations.
    :ivar nis: normalised innovation squared v'S^-1 v; chi-square with q degrees of freedom if the
        model is right.
    :ivar is_outlier: whether `nis` is above the quantile of the gate.
    """

    belief: Belief
    innovation: Array
    normalized: Array
    nis: float
    is_outlier: bool


class _Evaluator:
    """A function of x, u and p that CasADi evaluates into arrays, which each call overwrites."""

    def __init__(self, system: System, matrix: ca.SX, vector: ca.SX) -> None:
        function = ca.Function('evaluate', [system.x, system.u, system.p], [
            ca.densify(matrix.T), ca.densify(vector)])   # CasADi stores columns
        self.matrix, self.vector = np.zeros(matrix.shape), np.zeros(vector.shape[0])
        self._x, self._u, self._p = np.zeros(system.n), np.zeros(system.m), system.p_value
        parcel: tuple[Any, Any] = function.buffer()
        self._kept, self._evaluate = parcel
        for index, given in enumerate((self._x, self._u, self._p)):
            self._kept.set_arg(index, given.data)
        for index, found in enumerate((self.matrix, self.vector)):
            self._kept.set_res(index, found.data)

    def __call__(self, x: Array, u: Array) -> None:
        self._x[:], self._u[:] = x, u
        self._evaluate()


@dataclass(frozen=True)
class Consistency:
    """
    The mean of the last normalised squares, relative to their degrees of freedom.

    `ratio` is near 1 for a consistent estimator, above `upper` if the estimator trusts itself too
    much, below `lower` if too little; `count` is the number of measurements in the mean.
    """

    ratio: float
    lower: float
    upper: float
    count: int

    def __str__(self) -> str:
        if not self.count:
            return 'no innovation yet'
        band = f'{self.ratio:.2f}, 95 % band {self.lower:.2f} to {self.upper:.2f}'
        if self.ratio > self.upper:
            return f'inconsistent: innovations are larger than Qw and Rv say ({band})'
        if self.ratio < self.lower:
            return f'cautious: innovations are smaller than Qw and Rv say ({band})'
        return f'consistent ({band})'


def assess_innovations(squares: Sequence[tuple[float, int]]) -> Consistency:
    """Return the consistency of normalised innovations squared with their degrees of freedom."""
    if not squares:
        return Consistency(1.0, 1.0, 1.0, 0)
    degrees = sum([each for _, each in squares])
    lower, upper = compute_band(degrees)
    ratio = sum([nis for nis, _ in squares]) / degrees
    return Consistency(ratio, lower / degrees, upper / degrees, len(squares))


@lru_cache
def compute_band(degrees: float, count: int = 1) -> tuple[float, float]:
    """
    Return the interval that holds the mean of normalised squares with 95 %, with equal tails.

    :param degrees, count: degrees of freedom of each, and number of independent ones.
    """
    low, high = (compute_chi_square_quantile(p, degrees * count) for p in (_TAIL, 1.0 - _TAIL))
    return low / count, high / count


def compute_chi_square_quantile(probability: float, degrees: float) -> float:
    """Return the value below which a chi-square variable is with a probability."""
    return float(2.0 * special.gammaincinv(0.5 * degrees, probability))


@dataclass(frozen=True, eq=False)
class _Selection:
    """Some of the outputs: their indices, covariance, threshold, and which are angles."""

    at: slice | list[int]
    R: Array
    threshold: float
    is_angle: Array | None   # None: none of them


class KalmanFilter:
    """
    The extended Kalman filter of a system; for a linear system the Kalman filter.

    One thread at a time may use it.

    :param Qw: (n, n), intensity of the process noise, in squared units of the states per second;
        >= 0.
    :param Rv: (q, q), covariance of a measurement of all outputs; > 0.
    :param gate: probability with which a regular measurement passes the chi-square test; 1: no
        test.
    :ivar largest: (q,), largest absolute values of measurements: the rounding of larger ones
        exceeds their standard deviation, so that they say nothing.
    :raises StatementError, RefusedDesignError: if a matrix has a wrong size or is not definite, or
        the gate is no probability.
    """

    def __init__(self, system: System, Qw: Array, Rv: Array, gate: float = 1.0) -> None:
        if not 0.0 < gate <= 1.0:
            raise StatementError(f'gate = {gate:g}: wanted a probability above 0; 1: no test')
        self.system, n = system, system.n
        self.Qw = check_semidefinite('Qw', Qw, n)
        self.Rv = check_definite('Rv', Rv, len(system.outputs))
        self.largest = np.sqrt(self.Rv.diagonal()) / EPS
        self._thresholds = [math.inf if gate == 1.0 else compute_chi_square_quantile(gate, q)
                            for q in range(1, len(system.outputs) + 1)]
        self._is_angle = np.array([signal.angle for signal in system.outputs])
        self._slope = _Evaluator(system, ca.jacobian(system.xdot, system.x), system.xdot)
        self._output = _Evaluator(system, ca.jacobian(system.y, system.x), system.y)
        self._identity = np.eye(n)
        self._flow = np.zeros((2 * n + 1, 2 * n + 1))
        self._select = cache(self._choose)

    def predict(self, belief: Belief, u: Array, time: float) -> Belief:
        """
        Return the estimate after a time [s] with the input u (m,).

        :raises DynamicsError: if the estimate exceeds the range of double precision, or the time
            needs too many steps.
        """
        x, P, left, n, count = belief.x, belief.P, time, self.system.n, 0
        while left > 0.0:
            self._slope(x, u)
            rate = norm(self._slope.matrix)
            h = min(left, LARGEST_STEP, 1.0 / max(rate, 1e-12))
            count += 1
            if not math.isfinite(rate) or count > _MOST_STEPS:
                raise self._fault(time)
            top = self._exponentiate(h, rate * h)
            Phi = top[:, :n]
            P = (Phi @ P + top[:, n:-1]) @ Phi.T
            P += P.T.copy()
            P *= 0.5
            x, left = x + top[:, -1], left - h
        after = Belief(x, P)
        if not after.is_finite:
            raise self._fault(time)
        return after

    def _exponentiate(self, h: float, size: float) -> Array:
        """
        Return the first n rows of the exponential of h [[A, Qw, f], [0, -A', 0], [0, 0, 0]].

        These (n, 2 n + 1) are exp(A h); the integral of exp(A s) Qw exp(A's), times exp(-A'h); the
        integral of exp(A s) f. `size` is |A| h, at most 1.
        """
        flow, n = self._flow, self.system.n
        flow[:n, :n], flow[:n, n:-1] = self._slope.matrix, self.Qw
        np.negative(self._slope.matrix.T, out=flow[n:-1, n:-1])
        flow[:n, -1] = self._slope.vector
        flow *= h
        term = flow[:n].copy()
        total = term.copy()
        total[:, :n] += self._identity
        # The k-th term of the second block is below |Qw| h (2 size)^(k - 1) / k!.
        bound, k = 1.0, 1
        while bound > EPS:
            k += 1
            bound *= 2.0 * size / k
            term = term @ flow
            term *= 1.0 / k
            total += term
        return total

    def _fault(self, time: float) -> DynamicsError:
        return DynamicsError(f'the estimate cannot be predicted {time:g} s: it exceeds the range '
                             'of double precision, or the plant is too fast')

    def update(self, belief: Belief, u: Array, at: Sequence[int], y: Array) -> Update:
        """
        Return the estimate after a measurement of some outputs.

        :param belief, u: estimate and input (m,) at the instant of the measurement.
        :param at: indices of the measured outputs, at least one.
        :raises numpy.linalg.LinAlgError: if the covariance of the innovation is not positive
            definite: P has lost its digits.
        """
        chosen = self._select(tuple(at))
        self._output(belief.x, u)
        C, P = self._output.matrix[chosen.at], belief.P
        v = y - self._output.vector[chosen.at]
        if chosen.is_angle is not None:
            v = np.where(chosen.is_angle, np.remainder(v + math.pi, 2 * math.pi) - math.pi, v)
        CP = C @ P
        S = CP @ C.T + chosen.R
        _, solved, info = lapack.dposv(S, np.column_stack((CP, v)))
        if info:
            raise np.linalg.LinAlgError(f'the covariance of an innovation is indefinite: {info}')
        gain, nis = solved[:, :-1].T, float(v @ solved[:, -1])
        normalized = v / np.sqrt(S.diagonal())
        if not nis <= chosen.threshold:
            return Update(belief, v, normalized, nis, True)
        kept = self._identity - gain @ C
        P = kept @ P @ kept.T + gain @ chosen.R @ gain.T
        P += P.T.copy()
        P *= 0.5
        return Update(Belief(belief.x + gain @ v, P), v, normalized, nis, False)

    def _choose(self, at: tuple[int, ...]) -> _Selection:
        indices = list(at)
        is_all = indices == list(range(len(self._is_angle)))
        is_angle = self._is_angle[indices]
        return _Selection(slice(None) if is_all else indices, self.Rv[np.ix_(indices, indices)],
                          self._thresholds[len(at) - 1], is_angle if is_angle.any() else None)
