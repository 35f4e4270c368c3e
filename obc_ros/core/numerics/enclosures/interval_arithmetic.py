# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Interval arithmetic: bounds of an expression for bounds of its symbols.

The bounds are rigorous. They are wider than necessary where a symbol occurs several times. Every
operation rounds outward: sums by the sign of their rounding error, which is computed; products,
quotients and square roots, which IEEE 754 rounds correctly, to the next double unless they are
known to be exact; functions of the C library, whose error is assumed to be below 2 units in the
last place, by 4 units.
"""

from collections.abc import Callable
import math
from math import inf, isfinite, nextafter, pi
from typing import NamedTuple

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import Instructions

_UNITS = 4        # in the last place, above the error of the functions of the C library
_FAR = 1e6        # largest argument of sin, cos and tan for which extrema or poles are located
_TURN = 1e-14     # relative distance at which an extremum or a pole counts as inside
_EXACT = frozenset((0.0, 1.0, -1.0, inf, -inf))   # factors whose products are not rounded


class Interval(NamedTuple):
    """All numbers from `low` to `high`; they may be infinite."""

    low: float
    high: float


WHOLE = Interval(-inf, inf)


def enclose_outputs(function: ca.Function | Instructions,
                    boxes: list[tuple[Array, Array]]) -> list[Interval]:
    """Return an interval for each nonzero of the output, for bounds of each argument."""
    def apply(operation: int, operands: list[Interval]) -> Interval:
        enclose = _OPERATIONS.get(operation)
        found = enclose(*operands) if enclose else WHOLE
        undefined = math.isnan(found.low) or math.isnan(found.high)
        return WHOLE if undefined else found

    program = function if isinstance(function, Instructions) else Instructions(function)
    return program.evaluate(
        lambda i, k: Interval(float(boxes[i][0][k]), float(boxes[i][1][k])),
        lambda value: Interval(value, value), apply)[0]


def add_intervals(a: Interval, b: Interval) -> Interval:
    """Return an interval that contains x + y for all x in a and y in b."""
    return Interval(_sum(a.low, b.low, -inf), _sum(a.high, b.high, inf))


def multiply_intervals(a: Interval, b: Interval) -> Interval:
    """Return an interval that contains x y for all x in a and y in b."""
    if _EXACT.isdisjoint(a + b):
        products = a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high
        low, high = min(products), max(products)
        if isfinite(low) and isfinite(high):
            return Interval(nextafter(low, -inf), nextafter(high, inf))
    ends = [(x, y) for x in a for y in b]
    return Interval(min(_product(x, y, -inf) for x, y in ends),
                    max(_product(x, y, inf) for x, y in ends))


def _sum(x: float, y: float, towards: float) -> float:
    """Return x + y rounded towards -inf or inf; its error is a double (D. Knuth)."""
    total = x + y
    if not math.isfinite(total):
        # An infinite end stays; an overflow away from `towards` is bounded by a double.
        overflowed = math.isfinite(x) and math.isfinite(y) and total != towards
        return math.copysign(_LARGEST, total) if overflowed else total
    part = total - x
    error = (x - (total - part)) + (y - part)
    off = error > 0 if towards > 0 else error < 0
    return nextafter(total, towards) if off or error != error else total


def _product(x: float, y: float, towards: float) -> float:
    # The numbers of an interval are finite, so that 0 times an infinite end is 0.
    if x == 0.0 or y == 0.0:
        return 0.0
    value = x * y
    if abs(x) == 1.0 or abs(y) == 1.0 or math.isinf(x) or math.isinf(y):
        return value
    return _outward(value, towards)


def _quotient(x: float, y: float, towards: float) -> float:
    if x == 0.0:
        return 0.0
    if math.isinf(y):
        return 0.0   # for inf / inf, the quotients of the other ends are the bounds
    value = x / y
    return value if abs(y) == 1.0 or math.isinf(x) else _outward(value, towards)


def _outward(value: float, towards: float, units: int = 1) -> float:
    """Return a bound of the numbers that may have been rounded to a value."""
    if math.isinf(value):
        return value if value == towards else math.copysign(_LARGEST, value)
    for _ in range(units):
        value = nextafter(value, towards)
    return value


def _divide(a: Interval, b: Interval) -> Interval:
    if b.low <= 0.0 <= b.high:
        return WHOLE
    ends = [(x, y) for x in (a.low, a.high) for y in (b.low, b.high)]
    return Interval(min(_quotient(x, y, -inf) for x, y in ends),
                    max(_quotient(x, y, inf) for x, y in ends))


def _square(a: Interval) -> Interval:
    least, most = _size(a)
    return Interval(max(0.0, _product(least, least, -inf)), _product(most, most, inf))


def _raised(x: float, n: float, towards: float) -> float:
    """Return x to a power n > 0, rounded outward."""
    if x in (0.0, 1.0) or math.isinf(x):
        return float(x**n)
    try:
        value = float(x**n)
    except OverflowError:
        value = math.copysign(inf, x)
    return _outward(value, towards, _UNITS)


def _power(a: Interval, b: Interval) -> Interval:
    if b.low != b.high or not math.isfinite(b.low):
        return WHOLE
    n = b.low
    if n < 0:
        return _divide(Interval(1.0, 1.0), _power(a, Interval(-n, -n)))
    if n == 0:
        return Interval(1.0, 1.0)
    if n == 2.0:
        return _square(a)
    if n % 2.0 == 0.0:
        return _power(_square(a), Interval(n / 2, n / 2))
    if n % 2.0 == 1.0:
        return Interval(_raised(a.low, n, -inf), _raised(a.high, n, inf))
    if a.low >= 0:
        return Interval(max(0.0, _raised(a.low, n, -inf)), _raised(a.high, n, inf))
    return WHOLE


def _turned(function: Callable[[float], float], x: float, towards: float) -> float:
    """Return a bound of sin, cos or tan of x, which are exact at 0."""
    value = function(x)
    return value if x == 0.0 else _outward(value, towards, _UNITS)


def _wave(function: Callable[[float], float], peak: float) -> Callable[[Interval], Interval]:
    """Return the enclosure of sin or cos, whose maximum is at `peak`."""
    def enclose(a: Interval) -> Interval:
        if not a.high - a.low < 2 * pi or max(abs(a.low), abs(a.high)) > _FAR:
            return Interval(-1.0, 1.0)
        near = _TURN * (1 + max(abs(a.low), abs(a.high)))

        def passes(at: float) -> bool:
            turn = at + 2 * pi * math.ceil((a.low - near - at) / (2 * pi))
            return turn <= a.high + near or turn - 2 * pi >= a.low - near
        return Interval(
            -1.0 if passes(peak + pi) else max(-1.0, min(_turned(function, x, -inf) for x in a)),
            1.0 if passes(peak) else min(1.0, max(_turned(function, x, inf) for x in a)))
    return enclose


def _tangent(a: Interval) -> Interval:
    near = _TURN * (1 + max(abs(a.low), abs(a.high)))
    if not max(abs(a.low), abs(a.high)) < _FAR:
        return WHOLE
    branch = math.floor((a.low - near) / pi + 0.5)
    if branch != math.floor((a.high + near) / pi + 0.5):
        return WHOLE
    return Interval(_turned(math.tan, a.low, -inf), _turned(math.tan, a.high, inf))


def _rising(function: Callable[[float], float], within: tuple[float, float] = (-inf, inf),
            among: tuple[float, float] = (-inf, inf), units: int = _UNITS
            ) -> Callable[[Interval], Interval]:
    """Return the enclosure of a function that increases on `within` to values in `among`."""
    def value(x: float, towards: float) -> float:
        try:
            found = function(x)
        except OverflowError:
            found = math.copysign(inf, x)
        except ValueError:   # log(0)
            return -inf
        if found == 0.0 == x or math.isinf(found):
            return found
        return _outward(found, towards, units)

    def enclose(a: Interval) -> Interval:
        low, high = max(a.low, within[0]), min(a.high, within[1])
        if low > high:
            return WHOLE   # the function is undefined on all of a
        return Interval(max(among[0], value(low, -inf)), min(among[1], value(high, inf)))
    return enclose


def _size(a: Interval) -> Interval:
    ends = abs(a.low), abs(a.high)
    return Interval(0.0 if a.low <= 0.0 <= a.high else min(ends), max(ends))


_LARGEST = float(np.finfo(np.float64).max)
_PI = nextafter(pi, inf)
_HYPERBOLIC = _rising(math.cosh, (0.0, inf), (1.0, inf))
_MIRRORED = _rising(lambda x: math.acos(-x), (-1.0, 1.0), (0.0, _PI))

_OPERATIONS: dict[int, Callable[..., Interval]] = {
    ca.OP_ADD: add_intervals,
    ca.OP_SUB: lambda a, b: add_intervals(a, Interval(-b.high, -b.low)),
    ca.OP_MUL: multiply_intervals,
    ca.OP_DIV: _divide,
    ca.OP_NEG: lambda a: Interval(-a.high, -a.low),
    ca.OP_TWICE: lambda a: add_intervals(a, a),
    ca.OP_INV: lambda a: _divide(Interval(1.0, 1.0), a),
    ca.OP_SQ: _square,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SQRT: _rising(math.sqrt, (0.0, inf), (0.0, inf), 1),
    ca.OP_EXP: _rising(math.exp, among=(0.0, inf)),
    ca.OP_LOG: _rising(math.log, (0.0, inf)),
    ca.OP_TANH: _rising(math.tanh, among=(-1.0, 1.0)),
    ca.OP_SINH: _rising(math.sinh),
    ca.OP_COSH: lambda a: _HYPERBOLIC(_size(a)),
    ca.OP_ATAN: _rising(math.atan, among=(-_PI / 2, _PI / 2)),
    ca.OP_ASIN: _rising(math.asin, (-1.0, 1.0), (-_PI / 2, _PI / 2)),
    ca.OP_ACOS: lambda a: _MIRRORED(Interval(-a.high, -a.low)),
    ca.OP_TAN: _tangent,
    ca.OP_SIN: _wave(math.sin, pi / 2),
    ca.OP_COS: _wave(math.cos, 0.0),
    ca.OP_FABS: _size,
    ca.OP_FMIN: lambda a, b: Interval(min(a.low, b.low), min(a.high, b.high)),
    ca.OP_FMAX: lambda a, b: Interval(max(a.low, b.low), max(a.high, b.high)),
    ca.OP_ATAN2: lambda y, x: Interval(-_PI, _PI),
}
