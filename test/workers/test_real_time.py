# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Real-time priorities: what the system allows, and what a process then has."""

import os
import subprocess
import sys

from obc_ros.workers.processes.real_time import (
    drop_priority,
    find_priority_refusal,
    raise_priority,
)
import pytest

LOWEST, HIGHEST = os.sched_get_priority_min(os.SCHED_FIFO), os.sched_get_priority_max(
    os.SCHED_FIFO)


@pytest.mark.parametrize('priority', [LOWEST, 50, HIGHEST])
def test_the_answer_is_that_of_a_process_that_tries(priority):
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    refusal = find_priority_refusal(priority)
    tried = subprocess.run(
        [sys.executable, '-c', 'import os, sys; os.sched_setscheduler('
         '0, os.SCHED_FIFO, os.sched_param(int(sys.argv[1])))', str(priority)],
        capture_output=True, check=False)
    assert (refusal == '') == (tried.returncode == 0)
    assert not refusal or refusal.startswith(f'priority = {priority}: ')
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before


def test_a_refusal_says_what_to_do(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, 'Operation not permitted')

    monkeypatch.setattr(os, 'sched_setscheduler', refuse)
    refusal = find_priority_refusal(50)
    assert 'Operation not permitted' in refusal and 'limits.conf' in refusal


def test_a_system_without_such_priorities_is_named(monkeypatch):
    monkeypatch.delattr(os, 'sched_setscheduler')
    assert 'no real-time priorities' in find_priority_refusal(50)


def test_the_threads_of_a_process_have_their_priorities_or_it_is_said_why_not():
    """A process of its own, with a thread beside the calling one; then it gives its own up."""
    program = """
import os, threading
from obc_ros.workers.processes.real_time import drop_priority, raise_priority
ended = threading.Event()
other = threading.Thread(target=ended.wait)
other.start()
def find(thread):
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority
print(raise_priority(5, 0))
print(find(0), find(other.native_id))
drop_priority()
print(find(0))
ended.set()
"""
    said, raised, dropped = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert said == find_priority_refusal(5)
    fifo, other = os.SCHED_FIFO, (os.SCHED_OTHER, 0)
    assert raised == (f'{other} {other}' if said else f'{(fifo, 1)} {(fifo, 5)}')
    assert dropped == f'{other}'


def test_without_such_priorities_nothing_is_changed(monkeypatch):
    monkeypatch.delattr(os, 'sched_setscheduler')
    assert 'no real-time priorities' in raise_priority(5, 5)
    drop_priority()
