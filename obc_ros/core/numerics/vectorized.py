# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A CasADi function over many points at once, from numpy arrays to numpy arrays."""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.column_functions import ByColumn, Columns

_FEW = 32      # rows evaluated at once while they are few
_MANY = 1500   # rows after which reading the instructions has paid


class VectorizedFunction:
    """
    Expressions of columns, evaluated for the rows of arrays.

    Rows are evaluated in parcels, so that another number of them builds nothing new, and pass by
    address: through `casadi.DM` a thousand of them would cost more to convert than to evaluate.
    Once there were many of them they are evaluated by column. Not for use from two threads at
    once.

    Parameters
    ----------
    inputs : sequence of casadi.SX
        Columns of symbols.
    outputs : sequence of casadi.SX
        Their expressions, taken column by column.
    few : int, optional
        Rows evaluated at once while they are few.

    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX],
                 few: int = _FEW) -> None:
        self._few = few
        # One input and one output: handing over each costs more than an evaluation.
        self._function = ca.Function('batch', [_stacked(inputs)], [
            _stacked([*map(_column, outputs)])])
        self._inputs = list(accumulate((symbol.numel() for symbol in inputs), initial=0))
        self._outputs = list(accumulate((output.numel() for output in outputs), initial=0))
        self._seen = 0

    def __call__(self, *arguments: Array) -> tuple[Array, ...]:
        """
        Return the outputs, each of shape (K, its length).

        Parameters
        ----------
        *arguments : ndarray, shape (K, length) or (length,)
            One for each input; a single row stands for K equal ones.

        """
        result = self.joined(*arguments)
        return tuple(result[:, start:end] for start, end in pairwise(self._outputs))

    def joined(self, *arguments: Array) -> Array:
        """Return the outputs side by side, shape (K, length of all)."""
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
        """Return where the outputs stand in a row of `joined`."""
        return [slice(start, end) for start, end in pairwise(self._outputs)]

    def of_joined(self, w: Array, result: Array | None = None) -> Array:
        """
        Return what `joined` does for inputs side by side.

        It is written to `result` where that is given.
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
        """Return where a few rows are taken from and put to, and what evaluates them."""
        given, found = (np.zeros((self._few, size[-1])) for size in (self._inputs, self._outputs))
        both: tuple[Any, Any] = self._function.map(self._few).buffer()
        buffer, evaluate = both
        # Copying some rows costs less than handing over their address.
        buffer.set_arg(0, given.data)
        buffer.set_res(0, found.data)
        return given, found, evaluate, buffer

    @cached_property
    def _by_column(self) -> ByColumn:
        columns, inputs = Columns(self._function), self._inputs[-1]
        return ByColumn(lambda rows: columns.function(rows, [inputs]), inputs, self._outputs[-1])


class Chain:
    """
    A step z_(k+1) = F(z_k, what is given for it), taken for all rows of arrays in turn.

    Parameters
    ----------
    z : casadi.SX
        Column of symbols.
    given : sequence of casadi.SX
        Columns of symbols.
    after : casadi.SX
        Expression of z after the step.

    """

    def __init__(self, z: ca.SX, given: Sequence[ca.SX], after: ca.SX) -> None:
        steps = ca.Function('step', [z, _stacked(given)], [ca.densify(after)]).mapaccum(_FEW)
        self._inputs = list(accumulate((symbol.numel() for symbol in given), initial=0))
        self._parcel: tuple[Any, Any] = steps.buffer()

    def __call__(self, first: Array, *given: Array) -> Array:
        """
        Return z after each step, shape (K, length of z).

        Parameters
        ----------
        first : ndarray
            z before the first step.
        *given : ndarray, shape (K, length) or (length,)
            A single row stands for K equal ones.

        """
        return np.asarray(self.each(first, *given)[0])

    def each(self, first: Array, *given: Array) -> Array:
        """
        Return z after each step of R courses from the same z, shape (R, K, length of z).

        Parameters
        ----------
        first : ndarray
            z before the first step.
        *given : ndarray, shape (R, K, length), or one that is repeated to it
            The first has K rows, and R of them where any has.

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
    """Return columns as one; a single one costs CasADi as much as several."""
    return columns[0] if len(columns) == 1 else ca.vertcat(*columns)


def _column(value: ca.SX) -> ca.SX:
    """Return the entries column by column."""
    column = value if value.is_column() else ca.vec(value)
    return column if column.is_dense() else ca.densify(column)
