# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plans of the solver process as laws of the loop."""

from obc_ros.core.closed_loop.control import Control
from obc_ros.core.closed_loop.laws import PlanLaw
from obc_ros.core.closed_loop.sampled_plan import make_sampled_plan
from obc_ros.workers.wire import Packet


def make_plan(reply: Packet, period: int, control: Control) -> PlanLaw:
    """
    Return a plan as a law, with the feedback of the set point along it.

    :param reply: a plan: ``stamp`` of its first sample [ns], arrays x (N + 1, n) and u (N, m).
    :param period: time between two samples [ns].
    :param control: the control that follows it.
    """
    along = make_sampled_plan(period, reply.arrays['x'], reply.arrays['u'], control.regulator.K)
    # It begins half a period before its first sample, see `SampledPlan`.
    return PlanLaw(along, int(reply.plain['stamp']) - period // 2)
