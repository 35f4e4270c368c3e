# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A pool whose requests are handled by a Dask cluster.

A thread connects to the scheduler. While there is no connection, the processes of the pool work,
also on the requests that were on the cluster when it was lost.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import Thread
import time
from typing import Any
import uuid

from obc_ros.core.text.errors import ObcError
from obc_ros.sweep.cluster.connection import check_address, connect, count_threads
from obc_ros.sweep.cluster.tasks import cancel_request, handle_request
from obc_ros.workers.pool import GRACE, Job, Pool, RequestAnswer, RequestOutcome
from obc_ros.workers.wire import Packet

AHEAD = 2       # requests at each thread of a worker, one of which waits
RETRY = 3.0     # [s] between two attempts to connect, and for each: it may not hold up an end
CHECK = 0.05    # [s] between two looks at requests and connection
COUNT = 1.0     # [s] between two counts of the threads
ENDING = 0.5    # [s] in which the cluster must answer a cancelled or late request
CLOSING = 2.0   # [s] that `close` waits for the connection to end


@dataclass(eq=False)
class _Sent:
    """A request on the cluster; `ends` is set when its end was asked for."""

    job: Job
    key: str
    future: Any
    ends: float = 0.0


class ClusterPool(Pool):
    """
    Requests on a cluster; processes of this machine take over if it is gone.

    :param say: called by a thread with a sentence, and whether it is good, when the cluster is
        found or lost.
    :ivar absence: why there is no connection; empty while there is one.
    :ivar threads: number of requests that the cluster handles at once.
    :raises StatementError: if the address is malformed.
    """

    def __init__(self, address: str, module: str, size: int,
                 say: Callable[[str, bool], None]) -> None:
        check_address(address)
        self.address = address
        self.absence, self.threads = 'not connected yet', 0
        self._say = say
        self._client: Any = None
        self._sent: dict[Job, _Sent] = {}
        super().__init__(module, size)
        self._thread = Thread(target=self._run, name='cluster', daemon=True)
        self._thread.start()

    @property
    def uses_processes(self) -> bool:
        """Return whether the processes take requests, in place of the cluster."""
        return bool(self.absence)

    @property
    def sent(self) -> int:
        """Return the number of requests on the cluster."""
        return len(self._sent)

    def has_room(self) -> bool:
        """Return whether a request need not wait."""
        return super().has_room() or not self.absence and self.waiting < (
            AHEAD * self.threads - self.sent)

    def close(self) -> None:
        """Cancel all requests, and end the connection and the processes."""
        with self._changed:
            self._closed = True
            sent = [*self._sent.values()]
        for each in sent:
            self._finish(each, RequestAnswer(RequestOutcome.CANCELLED,
                                             'the server is shutting down'))
        super().close()
        self._thread.join(CLOSING)

    def _run(self) -> None:
        while not self._closed:
            try:
                self._client = connect(self.address, RETRY)
                self._client.subscribe_topic('obc-progress', self._report)
            except (ObcError, OSError, TimeoutError) as error:
                self._lose(str(error))
            else:
                self._attend()
            with self._changed:
                self._changed.wait_for(lambda: self._closed, RETRY)

    def _attend(self) -> None:
        """Send requests and pass on answers until the connection is lost or closed."""
        counted = -COUNT
        while not self._closed and self._client.status == 'running':
            now = time.monotonic()
            if now > counted + COUNT:
                counted = now
                self._count()
            self.review()
            try:
                self._send()
            except Exception:   # the connection has just been lost
                break
            for each in [*self._sent.values()]:
                self._look(each, now)
            with self._changed:
                self._changed.wait_for(self._has_news, CHECK)
        if not self._closed:
            self._lose('the scheduler is gone')
        with suppress(Exception):   # a connection that is gone cannot be closed
            self._client.close(timeout=1.0)

    def _has_news(self) -> bool:
        return self._closed or self._may_send() or any(
            each.future.done() for each in self._sent.values())

    def _may_send(self) -> bool:
        return bool(self._queue) and not self.absence and self.sent < AHEAD * self.threads

    def _send(self) -> None:
        with self._changed:
            while self._may_send() and not self._closed:
                job, key = self._queue[0], f'obc-request-{uuid.uuid4().hex}'
                future = self._client.submit(
                    handle_request, key, self.module, job.kind, job.request,
                    max(job.deadline - time.monotonic(), 0.01), self.memory, pure=False, key=key)
                self._sent[self._queue.popleft()] = _Sent(job, key, future)
                future.add_done_callback(self._wake)

    def _wake(self, _: Any) -> None:
        with self._changed:
            self._changed.notify_all()

    def _look(self, sent: _Sent, now: float) -> None:
        """Take the answer to a request, or end it if it is cancelled or late."""
        job = sent.job
        if sent.future.done():
            self._take(sent)
        elif sent.ends:
            if now > sent.ends:
                self._finish(sent, job.give_up(Packet({})))
        elif job.cancelled or now > job.deadline + GRACE:
            sent.ends = now + ENDING
            try:
                self._client.run(cancel_request, sent.key, wait=False, on_error='ignore')
            except (OSError, RuntimeError, ValueError):
                sent.ends = now

    def _take(self, sent: _Sent) -> None:
        """Pass on the answer of the cluster; without one the request waits again."""
        if sent.future.status == 'error':
            self._finish(sent, RequestAnswer(RequestOutcome.DIED, (
                f'the worker of the cluster that was solving this has died: '
                f'{sent.future.exception()}')))
            return
        try:
            answer: RequestAnswer = sent.future.result(timeout=ENDING)
        except Exception:   # its worker is gone, or the scheduler
            self._return([sent.job])
            return
        is_ended = sent.ends and answer.outcome is not RequestOutcome.ANSWERED
        if is_ended or answer.outcome is RequestOutcome.TIMED_OUT:   # in words of this pool
            answer = sent.job.give_up(answer.packet)
        self._finish(sent, answer)

    def _count(self) -> None:
        if (threads := count_threads(self._client)) is None:
            return
        self.threads = threads
        if not self.threads:
            self._lose('it has no workers')
        elif self.absence:
            self.absence = ''
            self._say(f'requests go to the cluster {self.address}, {self.threads} threads', True)

    def _lose(self, why: str) -> None:
        """Go on with the processes of this machine."""
        known, self.absence = self.absence, why
        if known != why:
            self._say(f'the cluster {self.address} cannot be used: {why}; requests go to the '
                      'processes of this server', False)
        self._return([*self._sent])

    def _return(self, jobs: list[Job]) -> None:
        """Let requests that were on the cluster wait again, before all others."""
        with self._changed:
            self._queue.extendleft(job for job in reversed(jobs) if self._sent.pop(job, None))
            self._changed.notify_all()

    def _finish(self, sent: _Sent, answer: RequestAnswer) -> None:
        with self._changed:
            if self._sent.pop(sent.job, None) is None:
                return
        sent.future.release()
        sent.job.done(answer)

    def _report(self, event: Any) -> None:
        key, *progress = event[1]
        for sent in [*self._sent.values()]:
            if sent.key == key:
                sent.job.progress(*progress)
