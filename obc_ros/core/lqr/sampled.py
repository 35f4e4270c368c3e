# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Sampled regulators for a held input with a known delay.

The sampled cost is the integral of the continuous cost. Between samples the input is constant, and
x'Qx x + 2 x'N u + u'Qu u is integrated along the motion (Van Loan 1978). The integral over a short
interval is doubled repeatedly, which avoids cancellation for stiff plants. The command of t_k acts
from t_k + delay on, for one period. From there on the problem has no delay. The optimal command is
therefore -K x(t_k + delay), where the state is predicted with the commands that are still to act.
"""

from dataclasses import replace
import math

import numpy as np
from obc_ros.core.lqr.held_loop import HeldLoop
from obc_ros.core.lqr.lqr import check_period, dlqr, LqrDesign
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array, linalg
from obc_ros.core.numerics.rounding import EPS, norm
from obc_ros.core.riccati import checks, dare
from obc_ros.core.text.errors import RefusedDesignError, StatementError

MOST = 300            # periods of a delay; a design for this many takes a second
_LEAST_ROBUSTNESS = 10.0


@np.errstate(all='ignore')  # an overflow is rejected
def sampled_lqr(A: Array, B: Array, weights: Weights, period: float, delay: float = 0.0
                ) -> LqrDesign:
    """
    Return the optimal regulator of dx/dt = A x + B u for a held and delayed input.

    Its gain is that of the sampled plant without the delay, for the predicted state.

    C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic
    Control 23 (1978).

    :param A, B, weights: (n, n), (n, m), plant and cost in continuous time.
    :param period, delay: [s]; the delay need not be a multiple of the period.
    :raises StatementError: if the period or the delay cannot be used.
    :raises RefusedDesignError: if a weight is not definite, or the stability of the loop with its
        delay cannot be verified.
    """
    _check_times(period, delay)
    # Errors must name the entries of the given weights, not those of the sampled ones.
    checks.remove_cross_term(*checks.check_matrices(A, B, weights.Qx, weights.Qu, weights.cross))
    Ad, Bd, cost = discretize_cost(A, B, weights, period)
    design = dlqr(Ad, Bd, cost.Qx, cost.Qu, cross=cost.cross, stability=cost.stability,
                  period=period)
    loop = HeldLoop(A, B, np.zeros((0, len(A))), design.K, period, delay, period).matrix
    X = dare.solve_stein(loop, np.eye(len(loop)))
    robust = 0.0 if X is None else dare.measure_discrete_robustness(loop, X,
                                                                    4 * EPS * np.abs(loop))
    if not robust >= _LEAST_ROBUSTNESS:
        raise RefusedDesignError(
            f'the stability of the loop with period = {period:g} and delay = {delay:g} cannot be '
            'verified: the state changes too much in that time to be predicted')
    return design


def discretize_cost(A: Array, B: Array, weights: Weights, period: float
                    ) -> tuple[Array, Array, Weights]:
    """
    Return the sampled plant and the sampled weights whose sum is the integral of the cost.

    :param A, B, weights: (n, n), (n, m), plant and cost in continuous time; the degree of
        stability is passed on unchanged.
    :param period: time for which an input is held [s].
    :raises StatementError: if a state within the period exceeds the range of double precision.
    """
    n, m = B.shape
    motion = np.zeros((n + m, n + m))
    motion[:n, :n], motion[:n, n:] = A, B
    cost = np.zeros((n + m, n + m))
    cost[:n, :n], cost[n:, n:] = weights.Qx, weights.Qu
    if weights.cross is not None:
        cost[:n, n:], cost[n:, :n] = weights.cross, weights.cross.T
    doublings = max(0, math.ceil(math.log2(max(norm(motion) * period, 1e-300)))) + 1
    if doublings > 60:
        raise StatementError(f'period = {period:g}: too long for this plant')
    short = period * 0.5**doublings
    size = n + m
    pencil = np.zeros((2 * size, 2 * size))
    pencil[:size, :size], pencil[:size, size:], pencil[size:, size:] = -motion.T, cost, motion
    flow = linalg.expm(pencil * short)
    plant = flow[size:, size:]
    total = plant.T @ flow[:size, size:]
    for _ in range(doublings):
        total = total + plant.T @ total @ plant
        plant = plant @ plant
    if not (np.isfinite(plant).all() and np.isfinite(total).all()):
        raise StatementError(f'period = {period:g}: too long for this plant')
    total = 0.5 * (total + total.T)
    return plant[:n, :n], plant[:n, n:], replace(
        weights, Qx=total[:n, :n], Qu=total[n:, n:], cross=total[:n, n:])


def _check_times(period: float, delay: float) -> None:
    check_period(period)
    if not (math.isfinite(delay) and delay >= 0.0):
        raise StatementError(f'delay = {delay:g}: wanted 0 or a positive number of seconds')
    if delay > MOST * period:
        raise StatementError(f'delay = {delay:g}: more than {MOST} periods of {period:g} s')
