# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Newton's method with damping: of each step the longest part that reduces the residual."""

from collections.abc import Callable, Sequence
import math
from typing import TypeVar

Point = TypeVar('Point')
Step = TypeVar('Step')


def take_damped_steps(now: Point, step: Callable[[Point, float], Step | None],
                      move: Callable[[Point, Step, float], Point],
                      size: Callable[[Point], float], parts: Sequence[float],
                      most: int) -> Point:
    """
    Reduce the size of a residual by damped steps.

    :param step: returns the step from a point, None if no further one is wanted; called as
        step(point, before) with the size of the residual before the last step, at first inf.
    :param move: returns the point after a part of a step; called as move(point, step, part).
    :return: the last one. A step of which no part reduces the residual ends the iteration.
    """
    before, left = math.inf, size(now)
    for _ in range(most):
        if (wanted := step(now, before)) is None:
            break
        trials = (move(now, wanted, part) for part in parts)
        better = next(((trial, after) for trial in trials if (after := size(trial)) < left), None)
        if better is None:
            break
        before, (now, left) = left, better
    return now
