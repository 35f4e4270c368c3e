# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Chunks solved by processes of this machine."""

from collections.abc import Generator, Sequence
from queue import SimpleQueue
from threading import Event, Thread

from obc_ros.sweep.chunk_solver import (
    Chunk,
    ChunkStoppedError,
    Row,
    solve_chunk,
    start_solver,
)

Finished = tuple[int, list[Row]]


def solve_locally(chunks: Sequence[Chunk], workers: int) -> Generator[Finished]:
    """
    Yield the answers of chunks as they are finished.

    :param chunks: in any order.
    :param workers: number of processes.
    :yield: number: of the chunk; rows: the answers at its points.
    """
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
