# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of a reference before it is followed: see docs/regulator.md."""

from collections.abc import Sequence
import math

import numpy as np
from obc_ros.core.closed_loop.control import AllowedErrors
from obc_ros.core.closed_loop.feedback import InputLimits
from obc_ros.core.closed_loop.references import is_within
from obc_ros.core.lqr.design.design import Design
from obc_ros.core.lqr.design.reference_tracking import Course
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import RefusedReferenceError
from obc_ros.core.text.tables import format_distinct

PART = 0.1         # allowed error relative to the range of a state along the reference
_ROUNDING = 1e-6   # excess over a limit relative to the input, by which a solution may exceed it


def compute_allowed_error(along: Course, x_limits: AllowedErrors = (),
                          tolerance: Sequence[float] = ()) -> AllowedErrors:
    """
    Return the lower and upper bounds (n,) of x - xr at which a reference may begin.

    :param x_limits: (n,) bounds of the error x - xr inside which the law is used; empty: none.
    :param tolerance: (n,) maximum error of each state, in its unit; empty: see docs/regulator.md.
    """
    with np.errstate(over='ignore'):
        return compute_allowed_distance(np.ptp(along.x, axis=0), x_limits, tolerance)


def compute_allowed_distance(ranges: Array, x_limits: AllowedErrors, tolerance: Sequence[float]
                             ) -> AllowedErrors:
    """Return `compute_allowed_error` for the ranges (n,) of the states along a reference."""
    if tolerance:
        return tuple((-each, each) for each in tolerance)
    own = PART * np.maximum(ranges, 1.0)
    default = tuple((-each, each) for each in own.tolist())
    if not x_limits:
        return default
    return tuple(
        (low if math.isfinite(low) else -each, high if math.isfinite(high) else each)
        for (low, high), (_, each) in zip(x_limits, default, strict=True))


def check(along: Course, found: Design, limits: InputLimits, allowed: AllowedErrors) -> None:
    """
    Check that the plant can follow a reference.

    :param found: the design of the regulator that is to follow it.
    :param allowed: from `compute_allowed_error`.
    :raises RefusedReferenceError: if an input exceeds a limit, or the reference does not satisfy
        the dynamics.
    """
    system = found.plant.system
    with np.errstate(all='ignore'):
        sentences = _beyond_limits(along, system, limits) or _off_dynamics(
            along, system, allowed, _slowest(found))
    if sentences:
        raise RefusedReferenceError('; '.join(sentences))


def _beyond_limits(along: Course, system: System, limits: InputLimits) -> list[str]:
    sentences = []
    for j, signal in enumerate(system.inputs):
        values, low, high = along.u[:, j], limits.lower[j], limits.upper[j]
        for k, bound, side in ((int(values.argmin()), low, -1.0),
                               (int(values.argmax()), high, 1.0)):
            size = max(abs(bound), float(np.abs(values).max()))
            if side * (values[k] - bound) > _ROUNDING * size:
                value, limit = format_distinct(values[k], bound, unit=signal.unit)
                sentences.append(f'{signal.name} is {value} at t = {along.t[k]:.4g} s, the limit '
                                 f'is {limit}')
    return sentences


def _off_dynamics(along: Course, system: System, allowed: AllowedErrors, time: float) -> list[str]:
    """
    Return a sentence for each state that does not satisfy the dynamics.

    The error e of a loop with the time constant `time` [s] satisfies e' = f - x' - e / time. The
    defect f - x' is taken as constant over each interval.
    """
    error, largest, at = np.zeros(system.n), np.zeros(system.n), np.zeros(system.n)
    steps = np.diff(along.t) / time
    part = np.where(steps > 0.0, -np.expm1(-steps) / np.where(steps > 0.0, steps, 1.0), 1.0)
    defects = part[:, None] * _defects(along, system)
    for k, (defect, fade) in enumerate(zip(defects, np.exp(-steps), strict=True)):
        error = fade * error + defect
        grown = ~(np.abs(error) <= np.abs(largest))
        largest = np.where(grown, error, largest)
        at = np.where(grown, along.t[k + 1], at)
    sentences = []
    for signal, e, t, (low, high) in zip(system.states, largest, at, allowed, strict=True):
        if not is_within(float(e), low, high):
            deviation, most = format_distinct(abs(e), -low if e < 0.0 else high, unit=signal.unit)
            sentences.append('the reference does not satisfy the dynamics: with its inputs '
                             f'{signal.name} deviates by {deviation} at t = {t:.4g} s, allowed '
                             f'{most}')
    return sentences


def _defects(along: Course, system: System) -> Array:
    """
    Return the integral of f - x' over each interval, shape (N - 1, n).

    The integral uses Simpson's rule, the midpoint state the cubic Hermite interpolant.
    """
    h, x = np.diff(along.t)[:, None], along.x
    u_begin = along.u[:-1]
    u_end = u_begin if along.holds else along.u[1:]
    begin, end = system.rates(x[:-1], u_begin), system.rates(x[1:], u_end)
    middle = system.rates(0.5 * (x[:-1] + x[1:]) + h / 8.0 * (begin - end),
                          0.5 * (u_begin + u_end))
    defects: Array = h / 6.0 * (begin + 4.0 * middle + end) - (x[1:] - x[:-1])
    return defects


def _slowest(found: Design) -> float:
    """Return the time constant of the slowest pole [s]."""
    decay, period = -found.lqr.E.real, found.lqr.period
    if period:
        decay = -np.log(np.maximum(np.abs(found.lqr.E), 1e-12)) / period
    return 1.0 / float(decay.min())
