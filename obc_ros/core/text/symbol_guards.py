# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Refusal, in words, of what Python functions may not do with symbols.

CasADi gives nan for float(x), so that a function of math would vanish from an expression or decide
an `if` without a word.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
import linecache
import math
import sys
from types import FrameType
from typing import Any

import casadi as ca
from obc_ros.core.text.errors import quote, StatementError

LARGER, SMALLER = '(a + b + fabs(a - b))/2', '(a + b - fabs(a - b))/2'

_LONG_NAMES = {'asin': 'arcsin', 'acos': 'arccos', 'atan': 'arctan', 'atan2': 'arctan2',
               'pow': 'power'}   # of functions of math in NumPy
_SHARED = {*_LONG_NAMES, 'cos', 'cosh', 'degrees', 'exp', 'exp2', 'expm1', 'fabs', 'hypot', 'log',
           'log10', 'log1p', 'log2', 'radians', 'sin', 'sinh', 'sqrt', 'tan', 'tanh'}
_refused = ContextVar('_refused', default=False)   # in this thread
_to_float, _to_bool = ca.SX.__float__, ca.SX.__bool__
_warn = getattr(ca.casadi, '_warn_preserve_type', None)   # not in older versions


@contextmanager
def refuse_values() -> Iterator[None]:
    """
    Raise StatementError where this thread uses a symbol as a number or as a condition.

    CasADi does not warn of functions of NumPy then: the expression is the same as with its own.
    """
    token = _refused.set(True)
    try:
        yield
    finally:
        _refused.reset(token)


def rewrite_operations(program: ca.Function, symbols: Sequence[ca.SX],
                       others: Mapping[int, Callable[..., Any]]) -> list[ca.SX]:
    """Return the scalar outputs of a function of scalars, with some operations replaced."""
    work: dict[int, ca.SX] = {}
    found = [ca.SX(0)] * program.n_out()
    for k in range(program.n_instructions()):
        operation, read, written = (program.instruction_id(k), program.instruction_input(k),
                                    program.instruction_output(k))
        if operation == ca.OP_OUTPUT:
            found[written[0]] = work[read[0]]
        elif operation == ca.OP_INPUT:
            work[written[0]] = symbols[read[0]]
        elif operation == ca.OP_CONST:
            work[written[0]] = ca.SX(program.instruction_constant(k))
        else:
            plain = ca.SX.unary if len(read) == 1 else ca.SX.binary
            apply = others.get(operation) or partial(plain, operation)
            work[written[0]] = apply(*(work[each] for each in read))
    return found


def _convert(value: ca.SX) -> float:
    if _refused.get() and value.is_scalar() and not value.is_constant():
        call = _read_call(sys._getframe(1))
        name = call.partition('(')[0].rpartition('.')[2]
        if hasattr(math, name):
            remedy = f': write numpy.{_LONG_NAMES.get(name, name)}' if name in _SHARED else ''
            raise StatementError(f'math.{name} takes numbers{remedy or ", not symbols"}')
        raise StatementError(f"'{quote(call or str(value), 40)}' takes numbers, not symbols")
    return float(_to_float(value))


def _decide(value: ca.SX) -> bool:
    try:
        return bool(_to_bool(value))
    except RuntimeError:
        if not _refused.get():
            raise
        call = _read_call(sys._getframe(1))
        told = f"'{quote(call, 40)}': " if call else ''
        raise StatementError(
            f'{told}if, and, or, max, min and a < b < c need numbers, not symbols; write the '
            f'larger of two as {LARGER}, the smaller as {SMALLER}, and a constraint a < b < c as '
            '(b, a, c)') from None


def _read_call(frame: FrameType) -> str:
    """Return the source of what a frame is evaluating, if it is on one line."""
    places: list[Any] = list(frame.f_code.co_positions())
    line, last, begin, end = places[frame.f_lasti // 2]
    if line is None or line != last or begin is None:
        return ''
    text = linecache.getline(frame.f_code.co_filename, line).encode()   # columns count bytes
    return text[begin:end].decode(errors='replace').strip()


def _warn_of_numpy() -> None:
    if _warn and not _refused.get():
        _warn()


def _guard(kind: Any, module: Any) -> None:
    kind.__float__, kind.__bool__, module._warn_preserve_type = _convert, _decide, _warn_of_numpy


_guard(ca.SX, ca.casadi)
