# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Real-time priorities of processes, where the system allows them."""

from collections.abc import Callable
from contextlib import suppress
import os
import threading


def raise_priority(priority: int, own: int) -> str:
    """
    Give the threads of this process a real-time priority (SCHED_FIFO).

    :param priority: of all threads but the calling one, 1 to 99; a lower number counts as 1.
    :param own: of the calling thread, and of threads and processes that it starts later.
    :return: why the system does not allow it; empty: it is done.
    """
    def change() -> None:
        for thread in map(int, os.listdir('/proc/self/task')):
            wanted = own if thread == threading.get_native_id() else priority
            with suppress(ProcessLookupError):   # it has ended meanwhile
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(max(1, wanted)))

    return _explain_refusal(priority, change)


def drop_priority() -> None:
    """Give up the real-time priority of the calling thread, such as an inherited one, if any."""
    if hasattr(os, 'sched_setscheduler') and os.sched_getscheduler(0) == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def find_priority_refusal(priority: int) -> str:
    """Return why the system allows no priority, or empty text; a short-lived thread tries it."""
    reasons: list[str] = []
    thread = threading.Thread(target=lambda: reasons.append(_explain_refusal(
        priority, lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority)))))
    thread.start()
    thread.join()
    return reasons[0]


def _explain_refusal(priority: int, change: Callable[[], None]) -> str:
    """Return why the system does not allow a change to a priority; empty: it is done."""
    if not hasattr(os, 'sched_setscheduler'):
        return f'priority = {priority}: this system has no real-time priorities'
    try:
        change()
    except OSError as error:
        return (f'priority = {priority}: {error.strerror}; the priority is not set. Allow '
                f"it by a line '@realtime - rtprio 99' in /etc/security/limits.conf")
    return ''
