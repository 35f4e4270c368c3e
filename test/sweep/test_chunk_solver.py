# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A chunk: a point that fails costs this point only, and the rest does not depend on it."""

from contextlib import contextmanager
from pathlib import Path
import threading
import time

from obc_ros.sweep.chunk_solver import Chunk, ChunkStoppedError, solve_chunk
from obc_ros.workers.pool import Pool
import pytest
from support import wait_for

pytestmark = pytest.mark.slow   # each starts processes


@contextmanager
def running(monkeypatch):
    """Yield a pool of one stand-in worker."""
    monkeypatch.setenv('PYTHONPATH', str(Path(__file__).parents[1]))
    pool = Pool('stand_in_worker', 1)
    try:
        wait_for(lambda: pool.pids)
        yield pool
    finally:
        pool.close()


def solve(pool, *requests, time_limit=20.0, **options):
    """Return the answers at the points of a chunk."""
    chunk = Chunk(0, 'point', tuple({'name': name, **more} for name, more in requests), time_limit)
    return solve_chunk(pool, chunk, **options)


def test_a_chunk_begins_without_the_points_of_others(monkeypatch):
    with running(monkeypatch) as pool:
        first = solve(pool, ('a', {}), ('b', {}))
        again = solve(pool, ('a', {}), ('b', {}))
    assert first == again
    assert [row['seen'] for row in again] == [['a'], ['a', 'b']]


def test_a_process_that_was_killed_costs_nothing(monkeypatch, tmp_path):
    with running(monkeypatch) as pool:
        rows = solve(pool, ('a', {}), ('b', {'once': str(tmp_path / 'once')}), ('c', {}))
    assert (tmp_path / 'once').exists()
    assert [row['seen'] for row in rows] == [['a'], ['a', 'b'], ['a', 'b', 'c']]


def test_points_that_end_the_process_cost_these_points(monkeypatch):
    with running(monkeypatch) as pool:
        rows = solve(pool, ('a', {}), ('b', {'crash': True}), ('c', {}), ('d', {'crash': True}),
                     ('e', {'crash': True}))
    assert [row['status'] for row in rows] == ['solved', 'died', 'solved', 'died', 'died']
    assert 'SIGABRT' in rows[1]['message']
    assert rows[2]['seen'] == ['c']   # the new process knows of no other point


def test_a_point_without_an_answer_in_time_costs_this_point(monkeypatch):
    with running(monkeypatch) as pool:
        begun = time.monotonic()
        rows = solve(pool, ('a', {}), ('b', {'hang': True}), ('c', {}), time_limit=2.0)
    assert [row['status'] for row in rows] == ['solved', 'timed_out', 'solved']
    assert time.monotonic() - begun < 20.0


def test_a_chunk_can_be_stopped(monkeypatch):
    stop = threading.Event()
    with running(monkeypatch) as pool:
        threading.Timer(0.3, stop.set).start()
        with pytest.raises(ChunkStoppedError):
            solve(pool, ('a', {'hang': True}), is_stopped=stop.is_set)
        assert solve(pool, ('a', {}))[0]['status'] == 'solved'
