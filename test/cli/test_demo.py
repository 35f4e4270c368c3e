# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc demo` as a user runs it: flight, recording, figures, and no process left."""

from itertools import pairwise
import os
from pathlib import Path
import re
import signal
import subprocess
from typing import Any

import numpy as np
from obc_ros.cli.demo.aircraft import GUST
from obc_ros.cli.demo.flight import measure_step
from obc_ros.cli.demo.flight_estimates import judge_flight
from obc_ros.cli.obc import main
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from probes import Probe
import pytest
from rosbags.highlevel import AnyReader
from scipy.optimize import brentq
import support
from support import alive, children, wait_for

PRINTED = {
    'aircraft': ('rise time', 'overshoot', 'settling', 'peak |f - fe|', 'state to command, p50',
                 'designs adopted', 'gust',
                 'rejected: Qu[0] = -0.1: Qu must be positive definite'),
    'vehicle': ('maximum lateral error', 'slalom', 'state to command, p50'),
    'mpc': ('largest |vx|, of 0.4 m/s', 'largest |theta|, of 0.2 rad', 'deadlines missed',
            'time of a plan, p50, p99, max'),
    'lqg': ('error of the estimate', 'in the 95 % band', 'measurements missing',
            'measurements used', 'state to command, p50', 'held')}
NODES = ('plant_simulator', 'lqr_node', 'trajectory_server')


def descendants(pid: int) -> list[int]:
    """Return the process ids of all descendants of a process."""
    found = children(pid)
    return found + [each for child in found for each in descendants(child)]


def wait_for_flight(demo: support.Process) -> list[int]:
    """Wait for the first step of a demonstration; return its descendants."""
    demo.wait_for_output('step to (1, 1)', 60.0)
    return descendants(demo.pid)


@pytest.mark.nodes
@pytest.mark.parametrize(('scenario', 'flights', 'figures'), [
    ('aircraft', ['aircraft'], ['aircraft.png']),
    ('vehicle', ['lane_change', 'slalom'], ['lane_change.png', 'slalom.png']),
    ('mpc', ['limits_lqr_node', 'limits_mpc_node'], ['limits.png'])])
def test_a_demo_writes_table_figures_and_complete_recording(scenario: str, flights: list[str],
                                                            figures: list[str], tmp_path: Path,
                                                            domain: int) -> None:
    """Every recorded state between the first command and the end has its command."""
    demo = support.Process([support.find('obc'), 'demo', scenario, '--out', str(tmp_path / 'out')],
                           tmp_path / 'log', domain)
    try:
        assert demo.wait(180.0) == 0, demo.output()
    finally:
        demo.end()
    assert re.findall(r'missed states\W+(\d+)', demo.output()) == ['0'] * len(flights)
    for words in PRINTED[scenario]:
        assert words in demo.output()
    assert all((tmp_path / 'out' / figure).stat().st_size > 20_000 for figure in figures)
    for flight in flights:
        design = f'/{"mpc_node" if flight.endswith("mpc_node") else "lqr_node"}/design'
        with AnyReader([tmp_path / 'out' / flight]) as reader:
            stamps = {topic: [message.header.stamp for message in of] for topic, of in (
                (topic, (reader.deserialize(data, connection.msgtype) for connection, _, data
                         in reader.messages(connections=[
                             c for c in reader.connections if c.topic == topic])))
                for topic in ('/state', '/command', design))}
        answered = {(stamp.sec, stamp.nanosec) for stamp in stamps['/command']}
        states = [(stamp.sec, stamp.nanosec) for stamp in stamps['/state']]
        assert len(states) >= 400
        assert set(states[states.index(min(answered)):-1]) <= answered
        assert stamps[design]
    if scenario == 'aircraft':
        check_impulse(tmp_path / 'out' / 'aircraft')


def check_impulse(recording: Path) -> None:
    """Check the gust: what the states gain beyond the model has the integral of 1 - cos."""
    with AnyReader([recording]) as reader:
        x, u = ({_find_time(message): getattr(message, name) for message in (
            reader.deserialize(data, connection.msgtype) for connection, _, data
            in reader.messages(connections=[
                each for each in reader.connections if each.topic == topic]))}
            for topic, name in (('/state', 'x'), ('/command', 'u')))
    times = sorted(set(x) & set(u))
    model = Simulator(registry.get_system('aircraft'))
    gained = {'before': 0.0, 'in': 0.0, 'after': 0.0}
    for now, later in pairwise(times):
        if not GUST - 1.0 <= now < GUST + 2.0:
            continue
        model.reset(x[now], u[now])
        model.advance(round((later - now) / model.conditions.dt))
        place = 'before' if now < GUST else 'in' if now < GUST + 1.0 else 'after'
        gained[place] += x[later][3] - model.x[3]
    assert gained['in'] == pytest.approx(0.5, rel=1e-3)   # 1 m/s^2 over 1 s, half of it
    assert abs(gained['before']) < 1e-9 and abs(gained['after']) < 1e-9


def _find_time(message: Any) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


@pytest.mark.nodes
def test_a_demo_with_an_estimator_records_what_it_hears(tmp_path: Path, domain: int) -> None:
    """The loop holds, measurements are lost, and each estimate is recorded with its covariance."""
    out = tmp_path / 'out'
    demo = support.Process([support.find('obc'), 'demo', 'lqg', '--out', str(out)],
                           tmp_path / 'log', domain)
    try:
        assert demo.wait(240.0) == 0, demo.output()
    finally:
        demo.end()
    for words in PRINTED['lqg']:
        assert words in demo.output()
    assert int(re.search(r'measurements missing\W+(\d+)', demo.output())[1]) > 0
    assert (out / 'estimates.png').stat().st_size > 20_000
    with AnyReader([out / 'estimates']) as reader:
        counts = {each.topic: each.msgcount for each in reader.connections}
    assert counts['/true_state'] > counts['/estimator_node/estimate'] > 500
    assert counts['/measurement'] > 500
    with AnyReader([out / 'estimates_whole_state']) as reader:
        assert not {'/true_state', '/measurement'} & {each.topic for each in reader.connections}


