# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""CasADi functions that read and write arrays in place, without a conversion of their values."""

from collections.abc import Callable

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array


class BufferedFunction:
    """
    A function whose inputs and outputs are arrays of a shared memory.

    An output is the input of another function if both have the same name.

    Parameters
    ----------
    function : casadi.Function
        It must not raise an exception, which would end the process.
    memory : dict of str to ndarray
        The arrays by name, each of the nonzeros in the order of CasADi (by columns). The arrays
        of further names are added, with zeros.

    Raises
    ------
    ValueError
        If an array has another size than the input or the output of its name.

    """

    def __init__(self, function: ca.Function, memory: dict[str, Array]) -> None:
        self._buffer, self._evaluate = function.buffer()
        self._places: list[tuple[Callable[..., None], int, memoryview]] = []
        for count, name_of, size_of, put in (
                (function.n_in(), function.name_in, function.nnz_in, self._buffer.set_arg),
                (function.n_out(), function.name_out, function.nnz_out, self._buffer.set_res)):
            for place in range(count):
                array = memory.setdefault(name_of(place), np.zeros(size_of(place)))
                if array.size != size_of(place):
                    raise ValueError(f'{name_of(place)} of {function.name()}: {array.size} '
                                     f'numbers; wanted {size_of(place)}')
                if array.size:
                    self._places.append((put, place, array.data))

    def run(self) -> None:
        """Compute the outputs."""
        for put, place, array in self._places:   # HPIPM uses the list of addresses for itself
            put(place, array)
        self._evaluate()
