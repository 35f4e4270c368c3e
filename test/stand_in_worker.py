# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the workers of test_workers.py do: each way in which a request can go."""

import os
import time

import numpy as np
from obc_ros.workers import requests
from obc_ros.workers.wire import Packet

SEEN = []
KEEP = []


def answer(kind, request, time_limit, report, keep):
    """Do what `kind` says, after keeping what it says to keep."""
    KEEP.append(keep)
    for name in request.plain.get('keep', ()):
        keep(Packet({'name': name}, request.arrays))
    return globals()[f'do_{kind}'](request, time_limit, report)


def do_echo(request, time_limit, report):
    """Return the request, by whom, and what came before."""
    SEEN.append(request.plain.get('name'))
    return Packet({**request.plain, 'pid': os.getpid(), 'seen': SEEN, 'limit': time_limit},
                  request.arrays)


def do_iterate(request, time_limit, report):
    """Work on, with a report each millisecond, until it is asked to stop or the time is over."""
    end = time.monotonic() + time_limit
    count = 0
    while not (stop := report('iterating', count, 1.0, np.inf)) and time.monotonic() < end:
        time.sleep(0.001)
        count += 1
    return Packet({'stopped': stop, 'count': count})


def do_hang(request, time_limit, report):
    """Heed nothing, like a solver between two iterations of a large problem."""
    report('hanging', 0, np.nan, np.nan)
    time.sleep(1000)


def do_eat(request, time_limit, report):
    """Ask for more and more memory."""
    eaten = []
    while True:
        eaten.append(np.ones(1 << 20))


def do_fail(request, time_limit, report):
    """Fail as a program with a mistake in it does."""
    raise ZeroDivisionError('a mistake')


def do_crash(request, time_limit, report):
    """End at once, as after a segmentation fault."""
    os.abort()


def do_solve(request, time_limit, report):
    """Solve a problem, but hang in the middle, once there is a path."""
    def keep(path):
        KEEP[-1](path)
        report('kept', 0, path.plain['objective'], 0.0)
        time.sleep(1000)

    return requests.answer('solve', request, time_limit, report, keep)


def do_pid(request, time_limit, report):
    """Tell the process id through the progress, then hang."""
    report(str(os.getpid()), 0, 0.0, 0.0)
    time.sleep(1000)
