# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A plant and its cost as a controller sees them that acts once in a period, and late.

Between two samples the input is held, so that x((k+1) h) = Ad x(k h) + Bd u_k exactly, and so is
the integral of the cost (C. F. Van Loan, IEEE Transactions on Automatic Control 23, 1978).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.control import Prediction
from obc_ros.core.errors import StatementError
from obc_ros.core.regulator import rows
from obc_ros.core.weights import Weights
from scipy.linalg import expm

Array = NDArray[np.float64]

MOST = 1_000  # periods that a delay may last


@dataclass(frozen=True)
class Sampling:
    """
    When a controller acts.

    Attributes
    ----------
    period : float
        Of the commands [s]; 0: not known.
    delay : float
        Known time until a command takes effect [s].
    exact : bool
        Whether the design is for the sampled plant, not the continuous one.

    """

    period: float = 0.0
    delay: float = 0.0
    exact: bool = False

    def __post_init__(self) -> None:
        if (self.exact or self.delay) and not self.period:
            what = 'design = sampled' if self.exact else f'delay = {self.delay:g}'
            raise StatementError(f'{what} needs the period of the commands: set sample_time or '
                                 'rate')
        if self.delay > MOST * self.period:
            raise StatementError(f'delay = {self.delay:g}: more than {MOST} periods of '
                                 f'{self.period:g} s')


def held(A: Array, B: Array, time: float) -> tuple[Array, Array]:
    """Return Ad (n, n) and Bd (n, m) of dx/dt = A x + B u with u held for a time [s]."""
    n, m = B.shape
    M = np.zeros((n + m, n + m))
    M[:n, :n], M[:n, n:] = A, B
    flow = expm(M * time)
    return flow[:n, :n], flow[:n, n:]


def sampled(A: Array, B: Array, weights: Weights, period: float) -> tuple[Array, Array, Weights]:
    """
    Return the sampled plant, and the weights of the sum that equals the integral of the cost.

    Raises
    ------
    StatementError
        If the period is so long that the plant's motion in it is not finite.

    """
    n, m = B.shape
    size = n + m
    M = np.zeros((2 * size, 2 * size))
    F = M[size:, size:]
    F[:n, :n], F[:n, n:] = A, B
    M[:size, :size] = -F.T
    Q = M[:size, size:]
    Q[:n, :n], Q[n:, n:] = weights.Qx, weights.Qu
    if weights.cross is not None:
        Q[:n, n:], Q[n:, :n] = weights.cross, weights.cross.T
    flow = expm(M * period)
    plant = flow[size:, size:]
    cost = plant.T @ flow[:size, size:]
    if not np.isfinite(cost).all():
        raise StatementError(f'period = {period:g}: too long for this plant')
    cost = 0.5 * (cost + cost.T)
    return plant[:n, :n], plant[:n, n:], replace(
        weights, Qx=cost[:n, :n], Qu=cost[n:, n:], cross=cost[:n, n:])


def prediction(A: Array, B: Array, sampling: Sampling) -> Prediction | None:
    """
    Return how a state is carried over the delay by the commands that are on their way.

    Parameters
    ----------
    A, B : ndarray, shape (n, n) and (n, m)
        The plant about its equilibrium.
    sampling : Sampling
        When commands are given, and how late they act.

    """
    h, delay = sampling.period, sampling.delay
    if not delay:
        return None
    whole = int(delay / h + 1e-9)
    rest = delay - whole * h
    Phi, Gamma = held(A, B, h)
    carried, gammas = np.eye(len(A)), []
    for _ in range(whole):
        gammas.append(carried @ Gamma)
        carried = carried @ Phi
    if rest > 1e-9 * h:
        Phi, Gamma = held(A, B, rest)
        gammas.append(carried @ Gamma)
        carried = carried @ Phi
    if not np.isfinite(carried).all():
        raise StatementError(f'delay = {delay:g}: too long for this plant')
    return Prediction(rows(carried), tuple(rows(each) for each in gammas), round(h * 1e9),
                      round(delay * 1e9))
