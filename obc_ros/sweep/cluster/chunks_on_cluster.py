# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Chunks solved by the workers of a Dask cluster."""

from collections.abc import Generator, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
import time
from typing import Any
import uuid

from obc_ros.core.text.errors import ObcError
from obc_ros.sweep.chunk_solver import Chunk, Finished
from obc_ros.sweep.cluster.connection import connect, count_threads, start_local
from obc_ros.sweep.cluster.tasks import end_solvers, solve_chunk_here, stop_sweep

AHEAD = 3          # chunks that wait at each thread of a worker
LOOK_PERIOD = 0.5         # [s] between two looks at the cluster
ALONE = 60.0       # [s] without a worker after which a sweep ends
LOST = 5.0         # [s] without the scheduler after which a sweep ends
TRIES = 10         # times that a chunk is sent again because its worker is gone


def solve_on_cluster(chunks: Sequence[Chunk], address: str, workers: int
                     ) -> Generator[Finished]:
    """
    Yield the answers of chunks as they are finished.

    A chunk whose worker is gone is sent to another one.

    :param address: of the scheduler; empty: a cluster in this process.
    :param workers: number of workers of a cluster in this process.
    :raises ObcError: if there is no scheduler, it is gone, it has no workers, or a chunk cannot be
        solved.
    """
    client = connect(address) if address else start_local(min(workers, len(chunks)) or 1)
    run = _ClusterRun(client, address or 'this process', chunks)
    try:
        yield from run.finished()
    finally:
        run.stop()
        with suppress(OSError, TimeoutError):
            client.close(timeout=2.0)
        if not address:
            client.cluster.close()
            end_solvers()


class _ClusterRun:
    """Chunks on a cluster: sent, some at a time, and their answers."""

    def __init__(self, client: Any, name: str, chunks: Sequence[Chunk]) -> None:
        self._client, self._name, self._chunks = client, name, chunks
        self._sweep = uuid.uuid4().hex
        self._sent = 0
        self._futures: dict[Any, tuple[Chunk, int]] = {}   # with the number of earlier tries
        self._done: SimpleQueue[Any] = SimpleQueue()
        self._seen = time.monotonic()     # when the scheduler, and a worker, was there last
        self._worked = self._seen

    def finished(self) -> Generator[Finished]:
        """Send chunks and yield their answers."""
        left = len(self._chunks)
        room = 0
        looked = -LOOK_PERIOD
        while left:
            if time.monotonic() - looked >= LOOK_PERIOD:
                room, looked = self._look(), time.monotonic()
            while self._sent < len(self._chunks) and len(self._futures) < room:
                self._send(self._chunks[self._sent], 0)
                self._sent += 1
            try:
                future = self._done.get(timeout=LOOK_PERIOD)
            except Empty:
                continue
            if (answer := self._take(future)) is not None:
                left -= 1
                yield answer

    def stop(self) -> None:
        """End the chunks under way."""
        if not self._futures:
            return
        with suppress(Exception):   # the cluster may be gone
            self._client.cancel(list(self._futures), force=True)
            self._client.run(stop_sweep, self._sweep, on_error='ignore')

    def _send(self, chunk: Chunk, tries: int) -> None:
        future = self._client.submit(
            solve_chunk_here, chunk, self._sweep, pure=False,
            key=f'obc-{self._sweep}-{chunk.number}-{tries}')
        self._futures[future] = chunk, tries
        future.add_done_callback(self._done.put)

    def _take(self, future: Any) -> Finished | None:
        chunk, tries = self._futures.pop(future)
        if future.status == 'finished':
            try:
                rows = future.result(timeout=LOST)
            except Exception as error:   # the worker that has it is gone, or all are
                why = str(error)
            else:
                if rows is not None:
                    return chunk.number, rows
                why = 'stopped'
        else:
            why = str(future.exception()) if future.status == 'error' else future.status
        self._look()
        if tries >= TRIES:
            raise ObcError(f'chunk {chunk.number} cannot be solved on the cluster: {why}')
        self._send(chunk, tries + 1)
        return None

    def _look(self) -> int:
        """Return how many chunks may be under way; ObcError: the cluster is gone."""
        while (threads := count_threads(self._client)) is None:
            if self._client.status == 'closed' or time.monotonic() > self._seen + LOST:
                raise ObcError(f'the scheduler of {self._name} is gone')
            time.sleep(0.1)
        self._seen = time.monotonic()
        if threads:
            self._worked = self._seen
        elif self._seen > self._worked + ALONE:
            raise ObcError(f'the cluster of {self._name} has had no worker for {ALONE:g} s')
        return AHEAD * threads
