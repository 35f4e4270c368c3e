# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The Kalman filter between arbitrary instants; for a nonlinear system the extended Kalman filter.

Prediction: with A = df/dx at the present mean, one matrix exponential gives exp(A h), the
integral of exp(A s) f and that of exp(A s) Qw exp(A's) over a step h. It is exact for a linear
system with a held input. For a nonlinear one the mean follows the Rosenbrock-Euler method, whose
error in a step is of third order in h. Update: Joseph's form, which keeps P symmetric and positive
semidefinite.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from obc_ros.core.estimation.consistency import compute_chi_square_quantile
from obc_ros.core.numerics.arrays import Array, Index, linalg
from obc_ros.core.numerics.rounding import norm
from obc_ros.core.riccati.checks import check_definite, check_semidefinite
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, StatementError

LARGEST_STEP = 0.02    # [s] of a linearisation of a nonlinear system
_MOST_STEPS = 2000     # of one prediction


@dataclass(frozen=True, eq=False)
class Belief:
    """An estimate: mean x (n,) and covariance P (n, n) of its error."""

    x: Array
    P: Array


@dataclass(frozen=True, eq=False)
class Update:
    """
    What a measurement did.

    Attributes
    ----------
    belief : Belief
        After the measurement; as before it if the measurement is an outlier.
    innovation : ndarray, shape (q,)
        y - h(x), angles in [-pi, pi].
    normalized : ndarray, shape (q,)
        The innovation divided by its standard deviations.
    nis : float
        Normalised innovation squared v'S^-1 v; chi-square with q degrees of freedom if the model
        is right.
    is_outlier : bool
        Whether `nis` is above the quantile of the gate.

    """

    belief: Belief
    innovation: Array
    normalized: Array
    nis: float
    is_outlier: bool


class KalmanFilter:
    """
    The extended Kalman filter of a system; for a linear system the Kalman filter.

    Parameters
    ----------
    system : System
        The plant, with its outputs y = h(x, u).
    Qw : array_like, shape (n, n)
        Intensity of the process noise, in squared units of the states per second; >= 0.
    Rv : array_like, shape (q, q)
        Covariance of a measurement of all outputs; > 0.
    gate : float
        Probability with which a regular measurement passes the chi-square test; 1: no test.

    Raises
    ------
    StatementError, RefusedDesignError
        If a matrix has a wrong size or is not definite, or the gate is no probability.

    """

    def __init__(self, system: System, Qw: Array, Rv: Array, gate: float = 1.0) -> None:
        if not 0.0 < gate <= 1.0:
            raise StatementError(f'gate = {gate:g}: wanted a probability above 0; 1: no test')
        self.system = system
        self.Qw = check_semidefinite('Qw', Qw, system.n)
        self.Rv = check_definite('Rv', Rv, len(system.outputs))
        self._thresholds = [math.inf if gate == 1.0 else compute_chi_square_quantile(gate, q)
                            for q in range(1, len(system.outputs) + 1)]
        self._is_angle = np.array([signal.angle for signal in system.outputs])

    def predict(self, belief: Belief, u: Array, time: float) -> Belief:
        """
        Return the estimate after a time [s] with the input u (m,).

        Raises
        ------
        DynamicsError
            If the estimate exceeds the range of double precision, or the time needs too many
            steps.

        """
        x, P, left = belief.x, belief.P, time
        n, count = len(x), 0
        while left > 0.0:
            xdot, A = self.system.linearize(x, u)
            h = min(left, LARGEST_STEP, 1.0 / max(norm(A), 1e-12))
            flow = np.zeros((2 * n + 1, 2 * n + 1))
            flow[:n, :n], flow[:n, n:-1], flow[n:-1, n:-1] = A, self.Qw, -A.T
            flow[:n, -1] = xdot
            count += 1
            if not np.isfinite(flow).all() or count > _MOST_STEPS:
                raise DynamicsError('the estimate cannot be predicted '
                                    f'{time:g} s: it exceeds the range of double precision, or '
                                    'the plant is too fast')
            flow = linalg.expm(flow * h)
            Phi = flow[:n, :n]
            P = Phi @ P @ Phi.T + flow[:n, n:-1] @ Phi.T
            P = 0.5 * (P + P.T)
            x, left = x + flow[:n, -1], left - h
        return Belief(x, P)

    def update(self, belief: Belief, u: Array, at: Sequence[int] | Index, y: Array) -> Update:
        """
        Return the estimate after a measurement of some outputs.

        Parameters
        ----------
        belief : Belief
            At the instant of the measurement.
        u : ndarray, shape (m,)
            Input then.
        at : sequence of int
            Indices of the measured outputs, at least one.
        y : ndarray
            Their values.

        """
        at = np.asarray(at, dtype=int)
        expected, hx = self.system.measure(belief.x, u)
        C, R = hx[at], self.Rv[np.ix_(at, at)]
        v = y - expected[at]
        v = np.where(self._is_angle[at], np.remainder(v + math.pi, 2 * math.pi) - math.pi, v)
        S = C @ belief.P @ C.T + R
        gain = linalg.solve(S, C @ belief.P, assume_a='pos').T
        nis = float(v @ linalg.solve(S, v, assume_a='pos'))
        normalized = v / np.sqrt(S.diagonal())
        if not nis <= self._thresholds[len(at) - 1]:
            return Update(belief, v, normalized, nis, True)
        kept = np.eye(len(belief.x)) - gain @ C
        P = kept @ belief.P @ kept.T + gain @ R @ gain.T
        return Update(Belief(belief.x + gain @ v, 0.5 * (P + P.T)), v, normalized, nis, False)
