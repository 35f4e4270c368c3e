# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Expressions whose numbers are symbols."""

from fractions import Fraction

import casadi as ca
import numpy as np
from obc_ros.core.numerics.enclosures.interval_arithmetic import enclose_outputs
from obc_ros.core.numerics.instructions import separate_numbers
import pytest


def test_the_value_does_not_change() -> None:
    """Powers, quotients and repeated numbers."""
    x, p = ca.SX.sym('x', 2), ca.SX.sym('p')
    f = ca.vertcat(0.1 * x[0]**3 + ca.sin(3 * x[1]) / 3, p * x[1]**1.5 + 2 * x[0], 7.0)
    g, numbers, values = separate_numbers(f, [x, p])
    at = [0.3, 1.7], 5.0
    wanted = ca.Function('f', [x, p], [f])(*at).full()
    assert sorted(set(values)) == [0.1, 1.5, 3.0, 7.0]
    assert ca.Function('g', [x, p, numbers], [g])(*at, values).full() == pytest.approx(wanted)


def test_a_derivative_is_enclosed_which_casadi_rounds() -> None:
    """d/dx of 0.1 (3 x + 1) is 0.1 * 3, which double precision does not have."""
    x = ca.SX.sym('x')
    f = 0.1 * (3.0 * x + 1.0)
    exact = Fraction(0.1) * 3
    assert Fraction(float(ca.jacobian(f, x))) != exact
    g, numbers, values = separate_numbers(f, [x])
    slope = ca.Function('slope', [numbers], [ca.jacobian(g, x)])
    [found] = enclose_outputs(slope, [(values, values)])
    assert Fraction(found.low) <= exact <= Fraction(found.high) < exact * (1 + Fraction(1e-15))


def test_an_expression_without_numbers_has_no_symbols() -> None:
    """The array of numbers is empty."""
    x = ca.SX.sym('x', 2)
    g, numbers, values = separate_numbers(ca.vertcat(x[1], 2 * x[0]), [x])
    assert numbers.numel() == 0 and values.shape == (0,)
    assert (ca.Function('g', [x], [g])([1, 3]).full().ravel() == np.array([3.0, 2.0])).all()
