# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Feedback of an estimate, u = -K xe: its margins, and their recovery; see docs/estimation.md.

With process noise q B B' added, the loop at the plant's input tends to that of the full state as q
grows, if the plant is of minimum phase with as many outputs as inputs (Doyle and Stein 1979). The
sampled loop in filter form recovers in this way too (Maciejowski 1985).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

import numpy as np
from obc_ros.core.estimation.kalman_gain import KalmanDesign, lqe, sampled_lqe
from obc_ros.core.lqr.held_loop import discretize_plant
from obc_ros.core.lqr.lqr import check_period, LqrDesign
from obc_ros.core.lqr.margins import compute_margins, Figures
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.riccati.checks import check_matrix
from obc_ros.core.text.errors import RefusedDesignError, StatementError

LITTLE = 0.5   # of the disk margin of the full state: less is called lost
POINTS = 10.0**np.arange(0.0, 13.0)   # q relative to the size of Qw, tried by the recovery


@dataclass(frozen=True, eq=False)
class OutputFeedback:
    """
    A regulator with a steady Kalman filter in the loop.

    :ivar figures: margins at the plant's inputs of the loop with the estimator.
    :ivar full_state: those of the regulator with the whole state.
    """

    estimator: KalmanDesign
    figures: Figures
    full_state: Figures

    @property
    def share(self) -> float:
        """Return the smallest disk margin relative to that with the whole state."""
        return float((self.figures.disk_margin / self.full_state.disk_margin).min())

    @property
    def words(self) -> str:
        """Return the margins of the input with the smallest phase margin in words."""
        worst = int(np.argmin(self.figures.phase_margin))
        phase, before = (math.degrees(each.phase_margin[worst])
                         for each in (self.figures, self.full_state))
        low, high = (self.figures.gain_reduction_margin[worst], self.figures.gain_margin[worst])
        return (f'the phase margin is {phase:.3g} degrees (whole state: {before:.3g}); the loop '
                f'is stable for gains times {low:.3g} to {high:.3g}')

    def __str__(self) -> str:
        """Return the margins in words, and what to do if they are lost."""
        if self.share >= LITTLE:
            return f'with the estimator {self.words}'
        return (f'the estimator loses the margins: with the estimator {self.words}; try '
                'recover_loop_transfer')


def combine(regulator: LqrDesign, estimator: KalmanDesign) -> OutputFeedback:
    """
    Return the margins of u = -K xe.

    :param estimator: the filter of the same plant; in discrete time its predictor form, u_k = -K
        xe_k|k-1.
    :raises StatementError: if the two are not of the same plant.
    """
    if regulator.A.shape != estimator.A.shape or not np.allclose(
            regulator.A, estimator.A, rtol=1e-9, atol=1e-12):
        raise StatementError('the regulator and the estimator have different plants')
    if regulator.period != estimator.period:
        raise StatementError(f'the regulator has the period {regulator.period:g} s, the estimator '
                             f'{estimator.period:g} s')
    A, B, K = regulator.A, regulator.B, regulator.K
    L, C = estimator.L, estimator.C
    return _close(A, B, K, estimator, [L @ C, A - B @ K - L @ C], [np.zeros_like(K), K])


def _close(A: Array, B: Array, K: Array, estimator: KalmanDesign, moved: list[Array],
           output: list[Array]) -> OutputFeedback:
    """
    Return the margins of a loop that is opened at the plant's input, which is its only input.

    :param moved, output: how the estimate moves, and what the regulator sends, over (x, xe).
    """
    loop = np.block([[A, np.zeros_like(A)], moved])
    figures = compute_margins(loop, np.concatenate([B, np.zeros_like(B)]),
                              np.concatenate(output, axis=1), estimator.period)
    return OutputFeedback(estimator, figures, compute_margins(A, B, K, estimator.period))


@dataclass(frozen=True, eq=False)
class Recovery:
    """
    Process noise that recovers the margins of the whole state.

    :ivar Qw: (n, n), the suggested intensity Qw + q B B'.
    :ivar before, loop: with the given noise, and with the suggested one.
    :ivar recovered: whether the wanted share of the margins is reached.
    """

    Qw: Array
    q: float
    before: OutputFeedback
    loop: OutputFeedback
    recovered: bool


def recover_loop_transfer(regulator: LqrDesign, C: Array, Qw: Array, Rv: Array, *,
                          share: float = LITTLE) -> Recovery:
    """
    Return the least added process noise for which margins of the full state are recovered.

    :param regulator: in continuous time.
    :param share: wanted share of the disk margins of the full state.
    :return: if the share is not reached (a plant that is not of minimum phase), the best that was
        found, with `recovered` False.
    :raises StatementError, RefusedDesignError: as `lqe` for the given noise; StatementError also
        for a sampled regulator.
    """
    if regulator.period:
        raise StatementError('loop transfer recovery: wanted a regulator in continuous time')
    return _find_noise(lambda noise: combine(regulator, lqe(regulator.A, C, noise, Rv)),
                       np.asarray(Qw, dtype=float), regulator.B, share)


def recover_sampled_loop(A: Array, B: Array, K: Array, C: Array, Qw: Array, Rv: Array,
                         period: float, *, share: float = LITTLE, outputs: Sequence[str] = ()
                         ) -> Recovery:
    """
    Return the least added process noise for which margins of u_k = -K xe_k are recovered.

    The loop is in filter form, the plant in continuous time; see `recover_loop_transfer`.

    :raises StatementError, RefusedDesignError: as `sampled_lqe` for the given noise;
        StatementError also if K has a wrong size or does not stabilise the sampled plant.
    """
    check_period(period)
    K = check_matrix('K', K, (B.shape[1], len(A)))
    Ad, Bd = discretize_plant(A, B, period)
    if np.abs(np.linalg.eigvals(Ad - Bd @ K)).max() >= 1.0:
        raise StatementError(f'K does not stabilise the plant that is sampled every {period:g} s; '
                             'wanted the gain of the regulator in use')
    names = tuple(outputs)
    return _find_noise(
        lambda noise: _close_filter_form(Ad, Bd, K, sampled_lqe(A, C, noise, Rv, period,
                                                                outputs=names)),
        np.asarray(Qw, dtype=float), B, share)


def _close_filter_form(A: Array, B: Array, K: Array, estimator: KalmanDesign) -> OutputFeedback:
    """Return the margins of u_k = -K xe_k for a sampled plant."""
    seen = estimator.M @ estimator.C
    kept = np.eye(len(A)) - seen
    # The state is (x, estimate before the measurement).
    return _close(A, B, K, estimator, [(A - B @ K) @ seen, (A - B @ K) @ kept],
                  [K @ seen, K @ kept])


def _find_noise(close: Callable[[Array], OutputFeedback], Qw: Array, B: Array, share: float
                ) -> Recovery:
    """Return the first loop of the grid that reaches a share, otherwise the best one."""
    pushed = B @ B.T
    size = max(float(np.trace(Qw)), 1e-12) / max(float(np.trace(pushed)), 1e-300)
    best: Recovery | None = None
    for q in (0.0, *(POINTS * size * 1e-2)):
        noise = Qw + q * pushed
        try:
            loop = close(noise)
        except RefusedDesignError:
            if best is None:
                raise
            break   # too much noise for a filter with verified stability
        found = Recovery(noise, float(q), best.before if best else loop, loop, loop.share >= share)
        if best is None or loop.share > best.loop.share:
            best = found
        if found.recovered:
            return found
    assert best is not None
    return best
