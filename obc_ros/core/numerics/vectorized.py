# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""CasADi functions evaluated for many points, from numpy arrays to numpy arrays."""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.column_functions import bind_buffers, ByColumn, Columns

_FEW = 32      # rows of a batch
_MANY = 1500   # rows so far after which building the evaluation by columns pays


class VectorizedFunction:
    """
    Expressions of columns of symbols, evaluated for the rows of arrays.

    Rows are evaluated in batches of one size, so that no function depends on their number. They
    are passed by address: the conversion of a thousand rows to `casadi.DM` takes longer than their
    evaluation. After `_MANY` rows they are evaluated by columns. Not thread-safe.

    :param outputs: expressions of the symbols; a matrix is taken column by column.
    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX],
                 few: int = _FEW) -> None:
        self._few = few
        # One input and one output: passing an argument takes longer than an evaluation.
        self._function = ca.Function('batch', [_stacked(inputs)], [
            _stacked([*map(_column, outputs)])])
        self._inputs = list(accumulate((symbol.numel() for symbol in inputs), initial=0))
        self._outputs = list(accumulate((output.numel() for output in outputs), initial=0))
        self._seen = 0

    def __call__(self, *arguments: Array) -> tuple[Array, ...]:
        """Return outputs (K, length) for inputs (K, length), or (length,) used for all K."""
        result = self.joined(*arguments)
        return tuple(result[:, start:end] for start, end in pairwise(self._outputs))

    def joined(self, *arguments: Array) -> Array:
        """Return the outputs side by side, shape (K, sum of their lengths)."""
        count = max((len(a) for a in arguments if np.ndim(a) == 2), default=1)
        if self._seen >= _MANY:
            result = np.empty((count, self._outputs[-1]))
            if result.size:
                self._by_column(arguments, result)
            return result
        w = np.empty((count, self._inputs[-1]))
        for (start, end), argument in zip(pairwise(self._inputs), arguments, strict=True):
            w[:, start:end] = argument
        return self.of_joined(w)

    @property
    def outputs(self) -> list[slice]:
        """Return the slices of the outputs in a row of `joined`."""
        return [slice(start, end) for start, end in pairwise(self._outputs)]

    def of_joined(self, w: Array, result: Array | None = None) -> Array:
        """
        Return the outputs side by side for inputs side by side.

        :param w: (K, sum of the lengths of the inputs), the inputs.
        :param result: (K, sum of the lengths of the outputs), optional, array to write to and to
            return.
        """
        count = len(w)
        if result is None:
            result = np.empty((count, self._outputs[-1]))
        if not (w.size and result.size):
            return result
        self._seen += count
        if self._seen >= _MANY:
            self._by_column([w], result)
            return result
        given, found, evaluate, _ = self._parcel
        for first in range(0, count, self._few):
            rows = slice(first, min(first + self._few, count))
            given[:count - first] = w[rows]
            evaluate()
            result[rows] = found[:count - first]
        return result

    @cached_property
    def _parcel(self) -> tuple[Array, Array, Callable[[], None], Any]:
        """Return the arguments and results of a batch, the call that evaluates it, its buffer."""
        given, found = (np.zeros((self._few, size[-1])) for size in (self._inputs, self._outputs))
        return given, found, *bind_buffers(self._function.map(self._few), given, found)

    @cached_property
    def _by_column(self) -> ByColumn:
        return ByColumn(Columns(self._function).function, self._inputs[-1], self._outputs[-1])


class Chain:
    """
    A recursion z_(k+1) = F(z_k, w_k), evaluated for the rows w_k of arrays.

    :param given: columns of symbols, together w.
    :param after: F, an expression of these symbols of the shape of z.
    """

    def __init__(self, z: ca.SX, given: Sequence[ca.SX], after: ca.SX) -> None:
        steps = ca.Function('step', [z, _stacked(given)], [ca.densify(after)]).mapaccum(_FEW)
        self._inputs = list(accumulate((symbol.numel() for symbol in given), initial=0))
        self._parcel: tuple[Any, Any] = steps.buffer()

    def __call__(self, first: Array, *given: Array) -> Array:
        """
        Return z after each step, shape (K, length of z).

        :param first: (length of z,), z before the first step.
        :param *given: (K, length) or (length,), a single row is used for all K steps.
        """
        return np.asarray(self.each(first, *given)[0])

    def each(self, first: Array, *given: Array) -> Array:
        """
        Return z after each step of R sequences from the same z, shape (R, K, length of z).

        :param first: (length of z,), z before the first step.
        :param *given: (R, K, length) or broadcast to it, R and K are read from the first array.
        """
        courses, count = len(given[0]) if given[0].ndim == 3 else 1, given[0].shape[-2]
        rows = -(-count // _FEW) * _FEW
        w = np.zeros((courses, rows, self._inputs[-1]))
        result = np.empty((courses, rows, len(first)))
        for (start, end), values in zip(pairwise(self._inputs), given, strict=True):
            w[:, :count, start:end] = values
        begin = np.array(first, dtype=float)
        buffer, trigger = self._parcel
        for course in range(courses):
            now = begin
            for k in range(0, rows, _FEW):
                buffer.set_arg(0, now.data)
                buffer.set_arg(1, w[course, k:k + _FEW].data)
                buffer.set_res(0, result[course, k:k + _FEW].data)
                trigger()
                now = result[course, k + _FEW - 1]
        return result[:, :count]


def _stacked(columns: Sequence[ca.SX]) -> ca.SX:
    """Return the columns as one; a single one is not copied."""
    return columns[0] if len(columns) == 1 else ca.vertcat(*columns)


def _column(value: ca.SX) -> ca.SX:
    """Return the entries column by column."""
    column = value if value.is_column() else ca.vec(value)
    return column if column.is_dense() else ca.densify(column)
