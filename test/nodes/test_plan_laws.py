# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plans of the solver process as laws of the loop."""

import numpy as np
from obc_ros.core.closed_loop.laws import select_plan
from obc_ros.nodes.mpc.plans import make_plan
from obc_ros.nodes.mpc.settings import judge_mpc_settings, Settings
from obc_ros.workers.wire import Packet

PERIOD = 20_000_000   # [ns]
BEGIN = 10**15
CONTROL = judge_mpc_settings(Settings(system='aircraft')).control


def plan(stamp, u=1.0):
    """Return a plan of five steps."""
    return make_plan(Packet({'stamp': stamp}, {'x': np.ones((6, 6)), 'u': u * np.ones((5, 2))}),
                     PERIOD, CONTROL)


def test_a_plan_covers_its_inputs_up_to_half_a_period_of_jitter():
    made = plan(BEGIN)
    for stamp, covered in ((-0.51, False), (-0.49, True), (1.0, True), (4.49, True),
                           (4.51, False)):
        assert made.covers(BEGIN + round(stamp * PERIOD)) is covered
    for jitter in (-9_000_000, 0, 9_000_000):
        assert made.at(BEGIN + PERIOD + jitter).u == (1.0, 1.0)


def test_the_last_plan_that_covers_a_stamp_is_followed():
    plans = [plan(BEGIN, 1.0), plan(BEGIN + 3 * PERIOD, 2.0)]
    assert select_plan(plans, BEGIN + 2 * PERIOD) is plans[0]
    assert select_plan(plans, BEGIN + 3 * PERIOD) is plans[1]
    assert select_plan(plans, BEGIN + 8 * PERIOD) is None
