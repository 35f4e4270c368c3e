# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Child processes: signals, domains, log folders and locked output folders."""

import fcntl
import os
import signal
import subprocess
import sys
import tempfile

from obc_ros.cli import processes
from obc_ros.cli.processes import Children, reserve_domain
from obc_ros.cli.terminal import InterruptedByUserError
import pytest


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_reaches_all_open_children_contexts(tmp_path, number):
    before = signal.getsignal(number)
    with Children(tmp_path / 'outer') as outer:
        signal.raise_signal(number)
        with (Children(tmp_path / 'inner') as inner,
              pytest.raises(InterruptedByUserError, match=number.name)):
            inner.check()
        with pytest.raises(InterruptedByUserError, match=number.name):
            outer.check()
    with Children(tmp_path / 'later') as later:
        later.check()
    assert signal.getsignal(number) is before


def test_a_failed_start_restores_the_signal_handlers(tmp_path):
    (tmp_path / 'file').touch()
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(OSError), Children(tmp_path / 'file' / 'log'):
        pass
    assert signal.getsignal(signal.SIGINT) is before


def test_reserving_a_domain_removes_shared_memory_of_dead_nodes(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, 'SHARED_MEMORY', tmp_path)
    monkeypatch.setattr(processes, 'DOMAINS', range(101, 0, -1))  # others begin with 1
    with reserve_domain() as domain:
        first = 7400 + 250 * domain
    dead = ['fastrtps_port{}', 'fastrtps_port{}_el', 'sem.fastrtps_port{}_mutex']
    alive = ['fastdds_port{}', 'fastdds_port{}_sl', 'sem.fastdds_port{}_mutex']
    for each in dead:
        (tmp_path / each.format(first + 11)).touch()
        (tmp_path / each.format(7012)).touch()
        os.utime(tmp_path / each.format(7012), (0, 0))
    others = [*(each.format(number) for each in alive for number in (first + 10, 7011)),
              *(each.format(7013) for each in dead),  # new files, perhaps being opened
              *(each.format(first + 250) for each in dead),
              *(each.format(first - 1) for each in dead),
              'fastrtps_0123456789abcdef', 'fastrtps_0123456789abcdef_el']
    for other in others:
        (tmp_path / other).touch()
    for each in alive:
        os.utime(tmp_path / each.format(7011), (0, 0))
    with (tmp_path / alive[1].format(first + 10)).open('rb') as held, (
            tmp_path / alive[1].format(7011)).open('rb') as common:
        fcntl.flock(held, fcntl.LOCK_SH)
        fcntl.flock(common, fcntl.LOCK_EX)
        with reserve_domain() as again:
            assert again == domain
    assert sorted(each.name for each in tmp_path.iterdir()) == sorted(others)


@pytest.mark.parametrize(('home', 'temporary'), [(None, True), ('/dev/null', True), ('', False)])
def test_logs_go_to_the_temporary_folder_without_a_home(tmp_path, monkeypatch, home, temporary):
    for name in ('ROS_LOG_DIR', 'ROS_HOME', 'HOME'):
        monkeypatch.delenv(name, raising=False)
    if home is not None:
        monkeypatch.setenv('HOME', home or str(tmp_path))
    monkeypatch.setattr(os, 'environ', os.environ.copy())
    processes.find_log_folder()
    assert os.environ.get('ROS_LOG_DIR') == (tempfile.gettempdir() if temporary else None)


@pytest.mark.ros
@pytest.mark.slow
def test_an_output_folder_is_locked_by_its_command(tmp_path):
    folder = tmp_path / 'out'
    with processes.lock_folder(folder):
        program = (
            'import sys; from obc_ros.cli import obc\n'
            f'sys.exit(obc.main(["demo", "vehicle", "--out", {str(folder)!r}]))')
        second = subprocess.run(
            [sys.executable, '-c', program], capture_output=True, text=True, check=False)
        assert (second.returncode, second.stdout) == (1, '')
        assert 'out is being written by another command; give another folder' in second.stderr
    with processes.lock_folder(folder):
        assert not list(folder.iterdir())
