# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""CasADi expressions from Python functions, held to what an expression in text may contain."""

from collections.abc import Mapping
import math

import casadi as ca
from obc_ros.core.text.errors import StatementError

# The operations of the language of expressions, and what CasADi makes of them.
_KNOWN = {getattr(ca, f'OP_{name}') for name in (
    'ADD', 'SUB', 'MUL', 'DIV', 'POW', 'CONSTPOW', 'NEG', 'SQ', 'TWICE', 'INV', 'SQRT', 'SIN',
    'COS', 'TAN', 'ASIN', 'ACOS', 'ATAN', 'ATAN2', 'SINH', 'COSH', 'TANH', 'EXP', 'LOG', 'FABS',
    'CONST', 'INPUT', 'OUTPUT', 'ASSIGN')}
_IN_WORDS = {ca.OP_FMAX: 'fmax(a, b); write (a + b + fabs(a - b))/2',
             ca.OP_FMIN: 'fmin(a, b); write (a + b - fabs(a - b))/2',
             ca.OP_HYPOT: 'hypot(a, b); write sqrt(a**2 + b**2)',
             ca.OP_LOG1P: 'log1p(a); write log(1 + a)', ca.OP_EXPM1: 'expm1(a); write exp(a) - 1'}
_COMPARISONS = {getattr(ca, f'OP_{name}') for name in (
    'LT', 'LE', 'EQ', 'NE', 'NOT', 'AND', 'OR', 'IF_ELSE_ZERO')}


def check_symbolic(value: ca.SX, symbols: Mapping[str, ca.SX], where: str, largest: float
                   ) -> ca.SX:
    """
    Return an expression if it is one that a text over the same symbols could state.

    :raises StatementError: if it is not one expression, contains another symbol, an operation that
        a text cannot contain, or a number that is not finite or too large.
    """
    if value.shape != (1, 1):
        rows, columns = value.shape
        raise StatementError(f'{where}: wanted one expression, found a matrix of {rows} x '
                             f'{columns}')
    value = ca.densify(value)
    known = {symbol.element_hash() for symbol in symbols.values()}
    for symbol in ca.symvar(value):
        if symbol.element_hash() not in known:
            raise StatementError(f"{where}: the symbol '{symbol.name()}' is none of those that "
                                 'the function was called with')
    program = ca.Function('expression', list(symbols.values()), [value])
    for k in range(program.n_instructions()):
        operation = program.instruction_id(k)
        if operation not in _KNOWN:
            raise StatementError(f'{where}: {_describe(operation)}')
        if operation == ca.OP_CONST:
            number = float(program.instruction_constant(k))
            if not math.isfinite(number):
                raise StatementError(f'{where}: {number} is not a finite number')
            if abs(number) > largest:
                raise StatementError(f'{where}: {number:g} is too large; numbers up to '
                                     f'{largest:g} are accepted')
    return value


def _describe(operation: int) -> str:
    if operation in _COMPARISONS:
        return 'comparisons and if_else are not supported'
    if operation in _IN_WORDS:
        return f'an expression may not contain {_IN_WORDS[operation]}'
    return ('an operation is not supported; an expression may contain + - * / **, sin, cos, tan, '
            'asin, acos, atan, atan2, sinh, cosh, tanh, exp, log, sqrt and fabs')
