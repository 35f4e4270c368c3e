# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of plans to messages."""

import numpy as np
from obc_ros.core.systems.system import System
from obc_ros.msg import Trajectory
from obc_ros.ros.messages import flatten_doubles
from obc_ros.workers.wire import Packet


def make_plan_message(reply: Packet, period: int, system: System, frame: str) -> Trajectory:
    """
    Return the message of a plan.

    :param reply: as in `make_leg`.
    :param period: time between two samples [ns].
    :param system: the system of the plan.
    :param frame: frame of its states.
    :return: N + 1 samples; the last input is repeated.
    """
    x, u = reply.arrays['x'], reply.arrays['u']
    message = Trajectory(
        system=system.name, state_names=list(system.state_names),
        input_names=list(system.input_names), interpolation='zoh',
        t=flatten_doubles(1e-9 * period * np.arange(len(x))), x=flatten_doubles(x),
        u=flatten_doubles(np.vstack([u, u[-1:]])))
    message.header.frame_id = frame
    seconds, nanoseconds = divmod(int(reply.plain['stamp']), 10**9)
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
    return message
