# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plans: values between samples, before and after them, and the rest of a plan."""

import math

from hypothesis import given, strategies
import numpy as np
from obc_ros.core.receding.plan import Plan
from obc_ros.core.text.errors import StatementError
import pytest

PLAN = Plan(5.0, 0.1, np.arange(11.0)[:, None], np.arange(10.0)[:, None] + 0.5, 1.0)


@given(strategies.floats(4.0, 7.0))
def test_states_are_linear_and_inputs_are_held(t: float) -> None:
    """x(t) = (t - stamp) / period within the plan, and its ends outside it."""
    x, u = PLAN.at(t)
    place = min(max((t - 5.0) / 0.1, 0.0), 10.0)
    assert x[0] == pytest.approx(place, abs=1e-7)
    assert abs(u[0] - 0.5 - min(math.floor(place + 1e-7), 9)) < 1e-6


@pytest.mark.parametrize('k', range(10))
def test_a_sample_reached_up_to_rounding_has_its_own_input(k: int) -> None:
    """5.0 + k * 0.1 may lie below sample k."""
    assert PLAN.at(5.0 + k * 0.1)[1][0] == k + 0.5


def test_the_rest_of_a_plan_has_the_same_values() -> None:
    """Its residual is unknown, because nothing was optimised from there."""
    rest = PLAN.shift(3)
    assert rest.end == pytest.approx(PLAN.end) and rest.residual == math.inf
    assert rest.at(5.75)[0] == pytest.approx(PLAN.at(5.75)[0])
    for k in (-1, 10):
        with pytest.raises(StatementError, match='the plan has 10'):
            PLAN.shift(k)
