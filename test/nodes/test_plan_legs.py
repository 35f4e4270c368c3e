# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plans as references: what is followed along a plan and after it."""

import numpy as np
from obc_ros.nodes.mpc.plan_legs import make_leg, select_legs
from obc_ros.nodes.mpc.settings import judge_mpc_settings, Settings
from obc_ros.workers.wire import Packet
import pytest

PERIOD = 20_000_000   # [ns]
BEGIN = 10**15


def judge(**parameters):
    """Return the control of a set of parameters."""
    return judge_mpc_settings(Settings(**parameters)).control


def test_after_a_plan_a_moving_set_point_goes_on_from_its_end():
    control = judge(system='vehicle', setpoint=(0.0, 0.0, 0.0), setpoint_input=(10.0, 0.0))
    x = np.column_stack([700.0 + 0.2 * np.arange(6), np.linspace(0.5, 0.1, 6), np.zeros(6)])
    leg = make_leg(Packet({'stamp': BEGIN}, {'x': x, 'u': np.tile([10.0, 0.0], (5, 1))}),
                   PERIOD, control)
    end = leg.reference.begin + round(leg.reference.duration * 1e9)
    assert end == BEGIN + 5 * PERIOD - PERIOD // 2
    # px goes on from the plan's end; py and theta are those of the set point.
    assert leg.after.at(0.5).x == pytest.approx((701.0 + 5.0, 0.0, 0.0))


def test_after_a_plan_a_set_point_at_rest_is_held():
    control = judge(system='aircraft')
    plan = Packet({'stamp': BEGIN}, {'x': np.ones((6, 6)), 'u': np.ones((5, 2))})
    leg = make_leg(plan, PERIOD, control)
    assert leg.after is control.regulator
    # At the stamp of a sample its own input is used, up to half a period of jitter.
    for jitter in (-9_000_000, 0, 9_000_000):
        t = (BEGIN + PERIOD + jitter - leg.reference.begin) * 1e-9
        assert leg.along.at(t).u == (1.0, 1.0)


def test_of_the_plans_the_last_begun_and_the_new_one_are_kept():
    control = judge(system='aircraft')
    legs = [make_leg(Packet({'stamp': BEGIN + k * PERIOD},
                            {'x': np.zeros((6, 6)), 'u': np.zeros((5, 2))}), PERIOD, control)
            for k in range(4)]
    assert select_legs(legs[:3], legs[3], BEGIN + PERIOD) == (legs[1], legs[3])
    assert select_legs(legs[:3], legs[3], None) == (legs[3],)
