# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A worker: a process that handles one request after another.

Started by `pool.Pool`: ``python -P -m obc_ros.workers.process FD MODULE MEMORY NICE PARENT``.
MODULE offers ``answer(kind, request, time_limit, report, keep) -> Packet``. It is imported before
the first request arrives, so that no request waits for the import.
"""

import ctypes
from importlib import import_module
import os
from pathlib import Path
import resource
import signal
import socket
import sys
import time
from types import TracebackType
from typing import Any

from obc_ros.workers.wire import Channel, Packet

PR_SET_PDEATHSIG = 1
REPORT_PERIOD = 0.1  # [s] between two reports of progress within one phase
TRIES, RETRY = 20, 0.05  # attempts to set the niceness of the group, and [s] between them


class Reporter:
    """
    Reports the progress of a solver to the pool, and a cancellation to the solver.

    Called as a `Report`, with phase, iteration, cost and infeasibility.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._phase = ''
        self._next = 0.0
        self.cancelled = False

    def __call__(self, phase: str, iteration: int, cost: float, infeasibility: float) -> bool:
        """Report progress, once in `REPORT_PERIOD` within a phase; return whether to stop."""
        now = time.monotonic()
        if phase != self._phase or now >= self._next:
            self._phase, self._next = phase, now + REPORT_PERIOD
            self._channel.send({'progress': [phase, iteration, cost, infeasibility]})
        # During a request the pool sends nothing but its cancellation.
        self.cancelled = self.cancelled or self._channel.receive(timeout=0.0) is not None
        return self.cancelled

    def keep(self, path: Packet) -> None:
        """Send the pool a packet to answer with if this process is ended before it answers."""
        self._channel.send({'path': path.plain}, path.arrays)


def end_with_parent(parent: int) -> None:
    """
    Have the kernel end this process with its parent, however the parent ends.

    On other systems than Linux it ends when it next reports, or waits for a request.
    """
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has ended already
        os._exit(1)


def keep_within(memory: int) -> None:
    """
    Limit the memory of this process, and make it the first to be ended if memory runs out.

    On other systems than Linux the memory is not limited.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == 'linux':
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
        Path('/proc/self/oom_score_adj').write_text('900', encoding='ascii')


def give_way(niceness: int) -> None:
    """Give the node and other processes priority over this process."""
    if not niceness:
        return
    os.nice(niceness)
    if sys.platform != 'linux':
        return
    # Where Linux groups processes by session, niceness counts within a session only, and a worker
    # has a session of its own: the group needs the niceness, too.
    for _ in range(TRIES):
        try:
            Path('/proc/self/autogroup').write_text(str(niceness), encoding='ascii')
        except BlockingIOError:  # accepted once in 0.1 s on the whole machine
            time.sleep(RETRY)
        except OSError:  # a kernel without such groups
            return
        else:
            return


def serve_pool(channel: Channel, module: Any) -> None:
    """Handle requests until the pool closes the channel."""
    channel.send({'ready': True})
    while (packet := channel.receive()) is not None:
        if 'cancel' in packet.plain:  # the request has been answered already
            continue
        reporter = Reporter(channel)
        answer: Packet = module.answer(
            packet.plain['kind'], Packet(packet.plain['request'], packet.arrays),
            packet.plain['time_limit'], reporter, reporter.keep)
        channel.send({'answer': answer.plain}, answer.arrays)


def main() -> None:
    """Serve the pool that started this process."""
    descriptor, module, memory, niceness, parent = sys.argv[1:]
    end_with_parent(int(parent))
    keep_within(int(memory))
    channel = Channel(socket.socket(fileno=int(descriptor)))

    def last_words(kind: type[BaseException], error: BaseException,
                   trace: TracebackType | None) -> None:
        # CasADi reports a lack of memory by other exceptions than MemoryError
        if issubclass(kind, MemoryError) or 'bad_alloc' in str(error):
            channel.send({'died': (
                f'it exceeded the memory limit of a worker, {int(memory) / 2**30:.3g} GiB; state '
                'a smaller problem, or solve it with obc_ros in Python, which has no limit')})
            return   # a traceback would say where memory ended, which is no fault of that place
        channel.send({'died': f'{kind.__name__}: {error}'})
        sys.__excepthook__(kind, error, trace)

    sys.excepthook = last_words
    try:
        loaded = import_module(module)  # at full priority: requests wait for it
        give_way(int(niceness))
        serve_pool(channel, loaded)
    except (EOFError, BrokenPipeError):
        return  # the pool is gone


if __name__ == '__main__':
    main()
