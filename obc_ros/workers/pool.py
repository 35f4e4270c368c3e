# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A pool of worker processes that answers every request within its time limit.

If a worker dies, its present request fails with an error, which comes with the best path that the
worker has sent, and the worker is replaced. A request that reaches its time limit or is cancelled
is first asked to stop, then ended with its process. No worker outlives the process of the pool.

The module is long because all methods change the state of one pool.
"""

from collections import deque, OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from queue import Empty, SimpleQueue
from threading import Condition, Thread
import time
from typing import Any

from obc_ros.core.ocp.solution import Report
from obc_ros.workers.processes.supervised_process import (
    check_system,
    find_pause,
    START_TIME,
    SupervisedProcess,
)
from obc_ros.workers.wire import Packet

SHORTEST = 0.01    # [s] shortest time limit of a request
LONGEST_LIMIT = 86_400.0
TIME_LIMIT = 60.0  # [s] unless the user wants another one
TICK = 0.02        # [s] until the thread of a busy worker sees a cancellation
HEAD_START = 0.1   # [s] by which the time limit of a solver is shorter
GRACE = 0.05       # [s] that a solver has to answer after it was asked to stop
IDLE_CHECK = 0.5   # [s] until the end of an idle worker is noticed
START_PAUSE = 1.0  # [s] before a worker that did not start is started again; doubled each time
LONGEST_PAUSE = 60.0  # [s]
TRIES = 3          # failed starts after which requests are answered with an error


class RequestOutcome(StrEnum):
    """How a request ended."""

    ANSWERED = 'answered'
    REFUSED = 'refused'
    TIMED_OUT = 'timed_out'
    CANCELLED = 'cancelled'
    DIED = 'died'


@dataclass(frozen=True)
class RequestAnswer:
    """
    The answer to a request: the packet of the worker, or else the reason in words.

    In the latter case `packet` is the last one that the worker has kept, if any.
    """

    outcome: RequestOutcome
    message: str = ''
    packet: Packet = field(default_factory=lambda: Packet({}))


@dataclass(eq=False)
class Job:
    """
    A request in the pool.

    :ivar kind, request: arguments of the module of the workers.
    :ivar time_limit: time [s] from submission to answer, waiting included.
    :ivar done: called once, with the answer.
    :ivar progress: called with phase, iteration, cost and infeasibility while a worker handles the
        request. Both are called by a thread of the pool, or by the thread that submits or cancels.
    :ivar affinity: requests of equal affinity are faster on the worker that handled the last one.
    """

    kind: str
    request: Packet
    time_limit: float
    done: Callable[[RequestAnswer], None]
    progress: Callable[[str, int, float, float], None] = lambda *_: None
    affinity: str = ''
    deadline: float = 0.0
    cancelled: bool = False

    def give_up_waiting(self) -> RequestAnswer | None:
        """Return the answer to a waiting request that is cancelled or late; None: it is not."""
        if self.cancelled:
            return RequestAnswer(
                RequestOutcome.CANCELLED, 'cancelled while it waited for a worker')
        if time.monotonic() >= self.deadline:
            return RequestAnswer(
                RequestOutcome.TIMED_OUT, f'no worker was free within {self.time_limit:g} s')
        return None

    def give_up(self, kept: Packet) -> RequestAnswer:
        """Return the answer to a request that was cancelled or has taken too long."""
        if self.cancelled:
            return RequestAnswer(RequestOutcome.CANCELLED, 'cancelled', kept)
        return RequestAnswer(
            RequestOutcome.TIMED_OUT, f'no answer within {self.time_limit:g} s', kept)


class Pool:
    """
    Worker processes and their queue.

    :param module: imported by each worker; its ``answer(kind, request, time_limit, report, keep)
        -> Packet`` handles a request. If a worker is ended, what it has passed to `keep` is in the
        answer: the last value of each key, and the last arrays.
    :param queue_length: number of requests that may wait; further ones are rejected.
    :param memory: memory limit of a worker [bytes].
    :param affinities: number of affinities whose data a worker is expected to keep.
    :param niceness: niceness of the workers: the node and control loops have priority.
    :ivar fault: why the workers do not start; empty if the last one to start did.
    :ivar has_started: whether a worker has been ready, or has failed to start.
    """

    def __init__(self, module: str, size: int, *, queue_length: int = 128,
                 memory: int = 2 << 30, affinities: int = 32, niceness: int = 3) -> None:
        check_system()
        self.module, self.memory, self.niceness = module, memory, niceness
        self.queue_length, self.affinities = queue_length, affinities
        self.replaced = 0
        self.fault = ''
        self._closed = self.has_started = False
        self._changed = Condition()
        self._queue: deque[Job] = deque()
        self._workers: list[_Worker] = []
        self.resize(size)

    @property
    def size(self) -> int:
        """Return the number of workers, including those that are being replaced."""
        return len(self._workers)

    @property
    def waiting(self) -> int:
        """Return the number of requests that wait for a worker."""
        return len(self._queue)

    @property
    def busy(self) -> int:
        """Return the number of workers that handle a request."""
        return sum(worker.job is not None for worker in self._workers)

    @property
    def uses_processes(self) -> bool:
        """Return whether the processes take requests; a subclass may have another place."""
        return True

    @property
    def pids(self) -> list[int]:
        """Return the process ids of the workers that have started."""
        return [worker.pid for worker in self._workers if worker.ready]

    def resize(self, size: int) -> None:
        """Set the number of workers; surplus ones end after their present request."""
        with self._changed:
            surplus = self._workers[size:]
            self._workers = self._workers[:size]
            self._workers += [_Worker(self) for _ in range(size - len(self._workers))]
            for worker in surplus:
                worker.wanted = False
            self._changed.notify_all()

    def wait_for_start(self, timeout: float) -> bool:
        """Return whether a worker has been ready or failed to start within `timeout` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: self.has_started, timeout)

    def submit(self, job: Job) -> None:
        """Accept a request; its time limit counts from now on."""
        with self._changed:
            job.deadline = time.monotonic() + job.time_limit
            refusal = self._refusal()
            if not refusal:
                worker = self._idle(job.affinity)
                if worker:
                    worker.job = job
                else:
                    self._queue.append(job)
                self._changed.notify_all()
        if refusal:
            job.done(refusal)

    def ask(self, kind: str, request: Packet, time_limit: float,
            is_cancelled: Callable[[], bool] = lambda: False,
            report: Report | None = None) -> RequestAnswer:
        """
        Return the answer to a request.

        :param kind, request: as for `Job`.
        :param time_limit: time to the answer [s], without the start of a worker.
        :param is_cancelled: called every `TICK` seconds, by this thread.
        :param report: called with the progress, by this thread; True cancels.
        """
        arrived: SimpleQueue[Any] = SimpleQueue()   # progress or the answer, of a worker's thread
        job = Job(kind, request, time_limit, arrived.put, lambda *told: arrived.put(told))
        while not (self.pids or self.fault or is_cancelled()):
            time.sleep(TICK)
        self.submit(job)
        while True:
            try:
                found = arrived.get(timeout=TICK)
            except Empty:
                found = None
            if isinstance(found, RequestAnswer):
                return found
            if found and report and report(*found) or is_cancelled():
                self.cancel(job)

    def cancel(self, job: Job) -> None:
        """Stop a request: at once if it is waiting, else within `TICK` + `GRACE` seconds."""
        job.cancelled = True
        self.review()

    def close(self) -> None:
        """End all workers; present and waiting requests are cancelled."""
        with self._changed:
            self._closed = True
            workers = self._workers
            for worker in workers:
                if worker.job:
                    worker.job.cancelled = True
        self.review(RequestAnswer(RequestOutcome.CANCELLED, 'the server is shutting down'))
        self.resize(0)
        for worker in workers:
            worker.join()

    def has_room(self) -> bool:
        """Return whether a request need not wait."""
        return self._idle('') is not None

    def review(self, refusal: RequestAnswer | None = None) -> None:
        """Answer the waiting requests that are cancelled or late; with a refusal, all of them."""
        with self._changed:
            answers = {job: answer for job in self._queue
                       if (answer := refusal or job.give_up_waiting())}
            if answers:
                self._queue = deque(job for job in self._queue if job not in answers)
        for job, answer in answers.items():
            job.done(answer)

    def note_start(self, worker: '_Worker', why: str = '') -> None:
        """Record that `worker` has started, or why it has not."""
        with self._changed:
            worker.ready, self.has_started = not why, True
            worker.failures = worker.failures + 1 if why else 0
            self.fault = why
            self._changed.notify_all()
        if why and self.uses_processes and not self.pids:
            self.review(self._no_worker())

    def next_job(self, worker: '_Worker') -> Job | None:
        """Return the next job of `worker`; None if there was none for `IDLE_CHECK` seconds."""
        with self._changed:
            if worker.wanted and not worker.job and not (self._queue and self.uses_processes):
                self._changed.wait(IDLE_CHECK)
            if worker.wanted and not worker.job and self._queue and self.uses_processes:
                worker.job = self._queue.popleft()
            return worker.job

    def retire(self, worker: '_Worker') -> None:
        """Give `worker` no more jobs; one that it has not begun goes to another worker."""
        with self._changed:
            worker.ready = False
            if worker.job:
                self._queue.appendleft(worker.job)
                worker.job = None
                self._changed.notify_all()

    def release(self, worker: '_Worker', ready: bool) -> None:
        """Record that `worker` has finished its job, and whether it is ready for another."""
        with self._changed:
            worker.job, worker.ready = None, ready

    def pause(self, worker: '_Worker', duration: float) -> None:
        """Wait for `duration` seconds, or less if `worker` is not wanted any more."""
        end = time.monotonic() + duration
        while worker.wanted and (left := end - time.monotonic()) > 0:
            self.review()
            with self._changed:
                self._changed.wait_for(lambda: not worker.wanted, min(left, TICK))

    def _refusal(self) -> RequestAnswer | None:
        """Return the answer to a request that cannot be accepted now; None if it can."""
        if self._closed:
            return RequestAnswer(RequestOutcome.REFUSED, 'the server is shutting down')
        if self.uses_processes and self._workers and all(
                worker.failures >= TRIES for worker in self._workers):
            return self._no_worker()
        if self.waiting >= self.queue_length and not self.has_room():
            return RequestAnswer(RequestOutcome.REFUSED, (
                f'refused: the queue is full, with {self.waiting} requests; send the request '
                'again later'))
        return None

    def _no_worker(self) -> RequestAnswer:
        return RequestAnswer(RequestOutcome.DIED, f'no worker starts: {self.fault}')

    def _idle(self, affinity: str) -> '_Worker | None':
        """Return an idle worker, preferably one that has seen `affinity`; None if all are busy."""
        idle = [worker for worker in self._workers
                if self.uses_processes and worker.ready and not worker.job]
        return next((worker for worker in idle if affinity in worker.seen),
                    min(idle, key=lambda worker: len(worker.seen), default=None))


