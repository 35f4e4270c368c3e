# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc bench` runs the scripts and passes on their status; `timing` measures and requires."""

import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

from obc_ros.cli import bench, obc
import pytest
import timing  # of benchmarks/


@pytest.fixture
def scripts(tmp_path, monkeypatch):
    """Write a benchmark that passes and prints its arguments, and one that fails."""
    folder = tmp_path / 'benchmarks'
    folder.mkdir()
    (folder / 'good.py').write_text('import sys\nprint("measured", sys.argv[1:])\n')
    (folder / 'bad.py').write_text('import sys\nsys.exit(1)\n')
    (folder / 'timing.py').write_text('raise SystemExit(9)\n')
    monkeypatch.setattr(bench, 'share_directory', lambda package: tmp_path)
    return folder


def test_the_exit_status_is_0_only_if_all_benchmarks_pass(scripts, capfd):
    assert obc.main(['bench', 'good']) == 0
    assert obc.main(['bench', 'good', '--peers']) == 0
    assert obc.main(['bench', 'bad', 'good']) == 1
    out, err = capfd.readouterr()
    assert "measured ['--peers']" in out
    assert out.count('== good ==') == 3, 'the benchmarks after a failed one run too'
    assert 'requirements not met: bad' in err
    assert obc.main(['bench']) == 1


def test_an_unknown_benchmark_is_refused_with_a_list(scripts, capsys):
    assert obc.main(['bench', 'speed']) == 2
    assert "no benchmark 'speed'; there are bad, good" in capsys.readouterr().err


def test_without_benchmarks_the_searched_folder_is_named(scripts, capsys):
    for script in scripts.iterdir():
        script.unlink()
    assert obc.main(['bench']) == 2
    assert str(scripts) in capsys.readouterr().err


def test_sigint_leaves_no_process_and_no_traceback(tmp_path):
    (tmp_path / 'benchmarks').mkdir()
    pid_file = tmp_path / 'pid'
    shutil.copy(timing.__file__, tmp_path / 'benchmarks')
    (tmp_path / 'benchmarks' / 'long.py').write_text(
        'import os, pathlib, time, timing\n'
        f'pathlib.Path({str(pid_file)!r}).write_text(str(os.getpid()))\ntime.sleep(60)\n')
    command = subprocess.Popen([sys.executable, '-c', (
        'import pathlib, sys\nfrom obc_ros.cli import bench, obc\n'
        f'bench.share_directory = lambda package: pathlib.Path({str(tmp_path)!r})\n'
        'sys.exit(obc.main(["bench"]))')], start_new_session=True, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 20
    while not (pid_file.exists() and pid_file.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    os.killpg(command.pid, signal.SIGINT)  # to the process group, as a terminal does
    assert command.communicate(timeout=20)[1] == b''
    assert command.returncode == 130
    assert not Path(f'/proc/{pid_file.read_text()}').exists()


def test_the_benchmarks_of_the_project_are_found():
    assert {'simulate'} <= set(bench.find_benchmarks())
    assert 'timing' not in bench.find_benchmarks()


def test_candidates_are_timed_in_turn_by_the_given_clock():
    now, order = [0.0], []

    def candidate(name, seconds):
        def call():
            order.append(name)
            now[0] += seconds
        return call

    times = timing.measure({'slow': candidate('slow', 0.3), 'fast': candidate('fast', 0.1)},
                           least=0.05, per=10, clock=lambda: now[0])
    assert times['slow'].median == pytest.approx(0.03)
    assert times['slow'].ratio(times['fast']) == pytest.approx(3.0)
    assert order[-18:] == ['slow', 'fast'] * 9
    with pytest.raises(ValueError, match='at least 7'):
        timing.measure({}, rounds=3)


def test_failed_requirements_decide_the_exit_status(capsys):
    timing.require('ratio', 1.05, 1.1)
    assert timing.finish() == 0
    timing.require('latency', 2.0, 1.1)
    timing.require('nan', float('nan'), 1.1)
    assert timing.finish() == 1
    out, err = capsys.readouterr()
    assert 'holds: ratio: 1.05 (limit 1.1)' in out
    assert 'FAILS: latency' in out
    assert 'requirements not met: latency; nan' in err


def test_a_missing_peer_is_named_and_skipped(capsys):
    assert timing.peer('nothing_of_that_name') is None
    assert 'skipped: nothing_of_that_name' in capsys.readouterr().out
    assert timing.peer('math').pi > 3
