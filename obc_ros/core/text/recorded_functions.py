# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What functions of a statement have returned, as plain data that another process can read.

A function of Python cannot be sent, but the expressions that it returned can, operation by
operation. They are checked as any others when they take their place in a statement.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import casadi as ca
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.expressions import parse_expression

_ROW = '\0'   # begins a text in place of an expression; no expression of a user contains it


@dataclass(frozen=True)
class RecordedFunction:
    """
    Expressions in place of the function that returned them.

    :ivar key: of the statement.
    :ivar names: of the symbols, which need not be those of the statement that it is read into.
    :ivar steps: operation, place of the result, and places of its operands; of a constant its
        value, of a symbol its number; of a row that is finished its place and its number.
    :ivar form: the value of the key, with the number of a row, after `_ROW`, for each expression.
    """

    key: str
    names: tuple[str, ...]
    steps: tuple[tuple[Any, ...], ...]
    form: Any

    def evaluate(self, symbols: Mapping[str, ca.SX]) -> Any:
        """Return the value of the key, with expressions in the symbols of a statement."""
        work, rows = dict[int, ca.SX](), dict[int, ca.SX]()
        for operation, result, *operands in self.steps:
            if operation == ca.OP_INPUT:
                name = self.names[operands[0]]
                if name not in symbols:
                    raise StatementError(f"{self.key}: the function used '{name}', which the "
                                         'statement no longer has')
                work[result] = symbols[name]
            elif operation == ca.OP_CONST:
                work[result] = ca.SX(operands[0])
            elif operation == ca.OP_OUTPUT:
                rows[operands[0]] = work[result]
            else:
                apply = ca.SX.unary if len(operands) == 1 else ca.SX.binary
                work[result] = apply(operation, *(work[each] for each in operands))
        return _insert(self.form, rows)


def record_function(key: str, value: Any, symbols: Mapping[str, ca.SX]) -> RecordedFunction:
    """
    Return what a function has returned for symbols, without the symbols.

    :raises StatementError: if an expression is a matrix, or has other symbols.
    """
    rows: list[ca.SX] = []
    form = _take_out(value, rows)
    for row in rows:
        parse_expression(row, symbols, key)   # refuses what cannot be recorded
    column = ca.vertcat(ca.SX(0, 1), *rows)   # it has symbols even if there are no rows
    used = {symbol.element_hash() for symbol in ca.symvar(column)}
    symbols = {name: each for name, each in symbols.items() if each.element_hash() in used}
    program = ca.Function('stated', [ca.vertcat(ca.SX(0, 1), *symbols.values())], [
        ca.densify(column)])
    steps: list[tuple[Any, ...]] = []
    for k in range(program.n_instructions()):
        operation, read, written = (program.instruction_id(k), program.instruction_input(k),
                                    program.instruction_output(k))
        if operation == ca.OP_OUTPUT:
            steps.append((operation, read[0], written[1]))
        elif operation == ca.OP_INPUT:
            steps.append((operation, written[0], read[1]))
        elif operation == ca.OP_CONST:
            steps.append((operation, written[0], float(program.instruction_constant(k))))
        else:
            steps.append((operation, written[0], *read))
    return RecordedFunction(key, tuple(symbols), tuple(steps), form)


def pack_statement(statement: Mapping[str, Any]) -> dict[str, Any]:
    """Return a request with a statement as plain data: recorded functions are beside it."""
    recorded = {key: asdict(value) for key, value in statement.items()
                if isinstance(value, RecordedFunction)}
    plain = {key: value for key, value in statement.items() if key not in recorded}
    return {'statement': plain} | ({'functions': recorded} if recorded else {})


def unpack_statement(request: Mapping[str, Any]) -> Any:
    """Return the statement of a request that `pack_statement` has made."""
    if not request.get('functions'):
        return request['statement']
    return request['statement'] | {key: RecordedFunction(
        **{**plain, 'names': tuple(plain['names'])})
        for key, plain in request['functions'].items()}


def _take_out(value: Any, rows: list[ca.SX]) -> Any:
    """Return nested mappings and lists with numbers of rows in place of expressions."""
    if isinstance(value, ca.SX):
        rows.append(value)
        return f'{_ROW}{len(rows) - 1}'
    if isinstance(value, Mapping):
        return {name: _take_out(each, rows) for name, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_take_out(each, rows) for each in value]
    return value


def _insert(form: Any, rows: Mapping[int, ca.SX]) -> Any:
    if isinstance(form, str) and form.startswith(_ROW):
        return rows[int(form[1:])]
    if isinstance(form, Mapping):
        return {name: _insert(each, rows) for name, each in form.items()}
    return [_insert(each, rows) for each in form] if isinstance(form, list) else form
