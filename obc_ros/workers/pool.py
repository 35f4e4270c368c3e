# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A pool of worker processes that answers requests within their time, whatever happens to a worker.

A worker that dies costs the one request it worked on an answer that says so, with the best path
that it has sent, and is replaced. A
request whose time is over, or that is cancelled, is first asked to stop and then ended with its
process. No worker outlives the process of the pool.
"""

from collections import Counter, deque, OrderedDict
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import Enum
import os
import signal
import socket
import subprocess
import sys
from threading import Condition, Thread
import time

from obc_ros.workers.wire import Channel, Packet

SHORTEST = 0.01    # [s] that a request may be given
LONGEST_LIMIT = 86_400.0
TICK = 0.02        # [s] how soon a busy worker's thread sees a cancelled request
HEAD_START = 0.1   # [s] that a solver is told to stop before its time is over
GRACE = 0.05       # [s] in which a solver that was asked to stop may still answer
END = 0.1          # [s] in which a process whose channel has closed has ended
IDLE_CHECK = 0.5   # [s] how soon the death of an idle worker is seen
START_TIME = 60.0  # [s] in which a worker must have started
START_PAUSE = 1.0  # [s] before a worker that did not start is tried again, doubled each time
LONGEST_PAUSE = 60.0  # [s]
TRIES = 3          # starts that fail before requests are answered without another
ENVIRONMENT = {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1', 'MKL_NUM_THREADS': '1',
               'PYTHONSAFEPATH': '1'}


class RequestOutcome(str, Enum):
    """How the pool dealt with a request."""

    ANSWERED = 'answered'
    REFUSED = 'refused'
    TIMED_OUT = 'timed_out'
    CANCELLED = 'cancelled'
    DIED = 'died'


@dataclass(frozen=True)
class RequestAnswer:
    """
    What came of a request: the worker's packet when answered, else the reason in words.

    Then `packet` is what the worker has kept for this, if anything.
    """

    outcome: RequestOutcome
    message: str = ''
    packet: Packet = field(default_factory=lambda: Packet({}))


def _ignore(phase: str, iteration: int, cost: float, infeasibility: float) -> None:
    """Take no notice of progress."""


@dataclass(eq=False)
class Job:
    """
    A request on its way through the pool.

    Attributes
    ----------
    kind, request
        What the worker's module is called with.
    time_limit : float
        Time [s] from submission to answer, waiting included.
    done
        Called once, with the answer.
    progress
        Called with phase, iteration, cost and infeasibility while a worker is at it. Both are
        called by a thread of the pool, or by the one that submits or cancels.
    affinity : str
        Requests of equal affinity are quicker on the worker that had the last one.

    """

    kind: str
    request: Packet
    time_limit: float
    done: Callable[[RequestAnswer], None]
    progress: Callable[[str, int, float, float], None] = _ignore
    affinity: str = ''
    deadline: float = 0.0
    cancelled: bool = False


class Pool:
    """
    Worker processes and the queue before them.

    Parameters
    ----------
    module : str
        Imported by each worker; its ``answer(kind, request, time_limit, report, keep) -> Packet``
        does the work; what `keep` is called with is answered should the worker be ended.
    size : int
        Number of workers.
    queue_length : int
        How many requests may wait; one more is refused.
    memory : int
        Bytes of memory that a worker may have.
    affinities : int
        How many affinities a worker is expected to remember.
    niceness : int
        By how much workers give way to other processes: to the node, to a control loop.

    Attributes
    ----------
    fault : str
        Why the workers do not start; empty when the last one to start did.
    has_started : bool
        Whether a worker has been ready, or has failed to start.

    """

    def __init__(self, module: str, size: int, *, queue_length: int = 128,
                 memory: int = 2 << 30, affinities: int = 32, niceness: int = 3) -> None:
        self.module = module
        self.queue_length = queue_length
        self.memory = memory
        self.affinities = affinities
        self.niceness = niceness
        self.outcomes: Counter[RequestOutcome] = Counter()
        self.replaced = 0
        self.fault = ''
        self._closed = self.has_started = False
        self._changed = Condition()
        self._queue: deque[Job] = deque()
        self._workers: list[_Worker] = []
        self.resize(size)

    @property
    def size(self) -> int:
        """Return the number of workers, those included that are being replaced."""
        return len(self._workers)

    @property
    def waiting(self) -> int:
        """Return how many requests wait for a worker."""
        return len(self._queue)

    @property
    def busy(self) -> int:
        """Return how many workers are at a request."""
        return sum(worker.job is not None for worker in self._workers)

    @property
    def pids(self) -> list[int]:
        """Return the process ids of the workers that have started."""
        return [worker.pid for worker in self._workers if worker.ready]

    def resize(self, size: int) -> None:
        """Have `size` workers; those too many end when they have done what they are at."""
        with self._changed:
            surplus = self._workers[size:]
            self._workers = self._workers[:size]
            self._workers += [_Worker(self) for _ in range(size - len(self._workers))]
            for worker in surplus:
                worker.wanted = False
            self._changed.notify_all()

    def submit(self, job: Job) -> None:
        """Take a request: its time runs from now on."""
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
            self.finish(job, refusal)

    def cancel(self, job: Job) -> None:
        """Stop a request: at once when it is waiting, else within `TICK` + `GRACE` seconds."""
        with self._changed:
            job.cancelled = True
            waiting = job in self._queue
            if waiting:
                self._queue.remove(job)
        if waiting:
            self.finish(job, RequestAnswer(RequestOutcome.CANCELLED,
                                           'cancelled while it waited for a worker'))

    def close(self) -> None:
        """End all workers; what they were at, and what was waiting, is cancelled."""
        with self._changed:
            self._closed = True
            workers = self._workers
            for worker in workers:
                if worker.job:
                    worker.job.cancelled = True
        self.empty_queue(RequestAnswer(RequestOutcome.CANCELLED, 'the server is shutting down'))
        self.resize(0)
        for worker in workers:
            worker.join()

    def finish(self, job: Job, answer: RequestAnswer) -> None:
        """Give the answer to the one who asked."""
        self.outcomes[answer.outcome] += 1
        job.done(answer)

    def empty_queue(self, answer: RequestAnswer) -> None:
        """Give all requests that wait the same answer."""
        with self._changed:
            jobs, self._queue = self._queue, deque()
        for job in jobs:
            self.finish(job, answer)

    def expire(self) -> None:
        """Answer the requests that have waited for all of their time."""
        now = time.monotonic()
        with self._changed:
            late = [job for job in self._queue if now >= job.deadline]
            for job in late:
                self._queue.remove(job)
        for job in late:
            self.finish(job, RequestAnswer(
                RequestOutcome.TIMED_OUT, f'no worker was free within {job.time_limit:g} s'))

    def note_start(self, worker: '_Worker', why: str = '') -> None:
        """Note that `worker` has started, or why it could not."""
        with self._changed:
            worker.ready, self.has_started = not why, True
            worker.failures = worker.failures + 1 if why else 0
            self.fault = why
            self._changed.notify_all()
        if why and not self.pids:
            self.empty_queue(self._no_worker())

    def next_job(self, worker: '_Worker') -> Job | None:
        """Return what `worker` is to do next; None when nothing came within `IDLE_CHECK`."""
        with self._changed:
            if worker.wanted and not worker.job and not self._queue:
                self._changed.wait(IDLE_CHECK)
            if worker.wanted and not worker.job and self._queue:
                worker.job = self._queue.popleft()
            return worker.job

    def retire(self, worker: '_Worker') -> None:
        """Give `worker` no more to do; what it was given but has not begun goes to another."""
        with self._changed:
            worker.ready = False
            if worker.job:
                self._queue.appendleft(worker.job)
                worker.job = None
                self._changed.notify_all()

    def release(self, worker: '_Worker', ready: bool) -> None:
        """Note that `worker` has done its job, and whether it is ready for another."""
        with self._changed:
            worker.job, worker.ready = None, ready

    def pause(self, worker: '_Worker', duration: float) -> None:
        """Wait for `duration` seconds, or less when `worker` is not wanted any more."""
        end = time.monotonic() + duration
        while worker.wanted and (left := end - time.monotonic()) > 0:
            self.expire()
            with self._changed:
                self._changed.wait_for(lambda: not worker.wanted, min(left, TICK))

    def _refusal(self) -> RequestAnswer | None:
        """Return the answer to a request that is not taken at present; None when it is."""
        if self._closed:
            return RequestAnswer(RequestOutcome.REFUSED, 'the server is shutting down')
        if self._workers and all(worker.failures >= TRIES for worker in self._workers):
            return self._no_worker()
        if self.waiting >= self.queue_length and not self._idle(''):
            return RequestAnswer(RequestOutcome.REFUSED, (
                f'refused: {self.waiting} requests are waiting already, as many as may wait; '
                'please ask again later'))
        return None

    def _no_worker(self) -> RequestAnswer:
        return RequestAnswer(RequestOutcome.DIED, f'no worker starts: {self.fault}')

    def _idle(self, affinity: str) -> '_Worker | None':
        """Return an idle worker, rather one that has seen `affinity`; None if all are busy."""
        idle = [worker for worker in self._workers if worker.ready and not worker.job]
        return next((worker for worker in idle if affinity in worker.seen),
                    min(idle, key=lambda worker: len(worker.seen), default=None))


class _Worker(Thread):
    """
    The thread that looks after one worker process, and starts another when that has ended.

    The kernel ends the process when this thread ends.
    """

    def __init__(self, pool: Pool) -> None:
        super().__init__(name='worker', daemon=True)
        self._pool = pool
        self.wanted = True
        self.ready = False
        self.failures = 0  # to start, one after another
        self.job: Job | None = None
        self._kept = Packet({})
        self.seen: OrderedDict[str, None] = OrderedDict()
        self.start()

    @property
    def pid(self) -> int:
        """Return the id of the process."""
        return self._process.pid

    def run(self) -> None:
        """Keep a process at work until it is not wanted any more."""
        while self.wanted:
            try:
                self._start_process()
            except OSError as error:  # no more processes, memory or files
                self._failed(f'{error.strerror}')
                continue
            why = self._wait_until_ready()
            if self.ready:
                self._serve()
            self._end()
            if not why:
                self._pool.replaced += self.wanted
            elif self.wanted:
                self._failed(why)

    def _failed(self, why: str) -> None:
        """Say why no process starts, and wait before the next one: ever longer."""
        self._pool.note_start(self, why)
        self._pool.pause(self, min(START_PAUSE * 2.0**(self.failures - 1), LONGEST_PAUSE))

    def _start_process(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs, ExitStack() as undo:
            undo.callback(ours.close)
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'obc_ros.workers.process', str(theirs.fileno()),
                 self._pool.module, str(self._pool.memory), str(self._pool.niceness),
                 str(os.getpid())],
                pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                env={**os.environ, **ENVIRONMENT}, start_new_session=True)
            undo.pop_all()
        self._channel = Channel(ours)
        self.seen.clear()

    def _wait_until_ready(self) -> str:
        """Return why the process did not start; empty when it did."""
        end = time.monotonic() + START_TIME
        while self.wanted and time.monotonic() < end:
            try:
                packet = self._channel.receive(TICK)
            except EOFError:
                return self._cause()
            self._pool.expire()
            if packet and 'ready' in packet.plain:
                self._pool.note_start(self)
                return ''
            if packet:
                return str(packet.plain['died'])
        return f'it takes more than {START_TIME:g} s'

    def _serve(self) -> None:
        """Do one job after another, until the process has ended or is not wanted any more."""
        while self.ready and (self.wanted or self.job):
            job = self._pool.next_job(self)
            if self._process.poll() is not None:
                self._pool.retire(self)
            elif job:
                answer = self._work(job)
                if answer.outcome is not RequestOutcome.ANSWERED:
                    self._process.kill()
                self._pool.release(self, ready=answer.outcome is RequestOutcome.ANSWERED)
                self._pool.finish(job, answer)

    def _work(self, job: Job) -> RequestAnswer:
        self._remember(job.affinity)
        self._kept = Packet({})
        left = max(job.deadline - time.monotonic(), 0.001)
        try:
            self._channel.send(
                {'kind': job.kind, 'request': job.request.plain,
                 'time_limit': left - min(HEAD_START, 0.2 * left)},
                job.request.arrays, timeout=left + GRACE)
            return self._attend(job)
        except (EOFError, OSError):
            return RequestAnswer(RequestOutcome.DIED, self._obituary(self._cause()), self._kept)

    def _attend(self, job: Job) -> RequestAnswer:
        """Pass on progress until there is an answer, or the time is over, or it is cancelled."""
        end, asked = job.deadline + GRACE, False
        while (now := time.monotonic()) < end:
            if job.cancelled and not asked:
                self._channel.send({'cancel': True}, timeout=GRACE)
                end, asked = min(end, now + GRACE), True
            packet = self._channel.receive(max(0.0, min(TICK, end - now)))
            self._pool.expire()
            if packet is None:
                continue
            if 'answer' in packet.plain:
                return RequestAnswer(RequestOutcome.ANSWERED, '',
                                     Packet(packet.plain['answer'], packet.arrays))
            if 'died' in packet.plain:
                return RequestAnswer(RequestOutcome.DIED, self._obituary(packet.plain['died']),
                                     self._kept)
            if 'path' in packet.plain:
                self._kept = Packet(packet.plain['path'], packet.arrays)
            else:
                job.progress(*packet.plain['progress'])
        if job.cancelled:
            return RequestAnswer(RequestOutcome.CANCELLED, 'cancelled', self._kept)
        return RequestAnswer(RequestOutcome.TIMED_OUT, f'no answer within {job.time_limit:g} s',
                             self._kept)

    def _cause(self) -> str:
        """Return how the process ended, for it has."""
        try:
            status = self._process.wait(END)
        except subprocess.TimeoutExpired:
            return 'it took no more data'
        if status == -signal.SIGKILL:
            return 'it was killed (SIGKILL), by hand or for want of memory'
        return (f'it was ended by {signal.Signals(-status).name}' if status < 0 else
                f'it ended with exit status {status}')

    @staticmethod
    def _obituary(cause: str) -> str:
        return f'the worker process that was solving this has died: {cause}'

    def _remember(self, affinity: str) -> None:
        self.seen[affinity] = None
        self.seen.move_to_end(affinity)
        while len(self.seen) > self._pool.affinities:
            self.seen.popitem(last=False)

    def _end(self) -> None:
        self.ready = False
        self._process.kill()
        self._process.wait()
        self._channel.close()
