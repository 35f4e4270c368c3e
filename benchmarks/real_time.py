# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The aircraft and its controller in real time over DDS: missed commands, drift, load of the machine.

Says what it is on this machine now: on a busy one states are left out or answered late.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Callable
import os
from pathlib import Path
import tempfile
import time

from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.cli.processes import Children, free_domain, isolate
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

SECONDS = 10.0
RATES = (200.0, 1000.0)  # [Hz]
START = 30.0             # [s] in which the loop must have closed
COUNTS = ('states published', 'states skipped', 'states unanswered')


def main() -> int:
    """Measure and print; return the exit status."""
    timing.arguments('the loop in real time over DDS')
    rows = []
    with free_domain() as domain:
        isolate(domain)
        for rate in RATES:
            rows.append(run(rate))
    timing.table(f'Aircraft and lqr_node in real time for {SECONDS:g} s', (
        'rate', 'published', 'skipped', 'unanswered', 'drift', 'plant', 'lqr_node'), [
        (f'{rate:g} Hz', *counts, f'{1e3 * drift:.2f} ms', *(f'{100 * each:.0f} %'
         for each in shares)) for rate, (counts, drift, shares) in zip(RATES, rows, strict=True)])
    for rate, (counts, _, _) in zip(RATES, rows, strict=True):
        if rate == RATES[0]:
            timing.require(f'states without their command at {rate:g} Hz', sum(counts[1:]), 0)
    return timing.finish()


def run(rate: float) -> tuple[list[int], float, list[float]]:
    """Return the counts, the drift [s] against the clock on the wall, and the loads of a run."""
    seen: list[tuple[float, dict[str, str]]] = []

    def look(message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == 'plant_simulator: plant':
                stamp = message.header.stamp
                seen.append((stamp.sec + stamp.nanosec * 1e-9,
                             {each.key: each.value for each in status.values}))

    with tempfile.TemporaryDirectory() as folder, Children(Path(folder)) as children:
        children.start('plant_simulator', '-p', f'publish_rate:={rate}')
        children.start('lqr_node', '-p', 'system:=aircraft')
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        try:
            node = rclpy.create_node('bench_real_time')
            node.create_subscription(DiagnosticArray, '/diagnostics', look, 10)
            wait(node, children, lambda: bool(seen) and int(seen[-1][1]['commands taken']) > rate)
            begin, before = seen[-1], loads(children)
            wait(node, children, lambda: seen[-1][0] - begin[0] > SECONDS)
            shares = [(now - then) / SECONDS
                      for now, then in zip(loads(children), before, strict=True)]
        finally:
            rclpy.shutdown()
    end = seen[-1]
    counts = [int(end[1][name]) - int(begin[1][name]) for name in COUNTS]
    simulated = [float(each[1]['simulated time [s]']) for each in (begin, end)]
    return counts, simulated[1] - simulated[0] - (end[0] - begin[0]), shares


def wait(node: Node, children: Children, condition: Callable[[], bool]) -> None:
    """Listen until a condition holds."""
    deadline = time.monotonic() + START
    while not condition():
        rclpy.spin_once(node, timeout_sec=0.2)
        children.check()
        if time.monotonic() > deadline:
            raise TimeoutError('the loop did not close')


def loads(children: Children) -> list[float]:
    """Return the processor time [s] that each node has used."""
    texts = [Path(f'/proc/{pid}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
             for pid in children.pids().values()]
    return [(int(each[11]) + int(each[12])) / os.sysconf('SC_CLK_TCK') for each in texts]


if __name__ == '__main__':
    sys.exit(main())
