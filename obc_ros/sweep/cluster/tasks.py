# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What the workers of a cluster do: chunks of sweeps and requests, in solver processes.

A worker itself computes nothing. Each of its threads has a solver process for each kind of work,
with the limits of time and memory, which is kept for the next task.
"""

from collections.abc import Callable
from threading import get_ident, Lock
from typing import Any

from obc_ros.sweep.chunk_solver import Chunk, ChunkStoppedError, Row, solve_chunk, start_solver
from obc_ros.workers.pool import Pool, RequestAnswer
from obc_ros.workers.wire import Packet

_solvers: dict[tuple[int, str], Pool] = {}   # by thread and kind of work
_cancelled: set[str] = set()     # requests that are not wanted any more
_stopped: set[str] = set()       # sweeps that are not wanted any more
_lock = Lock()


def solve_chunk_here(chunk: Chunk, sweep: str) -> list[Row] | None:
    """Return the answers at the points of a chunk; None: `stop_sweep` has stopped its sweep."""
    pool = _find_solver('chunks', start_solver)
    try:
        return solve_chunk(pool, chunk, lambda: sweep in _stopped)
    except ChunkStoppedError:
        return None


def stop_sweep(sweep: str) -> None:
    """Stop the chunks of a sweep on this worker."""
    _stopped.add(sweep)


def handle_request(key: str, module: str, kind: str, request: Packet, time_limit: float,
                   memory: int) -> RequestAnswer:
    """
    Return the answer to a request of a server.

    :param key: identifies the request, for `cancel_request` and its progress.
    :param module, kind, request, memory: as for `Pool` and `Job`.
    :param time_limit: time [s] from the begin of this task to the answer.
    """
    pool = _find_solver(module, lambda: Pool(module, 1, memory=memory, niceness=0))
    import distributed  # an extra, which only a worker of a cluster has
    worker = distributed.get_worker()

    def report(*progress: Any) -> bool:
        worker.log_event('obc-progress', [key, *progress])
        return False

    try:
        return pool.ask(kind, request, time_limit, lambda: key in _cancelled, report)
    finally:
        _cancelled.discard(key)


def cancel_request(key: str) -> None:
    """Cancel a request, if this worker handles it or is given it later."""
    _cancelled.add(key)


def end_solvers() -> None:
    """End the solver processes of this process."""
    with _lock:
        pools = list(_solvers.values())
        _solvers.clear()
    for pool in pools:
        pool.close()


def _find_solver(kind: str, start: Callable[[], Pool]) -> Pool:
    with _lock:
        key = get_ident(), kind
        if key not in _solvers:
            _solvers[key] = start()
        return _solvers[key]