def test_a_loop_that_leaves_its_set_point_does_not_hold() -> None:
    """Only the last 3 s count, and the distance is that in the plane."""
    t = np.linspace(0.0, 10.0, 1001)
    x = np.zeros((t.size, 6))
    x[t < 6.9, 0] = 100.0
    x[:, 5] = 100.0
    assert judge_flight(t, x)[0]
    x[t > 9.5, :2] = 0.4
    held, words = judge_flight(t, x)
    assert not held and '0.57 m' in words


@pytest.mark.nodes
def test_a_demo_in_real_time_ends_with_ctrl_c(tmp_path: Path, domain: int) -> None:
    """The speed is 1 without lockstep; Ctrl-C leaves no process."""
    demo = support.Process(
        [support.find('obc'), 'demo', 'aircraft', '--real-time', '--out', str(tmp_path / 'out')],
        tmp_path / 'log', domain)
    try:
        pids = wait_for_flight(demo)
        assert len(pids) >= len(NODES)
        assert f'three nodes over DDS, domain {domain}, this machine only' in demo.output()
        line = re.search(r'ROS_DOMAIN_ID=\d+ \S+/obc param get /lqr_node Qx', demo.output())[0]
        read = subprocess.run(['env', *line.split()], capture_output=True, text=True, timeout=60)
        assert read.stdout.startswith('Double values are: [1.0, '), read
        probe = Probe(domain)
        assert probe.get_parameters('/plant_simulator', 'speed', 'lockstep') == {
            'speed': 1.0, 'lockstep': False}
        probe.close()
        assert demo.interrupt(15.0) == 1
        wait_for(lambda: not any(map(alive, pids)))
        assert 'SIGINT' in demo.output()
        assert 'Traceback' not in demo.output()
    finally:
        demo.end()


def test_a_domain_with_a_running_loop_is_refused(spawn: Any, domain: int, tmp_path: Path) -> None:
    """The commands of the demonstration would reach the plant of that loop."""
    spawn('plant_simulator').wait_for_output('until the first command')
    demo = support.Process(
        [support.find('obc'), 'demo', 'aircraft', '--out', str(tmp_path / 'out')],
        tmp_path / 'log', domain)
    try:
        assert demo.wait(60.0) == 1
        # The end that is discovered first is enough for a refusal.
        assert re.search(rf'ROS_DOMAIN_ID={domain} has a loop already \(/(state|command)[,)]',
                         demo.output()), demo.output()
    finally:
        demo.end()


def test_an_invalid_domain_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                      capsys: pytest.CaptureFixture[str]) -> None:
    for named in ('-1', '233', 'x', '1.5'):
        monkeypatch.setenv('ROS_DOMAIN_ID', named)
        assert main(['demo', 'aircraft', '--out', str(tmp_path)]) == 1
        assert f'ROS_DOMAIN_ID={named}: wanted a number from 0 to 232' in capsys.readouterr().err


@pytest.mark.nodes
@pytest.mark.parametrize('victim', ['plant_simulator', 'trajectory_server'])
def test_the_death_of_a_node_ends_the_demo(victim: str, tmp_path: Path, domain: int) -> None:
    """The demonstration names the dead node, missed by others or not, and ends these."""
    demo = support.Process(
        [support.find('obc'), 'demo', 'aircraft', '--real-time', '--out', str(tmp_path / 'out')],
        tmp_path / 'log', domain)
    try:
        pids = wait_for_flight(demo)
        node = next(pid for pid in pids
                    if f'obc_ros.nodes.{victim}' in Path(f'/proc/{pid}/cmdline').read_text())
        os.kill(node, signal.SIGKILL)
        assert demo.wait(20.0) == 1
        assert f'{victim} was ended by SIGKILL' in demo.output()
        wait_for(lambda: not any(map(alive, pids)))
    finally:
        demo.end()


@pytest.mark.nodes
def test_a_killed_demo_leaves_no_node(tmp_path: Path, domain: int) -> None:
    demo = support.Process(
        [support.find('obc'), 'demo', 'aircraft', '--real-time', '--out', str(tmp_path / 'out')],
        tmp_path / 'log', domain)
    try:
        pids = wait_for_flight(demo)
        demo.kill()
        wait_for(lambda: not any(map(alive, pids)))
    finally:
        demo.end()


def test_step_figures_are_those_of_a_second_order_system() -> None:
    """Overshoot, settling and rise time follow from the closed-form step response."""
    t = np.linspace(0.0, 20.0, 200_001)
    zeta, w = 0.5, 1.0
    wd = w * np.sqrt(1 - zeta**2)
    y = 1 - np.exp(-zeta * w * t) * (np.cos(wd * t) + zeta * w / wd * np.sin(wd * t))
    step = measure_step(t, 2.0 + 3.0 * y, 2.0, 5.0)
    assert step.overshoot == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), abs=1e-6)
    def response(at: float, level: float) -> float:
        return 1 - level - np.exp(-zeta * w * at) * (
            np.cos(wd * at) + zeta * w / wd * np.sin(wd * at))

    rise = brentq(response, 1.0, 3.0, args=(0.9,)) - brentq(response, 0.1, 1.0, args=(0.1,))
    assert step.rise_time == pytest.approx(rise, abs=2e-4)
    assert np.abs(y[t >= step.settling_time] - 1).max() <= 0.02
