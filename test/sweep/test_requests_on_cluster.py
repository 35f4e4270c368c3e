# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests of a server on a Dask cluster: answers, limits, cancelling, loss and return."""

from contextlib import contextmanager
import time

import _endless  # of benchmarks/
from dask_cluster import Cluster
from obc_ros.sweep.cluster.requests_on_cluster import ClusterPool
from obc_ros.workers.pool import Job, RequestOutcome
from obc_ros.workers.wire import Packet
import problems
import pytest
from support import wait_for

pytest.importorskip('distributed')
pytestmark = pytest.mark.slow

ANSWERS = 'obc_ros.workers.requests'
ENDLESS = _endless.endless(12)


class Asked:
    """A request, its progress and its answer."""

    def __init__(self, pool, statement, time_limit=60.0):
        self.answers, self.progress = [], []
        self.begun = time.monotonic()
        self.pool = pool
        self.job = Job('solve', Packet({
            'statement': statement, 'method': '', 'cache_size': 32, 'max_intervals': 2000}),
            time_limit, self.answers.append, lambda *told: self.progress.append(told))
        pool.submit(self.job)

    def wait(self):
        """Return the answer and the time [s] until it came."""
        wait_for(lambda: self.answers, 90.0)
        [answer] = self.answers
        return answer, time.monotonic() - self.begun


@contextmanager
def connected():
    """Yield a cluster of one worker, a pool on it with one process of its own, and its words."""
    cluster, told = Cluster(), []
    cluster.add_worker()
    pool = ClusterPool(cluster.address, ANSWERS, 1, lambda *words: told.append(words))
    try:
        wait_for(lambda: not pool.absence, 60.0)
        yield cluster, pool, told
    finally:
        pool.close()
        for process in reversed(cluster.processes):
            process.kill()
            process.wait()


def test_requests_are_solved_limited_and_cancelled_on_the_cluster():
    with connected() as (_, pool, told):
        assert told[-1][1] and '1 threads' in told[-1][0]
        answer, _ = Asked(pool, problems.read('di_mintime_rest')).wait()
        assert answer.outcome is RequestOutcome.ANSWERED
        assert answer.packet.plain['status'] == 'solved'
        assert answer.packet.plain['objective'] == pytest.approx(2.0)
        late, took = Asked(pool, ENDLESS, time_limit=3.0).wait()
        assert took < 3.0 + 2.0
        assert (late.outcome is RequestOutcome.TIMED_OUT
                or late.packet.plain['status'] == 'timed_out')
        asked = Asked(pool, ENDLESS)
        wait_for(lambda: asked.progress, 60.0)   # it comes from the worker
        begun = time.monotonic()
        pool.cancel(asked.job)
        cancelled, _ = asked.wait()
        assert time.monotonic() - begun < 2.0
        assert (cancelled.outcome is RequestOutcome.CANCELLED
                or cancelled.packet.plain['status'] == 'cancelled')
        wait_for(lambda: not pool.sent)


def test_the_own_processes_take_over_and_the_cluster_comes_back():
    with connected() as (cluster, pool, told):
        asked = Asked(pool, ENDLESS, time_limit=15.0)   # it takes some 20 s
        wait_for(lambda: asked.progress, 60.0)
        for process in cluster.processes:
            process.kill()
        wait_for(lambda: pool.absence, 20.0)
        assert 'is gone' in told[-1][0] and not told[-1][1]
        moved, took = asked.wait()   # its time limit counts from the beginning
        assert took < 15.0 + 3.0
        assert 'timed_out' in (moved.outcome.value, moved.packet.plain.get('status'))
        answer, _ = Asked(pool, problems.read('di_mintime_rest')).wait()
        assert answer.packet.plain['status'] == 'solved'
        cluster.processes += Cluster(cluster.address).processes
        cluster.add_worker()
        wait_for(lambda: not pool.absence, 60.0)
        assert told[-1][1]
        answer, _ = Asked(pool, problems.read('di_mintime_rest')).wait()
        assert answer.packet.plain['status'] == 'solved'
