# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Faults: processes killed or stopped in every phase, clocks that jump, a full disk.

More faults are tested elsewhere: workers in test_pool.py, QoS and second publishers in
test_lqr_trust.py and test_plant_simulator.py, crashes under a demo in test_demo.py.
"""

from collections.abc import Iterable
from contextlib import suppress
import os
from pathlib import Path
import signal
import time
from typing import Any

from _endless import endless  # of benchmarks/
from lqr_bench import Heard
import numpy as np
from obc_ros.cli.recording import LATCHED, LIVE, Recorder
from obc_ros.core.ocp.statement import build_problem
from obc_ros.msg import Command, LqrDesign, State, Trajectory
from obc_ros.ros.messages import build_problem_message
from obc_ros.srv import DesignLqr, SolveOptimalControl
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from support import children, DEMO

NODES: dict[str, dict[str, Any]] = {
    'plant_simulator': {'system': 'aircraft', 'x0': [0.0] * 6, 'command_timeout': 0.3},
    'lqr_node': {**DEMO, 'system': 'aircraft', 'state_timeout': 0.3, 'stamp_timeout': 0.0},
    'trajectory_server': {'workers': 1}}


class Loop:
    """The three nodes, and a check that they work."""

    def __init__(self, spawn: Any, probe: Any) -> None:
        self.spawn, self.probe = spawn, probe
        self.heard = Heard(probe)
        self.running = {name: spawn(name, given) for name, given in NODES.items()}

    def verify(self) -> None:
        """Wait until new states are answered and the server responds."""
        self.heard.clear()
        self.probe.wait_for(lambda: self.heard.answers > 20, what='states that are answered')
        assert np.abs(self.heard.x).max() < 1e-3
        assert self.request_design().k == pytest.approx([1 + np.sqrt(2)])  # K^2 - 2 K - 1 = 0

    def request_design(self) -> LqrDesign:
        """
        Return a regulator for dx/dt = x + u from the server.

        For 20 s DDS still lists a killed server, and a request may reach that one only. So the
        client repeats its request.
        """
        request = DesignLqr.Request(a=[1.0], b=[1.0])
        request.weights.qx, request.weights.qu = [1.0], [1.0]
        client = self.probe.node.create_client(DesignLqr, '/trajectory_server/design_lqr')
        pending: list[Any] = []
        due = 0.0

        def answered() -> bool:
            nonlocal due
            if time.monotonic() > due and client.service_is_ready():
                pending.append(client.call_async(request))
                due = time.monotonic() + 0.5
            return any(each.done() for each in pending)

        self.probe.wait_for(answered, what='a design')
        self.probe.node.destroy_client(client)
        return next(each.result().design for each in pending if each.done())

    def restart(self, name: str) -> None:
        """Start a node in place of one that has ended."""
        self.running[name] = self.spawn(name, NODES[name])

    def send(self, number: int, names: Iterable[str] = NODES) -> None:
        """Send a signal to nodes."""
        for name in names:
            self.running[name].popen.send_signal(number)

    def end(self, number: int) -> None:
        """Send a signal to all nodes, and kill the remaining ones 5 ms later."""
        self.send(number)
        time.sleep(0.005)
        for process in self.running.values():
            process.kill()

    def suspend(self, names: Iterable[str], duration: float) -> None:
        """Stop nodes by SIGSTOP for `duration` seconds."""
        self.send(signal.SIGSTOP, names)
        self.probe.spin_for(duration)
        self.send(signal.SIGCONT, names)


def gone(pid: int) -> bool:
    return not Path(f'/proc/{pid}').exists()


def is_started(pid: int) -> bool:
    """
    Return whether a child runs its own program.

    Until then its parent is suspended by vfork: with the child stopped it would be, too.
    """
    with suppress(FileNotFoundError, ProcessLookupError):
        command = Path(f'/proc/{pid}/cmdline').read_bytes()
        return b'trajectory_server' not in command
    return False


def test_nodes_killed_in_any_phase_can_be_replaced(spawn, probe):
    loop = Loop(spawn, probe)
    loop.verify()
    for victim in NODES:  # one at a time while all run
        theirs = children(loop.running[victim].pid)
        loop.running[victim].popen.send_signal(signal.SIGKILL)
        loop.running[victim].wait()
        probe.wait_for(lambda left=theirs: all(map(gone, left)), 5.0, 'the end of its workers')
        loop.restart(victim)
        loop.verify()
    for delay in (0.02, 0.3, 0.8):  # [s] all at once, during the start
        loop.end(signal.SIGKILL)
        for victim in NODES:
            loop.restart(victim)
        probe.spin_for(delay)
    loop.end(signal.SIGTERM)  # all at once, during the shutdown
    for victim in NODES:
        loop.restart(victim)
    loop.verify()


def test_nodes_stopped_in_any_phase_continue(spawn, probe):
    """A debugger, a suspended machine or an overloaded one stops nodes like this."""
    loop = Loop(spawn, probe)
    for delay in (0.2, 0.3):  # [s] all at once, during the start
        probe.spin_for(delay)
        loop.suspend(NODES, 0.5)
    loop.verify()
    for victim in NODES:
        loop.suspend([victim], 0.7)
        loop.verify()
    loop.send(signal.SIGSTOP)
    loop.send(signal.SIGINT)
    probe.spin_for(0.3)
    assert all(process.running() for process in loop.running.values())
    loop.send(signal.SIGCONT)
    for process in loop.running.values():
        assert process.wait(5.0) == 0, 'SIGINT took effect after SIGCONT'


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGSTOP], ids=['killed', 'stopped'])
def test_a_lost_worker_loses_at_most_its_request(spawn, probe, number):
    server = spawn('trajectory_server', {'workers': 1, 'time_limit': 1.0})
    mapping = endless()
    slow = SolveOptimalControl.Request(problem=build_problem_message(
        mapping, build_problem(mapping).guess))
    for delay in (0.0, 0.1, 0.5):  # before, at the start of and during the solve
        probe.wait_for(lambda: children(server.pid), what='a worker')
        client = probe.node.create_client(SolveOptimalControl, '/trajectory_server/solve')
        probe.wait_for(client.service_is_ready)
        future = client.call_async(slow)
        probe.spin_for(delay)
        for pid in children(server.pid):
            if number == signal.SIGKILL or is_started(pid):
                os.kill(pid, number)
        probe.wait_for(future.done, 10.0, 'the answer')
        answer = future.result()
        assert answer.message
        assert answer.status in ('not_converged', 'timed_out', 'solved', 'infeasible')
        probe.node.destroy_client(client)
    quick = DesignLqr.Request(a=[1.0], b=[1.0])
    quick.weights.qx, quick.weights.qu = [1.0], [1.0]
    first = probe.call(DesignLqr, '/trajectory_server/design_lqr', quick)
    # a worker stopped while idle is detected at its next request
    assert first.success or first.message.startswith(('timed_out', 'not_converged'))
    probe.set_parameters('/trajectory_server', time_limit=20.0)
    # Workers killed during their start count as failures: requests are refused until one starts.
    probe.wait_for(lambda: probe.call(DesignLqr, '/trajectory_server/design_lqr', quick).success,
                   what='an answer from a new worker')
    assert server.running()


def test_a_controller_tolerates_a_jumping_clock(spawn, probe):
    """The controller uses the stamps of the states, so that jumps of /clock have no effect."""
    spawn('lqr_node', {**DEMO, 'system': 'aircraft', 'use_sim_time': True, 'state_timeout': 0.0})
    commands = probe.listen(Command, 'command')
    clock = probe.publisher(Clock, '/clock', QoSProfile(
        depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    states = probe.publisher(State, 'state')
    stamp = 100
    for jump in (100, 10_000_000, 3, 2**31 - 1, 0, 100):
        message = Clock()
        message.clock.sec = jump
        clock.publish(message)

        def answered() -> bool:
            nonlocal stamp
            stamp += 1
            state = State(x=[0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
            state.header.stamp.sec = stamp
            states.publish(state)
            probe.spin_for(0.02)
            return any(each.header.stamp.sec == stamp for each in commands)

        probe.wait_for(answered, what=f'an answer at {jump} s')
        probe.wait_for(answered, what=f'another at {jump} s')
        assert np.isfinite(commands[-1].u).all()
    assert len({tuple(each.u) for each in commands}) == 1, 'equal states have equal commands'


def test_a_plant_tolerates_a_jumping_clock(spawn, probe):
    """The plant continues from its state after jumps in both directions."""
    spawn('plant_simulator', {'hold_until_command': False,
        'system': 'aircraft', 'use_sim_time': True, 'publish_rate': 50.0,
        'x0': [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]})
    states = probe.listen(State, 'state')
    clock = probe.publisher(Clock, '/clock', QoSProfile(
        depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    now = 1_000_000_000
    for jump in (0, 3_600_000_000_000, -7_200_000_000_000 // 4, 2_000_000_000):
        now += jump
        states.clear()

        def moved() -> bool:
            nonlocal now
            now += 20_000_000
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(now, 10**9)
            clock.publish(message)
            probe.spin_for(0.005)
            return len(states) >= 10

        probe.wait_for(moved, what=f'states after a jump of {jump * 1e-9:g} s')
    # vx = 1 m/s: a simulated hour would be a drift of 3600 m
    assert 0.0 < states[-1].x[0] < 20.0


def test_a_full_disk_ends_the_recording_but_not_the_loop(spawn, probe, tmp_path, capsys):
    """The recording is written to /dev/full."""
    spawn('plant_simulator', {'system': 'aircraft', 'x0': [0.0] * 6, 'lockstep': True,
                              'speed': 0.0})
    spawn('lqr_node', NODES['lqr_node'])
    (tmp_path / 'flight').mkdir()
    (tmp_path / 'flight' / 'flight_0.mcap').symlink_to('/dev/full')
    seen: list[bytes] = []
    with Recorder(tmp_path / 'flight') as recorder:
        recorder.subscribe(probe.node, 'state', State, lambda data, _: seen.append(data), qos=LIVE)
        recorder.subscribe(probe.node, 'lqr_node/design', LqrDesign, qos=LATCHED)
        recorder.subscribe(probe.node, 'large', Trajectory, qos=LIVE)
        large = probe.publisher(Trajectory, 'large', LIVE)

        def full() -> bool:
            large.publish(Trajectory(x=[0.0] * 10_000))
            recorder.drain()
            return bool(recorder.fault)

        probe.wait_for(full, what='a full disk')
        seen.clear()

        def flies() -> bool:
            recorder.drain()
            return len(seen) > 200

        probe.wait_for(flies, what='states after that')
    assert recorder.fault.endswith('No space left on device')
    assert capsys.readouterr().err.count(recorder.fault) == 1
