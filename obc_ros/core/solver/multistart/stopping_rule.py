# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The stopping rule of multistart: whether further initial guesses are worth their work."""

from dataclasses import dataclass

from obc_ros.core.solver.options import MultistartOptions


@dataclass(frozen=True, kw_only=True)
class Effort:
    """
    What multistart has done so far, and what it knows of the problem.

    :ivar starts, wanted: initial guesses so far, and those that are worth a try because of earlier
        ones.
    :ivar before, spent, total: work before multistart, work of its starts, and work of the whole
        search.
    :ivar certified: whether the best solution is certified.
    :ivar uneven, bent, rough: whether the cost may have several local minima in the states;
        whether the dynamics are strongly nonlinear; whether coarse solves fail, end at very
        different costs, or are slow.
    :ivar stages: collocation points in an interval; 0: Runge-Kutta steps.
    :ivar complete: whether no further minimum is expected (Boender, Rinnooy Kan 1987).
    """

    starts: int
    wanted: int
    before: int
    spent: int
    total: int
    certified: bool
    uneven: bool = False
    bent: bool = False
    rough: bool = False
    stages: int = 0
    complete: bool = False


def explain_enough(effort: Effort, options: MultistartOptions) -> str:
    """Return in words why multistart may stop; '' if another start is worth its work."""
    number, spent, hard = effort.starts, effort.spent, effort.before > options.hard
    if spent > options.lavish:
        return f'{_count(number)} used up the work that further starts may take'
    if (effort.rough or effort.bent) and effort.certified and not (hard or effort.uneven) and (
            spent > options.hard):
        return f'{_count(number)} took more work than the solution'
    many = _are_many(effort, options)
    if many and spent > (2 if hard else 1) * options.share * effort.total:
        return f'{_count(number)} used up their part of the work'
    if many and effort.complete:
        return f'{_count(number)} led to known minima only'
    return ''


def _count(number: int) -> str:
    return f'{number} start{"" if number == 1 else "s"}'


def _are_many(effort: Effort, options: MultistartOptions) -> bool:
    """Return whether at least the minimum number of starts was tried."""
    hard = effort.before > options.hard
    if effort.uneven or hard and not effort.stages:
        return (effort.starts >= 2 * options.least_hard
                and effort.spent >= options.many_work)
    least = options.least_bent if effort.bent else 1
    least = options.least_hard if hard or effort.rough else least
    return effort.starts >= max(least, effort.wanted)