class _Worker(Thread):
    """The thread of one worker process, which the kernel ends with it, and of its successors."""

    def __init__(self, pool: Pool) -> None:
        super().__init__(name='worker', daemon=True)
        self._pool = pool
        self.wanted, self.ready = True, False
        self.failures = 0  # consecutive failed starts
        self.job: Job | None = None
        self._kept = Packet({})
        self.seen: OrderedDict[str, None] = OrderedDict()
        self.start()

    @property
    def pid(self) -> int:
        """Return the id of the process."""
        return self._process.pid

    def run(self) -> None:
        """Keep a process running until the worker is not wanted any more."""
        pool = self._pool
        while self.wanted:
            try:
                self._process = SupervisedProcess(
                    'obc_ros.workers.process', pool.module, str(pool.memory), str(pool.niceness),
                    has_session=True)
            except OSError as error:  # no more processes, memory or files
                self._failed(f'{error.strerror}')
                continue
            self.seen.clear()
            why = self._wait_until_ready()
            if self.ready:
                self._serve()
            self.ready = False
            self._process.close()
            if not why:
                pool.replaced += self.wanted
            elif self.wanted:
                self._failed(why)

    def _failed(self, why: str) -> None:
        """Record why no process starts, and wait before the next start, longer each time."""
        self._pool.note_start(self, why)
        self._pool.pause(self, find_pause(self.failures, START_PAUSE, LONGEST_PAUSE))

    def _wait_until_ready(self) -> str:
        end = time.monotonic() + START_TIME
        while self.wanted and time.monotonic() < end:
            try:
                packet = self._process.channel.receive(TICK)
            except EOFError:
                return self._cause()
            self._pool.review()
            if packet and 'ready' in packet.plain:
                self._pool.note_start(self)
                return ''
            if packet:
                return str(packet.plain['died'])
        return f'the start takes more than {START_TIME:g} s'

    def _serve(self) -> None:
        while self.ready and (self.wanted or self.job):
            job = self._pool.next_job(self)
            if self._process.has_ended:
                self._pool.retire(self)
            elif job:
                answer = self._work(job)
                if answer.outcome is not RequestOutcome.ANSWERED:
                    self._process.kill()
                self._pool.release(self, ready=answer.outcome is RequestOutcome.ANSWERED)
                job.done(answer)

    def _work(self, job: Job) -> RequestAnswer:
        self.seen[job.affinity] = None
        self.seen.move_to_end(job.affinity)
        while len(self.seen) > self._pool.affinities:
            self.seen.popitem(last=False)
        self._kept = Packet({})
        left = max(job.deadline - time.monotonic(), 0.001)
        try:
            self._process.channel.send(
                {'kind': job.kind, 'request': job.request.plain,
                 'time_limit': left - min(HEAD_START, 0.2 * left)},
                job.request.arrays, timeout=left + GRACE)
            return self._attend(job)
        except (EOFError, OSError):
            return RequestAnswer(RequestOutcome.DIED, self._obituary(self._cause()), self._kept)
        except (TypeError, ValueError) as error:   # of json: else the caller would wait for ever
            return RequestAnswer(RequestOutcome.DIED, f'the request cannot be sent: {error}',
                                 self._kept)

    def _attend(self, job: Job) -> RequestAnswer:
        """Pass on progress until the answer, the time limit or the cancellation."""
        end, asked = job.deadline + GRACE, False
        while (now := time.monotonic()) < end:
            if job.cancelled and not asked:
                self._process.channel.send({'cancel': True}, timeout=GRACE)
                end, asked = min(end, now + GRACE), True
            packet = self._process.channel.receive(max(0.0, min(TICK, end - now)))
            self._pool.review()
            if packet is None:
                continue
            if 'answer' in packet.plain:
                return RequestAnswer(RequestOutcome.ANSWERED, '',
                                     Packet(packet.plain['answer'], packet.arrays))
            if 'died' in packet.plain:
                return RequestAnswer(RequestOutcome.DIED, self._obituary(packet.plain['died']),
                                     self._kept)
            if 'path' in packet.plain:
                self._kept = Packet({**self._kept.plain, **packet.plain['path']},
                                    packet.arrays or self._kept.arrays)
            else:
                job.progress(*packet.plain['progress'])
        return job.give_up(self._kept)

    def _cause(self) -> str:
        end = self._process.describe_end()
        return f'it {end}' if 'SIGKILL' not in end else (
            'it was killed (SIGKILL), by a user or for lack of memory')

    @staticmethod
    def _obituary(cause: str) -> str:
        return f'the worker process that was solving this has died: {cause}'
