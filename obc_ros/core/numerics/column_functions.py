# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
CasADi functions of scalars for many rows at once, whole columns an instruction.

CasADi takes an instruction at a time, row by row, some nanoseconds each. An instruction of MX on
columns of sixteen rows and more takes less than one for an entry.
"""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array

# Rows evaluated at once: a few, or all of them up to a number, or many.
_FEW, _ALL, _MANY = 16, 128, 256
_PAID = 0, 20_000   # rows so far, after which building for all or for many at once has paid


class Columns:
    """
    The instructions of a function of columns of scalars.

    Parameters
    ----------
    function : casadi.Function
        Of SX.
    shared : sequence of int, optional
        The inputs that are the same for all rows.

    """

    def __init__(self, function: ca.Function, shared: Sequence[int] = ()) -> None:
        self._shared = shared
        self._outputs = [function.numel_out(i) for i in range(function.n_out())]
        count = function.n_instructions()
        self._steps = [(function.instruction_id(k), function.instruction_input(k),
                        function.instruction_output(k)) for k in range(count)]
        self._constants = {k: function.instruction_constant(k) for k in range(count)
                           if self._steps[k][0] == ca.OP_CONST}

    def __call__(self, rows: int, *given: ca.MX) -> list[ca.MX]:
        """Return the outputs, each (rows, its length), of inputs (rows, .) or (., 1) if shared."""
        split = [(ca.vertsplit if i in self._shared else ca.horzsplit)(part) if part.numel()
                 else [] for i, part in enumerate(given)]
        work = dict[int, ca.MX]()
        zero = ca.MX(0)
        found = [[zero] * count for count in self._outputs]
        unary, binary = ca.MX.unary, ca.MX.binary
        for k, (operation, read, written) in enumerate(self._steps):
            if operation == ca.OP_INPUT:
                work[written[0]] = split[read[0]][read[1]]
            elif operation == ca.OP_OUTPUT:
                found[written[0]][written[1]] = work[read[0]]
            elif operation == ca.OP_CONST:
                work[written[0]] = ca.MX(self._constants[k])
            elif len(read) == 2:
                work[written[0]] = binary(operation, work[read[0]], work[read[1]])
            else:
                work[written[0]] = unary(operation, work[read[0]])
        columns = dict[int, ca.MX]()   # of what is the same for all rows

        def column(part: ca.MX) -> ca.MX:
            if part.numel() == rows:
                return part
            key = part.__hash__()
            if key not in columns:
                columns[key] = ca.repmat(part, rows, 1)
            return columns[key]

        return [ca.horzcat(*map(column, parts)) if parts else ca.MX(rows, 0) for parts in found]

    def function(self, rows: int, lengths: Sequence[int]) -> ca.Function:
        """Return the function of so many rows and of inputs of these lengths."""
        given = [ca.MX.sym('given', *((length, 1) if i in self._shared else (rows, length)))
                 for i, length in enumerate(lengths)]
        return ca.Function('columns', given, [ca.densify(part) for part in self(rows, *given)])


class ByColumn:
    """
    A function from (rows, .) to (rows, .), for any number of rows.

    Parameters
    ----------
    of : callable
        Returns the function for so many rows.
    inputs, outputs : int
        Their lengths.
    paid : sequence of int, optional
        Rows after which building it for 16, 64 and 256 rows has paid.

    """

    def __init__(self, of: Callable[[int], ca.Function], inputs: int, outputs: int,
                 paid: Sequence[int] = _PAID) -> None:
        self._of, self._shape, self._paid, self._seen = of, (inputs, outputs), paid, 0
        # Arguments, results, the call from the first to the second, the buffer it is of.
        self._parcels: dict[int, tuple[Array, Array, Callable[[], None], Any]] = {}

    def __call__(self, arguments: Sequence[Array], result: Array) -> None:
        """Write the results for arguments side by side, (rows, .) or (.,) for all rows alike."""
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
        """Return how many of the rows left to evaluate at once, for a remainder as was built."""
        if self._seen < self._paid[0]:
            return _FEW
        if left > _ALL:
            return _MANY if self._seen >= self._paid[1] else _ALL
        most = _MANY if begun else left + max(_FEW, left // 3)
        return min((size for size in self._parcels if left <= size <= most),
                   default=-(-left // _FEW) * _FEW)

    def _parcel(self, size: int) -> tuple[Array, Array, Callable[[], None], Any]:
        if size not in self._parcels:
            given, found = np.ones((self._shape[0], size)), np.empty((self._shape[1], size))
            both: tuple[Any, Any] = self._of(size).buffer()
            buffer, evaluate = both
            # Copying some rows costs less than handing over their address.
            buffer.set_arg(0, given.data)
            buffer.set_res(0, found.data)
            self._parcels[size] = given, found, evaluate, buffer
        return self._parcels[size]
