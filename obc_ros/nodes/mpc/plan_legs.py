# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plans as references of the loop."""

from collections.abc import Sequence

from obc_ros.core.closed_loop.control import Control, Leg, Reference
from obc_ros.core.closed_loop.sampled_plan import make_sampled_plan
from obc_ros.workers.wire import Packet

HALF = 2   # a plan begins half a period before its first sample, see `SampledPlan`


def make_leg(reply: Packet, period: int, control: Control) -> Leg:
    """
    Return a plan as a reference, with the feedback of the set point along it and after it.

    After it a moving set point goes on from the end of the plan, in the states along which it
    moves.

    Parameters
    ----------
    reply : Packet
        A plan: ``stamp`` of its first sample [ns], arrays x (N + 1, n) and u (N, m).
    period : int
        Time between two samples [ns].
    control : Control
        The control that follows it.

    Returns
    -------
    Leg

    """
    along = make_sampled_plan(period, reply.arrays['x'], reply.arrays['u'], control.regulator.K)
    begin = int(reply.plain['stamp']) - period // HALF
    reference = Reference(begin, along.duration, is_judged=True, is_announced=False)
    after = control.regulator
    if any(after.drift):
        after = after.beside(along.x[-1], 0.0)
    return Leg(reference, along, after)


def select_legs(legs: Sequence[Leg], new: Leg, now: int | None) -> tuple[Leg, ...]:
    """
    Return the plans to keep: the last one that has begun at a stamp [ns], and a new one.

    Parameters
    ----------
    legs : sequence of Leg
        The plans so far, in the order of their beginnings.
    new : Leg
        The new plan.
    now : int or None
        Stamp of the last state [ns].

    Returns
    -------
    tuple of Leg

    """
    begun = [leg for leg in legs if now is not None and leg.reference.begin is not None
             and leg.reference.begin <= now]
    return (*begun[-1:], new)
