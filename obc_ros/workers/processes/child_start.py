# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a child process does first: its channel to the parent, and its limits."""

import ctypes
import os
from pathlib import Path
import resource
import signal
import socket
import sys
import time

from obc_ros.workers.wire import Channel

PR_SET_PDEATHSIG = 1
TRIES, RETRY = 20, 0.05  # attempts to set the niceness of the group, and [s] between them


def connect_to_parent() -> tuple[Channel, list[str]]:
    """
    Return the channel to the parent and the arguments of this program.

    On Linux the kernel ends this process with its parent, however that ends. On other systems it
    ends when it next uses the channel.
    """
    descriptor, parent, *arguments = sys.argv[1:]
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != int(parent):  # it has ended already
        os._exit(1)
    return Channel(socket.socket(fileno=int(descriptor))), arguments


def keep_within(memory: int) -> None:
    """Limit the memory, on Linux only; this process is the first to be ended if it runs out."""
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
