# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Latency from a state to its command over DDS, between two processes.

The baseline is an rclpy echo of the same two messages with the same QoS. The echo and lqr_node,
with default settings and with all options on, are measured in turn; then lqr_node runs at 1 kHz
for a minute. With ``--udp 1`` no shared memory is used, in a network namespace of its own.
"""

import sys

import timing  # isort: skip - before numpy

from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, ExitStack
from pathlib import Path
from statistics import median, quantiles
import subprocess
import time

from _hosts import enter, udp_only
from obc_ros.cli.processes import isolate, reserve_domain
from obc_ros.msg import Command, State, Trajectory
import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

ROUNDS = 15
MESSAGES = 200   # messages of one process in a round
GAP = 1e-3       # [s] between two of them
LIMIT, LIMIT_ALL = 1.1, 1.15
PERIOD, HELD, LATE = 1_000_000, 60.0, 1e-3  # [ns], [s], largest share of late commands
X = array('d', (0.1, -0.2, 0.05, 0.01, 0.02, -0.03))

ALL_ON = ('-p', "integral:=['px', 'py']", '-p', 'transition_time:=0.5',
          '-p', 'x_limits:=[9.0, 9.0, 2.0, 9.0, 9.0, 9.0]', '-p', 'frame_id:=odom',
          '-p', 'design:=sampled', '-p', 'sample_time:=0.001', '-p', 'delay:=0.004')


class Rival:
    """A process that replies to states, observed through a wait set with one subscription."""

    def __init__(self, node: Node, name: str, command: Sequence[str],
                 arguments: Sequence[str] = ()) -> None:
        self.name = name
        self.process = subprocess.Popen(
            [*command, '--ros-args', '-r', f'__ns:=/{name}', *arguments],
            stderr=subprocess.DEVNULL)
        self._context = node.context.handle
        self._publisher = node.create_publisher(State, f'/{name}/state', QoSProfile(depth=1))
        self._commands = node.create_subscription(
            Command, f'/{name}/command', lambda message: None, QoSProfile(depth=1))
        self._state = State(x=X)
        self._state.header.frame_id = 'odom'
        self._wait_set = _rclpy.WaitSet(1, 0, 0, 0, 0, 0, self._context)
        self.latencies: list[float] = []

    def find(self) -> None:
        """Wait until both directions are connected."""
        deadline = time.monotonic() + 30.0
        while not (self._publisher.get_subscription_count() and self._answers(50)):
            if self.process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit(f'{self.name} does not reply')
            time.sleep(0.05)

    def send(self, stamp: int) -> None:
        """Publish a state."""
        self._state.header.stamp.sec, self._state.header.stamp.nanosec = divmod(stamp, 10**9)
        self._publisher.publish(self._state)

    def receive(self, timeout: int) -> int | None:
        """Return the stamp of the next command [ns], or None after a timeout [ns]."""
        handle = self._commands.handle
        with handle:
            self._wait_set.clear_entities()
            self._wait_set.add_subscription(handle)
            self._wait_set.wait(max(timeout, 0))
            taken = handle.take_message(Command, False)
        if taken is None:
            return None
        stamp = taken[0].header.stamp
        return int(stamp.sec * 10**9 + stamp.nanosec)

    def measure(self) -> None:
        """Send states one after the other, each after the reply to the last one."""
        for _ in range(MESSAGES):
            time.sleep(GAP)
            stamp, begun = time.time_ns(), time.perf_counter()
            self.send(stamp)
            while (answered := self.receive(10**9)) not in (None, stamp):
                pass  # messages received before are no replies
            if answered is None:
                raise SystemExit(f'{self.name}: no reply within 1 s')
            self.latencies.append(time.perf_counter() - begun)

    def hold(self) -> tuple[int, list[float]]:
        """Send states at a fixed rate; return their number, and the latency of each reply [s]."""
        sent: dict[int, int] = {}
        latencies = []
        begin = time.monotonic_ns()
        offset = time.time_ns() - begin
        due = begin
        while due < begin + HELD * 1e9:
            left = due - time.monotonic_ns()
            if left <= 0:
                sent[due + offset] = time.monotonic_ns()
                self.send(due + offset)
                # states that this process would send too late are skipped
                due += PERIOD * (1 + -left // PERIOD)
            elif (stamp := self.receive(left)) in sent:
                latencies.append((time.monotonic_ns() - sent[stamp]) * 1e-9)
        return len(sent), latencies

    def _answers(self, tries: int) -> bool:
        for _ in range(tries):
            self.send(time.time_ns())
            if self.receive(20_000_000) is not None:
                return True
        return False


@contextmanager
def rivals(node: Node) -> Iterator[dict[str, Rival]]:
    """Start the processes; end them on exit."""
    lqr_node = (sys.executable, '-P', '-m', 'obc_ros.nodes.lqr_node')
    echo = (sys.executable, str(Path(__file__).parent / '_echo.py'))
    with ExitStack() as ending:
        found = {}
        for name, command, arguments in (
                ('echo', echo, ()), ('lqr_node', lqr_node, ()), ('all_on', lqr_node, ALL_ON)):
            found[name] = Rival(node, name, command, arguments)
            ending.callback(_end, found[name].process)
        for rival in found.values():
            rival.find()
        reference = node.create_publisher(Trajectory, '/all_on/reference', QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        reference.publish(hovering())
        time.sleep(2.0)
        yield found


def hovering() -> Trajectory:
    """Return a reference at the origin for one hour."""
    n, t = 6, [60.0 * k for k in range(61)]
    return Trajectory(
        system='aircraft', state_names=['px', 'py', 'theta', 'vx', 'vy', 'omega'],
        input_names=['f1', 'f2'], t=array('d', t), x=array('d', [0.0] * n * len(t)),
        u=array('d', [0.0, 39.2] * len(t)), interpolation='linear')


def _end(process: 'subprocess.Popen[bytes]') -> None:
    process.terminate()
    process.wait()


def main() -> int:
    """Measure and report."""
    args = timing.arguments(__doc__ or '', udp=0)
    if args.udp and (fault := enter()):
        raise SystemExit(fault)
    with reserve_domain() as domain:
        isolate(domain)
        if args.udp:
            udp_only()
        rclpy.init()
        node = Node('latency')
        with rivals(node) as found:
            for _ in range(ROUNDS):
                for rival in found.values():
                    rival.measure()
            sent, held = found['lqr_node'].hold()
        node.destroy_node()
        rclpy.shutdown()
    report(found)
    report_held(sent, held)
    return timing.finish()


def report(found: dict[str, Rival]) -> None:
    """Print the latencies and their requirements."""
    floor = found['echo'].latencies
    rows = []
    for rival in found.values():
        percent = quantiles(rival.latencies, n=100)
        rows.append((rival.name, *(f'{1e6 * value:.0f}' for value in (
            median(rival.latencies), percent[9], percent[89], percent[98])),
            f'{ratio(rival.latencies, floor):.3f}'))
    timing.table(f'state to command and back, {ROUNDS} rounds of {MESSAGES} [us]',
                 ('', 'median', '10 %', '90 %', '99 %', 'median against echo'), rows)
    timing.require('lqr_node', ratio(found['lqr_node'].latencies, floor), LIMIT)
    timing.require('everything on', ratio(found['all_on'].latencies, floor), LIMIT_ALL)


def ratio(mine: Sequence[float], its: Sequence[float]) -> float:
    """Return the median over the rounds of the ratio of their medians."""
    return median(median(mine[k:k + MESSAGES]) / median(its[k:k + MESSAGES])
                  for k in range(0, len(its), MESSAGES))


def report_held(sent: int, held: Sequence[float]) -> None:
    """Print the share of late commands at a fixed rate."""
    late = sent - sum(latency <= PERIOD * 1e-9 for latency in held)
    percent = quantiles(held, n=1000)
    timing.table(f'{1e9 / PERIOD:.0f} states a second for {HELD:g} s [us]',
                 ('sent', 'answered', 'median', '99 %', '99.9 %', 'most', 'late'),
                 [(sent, len(held), *(f'{1e6 * value:.0f}' for value in (
                     median(held), percent[989], percent[998], max(held))), late)])
    timing.require('share of commands late by more than a period', late / sent, LATE)


if __name__ == '__main__':
    sys.exit(main())
