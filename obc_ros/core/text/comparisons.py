# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Constraints that are written as comparisons: ``v <= 1``, ``-1 <= v <= 1``, ``p == 1``.

They are rewritten in the form of a problem file: an expression with bounds, or for an equation at
an end an expression that is 0. What is no comparison stays as it is. < means <=.
"""

from collections.abc import Collection, Mapping, Sequence
import re
from typing import Any

import casadi as ca
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.core.text.expressions import RESERVED_NAMES

ENDS = 'terminal_constraints', 'initial_constraints', 'boundary_constraints'
PATH = 'path_constraints'

_SIGN = re.compile(r'<=|>=|==|<|>')
_NAME = re.compile(r'(?<![\w.])[A-Za-z_]\w*')
_SYMBOLIC = {ca.OP_LE: '<', ca.OP_LT: '<', ca.OP_EQ: '=='}


def state_comparisons(given: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return a statement, with or without phases, in which no text of a constraint compares."""
    parameters = given.get('parameters')
    known = {*RESERVED_NAMES, *(parameters if isinstance(parameters, Mapping) else ())}
    found = _state_keys(given, known, '')
    phases = given.get('phases')
    if isinstance(phases, (list, tuple)):
        found['phases'] = [_state_keys(phase, known, f'phases[{k}].') if isinstance(
            phase, Mapping) else phase for k, phase in enumerate(phases)]
    return found


def state_row(key: str, row: Any, where: str, known: Collection[str] = ()) -> Any:
    """
    Return a constraint in the form of a file.

    :param key: `PATH`, or one of `ENDS`.
    :param row: a text, an expression of CasADi, a triple (expression, lower, upper), or a mapping.
    :param known: names of numbers, that may be bounds.
    """
    if isinstance(row, (list, tuple)) and len(row) == 3:
        return dict(zip(('expr', 'lower', 'upper'), row, strict=True))
    parts, signs = _split_text(row) if isinstance(row, str) else _split_expression(row)
    if not signs:
        return row
    if set(signs) == {'>'}:
        parts, signs = parts[::-1], ['<' for _ in signs]
    if signs not in (['<'], ['<', '<'], ['==']):
        raise StatementError(f"{where}: '{quote(str(row), 40)}' is not one comparison, nor "
                             'lower <= expression <= upper')
    if key != PATH and signs == ['==']:
        return _subtract(*parts)
    return _bound(parts, signs, where, known)


def _state_keys(given: Mapping[Any, Any], known: Collection[str], where: str) -> dict[Any, Any]:
    return {key: [state_row(key, row, f'{where}{key}[{k}]', known)
                  for k, row in enumerate(value)]
            if key in (PATH, *ENDS) and isinstance(value, (list, tuple)) else value
            for key, value in given.items()}


def _bound(parts: Sequence[Any], signs: Sequence[str], where: str, known: Collection[str]
           ) -> dict[str, Any]:
    """Return an expression with its bounds; a number is one, of other terms the difference has."""
    left, right = (_is_number(each, known) for each in (parts[0], parts[-1]))
    if len(signs) == 2:
        if not (left and right):
            raise StatementError(f'{where}: wanted numbers on both sides; write two constraints')
        return {'expr': parts[1], 'lower': _read(parts[0]), 'upper': _read(parts[2])}
    first, last = parts
    expression, number = (first, _read(last)) if right else (
        (last, _read(first)) if left else (_subtract(first, last), 0))
    sides = ('lower', 'upper') if signs[0] == '==' else ('lower',) if left and not right else (
        'upper',)
    return {'expr': expression} | dict.fromkeys(sides, number)


def _split_text(text: str) -> tuple[list[Any], list[str]]:
    """Return the parts of a text between its comparisons, and these."""
    signs = [found for found in _SIGN.finditer(text)
             if text.count('(', 0, found.start()) == text.count(')', 0, found.start())]
    edges = [0, *(edge for found in signs for edge in found.span()), len(text)]
    parts = [text[a:b].strip() for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return (parts, [found[0].replace('<=', '<').replace('>=', '>') for found in signs]
            ) if all(parts) else ([text], [])


def _split_expression(row: Any) -> tuple[list[Any], list[str]]:
    if not isinstance(row, ca.SX) or not row.is_scalar() or not row.nnz():
        return [row], []
    for operation, sign in _SYMBOLIC.items():
        if row.is_op(operation):
            return [row.dep(0), row.dep(1)], [sign]
    return [row], []


def _is_number(part: Any, known: Collection[str]) -> bool:
    if isinstance(part, ca.SX):
        return bool(part.is_constant())
    return set(_NAME.findall(part)) <= set(known)


def _read(part: Any) -> Any:
    return float(part) if isinstance(part, ca.SX) else part


def _subtract(first: Any, last: Any) -> Any:
    return first - last if isinstance(first, ca.SX) else f'{first} - ({last})'
