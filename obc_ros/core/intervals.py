# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Between which values an expression stays while its symbols stay within bounds: interval arithmetic.

The bounds hold whatever the values are, and are wider than need be where a symbol stands several
times. Rounding is not directed: what is to follow from them needs a margin.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, inf, pi

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Interval:
    """All numbers from `low` to `high`; they may be infinite."""

    low: float
    high: float


WHOLE = Interval(-inf, inf)


def enclosure(function: ca.Function, boxes: list[tuple[Array, Array]]) -> list[Interval]:
    """
    Return an interval for each entry of the one output of a function of SX.

    Parameters
    ----------
    function : casadi.Function
        Of columns, made of casadi.SX.
    boxes : list of (lower, upper)
        Bounds of each argument, of its shape.

    """
    work: dict[int, Interval] = {}
    result = [Interval(0.0, 0.0)] * function.nnz_out(0)
    with np.errstate(all='ignore'):
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            inputs, outputs = function.instruction_input(k), function.instruction_output(k)
            if operation == ca.OP_INPUT:
                lower, upper = boxes[inputs[0]]
                work[outputs[0]] = Interval(float(lower[inputs[1]]), float(upper[inputs[1]]))
            elif operation == ca.OP_CONST:
                value = float(function.instruction_constant(k))
                work[outputs[0]] = Interval(value, value)
            elif operation == ca.OP_OUTPUT:
                result[outputs[1]] = work[inputs[0]]
            else:
                apply = _OPERATIONS.get(operation)
                found = apply(*(work[index] for index in inputs)) if apply else WHOLE
                undefined = np.isnan(found.low) or np.isnan(found.high)
                work[outputs[0]] = WHOLE if undefined else found
    return result


def _hull(*values: float) -> Interval:
    # 0 * inf is the product of a zero and of something large, not of something infinite
    numbers = [0.0 if np.isnan(value) else float(value) for value in values]
    return Interval(min(numbers), max(numbers))


def _add(a: Interval, b: Interval) -> Interval:
    return Interval(a.low + b.low, a.high + b.high)


def _subtract(a: Interval, b: Interval) -> Interval:
    return Interval(a.low - b.high, a.high - b.low)


def _multiply(a: Interval, b: Interval) -> Interval:
    return _hull(*np.outer([a.low, a.high], [b.low, b.high]).ravel())


def _divide(a: Interval, b: Interval) -> Interval:
    if b.low <= 0.0 <= b.high:
        return WHOLE
    return _multiply(a, Interval(1.0 / b.high, 1.0 / b.low))


def _square(a: Interval) -> Interval:
    ends = a.low * a.low, a.high * a.high
    return Interval(0.0 if a.low <= 0.0 <= a.high else min(ends), max(ends))


def _power(a: Interval, b: Interval) -> Interval:
    if b.low != b.high:
        return WHOLE
    n = b.low
    if n == 2.0:
        return _square(a)
    if n % 2.0 == 1.0 and n > 0:
        return Interval(a.low**n, a.high**n)
    if n % 2.0 == 0.0 and n > 0:
        return _power(_square(a), Interval(n / 2, n / 2))
    if n > 0 and a.low >= 0:
        return Interval(a.low**n, a.high**n)
    return WHOLE


def _wave(peak: float) -> Callable[[Interval], Interval]:
    """Return the enclosure of a wave of period 2 pi between -1 and 1 that is 1 at `peak`."""
    def enclose(a: Interval) -> Interval:
        if not a.high - a.low < 2 * pi:
            return Interval(-1.0, 1.0)
        ends = np.cos([a.low - peak, a.high - peak])

        def passes(at: float) -> bool:
            return at + 2 * pi * ceil((a.low - at) / (2 * pi)) <= a.high
        return Interval(-1.0 if passes(peak + pi) else float(ends.min()),
                        1.0 if passes(peak) else float(ends.max()))
    return enclose


def _rising(function: Callable[[float], float], least: float = -inf) -> (
        Callable[[Interval], Interval]):
    def enclose(a: Interval) -> Interval:
        return Interval(float(function(max(a.low, least))), float(function(a.high))) if (
            a.high >= least) else WHOLE
    return enclose


def _size(a: Interval) -> Interval:
    ends = abs(a.low), abs(a.high)
    return Interval(0.0 if a.low <= 0.0 <= a.high else min(ends), max(ends))


_OPERATIONS: dict[int, Callable[..., Interval]] = {
    ca.OP_ADD: _add,
    ca.OP_SUB: _subtract,
    ca.OP_MUL: _multiply,
    ca.OP_DIV: _divide,
    ca.OP_NEG: lambda a: Interval(-a.high, -a.low),
    ca.OP_TWICE: lambda a: Interval(2 * a.low, 2 * a.high),
    ca.OP_INV: lambda a: _divide(Interval(1.0, 1.0), a),
    ca.OP_SQ: _square,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SQRT: _rising(np.sqrt, 0.0),
    ca.OP_EXP: _rising(np.exp),
    ca.OP_LOG: _rising(np.log, 0.0),
    ca.OP_TANH: _rising(np.tanh),
    ca.OP_SINH: _rising(np.sinh),
    ca.OP_ATAN: _rising(np.arctan),
    ca.OP_SIN: _wave(pi / 2),
    ca.OP_COS: _wave(0.0),
    ca.OP_FABS: _size,
    ca.OP_ATAN2: lambda y, x: Interval(-pi, pi),
}
