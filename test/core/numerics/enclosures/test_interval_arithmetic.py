# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Enclosures contain the exact values (400 digits) and are narrow."""

import math

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import mpmath
import numpy as np
from obc_ros.core.numerics.enclosures.interval_arithmetic import enclose_outputs, WHOLE
from obc_ros.core.text.expressions import parse_expression
import pytest

X, Y = ca.SX.sym('x'), ca.SX.sym('y')
# The same expressions in multiple-precision arithmetic.
TEXTS = {
    'x + y': lambda x, y: x + y, 'x - 2*y': lambda x, y: x - 2*y, 'x*y': lambda x, y: x*y,
    'x/(y**2 + 1)': lambda x, y: x/(y**2 + 1), 'x**2': lambda x, y: x**2,
    'x**3': lambda x, y: x**3, '(x*y)**4': lambda x, y: (x*y)**4, 'x**7': lambda x, y: x**7,
    '1/x**3': lambda x, y: 1/x**3, 'abs(x)**1.5': lambda x, y: abs(x)**mpf(1.5),
    'abs(x)**0.3': lambda x, y: abs(x)**mpf(0.3), 'sin(x)': lambda x, y: mp.sin(x),
    'cos(y)': lambda x, y: mp.cos(y), 'tan(x)': lambda x, y: mp.tan(x),
    'exp(x) - exp(-y)': lambda x, y: mp.exp(x) - mp.exp(-y),
    'sqrt(x**2 + y)': lambda x, y: mp.sqrt(x**2 + y),
    'log(2 + sin(x*y))': lambda x, y: mp.log(2 + mp.sin(x*y)), 'log(x)': lambda x, y: mp.log(x),
    'abs(x) - abs(y)': lambda x, y: abs(x) - abs(y), 'atan2(x, y)': lambda x, y: mp.atan2(x, y),
    'tanh(x)*sinh(y)': lambda x, y: mp.tanh(x)*mp.sinh(y), 'cosh(x)': lambda x, y: mp.cosh(x),
    'atan(x*y)': lambda x, y: mp.atan(x*y), 'x/y': lambda x, y: x/y, '1/x': lambda x, y: 1/x,
    'asin(x)': lambda x, y: mp.asin(x), 'acos(x/20)': lambda x, y: mp.acos(x/20),
    '(x + y)*(x - y) - x/3': lambda x, y: (x + y)*(x - y) - x/3}
NUMBERS = st.floats(-20, 20) | st.floats(-1, 1) | st.floats(-1e-160, 1e-160) | (
    st.sampled_from([0.0, 1.0, -1.0, math.pi, math.pi / 2, -math.pi / 2, 3 * math.pi / 2]))
mp = mpmath.MPContext()
mp.dps = 400   # products of the smallest numbers must be exact
mpf = mp.mpf


def enclose_expression(text, x, y):
    """Return the enclosure of an expression for x and y in intervals."""
    function = ca.Function('f', [ca.vertcat(X, Y)],
                           [parse_expression(text, {'x': X, 'y': Y}, 'text')])
    [found] = enclose_outputs(function, [(np.array([x[0], y[0]]), np.array([x[1], y[1]]))])
    return found


@pytest.mark.slow
@settings(max_examples=600, deadline=None)
@given(st.sampled_from(sorted(TEXTS)), NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.floats(0, 1),
       st.floats(0, 1))
def test_enclosures_over_intervals_contain_every_value(text, a, b, c, d, s, r):
    check(text, sorted([a, b]), sorted([c, d]), s, r)


@pytest.mark.slow
@settings(max_examples=600, deadline=None)
@given(st.sampled_from(sorted(TEXTS)), NUMBERS, NUMBERS)
def test_enclosures_at_points_contain_the_exact_value(text, a, c):
    check(text, [a, a], [c, c], 0.0, 0.0)


def check(text, x, y, s, r):
    """Check that the enclosure contains the exact value at one point, without tolerance."""
    found = enclose_expression(text, x, y)
    at = (min(max(low + part * (high - low), low), high) for (low, high), part in (
        (x, s), (y, r)))
    try:
        value = TEXTS[text](*map(mpf, at))
    except ZeroDivisionError:
        return
    if isinstance(value, mpf) and mp.isfinite(value):
        assert mpf(found.low) <= value <= mpf(found.high)


@pytest.mark.parametrize('text', ['x + y', 'x*y', 'x/y', 'x**3', 'sin(x)', 'exp(x) - exp(-y)'])
def test_enclosures_at_points_have_a_width_of_a_few_ulp(text):
    found = enclose_expression(text, (1.1, 1.1), (0.7, 0.7))
    value = float(TEXTS[text](mpf(1.1), mpf(0.7)))
    assert found.low <= value <= found.high
    assert found.high - found.low <= 24 * math.ulp(value) + 24 * math.ulp(1.0)


@pytest.mark.parametrize(('text', 'low', 'high'), [
    ('0*x', 0, 0), ('x*y - x*y*1', 0, 0), ('2*y', 0, 0), ('y/x', 0, 0), ('x*y + y', 0, 0),
    ('sin(y)', 0, 0), ('tan(y)', 0, 0), ('1 - cos(y)', 0, 0)])
def test_expressions_that_are_exactly_zero_stay_zero(text, low, high):
    """Rates that are exactly 0 at 0 are needed for nonnegative states, and at set points."""
    found = enclose_expression(text, (0.1, 0.7), (0, 0))
    assert (found.low, found.high) == (low, high)


@pytest.mark.parametrize('text, x, y, low, high', [
    ('x**2 + 1', (-math.inf, math.inf), (0, 0), 1, math.inf),
    ('sin(x)', (0, math.pi), (0, 0), 0, 1), ('cos(x)', (3, 4), (0, 0), -1, math.cos(4)),
    ('sin(x)', (-math.inf, math.inf), (0, 0), -1, 1), ('x*y', (-1, 2), (-3, 4), -6, 8),
    ('x*y', (0, 0), (-math.inf, math.inf), 0, 0), ('x**6', (-2, 1), (0, 0), 0, 64),
    ('y*cos(x)', (-math.inf, math.inf), (0, 5), -5, 5), ('sqrt(x)', (-1, 4), (0, 0), 0, 2)])
def test_enclosures_over_intervals_are_tight(text, x, y, low, high):
    found = enclose_expression(text, x, y)
    assert (found.low, found.high) == pytest.approx((low, high), abs=1e-12)


def test_expressions_with_unbounded_range_give_the_whole_line():
    assert enclose_expression('1/x', (-1, 1), (0, 0)) == WHOLE
    assert enclose_expression('x - y', (-math.inf, math.inf), (-math.inf, math.inf)) == WHOLE
