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

from dataclasses import dataclass, replace
import math

import numpy as np
from obc_ros.core.lqr.lqr import dlqr, LqrDesign
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array, linalg
from obc_ros.core.numerics.rounding import EPS, norm
from obc_ros.core.riccati import checks, dare
from obc_ros.core.text.errors import RefusedDesignError, StatementError

MOST = 300            # periods of a delay; a design for this many takes a second
_WHOLE = 1e-9         # of a period; a delay this near to a multiple of the period is rounded to it
_LEAST_ROBUSTNESS = 10.0


@dataclass(frozen=True, eq=False)
class SampledDesign:
    """
    A feedback u_k = -K (Phi x_k + sum of Gamma_j u_(k-j)), verified for its period and delay.

    :ivar design: the gain for the sampled plant, its weights and poles.
    :ivar delay: known time until a command acts [s].
    :ivar Phi: (n, n), transition matrix over the delay.
    :ivar Gamma: (n, m), input matrices over the delay for u_(k-1), u_(k-2), ...
    :ivar loop: (n + d m, n + d m), the closed loop of (x_k, u_(k-1), ..., u_(k-d)).
    :ivar robustness: lower bound of the rounding units in each entry of `loop` under which it
        stays stable.
    """

    design: LqrDesign
    delay: float
    Phi: Array
    Gamma: tuple[Array, ...]
    loop: Array
    robustness: float


@np.errstate(all='ignore')  # an overflow is rejected
def sampled_lqr(A: Array, B: Array, weights: Weights, period: float, delay: float = 0.0
                ) -> SampledDesign:
    """
    Return the optimal regulator of dx/dt = A x + B u for a held and delayed input.

    C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic
    Control 23 (1978).

    :param A, B: (n, n) and (n, m), the plant in continuous time.
    :param weights: its cost in continuous time.
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
    Phi, Gamma = predict_delayed_state(A, B, period, delay)
    loop = build_delayed_loop(A, B, design.K, period, delay, Phi, Gamma)
    X = dare.solve_stein(loop, np.eye(len(loop)))
    robust = 0.0 if X is None else dare.measure_discrete_robustness(loop, X,
                                                                    4 * EPS * np.abs(loop))
    if not robust >= _LEAST_ROBUSTNESS:
        raise RefusedDesignError(
            f'the stability of the loop with period = {period:g} and delay = {delay:g} cannot be '
            'verified: the state changes too much in that time to be predicted')
    return SampledDesign(design, delay, Phi, Gamma, loop, robust)


def discretize_cost(A: Array, B: Array, weights: Weights, period: float
                    ) -> tuple[Array, Array, Weights]:
    """
    Return the sampled plant and the sampled weights whose sum is the integral of the cost.

    :param A, B: (n, n) and (n, m), the plant in continuous time.
    :param weights: its cost in continuous time; the degree of stability is passed on unchanged.
    :param period: time for which an input is held [s].
    :return: Ad, Bd: (n, n) and (n, m), the sampled plant; weights: the sampled cost, with a cross
        term.
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


def discretize_plant(A: Array, B: Array, time: float | Array) -> tuple[Array, Array]:
    """
    Return Ad, Bd of x(t + time) = Ad x(t) + Bd u for dx/dt = A x + B u with a constant u.

    :param A, B: (n, n) and (n, m), the plant in continuous time.
    :param time: time for which the input is held [s], or such times.
    :return: Ad, Bd: (..., n, n) and (..., n, m).
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

    :param A, B: (n, n) and (n, m), the plant in continuous time.
    :param period, delay: [s].
    :return: Phi: (n, n); Gamma: (n, m), the matrix of the last command first.
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


def build_delayed_loop(A: Array, B: Array, K: Array, period: float, delay: float,
                       Phi: Array | None = None, Gamma: tuple[Array, ...] = ()) -> Array:
    """
    Return the closed loop of (x_k, u_(k-1), ..., u_(k-d)) for a gain and a delay.

    :param A, B, K: (n, n), (n, m), (m, n), the plant in continuous time and the gain; u = -K x.
    :param period, delay: [s].
    :param Phi, Gamma: from `predict_delayed_state`: the gain acts on the predicted state. Without
        them it acts on x_k.
    :return: (n + d m, n + d m).
    """
    n, m = B.shape
    whole, rest = split_delay(period, delay)
    held_back = whole + bool(rest)
    late, early = discretize_plant(A, B, rest), discretize_plant(A, B, period - rest)
    commands = [-K @ (np.eye(n) if Phi is None else Phi)] + [
        -K @ gamma for gamma in Gamma] + [np.zeros((m, m))] * (held_back - len(Gamma))
    u = np.concatenate(commands[:held_back + 1], axis=1)
    past = [np.concatenate([np.zeros((m, n + j * m)), np.eye(m),
                            np.zeros((m, (held_back - 1 - j) * m))], axis=1)
            for j in range(held_back)]
    newest_first = [u, *past]
    # After t_k the command of `held_back` periods ago acts for `rest` seconds.
    x = np.eye(n, n + held_back * m)
    x = late[0] @ x + late[1] @ newest_first[held_back]
    x = early[0] @ x + early[1] @ newest_first[whole]
    return np.concatenate([x, *newest_first[:held_back]])


def compute_spectral_radius(M: Array) -> float:
    """
    Return the largest modulus of the eigenvalues of M.

    :param M: (n, n), a loop in discrete time; it is stable if the result is below 1.
    """
    return float(np.abs(np.linalg.eigvals(M)).max())


def split_delay(period: float, delay: float) -> tuple[int, float]:
    """
    Return the number of whole periods in a delay, and the remainder.

    :param period, delay: [s].
    :return: the remainder [s] is 0 or below the period.
    """
    whole = math.floor(delay / period + _WHOLE)
    rest = delay - whole * period
    return whole, rest if rest > _WHOLE * period else 0.0


def _check_times(period: float, delay: float) -> None:
    if not (math.isfinite(period) and period > 0.0):
        raise StatementError(f'period = {period:g}: wanted a positive number of seconds')
    if not (math.isfinite(delay) and delay >= 0.0):
        raise StatementError(f'delay = {delay:g}: wanted 0 or a positive number of seconds')
    if delay > MOST * period:
        raise StatementError(f'delay = {delay:g}: more than {MOST} periods of {period:g} s')
