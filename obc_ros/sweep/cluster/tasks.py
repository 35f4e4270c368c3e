# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What the workers of a cluster do: chunks of sweeps and requests, in solver processes.

A worker itself computes nothing. Each of its threads has a solver process for each kind of work,
with the limits of time and memory, which is kept for the next task.
"""

from collections.abc import Callable
from threading import Event, get_ident, Lock
import time
from typing import Any

from obc_ros.sweep.chunk_solver import Chunk, ChunkStoppedError, Row, solve_chunk, start_solver
from obc_ros.workers.pool import Job, Pool, RequestAnswer, RequestOutcome
from obc_ros.workers.wire import Packet

_solvers: dict[tuple[int, str], Pool] = {}   # by thread and kind of work
_cancelled: set[str] = set()     # requests that are not wanted any more
_stopped: set[str] = set()       # sweeps that are not wanted any more
_lock = Lock()

CHECK = 0.01   # [s] between two looks at whether a request is cancelled


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

    Parameters
    ----------
    key : str
        Identifies the request, for `cancel_request` and its progress.
    module, kind, request, memory
        As for `Pool` and `Job`.
    time_limit : float
        Time [s] from the begin of this task to the answer.

    """
    pool = _find_solver(module, lambda: Pool(module, 1, memory=memory, niceness=0))
    report = _find_reporter()
    while not pool.pids and not pool.fault and key not in _cancelled:
        time.sleep(CHECK)
    answers: list[RequestAnswer] = []
    arrived = Event()

    def take(answer: RequestAnswer) -> None:
        answers.append(answer)
        arrived.set()

    job = Job(kind, request, time_limit, take, lambda *progress: report([key, *progress]))
    if key in _cancelled:
        _cancelled.discard(key)
        return RequestAnswer(RequestOutcome.CANCELLED, 'cancelled while it waited for a worker')
    pool.submit(job)
    while not arrived.wait(CHECK):
        if key in _cancelled and not job.cancelled:
            pool.cancel(job)
    _cancelled.discard(key)
    return answers[0]


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
    """Return the solver process of this thread for a kind of work."""
    with _lock:
        key = get_ident(), kind
        if key not in _solvers:
            _solvers[key] = start()
        return _solvers[key]


def _find_reporter() -> Callable[[list[Any]], None]:
    """Return what sends progress to the server: an event of the worker."""
    import distributed  # an extra, which only a worker of a cluster has
    worker = distributed.get_worker()
    return lambda progress: worker.log_event('obc-progress', progress)
