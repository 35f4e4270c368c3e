# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Expressions whose numbers are symbols, and whose norms have derivatives."""

from fractions import Fraction

import casadi as ca
import numpy as np
from obc_ros.core.numerics.enclosures.interval_arithmetic import enclose_outputs
from obc_ros.core.numerics.instructions import make_norms_differentiable, separate_numbers
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


def test_norms_of_some_symbols_remain() -> None:
    v, u = ca.SX.sym('v', 2), ca.SX.sym('u')
    stated = ca.vertcat(ca.sqrt(v[0]**2 + v[1]**2), ca.sqrt(v[0]**2 + u**2))
    [new] = make_norms_differentiable([stated], [v, u], u)
    slopes = ca.Function('slopes', [v, u], [ca.jacobian(new, v)])([0, 0], 0).full()
    assert np.isnan(slopes[1]).any() and not slopes[0].any()


def test_norms_have_derivatives_at_zero() -> None:
    """That of |v| is 0 there, that of |v| v, too; elsewhere nothing changes."""
    v = ca.SX.sym('v', 2)
    stated = ca.vertcat(ca.sqrt(v[0]**2 + v[1]**2) * v, ca.sqrt(3 * v[0]**2 + (v[1] - v[0])**2))
    [new] = make_norms_differentiable([stated], [v], ca.SX(0, 1))
    before, after = (ca.Function('both', [v], [each, ca.jacobian(each, v)])
                     for each in (stated, new))
    assert np.isnan(before([0, 0])[1].full()).all()
    assert all(np.abs(each.full()).max() <= 1e-149 for each in after([0, 0]))
    for at in ([3, -4], [1e-9, 0], [0, 2e5]):
        for ours, theirs in zip(after(at), before(at), strict=True):
            assert (ours.full() == theirs.full()).all()


def test_other_roots_keep_their_infinite_derivatives() -> None:
    """The outflow sqrt(x) of a tank, and roots of expressions that may change sign."""
    x = ca.SX.sym('x', 2)
    roots = [ca.sqrt(x[0]), ca.sqrt(x[0]**2 - x[1]**2), ca.sqrt(x[0] * x[1]),
             ca.sqrt(x[0]**2 + x[1]), ca.sqrt(-2 * x[0]**2)]
    new = make_norms_differentiable(roots, [x], ca.SX(0, 1))
    assert all(a is b for a, b in zip(new, roots, strict=True))
