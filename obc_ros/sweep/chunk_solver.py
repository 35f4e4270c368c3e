# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The points of a chunk, solved one after the other by a solver process.

The process is that of a `Pool`: a point that exceeds its time or memory, or that ends the process,
costs this point only.
"""

from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
import math
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any

from obc_ros.workers.pool import Pool, RequestOutcome
from obc_ros.workers.wire import Packet

MODULE = 'obc_ros.sweep.point_requests'
MEMORY = 2 << 30       # [bytes] of a solver process
TRIES = 3              # times that a process may end at a point
STATUS_OF = {RequestOutcome.REFUSED: 'died', RequestOutcome.TIMED_OUT: 'timed_out',
             RequestOutcome.CANCELLED: 'cancelled'}

Row = dict[str, Any]   # the answer at one point
Finished = tuple[int, list[Row]]   # a chunk and its answers


class ChunkStoppedError(Exception):
    """A chunk was stopped before its end."""


@dataclass(frozen=True)
class Chunk:
    """Points to be solved in this order: kind and contents of each request."""

    number: int
    kind: str
    requests: tuple[dict[str, Any], ...]
    time_limit: float


def start_solver() -> Pool:
    """Return a pool of one process for chunks."""
    return Pool(MODULE, 1, memory=MEMORY, niceness=0)


def solve_chunk(pool: Pool, chunk: Chunk,
                is_stopped: Callable[[], bool] = lambda: False) -> list[Row]:
    """
    Return the answers at all points of a chunk.

    They do not depend on what the process has solved before. If the process ends, the chunk is
    begun again; a point at which it has ended `TRIES` times has the status ``died``.

    :param pool: of one process, from `start_solver`.
    :param is_stopped: called several times a second.
    :raises ChunkStoppedError: if `is_stopped` returned True.
    """
    deaths: Counter[int] = Counter()
    guilty: dict[int, str] = {}
    while True:
        rows, message = _try_chunk(pool, chunk, is_stopped, guilty)
        if not message:
            return rows
        deaths[len(rows)] += 1
        if deaths[len(rows)] >= TRIES:
            guilty[len(rows)] = message


def _try_chunk(pool: Pool, chunk: Chunk, is_stopped: Callable[[], bool],
               guilty: Mapping[int, str]) -> tuple[list[Row], str]:
    """
    Solve the points of a chunk, but for the guilty ones, until the process ends.

    :return: rows: all answers, or those before the process ended; message: how the process ended,
        at the point after these; empty if it did not.
    """
    rows: list[Row] = []
    fresh = True
    for index, request in enumerate(chunk.requests):
        if index in guilty:
            rows.append({'status': 'died', 'message': guilty[index], 'time': math.nan})
            fresh = True
            continue
        answer = pool.ask(chunk.kind, Packet({**request, 'fresh': fresh}), chunk.time_limit,
                          is_stopped)
        if is_stopped():
            raise ChunkStoppedError
        if answer.outcome is RequestOutcome.DIED:
            return rows, answer.message
        fresh = answer.outcome is not RequestOutcome.ANSWERED   # the next process knows nothing
        rows.append(answer.packet.plain if not fresh else {
            'status': STATUS_OF[answer.outcome], 'message': answer.message,
            'time': chunk.time_limit})
    return rows, ''


def solve_locally(chunks: Sequence[Chunk], workers: int) -> Generator[Finished]:
    """Yield numbers and answers of chunks as processes of this machine finish them."""
    waiting: SimpleQueue[Chunk] = SimpleQueue()
    finished: SimpleQueue[Finished | BaseException] = SimpleQueue()
    stop = Event()
    for chunk in chunks:
        waiting.put(chunk)

    def work() -> None:
        pool = start_solver()
        try:
            while not stop.is_set() and not waiting.empty():
                chunk = waiting.get_nowait()
                finished.put((chunk.number, solve_chunk(pool, chunk, stop.is_set)))
        except ChunkStoppedError:
            return
        except BaseException as error:
            finished.put(error)
        finally:
            pool.close()

    threads = [Thread(target=work, name='chunks', daemon=True)
               for _ in range(min(workers, len(chunks)))]
    for thread in threads:
        thread.start()
    try:
        for _ in chunks:
            found = finished.get()
            if isinstance(found, BaseException):
                raise found
            yield found
    finally:
        stop.set()
        for thread in threads:
            thread.join()
