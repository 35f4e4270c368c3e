# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of merit of a recorded flight."""

from dataclasses import dataclass

import numpy as np
from obc_ros.cli.flight_client import Pilot
from obc_ros.core.numerics.arrays import Array


@dataclass(frozen=True)
class StepFigures:
    """A step response: rise and settling time [s], overshoot as a fraction of the step."""

    rise_time: float
    overshoot: float
    settling_time: float


def measure_step(t: Array, y: Array, start: float, target: float) -> StepFigures:
    """
    Return rise time (10 % to 90 %), overshoot and settling time (2 %) of a recorded step.

    :param t, y: (N,), times [s] from the step on, and the signal.
    :param start, target: value before the step, and its set point.
    """
    share = (y - start) / (target - start)
    above = [np.flatnonzero(share >= level) for level in (0.1, 0.9)]
    rise = t[above[1][0]] - t[above[0][0]] if above[1].size else np.nan
    outside = np.flatnonzero(np.abs(share - 1.0) > 0.02)
    settled = outside.size == 0 or outside[-1] + 1 < t.size
    settling = (t[outside[-1] + 1] - t[0] if outside.size else 0.0) if settled else np.nan
    return StepFigures(float(rise), float(max(0.0, share.max() - 1.0)), float(settling))


def report_loop(pilot: Pilot, wall: float) -> list[tuple[str, str]]:
    """Return message counts and latencies of the loop, as names and values."""
    late = pilot.latencies() * 1e3
    simulated = pilot.now
    return [
        ('states, commands', f'{len(pilot.heard.stamp)}, {len(pilot.commands.stamp)}'),
        ('missed states', f'{pilot.missed()}'),
        ('state to command, p50 / p99',
         f'{np.percentile(late, 50):.2f} / {np.percentile(late, 99):.2f} ms'),
        ('designs adopted', f'{pilot.designs[-1].revision if pilot.designs else 0}'),
        ('simulated in', f'{simulated:.1f} s in {wall:.1f} s of wall time '
                         f'({simulated / wall:.1f} x real time)'),
    ]
