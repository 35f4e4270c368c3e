# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What the workers of a cluster do: chunks of sweeps, in a solver process of each thread.

A worker itself computes nothing. Its solver process has the limits of time and memory, and is
kept for the next task.
"""

from threading import get_ident, Lock

from obc_ros.sweep.chunk_solver import Chunk, ChunkStoppedError, Row, solve_chunk, start_solver
from obc_ros.workers.pool import Pool

_solvers: dict[int, Pool] = {}   # by thread
_stopped: set[str] = set()       # sweeps that are not wanted any more
_lock = Lock()


def solve_chunk_here(chunk: Chunk, sweep: str) -> list[Row] | None:
    """
    Return the answers at the points of a chunk.

    Parameters
    ----------
    chunk : Chunk
        The points.
    sweep : str
        Identifies the sweep, for `stop_sweep`.

    Returns
    -------
    list or None
        None if the sweep was stopped.

    """
    with _lock:
        pool = _solvers.get(get_ident()) or start_solver()
        _solvers[get_ident()] = pool
    try:
        return solve_chunk(pool, chunk, lambda: sweep in _stopped)
    except ChunkStoppedError:
        return None


def stop_sweep(sweep: str) -> None:
    """Stop the chunks of a sweep on this worker."""
    _stopped.add(sweep)


def end_solvers() -> None:
    """End the solver processes of this process."""
    with _lock:
        pools = list(_solvers.values())
        _solvers.clear()
    for pool in pools:
        pool.close()
