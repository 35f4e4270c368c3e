# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Chunks: every point once, neighbours together, the same whatever the workers."""

from hypothesis import given, strategies
import numpy as np
from obc_ros.sweep.chunks import divide_grid, order_samples

SHAPES = strategies.lists(strategies.integers(1, 6), min_size=1, max_size=3)


@given(SHAPES, strategies.integers(1, 40))
def test_every_point_is_in_one_chunk(shape, size):
    chunks = divide_grid(shape, size)
    assert sorted(np.concatenate(chunks)) == list(range(int(np.prod(shape, dtype=int))))
    assert max(map(len, chunks)) <= size


@given(SHAPES, strategies.integers(1, 40))
def test_successive_points_differ_by_one_step(shape, size):
    for chunk in divide_grid(shape, size):
        places = np.array(np.unravel_index(chunk, tuple(shape))).reshape(len(shape), -1)
        assert (np.abs(np.diff(places, axis=1)).sum(axis=0) == 1).all()


def test_tiles_are_compact():
    chunks = divide_grid((100, 100), 64)
    assert len(chunks) <= 2 * 100 * 100 / 64
    for chunk in chunks:
        rows, columns = np.unravel_index(chunk, (100, 100))
        assert np.ptp(rows) <= 7 and np.ptp(columns) <= 7


@given(strategies.integers(1, 60), strategies.integers(1, 3), strategies.integers(0, 99))
def test_an_order_of_samples_has_each_once(count, keys, seed):
    values = np.random.default_rng(seed).normal(size=(count, keys))
    assert sorted(order_samples(values)) == list(range(count))


def test_successive_samples_are_near_each_other():
    values = np.random.default_rng(1).normal(size=(2000, 2))
    order = order_samples(values)
    steps = np.linalg.norm(np.diff(values[order], axis=0), axis=1)
    unordered = np.linalg.norm(np.diff(values, axis=0), axis=1)
    assert steps.mean() < 0.1 * unordered.mean()


def test_samples_of_equal_values_can_be_ordered():
    assert sorted(order_samples(np.ones((5, 2)))) == list(range(5))
