# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Enclosures hold what they enclose, and are as narrow as they can be where they should be."""

import math

import casadi as ca
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.expressions import parse
from obc_ros.core.intervals import enclosure, WHOLE
import pytest

X, Y = ca.SX.sym('x'), ca.SX.sym('y')
TEXTS = ('x + y', 'x - 2*y', 'x*y', 'x/(y**2 + 1)', 'x**2', 'x**3', '(x*y)**4', 'sin(x)', 'cos(y)',
         'tan(x)', 'exp(x) - exp(-y)', 'sqrt(x**2 + y)', 'log(2 + sin(x*y))', 'abs(x) - abs(y)',
         'atan2(x, y)', 'tanh(x)*sinh(y)', 'atan(x*y)', 'x/y', '1/x', 'abs(x)**1.5', 'asin(x)')
NUMBERS = st.floats(-20, 20)


def between(text, x, y):
    """Return the enclosure of an expression of x and y."""
    function = ca.Function('f', [ca.vertcat(X, Y)], [parse(text, {'x': X, 'y': Y}, 'text')])
    [found] = enclosure(function, [(np.array([x[0], y[0]]), np.array([x[1], y[1]]))])
    return found


@given(st.sampled_from(TEXTS), NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.floats(0, 1),
       st.floats(0, 1))
def test_every_value_is_enclosed(text, a, b, c, d, s, r):
    x, y = sorted([a, b]), sorted([c, d])
    found = between(text, x, y)
    at = x[0] + s * (x[1] - x[0]), y[0] + r * (y[1] - y[0])
    value = float(ca.Function('f', [X, Y], [parse(text, {'x': X, 'y': Y}, 'text')])(*at))
    if math.isfinite(value):
        slack = 1e-9 * (1 + abs(value))
        assert found.low - slack <= value <= found.high + slack


@pytest.mark.parametrize('text, x, y, low, high', [
    ('x**2 + 1', (-math.inf, math.inf), (0, 0), 1, math.inf),
    ('sin(x)', (0, math.pi), (0, 0), 0, 1), ('cos(x)', (3, 4), (0, 0), -1, math.cos(4)),
    ('sin(x)', (-math.inf, math.inf), (0, 0), -1, 1), ('x*y', (-1, 2), (-3, 4), -6, 8),
    ('x*y', (0, 0), (-math.inf, math.inf), 0, 0), ('x**6', (-2, 1), (0, 0), 0, 64),
    ('y*cos(x)', (-math.inf, math.inf), (0, 5), -5, 5), ('sqrt(x)', (-1, 4), (0, 0), 0, 2)])
def test_narrow(text, x, y, low, high):
    found = between(text, x, y)
    assert (found.low, found.high) == pytest.approx((low, high), abs=1e-12)


def test_nothing_is_said_of_what_may_be_anything():
    assert between('1/x', (-1, 1), (0, 0)) == WHOLE
    assert between('x - y', (-math.inf, math.inf), (-math.inf, math.inf)) == WHOLE
