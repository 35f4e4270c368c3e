# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The size of a summand is that of what cancels in it."""

import casadi as ca
import numpy as np
from obc_ros.core.ocp.certificate.cost_summands import CostSummands, split_sum
import problems
import pytest

T = np.linspace(0.0, 1.0, 101)


def measure(running_cost, x, u=0.0, terminal_cost='0', **parameters):
    """Return the summands of a cost along x(t) and u(t), for t from 0 to 1."""
    problem = problems.pose({'x': 'u'}, running_cost, (float(x[0]),), 1,
                            terminal_cost=terminal_cost, parameters=parameters)
    path = np.column_stack([x, T][:problem.n])
    return CostSummands(problem).measure(
        T, path, np.broadcast_to(u, T.shape)[:, None], problem.p_value)


@pytest.mark.parametrize('off', [0.0, 1e-6])
def test_a_reference_that_is_followed_vanishes(off):
    # The size of (x - t)^2 is (2 t)^2, with the integral 4/3, or (|2 t - 1|)^2 near the middle.
    found = measure('(x - t)**2', T + off)
    assert found.vanish(1e-10)
    assert found.largest == pytest.approx([4/3], rel=1e-3)
    middle = np.minimum(2*T, np.abs(2*T - 1))**2
    assert found.sizes == pytest.approx([middle.mean()], rel=2e-2)


def test_a_summand_that_does_not_cancel_does_not_vanish():
    found = measure('w*(x - t)**2 + u**2', T, 1.0, w=1e12)
    assert found.values == pytest.approx([0.0, 1.0])
    assert not found.vanish(1e-2)


def test_an_offset_is_no_size():
    # 300.01 - 300: the deviation, not the temperature, is the size of what is small.
    assert not measure('(x - 300)**2', 300 + 0.01*(1 - T)).vanish(1e-2)
    assert measure('(x - 300 - t)**2', 300 + T).vanish(1e-10)


def test_a_small_value_is_no_cancellation():
    assert not measure('x**2 + u**2', 1e-9*(1 - T)).vanish(1e-2)
    assert not measure('0', 1 - T + 1e-12, terminal_cost='x').vanish(1e-2)
    assert not measure('0', T).vanish(1e-2)


def test_the_end_belongs_to_the_summands():
    assert measure('(x - t)**2', T, terminal_cost='10*(x - 1)**2').vanish(1e-10)
    assert not measure('(x - t)**2', T, terminal_cost='10*(x - 1.1)**2').vanish(1e-4)


def test_sums_are_split_as_far_as_they_are_sums():
    a, b, c = (ca.SX.sym(name) for name in 'abc')
    for whole, parts in [
            (2*((a - b)**2 + 3*c), [2*(a - b)**2, 6*c]), (-(a + b)/c, [-a/c, -b/c]),
            (a*(b - c), [a*b, -a*c]), ((a + b)*(a + c), [(a + b)*(a + c)]), (ca.SX(0), [])]:
        found = split_sum(whole)
        assert len(found) == len(parts)
        values = ca.Function('values', [a, b, c], [ca.vertcat(*found), ca.vertcat(*parts)])
        each, wanted = values(0.7, 1.9, -2.3)
        np.testing.assert_allclose(each, wanted)
