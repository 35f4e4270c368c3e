# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A worker: a process that handles one request after another.

Started by `pool.Pool`: ``python -P -m obc_ros.workers.process FD PARENT MODULE MEMORY NICE``.
MODULE offers ``answer(kind, request, time_limit, report, keep) -> Packet``. It is imported before
the first request arrives, so that no request waits for the import.
"""

from importlib import import_module
import sys
import time
from types import TracebackType
from typing import Any

from obc_ros.workers.processes.child_start import connect_to_parent, give_way, keep_within
from obc_ros.workers.wire import Channel, Packet

REPORT_PERIOD = 0.1  # [s] between two reports of progress within one phase


class Reporter:
    """A `Report` that passes progress to the pool, and a cancellation to the solver."""

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
    channel, (module, memory, niceness) = connect_to_parent()
    keep_within(int(memory))

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
