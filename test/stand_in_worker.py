# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A worker for the tests of the pool, with a request for each way in which work can end."""

import os
import time

import numpy as np
from obc_ros.workers import requests
from obc_ros.workers.wire import Packet

SEEN = []
KEEP = []


def answer(kind, request, time_limit, report, keep):
    """Carry out the request `kind` after storing the values that it asks to store."""
    KEEP.append(keep)
    for name in request.plain.get('keep', ()):
        keep(Packet({'name': name}, request.arrays))
    return globals()[f'do_{kind}'](request, time_limit, report)


def do_echo(request, time_limit, report):
    """Return the request, the process id and the names of all requests so far."""
    SEEN.append(request.plain.get('name'))
    return Packet({**request.plain, 'pid': os.getpid(), 'seen': SEEN, 'limit': time_limit},
                  request.arrays)


def do_iterate(request, time_limit, report):
    """Iterate with a report each millisecond, until cancelled or out of time."""
    end = time.monotonic() + time_limit
    count = 0
    while not (stop := report('iterating', count, 1.0, np.inf)) and time.monotonic() < end:
        time.sleep(0.001)
        count += 1
    return Packet({'stopped': stop, 'count': count})


def do_hang(request, time_limit, report):
    """Do not check for cancellation, like a solver within an iteration of a large problem."""
    report('hanging', 0, np.nan, np.nan)
    time.sleep(1000)


def do_eat(request, time_limit, report):
    """Allocate more and more memory."""
    eaten = []
    while True:
        eaten.append(np.ones(1 << 20))


def do_fail(request, time_limit, report):
    """Raise an exception, like a program with an error in it."""
    raise ZeroDivisionError('a mistake')


def do_crash(request, time_limit, report):
    """Exit at once, as after a segmentation fault."""
    os.abort()


def do_solve(request, time_limit, report):
    """Solve a problem, but hang as soon as there is a path."""
    def keep(path):
        KEEP[-1](path)
        if 'objective' not in path.plain:   # only what was tried so far
            return
        report('kept', 0, path.plain['objective'], 0.0)
        time.sleep(1000)

    return requests.answer('solve', request, time_limit, report, keep)


def do_pid(request, time_limit, report):
    """Report the process id as progress, then hang."""
    report(str(os.getpid()), 0, 0.0, 0.0)
    time.sleep(1000)


def do_point(request, time_limit, report):
    """Answer for a point of a sweep, or end as the request says: always, or the first time."""
    plain = request.plain
    if plain['fresh']:
        SEEN.clear()
    SEEN.append(plain['name'])
    once = plain.get('once')
    if plain.get('crash') or once and not os.path.exists(once):
        if once:
            open(once, 'x').close()
        os.abort()
    if plain.get('hang'):
        time.sleep(1000)
    return Packet({'status': 'solved', 'seen': list(SEEN)})
