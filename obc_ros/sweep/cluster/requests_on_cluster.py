# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Requests of a server on a Dask cluster, with the interface of `workers.pool.Pool`.

A thread connects to the scheduler. While there is no connection, and for requests under way when
it is lost, the server's own processes work.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
import time
from typing import Any
import uuid

from obc_ros.core.text.errors import ObcError
from obc_ros.sweep.cluster.connection import check_address, connect
from obc_ros.sweep.cluster.tasks import cancel_request, handle_request
from obc_ros.workers.pool import GRACE, Job, Pool, RequestAnswer, RequestOutcome

RETRY = 3.0     # [s] between two attempts to connect, and for each: it may not hold up an end
CHECK = 0.05    # [s] between two looks at requests and connection
ENDING = 0.5    # [s] in which the cluster must answer a cancelled or late request
CLOSING = 2.0   # [s] that `close` waits for the connection to end
SILENT = 3.0    # [s] without the scheduler after which the own processes take over


@dataclass(eq=False)
class _Sent:
    """A request on the cluster; `ends` is set when its end was asked for."""

    job: Job
    key: str
    deadline: float
    future: Any
    ends: float = 0.0
    outcome: RequestOutcome = RequestOutcome.CANCELLED


class ClusterPool:
    """
    Requests on a cluster; own processes take over if it is gone.

    Parameters
    ----------
    address : str
        Of the scheduler.
    module : str
        As for `Pool`.
    own : Pool
        The processes of the server. It counts the outcomes of all requests.
    say : callable
        Called by a thread with a sentence, and whether it is good, when the cluster is found or
        lost.

    Attributes
    ----------
    fault : str
        Why there is no connection; empty while there is one.
    threads : int
        Number of requests that the cluster handles at once.

    Raises
    ------
    StatementError
        If the address is malformed.

    """

    def __init__(self, address: str, module: str, own: Pool,
                 say: Callable[[str, bool], None]) -> None:
        check_address(address)
        self.address, self.module = address, module
        self.fault, self.threads = 'not connected yet', 0
        self._own, self._say = own, say
        self._client: Any = None
        self._lock = Lock()
        self._sent: dict[Job, _Sent] = {}
        self._moved: dict[Job, Job] = {}   # to the own processes
        self._closed = Event()
        self._arrived: SimpleQueue[_Sent] = SimpleQueue()
        self._thread = Thread(target=self._run, name='cluster', daemon=True)
        self._thread.start()

    @property
    def busy(self) -> int:
        """Return the number of requests on the cluster."""
        return len(self._sent)

    def submit(self, job: Job) -> None:
        """Accept a request; its time limit counts from now on."""
        with self._lock:
            full = len(self._sent) >= self.threads + self._own.queue_length
            if not self.fault and not full:
                try:
                    self._send(job)
                    return
                except Exception as error:   # the connection has just been lost
                    self.fault = str(error)
        if not self.fault and full:
            self._own.finish(job, RequestAnswer(RequestOutcome.REFUSED, (
                f'refused: {len(self._sent)} requests wait for the cluster; send the request '
                'again later')))
            return
        self._own.submit(job)

    def cancel(self, job: Job) -> None:
        """Stop a request."""
        with self._lock:
            sent, moved = self._sent.get(job), self._moved.get(job, job)
            if sent:
                job.cancelled = True   # `_look` asks the cluster
        if not sent:
            self._own.cancel(moved)

    def close(self) -> None:
        """Cancel all requests on the cluster and end the connection."""
        self._closed.set()
        self._thread.join(CLOSING)

    def _send(self, job: Job) -> None:
        key = f'obc-request-{uuid.uuid4().hex}'
        future = self._client.submit(
            handle_request, key, self.module, job.kind, job.request, job.time_limit,
            self._own.memory, pure=False, key=key)
        sent = _Sent(job, key, time.monotonic() + job.time_limit, future)
        self._sent[job] = sent
        future.add_done_callback(lambda _: self._arrived.put(sent))

    def _run(self) -> None:
        """Connect, and connect again, until closed."""
        while not self._closed.is_set():
            try:
                self._client = connect(self.address, RETRY)
                self._client.subscribe_topic('obc-progress', self._report)
            except (ObcError, OSError, TimeoutError) as error:
                self._lose(str(error))
            else:
                self._count()
                self._attend()
            self._closed.wait(RETRY)

    def _attend(self) -> None:
        """Pass on answers until the connection is lost or closed."""
        looked = seen = time.monotonic()
        while not self._closed.is_set():
            try:
                sent = self._arrived.get(timeout=CHECK)
            except Empty:
                pass
            else:
                self._take(sent)
            now = time.monotonic()
            if self._client.status == 'running':
                seen = now
            if now > seen + SILENT or self._client.status == 'closed':
                self._lose('the scheduler is gone')
                break
            for each in list(self._sent.values()):
                self._look(each, now)
            if now > looked + 1.0:
                looked = now
                self._count()
        for each in list(self._sent.values()) if self._closed.is_set() else ():
            self._finish(each, RequestAnswer(RequestOutcome.CANCELLED,
                                             'the server is shutting down'))
        try:
            self._client.close(timeout=1.0)
        except Exception as error:   # a connection that is gone cannot be closed
            self.fault = self.fault or str(error)

    def _look(self, sent: _Sent, now: float) -> None:
        """End a request that is cancelled or late."""
        if sent.ends:
            if now > sent.ends:
                self._finish(sent, _ended(sent, RequestAnswer(sent.outcome)))
            return
        late = now > sent.deadline + GRACE
        if late or sent.job.cancelled:
            sent.outcome = (RequestOutcome.CANCELLED if sent.job.cancelled else
                            RequestOutcome.TIMED_OUT)
            sent.ends = now + ENDING
            try:
                self._client.run(cancel_request, sent.key, wait=False, on_error='ignore')
            except (OSError, RuntimeError, ValueError):
                sent.ends = now

    def _take(self, sent: _Sent) -> None:
        """Pass on the answer of the cluster, or give the request to the own processes."""
        if sent.job not in self._sent:
            return
        if sent.future.status == 'finished':
            try:
                answer: RequestAnswer = sent.future.result(timeout=ENDING)
            except Exception:   # its worker is gone
                self._move(sent)
            else:
                self._finish(sent, _ended(sent, answer) if sent.ends else answer)
        elif sent.future.status == 'error':
            self._finish(sent, RequestAnswer(RequestOutcome.DIED, (
                f'the worker of the cluster that was solving this has died: '
                f'{sent.future.exception()}')))
        else:
            self._move(sent)

    def _count(self) -> None:
        try:
            self.threads = sum(self._client.nthreads().values())
        except (OSError, TimeoutError):
            return
        if not self.threads:
            self._lose('it has no workers')
        elif self.fault:
            self.fault = ''
            self._say(f'requests go to the cluster {self.address}, {self.threads} threads', True)

    def _lose(self, why: str) -> None:
        """Go on with the own processes."""
        known, self.fault = self.fault, why
        if known != why:
            self._say(f'the cluster {self.address} cannot be used: {why}; requests go to the '
                      'processes of this server', False)
        for sent in list(self._sent.values()):
            self._move(sent)

    def _move(self, sent: _Sent) -> None:
        """Give a request to the own processes, with the time that is left."""
        with self._lock:
            if self._sent.pop(sent.job, None) is None:
                return
            job = replace(sent.job, time_limit=max(sent.deadline - time.monotonic(), 0.01),
                          done=lambda answer: self._settle(sent.job, answer))
            self._moved[sent.job] = job
        self._own.submit(job)

    def _settle(self, job: Job, answer: RequestAnswer) -> None:
        self._moved.pop(job, None)
        job.done(answer)

    def _finish(self, sent: _Sent, answer: RequestAnswer) -> None:
        with self._lock:
            if self._sent.pop(sent.job, None) is None:
                return
        sent.future.release()
        self._own.finish(sent.job, answer)

    def _report(self, event: Any) -> None:
        """Pass on the progress of a request."""
        key, *progress = event[1]
        for sent in list(self._sent.values()):
            if sent.key == key:
                sent.job.progress(*progress)


def _ended(sent: _Sent, answer: RequestAnswer) -> RequestAnswer:
    """Return an answer to a request that was ended, in the words of a pool."""
    if answer.outcome is RequestOutcome.ANSWERED:
        return answer
    return RequestAnswer(sent.outcome, 'cancelled' if sent.outcome is RequestOutcome.CANCELLED else
                         f'no answer within {sent.job.time_limit:g} s', answer.packet)
