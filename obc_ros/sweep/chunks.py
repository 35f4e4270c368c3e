# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Chunks of neighbouring points, each solved by one worker in one order.

They depend on the points only, not on the number of workers. The grid is divided into tiles. A
tile is passed through row by row, every second row backwards, so that each point is a neighbour of
the one before.
"""

from collections.abc import Iterator, Sequence
import itertools
import math

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array

Indices = NDArray[np.int64]


def divide_grid(shape: Sequence[int], size: int) -> list[Indices]:
    """
    Return the chunks of a grid.

    :param size: largest number of points of a chunk.
    :return: flat indices of the points (the last dimension counts fastest), in the order of
        solution.
    """
    tiles = _tile_shape(shape, size)
    spans = [np.array_split(np.arange(n), math.ceil(n / t))
             for n, t in zip(shape, tiles, strict=True)]
    return [np.array([np.ravel_multi_index(point, tuple(shape)) for point in _serpentine(tile)],
                     np.int64)
            for tile in itertools.product(*spans)]


def order_samples(values: Array) -> Indices:
    """
    Return an order of random samples in which successive ones are near each other.

    :return: (count,), indices of the rows. The samples are halved again and again, each time
        across the widest dimension in units of its standard deviation.
    """
    spread = values.std(axis=0)
    scaled = values / np.where(spread > 0.0, spread, 1.0)
    order: list[int] = []
    waiting = [np.arange(len(values))]
    while waiting:
        rows = waiting.pop()
        if len(rows) == 1:
            order.append(int(rows[0]))
            continue
        widest = int(np.argmax(np.ptp(scaled[rows], axis=0)))
        rows = rows[np.argsort(scaled[rows, widest], kind='stable')]
        waiting += [rows[len(rows) // 2:], rows[:len(rows) // 2]]
    return np.array(order, np.int64)


def _tile_shape(shape: Sequence[int], size: int) -> list[int]:
    """Return the sides of a tile: as equal as the grid allows, at most `size` points."""
    sides = [1] * len(shape)
    while True:
        for k in sorted(range(len(shape)), key=lambda k: sides[k]):
            if sides[k] < shape[k] and math.prod(sides) // sides[k] * (sides[k] + 1) <= size:
                sides[k] += 1
                break
        else:
            return sides


def _serpentine(spans: Sequence[Indices]) -> Iterator[tuple[int, ...]]:
    """Yield the points of a tile; each differs from the last in one index, by one step."""
    if not spans:
        yield ()
        return
    for row, first in enumerate(spans[0]):
        rest = list(_serpentine(spans[1:]))
        for others in rest if row % 2 == 0 else reversed(rest):
            yield (int(first), *others)
