# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
1, 2, 4, 8 and 16 loops on one machine, each in a namespace of its own.

A loop is a plant_simulator and an lqr_node at ``--rate`` states per second. The figures are from
the diagnostics of the nodes and from the kernel. Stalls of the machine are measured meanwhile.
"""

import timing  # isort: skip - before numpy

from collections.abc import Iterator
from contextlib import contextmanager
import os
from statistics import median
import subprocess
import sys
import time

from _machine import processor_time, share, Stalls, told
from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.cli.processes import isolate, reserve_domain
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

LOOPS = (1, 2, 4, 8, 16)
NODES = ('plant_simulator', 'lqr_node')
HELD = 0.95   # smallest share of the wanted rate
MEMORY = 160  # [MiB] limit of the two processes of a loop


class Listener:
    """The last values in /diagnostics, by node and key."""

    def __init__(self, node: Node) -> None:
        self.told: dict[tuple[str, str], float] = {}
        node.create_subscription(DiagnosticArray, '/diagnostics', self._listen,
                                 QoSProfile(depth=1000))

    def _listen(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.partition(':')[0]
            for each in status.values:
                try:
                    self.told[name, each.key] = float(each.value)
                except ValueError:  # a text
                    continue

    def all(self, node: str, key: str) -> list[float]:
        """Return the values of a key from all nodes with a name."""
        return [value for (name, each), value in self.told.items()
                if each == key and name.endswith(node)]


@contextmanager
def loops(count: int, rate: float) -> Iterator[list[int]]:
    """Run loops; yield the ids of their processes."""
    processes = [subprocess.Popen(
        [sys.executable, '-P', '-m', f'obc_ros.nodes.{node}', '--ros-args',
         '-r', f'__ns:=/loop{k}',
         '-p', f'publish_rate:={rate:.1f}'],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for k in range(count) for node in NODES]
    try:
        yield [process.pid for process in processes]
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait()


def measure(count: int, rate: float, seconds: float) -> tuple[str, ...]:
    """Return a row of the table for a number of loops."""
    with reserve_domain() as domain, loops_on(domain, count, rate) as (listener, executor, pids):
        deadline = time.monotonic() + 30.0 + 3.0 * count
        while len([1 for value in listener.all('lqr_node', 'rate [Hz]') if value > 0.0]) < count:
            executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > deadline:
                raise SystemExit(f'{count} loops do not start')
        _spin(executor, 2.0)  # the first second after the start does not count
        begin = time.monotonic()
        used = [processor_time(pid) for pid in pids]
        rates: list[float] = []
        stalls = Stalls()
        while time.monotonic() < begin + seconds:
            _spin(executor, 1.0)
            rates += listener.all('lqr_node', 'rate [Hz]')
        elapsed = time.monotonic() - begin
        still = stalls.end()
        cores = sum(processor_time(pid) - then for pid, then in zip(pids, used, strict=True)
                    ) / elapsed
        sizes = [share(pid) for pid in pids]
        latency = listener.all('lqr_node', 'latency p50 [us]')
        late = listener.all('lqr_node', 'latency p99 [us]')
    held = median(rates) / rate
    per_loop = sum(sizes) / count
    if cores < 0.75 * (os.cpu_count() or 1):  # larger numbers measure the machine
        timing.require(f'{count} loops: missing share of the rate', 1.0 - held, 1.0 - HELD)
    timing.require(f'{count} loops: memory of one [MiB]', per_loop, MEMORY)
    print(f'  {count} loops: {told(still)}')
    return (str(count), f'{median(rates):.1f}', f'{min(rates):.1f}', f'{cores:.2f}',
            f'{cores / count:.3f}', f'{per_loop:.0f}', f'{median(latency):.0f}',
            f'{max(late):.0f}', f'{os.getloadavg()[0]:.1f}')


@contextmanager
def loops_on(domain: int, count: int, rate: float
             ) -> Iterator[tuple[Listener, SingleThreadedExecutor, list[int]]]:
    """Run loops and an observer on a domain."""
    isolate(domain)
    rclpy.init()
    node = rclpy.create_node('scale')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        with loops(count, rate) as pids:
            yield Listener(node), executor, pids
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


def _spin(executor: SingleThreadedExecutor, duration: float) -> None:
    end = time.monotonic() + duration
    while (left := end - time.monotonic()) > 0.0:
        executor.spin_once(timeout_sec=left)


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments(__doc__ or '', seconds=10.0, rate=100.0, most=16)
    rows = [measure(count, args.rate, args.seconds) for count in LOOPS if count <= args.most]
    timing.table(
        f'loops on one machine, {args.rate:g} states per second each, {args.seconds:g} s',
        ('loops', 'answered/s', 'minimum in a second', 'cores', 'cores a loop', 'MiB a loop',
         'latency 50 % [us]', 'worst 99 % [us]', 'load'), rows)
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())
