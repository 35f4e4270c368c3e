# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Whether the system allows a real-time priority, asked without a change of the process."""

import os
import subprocess
import sys

from obc_ros.ros.subscription_thread import find_priority_refusal
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
