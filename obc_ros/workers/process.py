# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A worker: a process of its own that answers one request after another.

Started by `pool.Pool`: ``python -m obc_ros.workers.process FD MODULE MEMORY NICE PARENT``.
MODULE offers ``answer(kind, request, time_limit, report, keep) -> Packet``; it is imported before
the first request comes, so that no request pays for it.
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
TRIES, RETRY = 20, 0.05  # [s]


class Reporter:
    """
    Tell the pool what a solver is doing, and the solver whether it is still wanted.

    Called as a `Report`: with phase, iteration, cost and infeasibility.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._phase = ''
        self._next = 0.0
        self.cancelled = False

    def __call__(self, phase: str, iteration: int, cost: float, infeasibility: float) -> bool:
        """Pass on what is being done, not too often; return whether to stop."""
        now = time.monotonic()
        if phase != self._phase or now >= self._next:
            self._phase, self._next = phase, now + REPORT_PERIOD
            self._channel.send({'progress': [phase, iteration, cost, infeasibility]})
        # While a request is worked on, all that comes is the wish to cancel it.
        self.cancelled = self.cancelled or self._channel.receive(timeout=0.0) is not None
        return self.cancelled

    def keep(self, path: Packet) -> None:
        """Let the pool have what to answer should this process be ended before it answers."""
        self._channel.send({'path': path.plain}, path.arrays)


def end_with_parent(parent: int) -> None:
    """Have the kernel end this process when its parent ends, however that happens."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has ended already
        os._exit(1)


def keep_within(memory: int) -> None:
    """Bound the memory of this process, and let the kernel end it before others."""
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    Path('/proc/self/oom_score_adj').write_text('900', encoding='ascii')


def give_way(niceness: int) -> None:
    """Let the node, and whoever else, have the processor before this process."""
    if not niceness:
        return
    os.nice(niceness)
    # Where Linux groups processes by session, niceness counts within a session only, and a
    # worker has one of its own: the group must be nice as well.
    for _ in range(TRIES):
        try:
            Path('/proc/self/autogroup').write_text(str(niceness), encoding='ascii')
        except BlockingIOError:  # taken once in 0.1 s, for the whole machine
            time.sleep(RETRY)
        except OSError:  # a kernel without such groups
            return
        else:
            return


def serve_pool(channel: Channel, module: Any) -> None:
    """Answer requests until the pool closes the channel."""
    channel.send({'ready': True})
    while (packet := channel.receive()) is not None:
        if 'cancel' in packet.plain:  # it crossed the answer
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
        # CasADi's exceptions for want of memory are no MemoryError
        if issubclass(kind, MemoryError) or 'bad_alloc' in str(error):
            why = f'it needed more than the {int(memory) / 2**30:.3g} GiB that a worker may have'
        else:
            why = f'{kind.__name__}: {error}'
        channel.send({'died': why})
        sys.__excepthook__(kind, error, trace)

    sys.excepthook = last_words
    try:
        loaded = import_module(module)  # soon, for requests wait for it
        give_way(int(niceness))
        serve_pool(channel, loaded)
    except (EOFError, BrokenPipeError):
        return  # the pool is gone


if __name__ == '__main__':
    main()
