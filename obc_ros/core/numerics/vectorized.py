# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
CasADi functions evaluated for many points, from numpy arrays to numpy arrays.

CasADi evaluates a function of SX row by row and needs some nanoseconds for each instruction. An
instruction of MX on a column of 16 rows or more takes less than that for each row: functions that
are evaluated often are evaluated by columns.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import Instructions

_FEW = 32       # rows of a batch
_OFTEN = 1500   # rows so far after which building the evaluation by columns pays
# Rows of columns: the unit; the most of a function built for one call; of many rows.
_UNIT, _ALL, _MANY = 16, 128, 256
_PAID = 20_000   # rows so far after which a function of `_MANY` rows pays

# Arguments and results of a batch, the call that evaluates it, and its buffer, to be kept.
_Batch = tuple[Array, Array, Callable[[], None], Any]


class VectorizedFunction:
    """
    Expressions of columns of symbols, evaluated for the rows of arrays.

    Rows are evaluated in batches of one size, so that no function depends on their number. They
    are passed by address: the conversion of a thousand rows to `casadi.DM` takes longer than their
    evaluation. After `_OFTEN` rows they are evaluated by columns. Not thread-safe.

    :param outputs: expressions of the symbols; a matrix is taken column by column.
    :ivar outputs: slices of the outputs in a row of `joined`.
    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX],
                 few: int = _FEW) -> None:
        self._few = few
        # One input and one output: passing an argument takes longer than an evaluation.
        self._function = ca.Function('batch', [_stacked(inputs)], [
            _stacked([ca.densify(ca.vec(each)) for each in outputs])])
        self._inputs, self.outputs = _slice_row(inputs), _slice_row(outputs)
        self._shape = self._inputs[-1].stop, self.outputs[-1].stop
        self._seen = 0

    def __call__(self, *arguments: Array) -> tuple[Array, ...]:
        """Return outputs (K, length) for inputs (K, length), or (length,) used for all K."""
        result = self.joined(*arguments)
        return tuple(result[:, part] for part in self.outputs)

    def joined(self, *arguments: Array) -> Array:
        """Return the outputs side by side, shape (K, sum of their lengths)."""
        count = max((len(a) for a in arguments if np.ndim(a) == 2), default=1)
        if self._seen >= _OFTEN:
            result = np.empty((count, self._shape[1]))
            if result.size:
                self._by_column(arguments, result)
            return result
        w = np.empty((count, self._shape[0]))
        for part, argument in zip(self._inputs, arguments, strict=True):
            w[:, part] = argument
        return self.of_joined(w)

    def of_joined(self, w: Array, result: Array | None = None) -> Array:
        """Return the outputs side by side for inputs side by side, in `result` if it is given."""
        count = len(w)
        if result is None:
            result = np.empty((count, self._shape[1]))
        if not (w.size and result.size):
            return result
        self._seen += count
        if self._seen >= _OFTEN:
            self._by_column([w], result)
            return result
        given, found, evaluate, _ = self._batch
        for first in range(0, count, self._few):
            rows = slice(first, min(first + self._few, count))
            given[:count - first] = w[rows]
            evaluate()
            result[rows] = found[:count - first]
        return result

    @cached_property
    def _batch(self) -> _Batch:
        return _bind_buffers(self._function.map(self._few), *(
            np.zeros((self._few, size)) for size in self._shape))

    @cached_property
    def _by_column(self) -> '_ByColumn':
        return _ByColumn(self._function)


class _ByColumn:
    """A function from (rows, inputs) to (rows, outputs), for any number of rows."""

    def __init__(self, function: ca.Function) -> None:
        self._instructions, self._seen = Instructions(function), 0
        self._inputs, self._outputs = function.size1_in(0), function.size1_out(0)
        self._batches: dict[int, _Batch] = {}   # by number of rows

    def __call__(self, arguments: Sequence[Array], result: Array) -> None:
        """Evaluate arguments (rows, length), or (length,) if equal for all rows, into `result`."""
        count, first = len(result), 0
        self._seen += count
        while first < count:
            given, found, evaluate, _ = self._batch(self._size(count - first, first > 0))
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
        most = _MANY if begun else left + max(_UNIT, left // 3)
        return min((size for size in self._batches if left <= size <= most),
                   default=-(-left // _UNIT) * _UNIT)

    def _batch(self, rows: int) -> _Batch:
        if rows not in self._batches:
            self._batches[rows] = _bind_buffers(self._build(rows), np.ones(
                (self._inputs, rows)), np.empty((self._outputs, rows)))
        return self._batches[rows]

    def _build(self, rows: int) -> ca.Function:
        given = ca.MX.sym('given', rows, self._inputs)
        split = ca.horzsplit(given) if self._inputs else []

        def apply(operation: int, operands: list[ca.MX]) -> ca.MX:
            return (ca.MX.binary(operation, operands[0], operands[1]) if len(operands) == 2
                    else ca.MX.unary(operation, operands[0]))

        [parts] = self._instructions.evaluate(lambda _, k: split[k], ca.MX, apply)
        columns = dict[int, ca.MX]()   # of values that are the same for all rows

        def column(part: ca.MX) -> ca.MX:
            if part.numel() == rows:
                return part
            key = part.__hash__()
            if key not in columns:
                columns[key] = ca.repmat(part, rows, 1)
            return columns[key]

        return ca.Function('columns', [given], [
            ca.densify(ca.horzcat(*map(column, parts)) if parts else ca.MX(rows, 0))])


class Chain:
    """A recursion z_(k+1) = F(z_k, w_k), evaluated for the rows w_k of arrays."""

    def __init__(self, z: ca.SX, given: Sequence[ca.SX], after: ca.SX) -> None:
        steps = ca.Function('step', [z, _stacked(given)], [ca.densify(after)]).mapaccum(_FEW)
        self._inputs = _slice_row(given)
        self._buffer: tuple[Any, Any] = steps.buffer()

    def __call__(self, first: Array, *given: Array) -> Array:
        """Return z (K, length of z) after each step from `first`; a single row is used for all."""
        return np.asarray(self.each(first, *given)[0])

    def each(self, first: Array, *given: Array) -> Array:
        """
        Return z after each step of R sequences from the same z, shape (R, K, length of z).

        :param *given: (R, K, length) or broadcast to it, R and K are read from the first array.
        """
        courses, count = len(given[0]) if given[0].ndim == 3 else 1, given[0].shape[-2]
        rows = -(-count // _FEW) * _FEW
        w = np.zeros((courses, rows, self._inputs[-1].stop))
        result = np.empty((courses, rows, len(first)))
        for part, values in zip(self._inputs, given, strict=True):
            w[:, :count, part] = values
        begin = np.array(first, dtype=float)
        buffer, trigger = self._buffer
        for course in range(courses):
            now = begin
            for k in range(0, rows, _FEW):
                buffer.set_arg(0, now.data)
                buffer.set_arg(1, w[course, k:k + _FEW].data)
                buffer.set_res(0, result[course, k:k + _FEW].data)
                trigger()
                now = result[course, k + _FEW - 1]
        return result[:, :count]


def _bind_buffers(function: ca.Function, given: Array, found: Array) -> _Batch:
    """
    Bind the input and the output of a function to contiguous arrays.

    Copying some rows into them takes less time than passing their address.
    """
    both: tuple[Any, Any] = function.buffer()
    buffer, evaluate = both
    buffer.set_arg(0, given.data)
    buffer.set_res(0, found.data)
    return given, found, evaluate, buffer


def _slice_row(columns: Sequence[ca.SX]) -> list[slice]:
    """Return the slices of columns in a row that has their entries."""
    ends = accumulate((column.numel() for column in columns), initial=0)
    return [slice(start, end) for start, end in pairwise(ends)]


def _stacked(columns: Sequence[ca.SX]) -> ca.SX:
    """Return the columns as one; a single one is not copied."""
    return columns[0] if len(columns) == 1 else ca.vertcat(*columns)
