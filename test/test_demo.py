# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc demo` as a user runs it: it flies, records, draws, and leaves nothing behind."""

from collections.abc import Callable
import os
from pathlib import Path
import re
import signal
import time

import numpy as np
from obc_ros.cli.report import step_figures
import pytest
from rosbags.highlevel import AnyReader
from scipy.optimize import brentq
import support

NODES = ('plant_simulator', 'lqr_node', 'trajectory_server')


def children(pid: int) -> list[int]:
    """Return the process ids of all descendants of a process."""
    parents = {}
    for entry in Path('/proc').iterdir():
        if entry.name.isdigit():
            try:
                stat = (entry / 'stat').read_text()
            except (FileNotFoundError, ProcessLookupError):
                continue
            parents[int(entry.name)] = int(stat.rpartition(')')[2].split()[1])
    found = [child for child, parent in parents.items() if parent == pid]
    return found + [grandchild for child in found for grandchild in children(child)]


def alive(pid: int) -> bool:
    """Return whether a process runs, zombies not counted."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_for(condition: Callable[[], object], timeout: float = 30.0) -> None:
    """Wait until a condition holds; fail at the deadline."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def flying(demo: support.Process) -> list[int]:
    """Wait until a demonstration has made its first step; return its descendants."""
    demo.wait_for_output('step to (1, 1)', 60.0)
    return children(demo.pid)


@pytest.mark.nodes
@pytest.mark.parametrize(('scenario', 'flights', 'figures'), [
    ('aircraft', ['aircraft'], ['aircraft.png']),
    ('vehicle', ['lane_change', 'slalom'], ['lane_change.png', 'slalom.png'])])
def test_demo(scenario: str, flights: list[str], figures: list[str], tmp_path: Path,
              domain: int) -> None:
    """A demonstration ends with a table, figures and a recording in which no state is missed."""
    demo = support.Process([support.find('obc'), 'demo', scenario, '--out', str(tmp_path / 'out')],
                           tmp_path / 'log', domain)
    try:
        assert demo.wait(180.0) == 0, demo.output()
    finally:
        demo.end()
    assert re.findall(r'missed states\W+(\d+)', demo.output()) == ['0'] * len(flights)
    assert all((tmp_path / 'out' / figure).stat().st_size > 20_000 for figure in figures)
    for flight in flights:
        with AnyReader([tmp_path / 'out' / flight]) as reader:
            stamps = {topic: [message.header.stamp for message in of] for topic, of in (
                (topic, (reader.deserialize(data, connection.msgtype) for connection, _, data
                         in reader.messages(connections=[
                             c for c in reader.connections if c.topic == topic])))
                for topic in ('/state', '/command', '/lqr_node/design'))}
        answered = {(stamp.sec, stamp.nanosec) for stamp in stamps['/command']}
        states = [(stamp.sec, stamp.nanosec) for stamp in stamps['/state']]
        assert len(states) > 500
        assert set(states[states.index(min(answered)):-1]) <= answered
        assert stamps['/lqr_node/design']


@pytest.mark.nodes
def test_ctrl_c_ends_all(tmp_path: Path, domain: int) -> None:
    """After Ctrl-C no process of the demonstration is left."""
    demo = support.Process(
        [support.find('obc'), 'demo', 'aircraft', '--real-time', '--out', str(tmp_path / 'out')],
        tmp_path / 'log', domain)
    try:
        pids = flying(demo)
        assert len(pids) >= len(NODES)
        assert demo.interrupt(15.0) == 1
        wait_for(lambda: not any(map(alive, pids)))
        assert 'SIGINT' in demo.output()
        assert 'Traceback' not in demo.output()
    finally:
        demo.end()


@pytest.mark.nodes
@pytest.mark.parametrize('victim', NODES)
def test_a_crash_of_one_ends_all(victim: str, tmp_path: Path, domain: int) -> None:
    """When a node dies the demonstration says which, and ends the others."""
    demo = support.Process(
        [support.find('obc'), 'demo', 'aircraft', '--real-time', '--out', str(tmp_path / 'out')],
        tmp_path / 'log', domain)
    try:
        pids = flying(demo)
        node = next(pid for pid in pids
                    if f'obc_ros.nodes.{victim}' in Path(f'/proc/{pid}/cmdline').read_text())
        os.kill(node, signal.SIGKILL)
        assert demo.wait(20.0) == 1
        assert f'{victim} was ended by SIGKILL' in demo.output()
        wait_for(lambda: not any(map(alive, pids)))
    finally:
        demo.end()


@pytest.mark.nodes
def test_its_own_crash_ends_all(tmp_path: Path, domain: int) -> None:
    """When the demonstration itself is killed, its nodes end too."""
    demo = support.Process(
        [support.find('obc'), 'demo', 'aircraft', '--real-time', '--out', str(tmp_path / 'out')],
        tmp_path / 'log', domain)
    try:
        pids = flying(demo)
        demo.kill()
        wait_for(lambda: not any(map(alive, pids)))
    finally:
        demo.end()


def test_step_figures_of_a_known_response() -> None:
    """A second order step has the overshoot, settling and rise time of its formula."""
    t = np.linspace(0.0, 20.0, 200_001)
    zeta, w = 0.5, 1.0
    wd = w * np.sqrt(1 - zeta**2)
    y = 1 - np.exp(-zeta * w * t) * (np.cos(wd * t) + zeta * w / wd * np.sin(wd * t))
    step = step_figures(t, 2.0 + 3.0 * y, 2.0, 5.0)
    assert step.overshoot == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), abs=1e-6)
    def response(at: float, level: float) -> float:
        return 1 - level - np.exp(-zeta * w * at) * (
            np.cos(wd * at) + zeta * w / wd * np.sin(wd * at))

    rise = brentq(response, 1.0, 3.0, args=(0.9,)) - brentq(response, 0.1, 1.0, args=(0.1,))
    assert step.rise_time == pytest.approx(rise, abs=2e-4)
    assert np.abs(y[t >= step.settling_time] - 1).max() <= 0.02
