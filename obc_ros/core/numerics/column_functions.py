# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
CasADi functions of scalars, evaluated by columns: one instruction for many rows.

CasADi evaluates a function of SX row by row and needs some nanoseconds for each instruction. An
instruction of MX on a column of 16 rows or more takes less than that for each row.
"""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import Instructions

# Rows evaluated at once: the unit; the most of a function built for one call; of many rows.
_FEW, _ALL, _MANY = 16, 128, 256
_PAID = 20_000   # rows so far after which a function of `_MANY` rows pays


class Columns:
    """The instructions of a function of scalars with one input, applied to columns."""

    def __init__(self, function: ca.Function) -> None:
        self._instructions, self._length = Instructions(function), function.size1_in(0)

    def function(self, rows: int) -> ca.Function:
        """Return the function from (rows, length) to (rows, length of the output)."""
        given = ca.MX.sym('given', rows, self._length)
        split = ca.horzsplit(given) if self._length else []
        unary, binary = ca.MX.unary, ca.MX.binary

        def apply(operation: int, operands: list[ca.MX]) -> ca.MX:
            return (binary(operation, operands[0], operands[1]) if len(operands) == 2
                    else unary(operation, operands[0]))

        found = self._instructions.evaluate(lambda i, k: split[k], ca.MX, apply)
        columns = dict[int, ca.MX]()   # of values that are the same for all rows

        def column(part: ca.MX) -> ca.MX:
            if part.numel() == rows:
                return part
            key = part.__hash__()
            if key not in columns:
                columns[key] = ca.repmat(part, rows, 1)
            return columns[key]

        return ca.Function('columns', [given], [
            ca.densify(ca.horzcat(*map(column, parts)) if parts else ca.MX(rows, 0))
            for parts in found])


class ByColumn:
    """
    A function from (rows, inputs) to (rows, outputs), for any number of rows.

    :param of: returns the function for a given number of rows.
    :param inputs, outputs: lengths of a row.
    """

    def __init__(self, of: Callable[[int], ca.Function], inputs: int, outputs: int) -> None:
        self._of, self._shape, self._seen = of, (inputs, outputs), 0
        # By number of rows: arguments, results, the call that evaluates them, its buffer.
        self._parcels: dict[int, tuple[Array, Array, Callable[[], None], Any]] = {}

    def __call__(self, arguments: Sequence[Array], result: Array) -> None:
        """Evaluate arguments (rows, length), or (length,) if equal for all rows, into `result`."""
        count, first = len(result), 0
        self._seen += count
        while first < count:
            given, found, evaluate, _ = self._parcel(self._size(count - first, first > 0))
            size = given.shape[1]
            last, row = min(first + size, count), 0
            for argument in arguments:
                end = row + argument.shape[-1]
                given[row:end, :last - first] = (
                    argument[first:last].T if argument.ndim == 2 else argument[:, None])
                row = end
            evaluate()
            result[first:last] = found[:, :last - first].T
            first = last

    def _size(self, left: int, begun: bool) -> int:
        """Return how many rows to evaluate next; a remainder uses a function that exists."""
        if left > _ALL:
            return _MANY if self._seen >= _PAID else _ALL
        most = _MANY if begun else left + max(_FEW, left // 3)
        return min((size for size in self._parcels if left <= size <= most),
                   default=-(-left // _FEW) * _FEW)

    def _parcel(self, size: int) -> tuple[Array, Array, Callable[[], None], Any]:
        if size not in self._parcels:
            given, found = np.ones((self._shape[0], size)), np.empty((self._shape[1], size))
            self._parcels[size] = given, found, *bind_buffers(self._of(size), given, found)
        return self._parcels[size]


def bind_buffers(function: ca.Function, given: Array, found: Array
                 ) -> tuple[Callable[[], None], Any]:
    """
    Bind the input and the output of a function to arrays.

    :param given, found: Contiguous. Copying some rows into them takes less time than passing their
        address.
    :return: evaluate: evaluates the function; buffer: to be kept as long as it is called.
    """
    both: tuple[Any, Any] = function.buffer()
    buffer, evaluate = both
    buffer.set_arg(0, given.data)
    buffer.set_res(0, found.data)
    return evaluate, buffer
