# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The process of the steps: the newest request wins, and a lost process is replaced."""

from contextlib import contextmanager
import os
from pathlib import Path
import signal
from threading import Event
import time

import numpy as np
from obc_ros.core.text.errors import ObcError
from obc_ros.workers.processes.real_time import find_priority_refusal
from obc_ros.workers.steps.step_supervisor import StepLink, StepSupervisor
from obc_ros.workers.wire import Packet
import pytest
from support import alive, wait_for

pytestmark = pytest.mark.slow   # each test starts processes
DEADLINE = 30.0  # [s] reached only by a failing test
X, U = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, 39.2])


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    """Put the folder of stand_in_steps on the path of the processes."""
    monkeypatch.setenv('PYTHONPATH', str(Path(__file__).parents[1]))


def make_problem(system='aircraft'):
    """Return a problem of the aircraft at hover, with px at most 1 m."""
    infinite = np.full(6, np.inf)
    return Packet({'system': system, 'period': 0.02, 'steps': 10},
                  {'Qx': np.eye(6), 'Qu': np.eye(2), 'xe': np.zeros(6), 'ue': U,
                   'x_upper': np.r_[1.0, infinite[1:]]})


class Watched:
    """A supervisor whose replies and news are kept."""

    def __init__(self):
        self.replies, self.news, self.ready = [], [], Event()
        self.steps = StepSupervisor(
            self.replies.append, lambda _: self.ready.set(), self.news.append)

    def ask(self, **plain):
        """Ask for a step from X."""
        return self.steps.ask({'kind': 'step', 'stamp': 20_000_000, **plain}, {'x': X, 'u': U})

    def answers(self):
        """Return whether a new request is answered."""
        before = len(self.replies)
        self.ask()
        time.sleep(0.1)
        return len(self.replies) > before


@contextmanager
def supervised(system='aircraft', priority=0):
    """Yield a supervisor at work; check that it leaves no process."""
    watched = Watched()
    link = StepLink('stand_in_steps', make_problem(system), priority)
    watched.steps.use(link)
    watched.steps.start()
    try:
        yield watched
    finally:
        last = watched.steps.link
        watched.steps.stop()
    assert not alive(link.pid)
    assert last is None or not alive(last.pid)


def test_of_the_waiting_requests_the_newest_is_answered():
    link = StepLink('stand_in_steps', make_problem())
    try:
        link.wait_until_ready(DEADLINE)
        asked = [link.send({'kind': 'step', 'stamp': k, 'sleep': 0.3}, {'x': X, 'u': U})
                 for k in range(6)]
        replies, end = [], time.monotonic() + DEADLINE
        while (not replies or replies[-1].plain['id'] != asked[-1]) and time.monotonic() < end:
            if (packet := link.channel.receive(1.0)) is not None:
                replies.append(packet)
        assert replies[-1].plain['stamp'] == 5
        assert len(replies) <= 3, 'older requests must be dropped'
    finally:
        link.close()
    assert not alive(link.pid)


def test_a_process_that_the_system_refuses_is_tried_again(monkeypatch):
    with supervised() as watched:
        assert watched.ready.wait(DEADLINE)
        watched.ready.clear()
        first, start, failures = watched.steps.link, StepLink.__init__, []

        def fail_twice(link, *given):
            if len(failures) < 2:
                failures.append(link)
                raise BlockingIOError(11, 'Resource temporarily unavailable')
            start(link, *given)

        monkeypatch.setattr(StepLink, '__init__', fail_twice)
        os.kill(first.pid, signal.SIGKILL)
        assert watched.ready.wait(DEADLINE)
        wait_for(watched.answers)
        assert len(failures) == 2
        assert sum('cannot be started' in each for each in watched.news) == 2


def test_a_plan_is_a_motion_of_the_linear_model():
    link = StepLink('stand_in_steps', make_problem())
    try:
        P = link.wait_until_ready(DEADLINE).arrays['P']
        reply = link.call({'kind': 'step', 'stamp': 7}, {'x': X, 'u': U}, DEADLINE)
    finally:
        link.close()
    x, u = reply.arrays['x'], reply.arrays['u']
    assert (reply.plain['stamp'], x.shape, u.shape) == (7, (11, 6), (10, 2))
    values = np.einsum('ki,ij,kj->k', x, P, x)
    assert (np.diff(values) < 0.0).all(), 'the cost-to-go must fall along the regulator'


def test_no_collection_visits_the_objects_of_the_start():
    """CasADi, numpy and the problem are some 45 000 objects: a collection took a period."""
    link = StepLink('stand_in_steps', make_problem())
    try:
        link.wait_until_ready(DEADLINE)
        assert link.call({'kind': 'first'}, {'x': X}, DEADLINE).plain['frozen'] > 10_000
    finally:
        link.close()


def test_a_refused_first_plan_says_why():
    link = StepLink('stand_in_steps', make_problem())
    try:
        link.wait_until_ready(DEADLINE)
        with pytest.raises(ObcError, match='no plan keeps the bounds'):
            link.call({'kind': 'first'}, {'x': 20.0 * X}, DEADLINE)
        assert link.call({'kind': 'first'}, {'x': X}, DEADLINE).plain['pid'] == link.pid
    finally:
        link.close()


@pytest.mark.parametrize(('number', 'kind', 'words'), [
    (signal.SIGKILL, 'ended', 'has ended by SIGKILL'),
    (signal.SIGSTOP, 'silent', 'has not answered in time')])
def test_a_lost_process_is_replaced_and_told(number, kind, words):
    with supervised() as watched:
        assert watched.ready.wait(DEADLINE)
        first = watched.steps.link.pid
        wait_for(watched.answers, DEADLINE)
        os.kill(first, number)
        wait_for(lambda: watched.answers() and watched.replies[-1].plain['pid'] != first, DEADLINE)
        assert watched.steps.counts[kind] == 1
        assert words in watched.news[0]
        assert watched.news[-1] == 'the solver process has been replaced'
        assert not alive(first)


def test_a_process_and_its_successor_have_the_priority_or_it_is_said_why_not():
    """Each has it when it is ready; one that ends with a priority starts its successor."""
    refusal = find_priority_refusal(3)
    with supervised(priority=3) as watched:
        assert watched.ready.wait(DEADLINE)
        for _ in range(2):
            pid = watched.steps.link.pid
            found = os.sched_getscheduler(pid), os.sched_getparam(pid).sched_priority
            assert found == ((os.SCHED_OTHER, 0) if refusal else (os.SCHED_FIFO, 3))
            watched.ready.clear()
            os.kill(pid, signal.SIGKILL)
            assert watched.ready.wait(DEADLINE)
        assert watched.steps.link.pid != pid
    said = [each for each in watched.news if 'limits.conf' in each]
    assert said == ([f'the solver process: {refusal}'] if refusal else [])


def test_a_refused_problem_is_not_tried_again():
    with supervised('refused') as watched:
        wait_for(lambda: watched.steps.refusal, DEADLINE)
        assert watched.steps.refusal == 'this problem is refused'
        assert watched.steps.link is None
        assert not watched.ask()
