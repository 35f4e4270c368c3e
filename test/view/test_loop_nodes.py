# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The loop that `obc view` starts."""

import os
from pathlib import Path
import re

from obc_ros.view.command import LOOP_PRIORITY
from obc_ros.workers.processes.real_time import find_priority_refusal
import pytest
import support


def find_schedulers(parent: int) -> dict[str, tuple[int, int]]:
    """Return policy and priority of the nodes that a process has started, by their names."""
    pids = [int(pid) for file in Path(f'/proc/{parent}/task').glob('*/children')
            for pid in file.read_text().split()]
    names = {pid: re.search(r'obc_ros\.nodes\.(\w+)', Path(
        f'/proc/{pid}/cmdline').read_text()) for pid in pids}
    return {found[1]: (os.sched_getscheduler(pid), os.sched_getparam(pid).sched_priority)
            for pid, found in names.items() if found}


def view(spawn: support.Spawner, folder: Path, *words: str) -> support.Process:
    """Start `obc view`, whose loop has a domain of its own."""
    process = support.Process(
        [support.find('obc'), 'view', *words, '--no-browser', '--port', str(support.find_port())],
        folder / 'view.log', spawn.domain)
    spawn.processes.append(process)
    return process


@pytest.mark.parametrize('words', [(), ('--priority', '0')])
def test_the_loop_of_obc_view_has_a_priority_that_leaves_time_to_others(spawn, tmp_path, words):
    """Where the system does not allow it, it is ordinary."""
    process = view(spawn, tmp_path, *words)
    process.wait_for_output('obc view: http')
    raised = not words and not find_priority_refusal(LOOP_PRIORITY)
    expected = (os.SCHED_FIFO, LOOP_PRIORITY - 1) if raised else (os.SCHED_OTHER, 0)
    support.wait_for(lambda: find_schedulers(process.pid) == {
        'plant_simulator': expected, 'lqr_node': expected,
        'trajectory_server': (os.SCHED_OTHER, 0)}, support.DEADLINE)
    assert process.interrupt() == 0


def test_a_signal_before_the_page_is_served_ends_the_command(spawn, tmp_path):
    """The server takes signals only when its modules are there, which takes seconds."""
    process = view(spawn, tmp_path)
    process.wait_for_output('three nodes, ')
    assert process.interrupt() == 0
