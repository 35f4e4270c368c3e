# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Feedback of an estimate, u = -K xe: its margins, and their recovery.

A regulator with the whole state has a phase margin of 60 degrees. With an estimator in the loop
nothing is guaranteed (Doyle 1978). The margins are therefore computed for the loop that is closed.
With process noise q B B' added, the loop at the plant's input tends to that of the full state as q
grows, if the plant is of minimum phase with as many outputs as inputs (Doyle and Stein 1979).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from obc_ros.core.estimation.kalman_gain import KalmanDesign, lqe
from obc_ros.core.lqr.lqr import LqrDesign
from obc_ros.core.lqr.margins import compute_margins, Figures
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import StatementError

LITTLE = 0.5   # of the disk margin of the full state: less is called lost
POINTS = 10.0**np.arange(0.0, 13.0)   # q relative to the size of Qw, tried by the recovery


@dataclass(frozen=True, eq=False)
class OutputFeedback:
    """
    A regulator with a steady Kalman filter in the loop.

    Attributes
    ----------
    regulator : LqrDesign
    estimator : KalmanDesign
    figures : Figures
        Margins at the plant's inputs of the loop with the estimator.
    full_state : Figures
        Those of the regulator with the whole state.

    """

    regulator: LqrDesign
    estimator: KalmanDesign
    figures: Figures
    full_state: Figures

    @property
    def keeps_margins(self) -> bool:
        """Return whether no disk margin falls below half of that with the whole state."""
        return bool((self.figures.disk_margin >= LITTLE * self.full_state.disk_margin).all())

    def __str__(self) -> str:
        """Return the margins in words."""
        worst = int(np.argmin(self.figures.phase_margin))
        phase, before = (math.degrees(each.phase_margin[worst])
                         for each in (self.figures, self.full_state))
        low, high = (self.figures.gain_reduction_margin[worst], self.figures.gain_margin[worst])
        words = (f'with the estimator the phase margin is {phase:.3g} degrees (whole state: '
                 f'{before:.3g}); the loop is stable for gains times {low:.3g} to {high:.3g}')
        if self.keeps_margins:
            return words
        return f'the estimator loses the margins: {words}; try recover_loop_transfer'


def combine(regulator: LqrDesign, estimator: KalmanDesign) -> OutputFeedback:
    """
    Return the margins of u = -K xe.

    Parameters
    ----------
    regulator : LqrDesign
        The gain K of the plant.
    estimator : KalmanDesign
        The filter of the same plant; in discrete time its predictor form, u_k = -K xe_k|k-1.

    Raises
    ------
    StatementError
        If the two are not of the same plant.

    """
    if regulator.A.shape != estimator.A.shape or not np.allclose(
            regulator.A, estimator.A, rtol=1e-9, atol=1e-12):
        raise StatementError('the regulator and the estimator have different plants')
    if regulator.period != estimator.period:
        raise StatementError(f'the regulator has the period {regulator.period:g} s, the estimator '
                             f'{estimator.period:g} s')
    A, B, K = regulator.A, regulator.B, regulator.K
    n = len(A)
    L, C = estimator.L, estimator.C
    # The state (x, xe) with the loop opened at the plant's input: the plant's input is the only
    # input, and the output is K xe.
    loop = np.block([[A, np.zeros((n, n))], [L @ C, A - B @ K - L @ C]])
    figures = compute_margins(loop, np.concatenate([B, np.zeros_like(B)]),
                              np.concatenate([np.zeros_like(K), K], axis=1), regulator.period)
    return OutputFeedback(regulator, estimator, figures,
                          compute_margins(A, B, K, regulator.period))


@dataclass(frozen=True, eq=False)
class Recovery:
    """
    Process noise that recovers the margins of the whole state.

    Attributes
    ----------
    Qw : ndarray, shape (n, n)
        The suggested intensity Qw + q B B'.
    q : float
        The added noise.
    loop : OutputFeedback
        With that noise.
    recovered : bool
        Whether the margins are kept.

    """

    Qw: Array
    q: float
    loop: OutputFeedback
    recovered: bool


def recover_loop_transfer(regulator: LqrDesign, C: Array, Qw: Array, Rv: Array, *,
                          share: float = LITTLE, outputs: Sequence[str] = ()) -> Recovery:
    """
    Return the least added process noise for which margins of the full state are recovered.

    Parameters
    ----------
    regulator : LqrDesign
        In continuous time.
    C, Qw, Rv : ndarray, shape (q, n), (n, n), (q, q)
        Outputs and noise, as for `lqe`.
    share : float
        Wanted share of the disk margins of the full state.
    outputs : sequence of str, optional
        Names of the outputs.

    Returns
    -------
    Recovery
        If the share is not reached (a plant that is not of minimum phase), the best that was
        found, with `recovered` False.

    Raises
    ------
    StatementError, RefusedDesignError
        As `lqe` for the given noise; StatementError also for a sampled regulator.

    """
    if regulator.period:
        raise StatementError('loop transfer recovery: wanted a regulator in continuous time')
    A, B = regulator.A, regulator.B
    Qw = np.asarray(Qw, dtype=float)
    pushed = B @ B.T
    size = max(float(np.trace(Qw)), 1e-12) / float(np.trace(pushed))
    best: Recovery | None = None
    for q in (0.0, *(POINTS * size * 1e-2)):
        noise = Qw + q * pushed
        loop = combine(regulator, lqe(A, C, noise, Rv, outputs=tuple(outputs)))
        reached = float((loop.figures.disk_margin / loop.full_state.disk_margin).min())
        found = Recovery(noise, float(q), loop, reached >= share)
        if best is None or reached > float((
                best.loop.figures.disk_margin / best.loop.full_state.disk_margin).min()):
            best = found
        if found.recovered:
            return found
    assert best is not None
    return replace(best, recovered=False)
