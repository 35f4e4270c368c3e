# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A process that solves steps, seen from the node, and the thread that keeps one at work.

A process that has ended, or does not answer, is replaced by another one for the same problem.
"""

from collections import Counter, deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
import itertools
from threading import Lock, Thread
import time
from typing import Any

from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import ObcError
from obc_ros.workers.processes.supervised_process import (
    find_pause,
    START_TIME,
    SupervisedProcess,
)
from obc_ros.workers.wire import Packet

TICK = 0.05           # [s] in which the thread sees a silent or another process
STEP_PATIENCE = 1.0   # [s] that a request may be without a reply, beside the time it may take
START_PAUSE = 0.5     # [s] before another start after a failed one; doubled each time
LONGEST_PAUSE = 30.0  # [s]
SEND = 0.005   # [s] that a request may take to be sent: the process reads at once, or is stopped
LOOK_AGAIN = 0.05    # [s] between two looks whether a reply is still wanted


class StepLink(SupervisedProcess):
    """
    A process with a prepared problem.

    One thread sends and one receives. Both use finite times, because the socket has one mode.

    :param priority: real-time priority of the process once it is prepared; 0: none.
    :ivar ready: reply of the process when it is prepared.
    :ivar priority_refusal: why the system does not allow the priority; empty before `ready`, and
        if it does.
    :ivar is_broken: whether a request was sent in part: the process cannot read another one.
    :raises OSError: if the system starts no process, or it ends at once.
    """

    def __init__(self, module: str, problem: Packet, priority: int = 0) -> None:
        super().__init__('obc_ros.workers.steps.step_process', module, str(priority))
        self.module, self.problem, self.priority = module, problem, priority
        self.ready: Packet | None = None
        self.priority_refusal = ''
        self.is_broken = False
        self._ids = itertools.count(1)
        with ExitStack() as undo:
            undo.callback(self.close)
            self.channel.send(problem.plain, problem.arrays, timeout=1.0)
            undo.pop_all()

    def wait_until_ready(self, timeout: float,
                         is_cancelled: Callable[[], bool] = lambda: False) -> Packet:
        """Return the reply of the prepared process; ObcError: there is none in `timeout` [s]."""
        while self.ready is None:
            self.look(self._wait_for(lambda _: True, timeout, is_cancelled,
                                     f'is not ready after {timeout:g} s'))
        return self.ready

    def look(self, packet: Packet) -> None:
        """Take the reply to the problem; ObcError: it is refused."""
        if 'refused' in packet.plain:
            raise ObcError(str(packet.plain['refused']))
        if 'ready' in packet.plain:
            self.priority_refusal = str(packet.plain['priority'])
            self.ready = Packet(packet.plain['ready'], packet.arrays)

    def send(self, plain: Mapping[str, Any], arrays: Mapping[str, Array]) -> int:
        """Send a request; return its id, 0 if it could not be sent."""
        if self.is_broken:
            return 0
        number = next(self._ids)
        try:
            self.channel.send({**plain, 'id': number}, arrays, timeout=SEND)
        except OSError:   # stopped or ended
            self.is_broken = True
            return 0
        return number

    def call(self, plain: Mapping[str, Any], arrays: Mapping[str, Array], timeout: float,
             is_cancelled: Callable[[], bool] = lambda: False) -> Packet:
        """Send a request and return its reply; ObcError: it is a refusal, or there is none."""
        number = self.send(plain, arrays)
        packet = self._wait_for(lambda packet: packet.plain.get('id') == number, timeout,
                                is_cancelled, f'has not answered within {timeout:g} s')
        if 'refused' in packet.plain:
            raise ObcError(str(packet.plain['refused']))
        return packet

    def _wait_for(self, is_wanted: Callable[[Packet], bool], timeout: float,
                  is_cancelled: Callable[[], bool], delay: str) -> Packet:
        end = time.monotonic() + timeout
        while (left := end - time.monotonic()) > 0.0:
            if is_cancelled():
                raise ObcError('cancelled')
            try:
                packet = self.channel.receive(min(left, LOOK_AGAIN))
            except EOFError:
                raise ObcError(f'the solver process {self.describe_end()}') from None
            if packet is not None and is_wanted(packet):
                return packet
        raise ObcError(f'the solver process {delay}')


class StepSupervisor:
    """
    A solver process, and its successors.

    :param on_reply: called in the thread with each reply to a request.
    :param on_ready: called in the thread with the reply of a prepared process.
    :param on_news: called in the thread with a sentence when a process is lost, when it has been
        replaced, and if the system does not allow its priority.
    :ivar counts: numbers of requests: sent, unsent, answered; and of processes: ended, silent.
    :ivar refusal: why the problem cannot be solved at all; empty: it can, or is not prepared yet.
    """

    def __init__(self, on_reply: Callable[[Packet], None], on_ready: Callable[[Packet], None],
                 on_news: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self.link: StepLink | None = None
        self.refusal = ''
        self._on_reply, self._on_ready, self._on_news = on_reply, on_ready, on_news
        self._lock = Lock()   # guards `link` against a replacement
        self._waiting: deque[tuple[int, float]] = deque(maxlen=1000)   # id, end
        self._lost = False
        self._failures = 0   # consecutive failed starts
        self._thread: Thread | None = None
        self._is_wanted = False

    @property
    def is_ready(self) -> bool:
        """Return whether the process has prepared its problem."""
        return self.link is not None and self.link.ready is not None

    def use(self, link: StepLink) -> None:
        """Use another process from now on, and end the present one."""
        with self._lock:
            before, self.link, self.refusal = self.link, link, ''
            self._waiting.clear()
            self._since, self._failures = time.monotonic(), 0
        if before is not None and before is not link:
            before.close()

    def start(self) -> None:
        """Begin to receive replies."""
        self._is_wanted = True
        self._thread = Thread(target=self._run, name='steps', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and the process."""
        self._is_wanted = False
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        with self._lock:
            if self.link is not None:
                self.link.close()
                self.link = None

    def ask(self, plain: Mapping[str, Any], arrays: Mapping[str, Array],
            patience: float = STEP_PATIENCE) -> bool:
        """
        Send a request; return False if no process is ready to take it.

        A process that has not answered after `patience` seconds is replaced.
        """
        with self._lock:
            link = self.link
            number = link.send(plain, arrays) if link is not None and link.ready else 0
            if number:
                self._waiting.append((number, time.monotonic() + patience))
        self.counts['sent' if number else 'unsent'] += 1
        return bool(number)

    def _run(self) -> None:
        while self._is_wanted:
            link = self.link
            if link is None:
                time.sleep(TICK)
                continue
            try:
                if (packet := link.channel.receive(TICK)) is not None:
                    (self._take if link.ready else self._begin)(link, packet)
                if reason := self._find_silence(link):
                    self._replace(link, 'silent', reason)
            except (EOFError, OSError):
                self._replace(link, 'ended', link.describe_end())
            except ObcError as error:
                self._give_up(link, str(error))

    def _give_up(self, link: StepLink, reason: str) -> None:
        with self._lock:
            if link is not self.link:
                return
            self.link, self.refusal = None, reason
        link.close()
        self._on_news(f'the problem is refused: {reason}')

    def _begin(self, link: StepLink, packet: Packet) -> None:
        link.look(packet)
        if link.ready is None or link is not self.link:
            return
        if self._lost:
            self._lost, self._failures = False, 0
            self._on_news('the solver process has been replaced')
        elif link.priority_refusal:
            self._on_news(f'the solver process: {link.priority_refusal}')
        self._on_ready(link.ready)

    def _take(self, link: StepLink, packet: Packet) -> None:
        number = packet.plain.get('id', 0)
        with self._lock:
            if link is not self.link:
                return
            while self._waiting and self._waiting[0][0] <= number:
                self._waiting.popleft()
        self.counts['answered'] += 1
        self._on_reply(packet)

    def _find_silence(self, link: StepLink) -> str:
        """Return why a process is taken as stopped; empty: it is not."""
        now = time.monotonic()
        if link.is_broken:
            return 'takes no more requests'
        if link.ready is None:
            late = now - self._since > START_TIME
            return f'was not prepared within {START_TIME:g} s' if late else ''
        with self._lock:
            is_late = bool(self._waiting) and now > self._waiting[0][1]
        return 'has not answered in time' if is_late else ''

    def _replace(self, link: StepLink, kind: str, reason: str) -> None:
        """Start another process for the problem of `link`, unless that is not used any more."""
        if link is not self.link:
            return
        self.counts[kind] += 1
        self._lost = True
        self._failures += link.ready is None
        self._on_news(f'the solver process {reason}; another one is started')
        while self._has_paused(link):
            try:
                new = StepLink(link.module, link.problem, link.priority)
            except OSError as error:
                self._failures += 1
                self._on_news(f'the solver process cannot be started: {error}; it is tried again')
                continue
            with self._lock:
                is_current = link is self.link
                if is_current:
                    self.link, self._since = new, time.monotonic()
                    self._waiting.clear()
            (link if is_current else new).close()

    def _has_paused(self, link: StepLink) -> bool:
        """Pause after failed starts; return False if no process for `link` is wanted any more."""
        end = time.monotonic() + find_pause(self._failures, START_PAUSE, LONGEST_PAUSE)
        while (is_wanted := self._is_wanted and link is self.link) and time.monotonic() < end:
            time.sleep(TICK)
        return is_wanted
