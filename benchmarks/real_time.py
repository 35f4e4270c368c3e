# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The aircraft and its controller in real time over DDS: missed commands, drift, processor load.

The figures are those of this machine under its present load. Both nodes are on one core, of which
they use less than half: a stall of the core delays both and leaves no state without its command. A
timer on each core measures the stalls of the machine. Stalls, due to other programs or to the host
of a virtual machine, delay commands whatever the nodes do. So the run at 200 Hz is repeated until
the machine was idle, at most `TRIES` times.

The part of the machine at 1 kHz is measured before and after the run: by a timer of the same
priority on the core of the nodes, without the nodes, and by the time that the host of a virtual
machine reports as stolen from that core.

The counts begin at `SETTLE`. Before, the processes discover each other and this one, and Fast DDS
may block a sender for 0.333 s when it opens the shared memory of a new process (Fast DDS issue
6535). ``--newcomers N`` measures this delay instead: N processes join the loop in turn. With
``--udp 1`` no shared memory is used, in a network namespace of its own.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import os
from pathlib import Path
import subprocess
import tempfile
import time

from _hosts import enter, udp_only
from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.cli.processes import Children, isolate, reserve_domain
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

RUNS = ((200.0, 10.0, 0), (1000.0, 60.0, 50))  # [Hz], [s], priority (0: an ordinary process)
START = 30.0             # [s] for the loop to close
SETTLE = 5.0             # [s] before the counts begin
STAY = 5.0               # [s] that a new process stays
HELD = 0.2               # [s] without a command: longer than the delay by the start of a process
TRIES = 5
TICK = 0.001             # [s] period of the timers
FLOOR = 10.0             # [s] duration of the timers before and after a run
IDLE = 0.0025            # [s] largest delay of the timers on an idle machine
MOST_LATE = 0.001        # largest share of the states at 1 kHz that are late by more than a period
COUNTS = ('states published', 'states unanswered', 'times held up')

# A timer that runs until its input ends; it prints delays of more than a period.
TIMER = """
import os, select, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
if priority := int(sys.argv[3]):
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
while True:
    tick = float(sys.argv[2])
    due = time.monotonic() + tick
    if select.select([sys.stdin], [], [], tick)[0]:
        break
    late = time.monotonic() - due
    if late > tick:
        print(late)
"""


# Joins the domain until its input ends.
NEWCOMER = """
import sys, rclpy
rclpy.init()
node = rclpy.create_node('newcomer')
sys.stdin.read()
rclpy.shutdown()
"""

Report = tuple[float, dict[str, str]]  # stamp [s], diagnostics of the plant


@dataclass(frozen=True)
class Run:
    """The figures of a run."""

    rate: float
    priority: int
    published: int
    unanswered: int
    held_up: int
    drift: float
    loads: list[float]
    late: list[float]  # [s] delays of the timers over a period
    ticks: int
    stolen: float  # share of the nodes' core

    @property
    def stalls(self) -> list[float]:
        """Return the durations [s] of the stalls of the machine."""
        return [each for each in self.late if each > IDLE]

    def row(self) -> tuple[str, ...]:
        """Return the run as a row of the table."""
        longest = f'{1e3 * max(self.stalls):.1f} ms' if self.stalls else '-'
        return (f'{self.rate:g} Hz', str(self.priority), str(self.published), str(self.unanswered),
                str(self.held_up), f'{1e3 * self.drift:.2f} ms',
                *(f'{100 * each:.0f} %' for each in self.loads), str(len(self.stalls)), longest,
                f'{100 * sum(self.late) / TICK / self.ticks:.2f} %')


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments('the loop in real time over DDS', newcomers=0, udp=0)
    if args.udp and (fault := enter()):
        raise SystemExit(fault)
    runs = []
    with reserve_domain() as domain:
        isolate(domain)
        if args.udp:
            udp_only()
        slow, fast = RUNS
        if args.newcomers:
            return join(slow[0], args.newcomers)
        while len(runs) < TRIES and not (runs and not runs[-1].stalls):
            runs.append(run(*slow))
        before = floor(fast[0], fast[2])
        runs.append(run(*fast))
        after = floor(fast[0], fast[2])
    timing.table(f'Aircraft and lqr_node in real time; the machine has stalled when timers '
                 f'were over {1e3 * IDLE:g} ms late', (
                     'rate', 'priority', 'published', 'unanswered', 'held up', 'drift', 'plant',
                     'lqr_node', 'stood still', 'longest', 'timers late'),
                 [each.row() for each in runs])
    shares = [before, (runs[-1].unanswered / runs[-1].published, runs[-1].stolen), after]
    timing.table(f'Late by more than a period at {fast[0]:g} Hz, priority {fast[2]}', (
        'on one core', 'late', 'stolen by the host'),
        [(name, *(f'{100 * each:.3f} %' for each in pair)) for name, pair in zip(
            ('a timer before', 'the states of the loop', 'a timer after'), shares,
            strict=True)])
    if runs[-2].stalls:
        print(f'  the machine was not idle for {slow[1]:g} s in {TRIES} tries')
    timing.require(f'states without their command at {slow[0]:g} Hz', runs[-2].unanswered, 0)
    timing.require(f'share of states not answered within a period at {fast[0]:g} Hz',
                   runs[-1].unanswered / runs[-1].published, MOST_LATE)
    return timing.finish()


def run(rate: float, seconds: float, priority: int) -> Run:
    """Run the loop in real time and count."""
    with flight(rate, priority) as (watch, children), bare_timers() as late:
        before, taken = loads(children), stolen()
        begin, end = watch(seconds)
        taken = (stolen() - taken) / seconds
        shares = [(now - then) / seconds
                  for now, then in zip(loads(children), before, strict=True)]
    counts = [int(end[1][name]) - int(begin[1][name]) for name in COUNTS]
    simulated = [float(each[1]['simulated time [s]']) for each in (begin, end)]
    drift = simulated[1] - simulated[0] - (end[0] - begin[0])
    return Run(rate, priority, *counts, drift, shares, late,
               round(seconds / TICK) * len(os.sched_getaffinity(0)), taken)


def floor(rate: float, priority: int) -> tuple[float, float]:
    """Return the share of late ticks of a timer, and the share of stolen processor time."""
    before = stolen()
    with bare_timers([max(os.sched_getaffinity(0))], 1.0 / rate, priority) as late:
        time.sleep(FLOOR)
    return len(late) / (rate * FLOOR), (stolen() - before) / FLOOR


def stolen() -> float:
    """Return the time [s] that the host has stolen from the core of the nodes."""
    name = f'cpu{max(os.sched_getaffinity(0))} '
    lines = Path('/proc/stat').read_text(encoding='ascii').splitlines()
    line = next(each for each in lines if each.startswith(name))
    return int(line.split()[8]) / os.sysconf('SC_CLK_TCK')


def join(rate: float, count: int) -> int:
    """Let processes join the loop in turn, and print the delay that each causes."""
    lost = []
    with flight(rate, 0) as (watch, _):
        for _ in range(count):
            newcomer = subprocess.Popen([sys.executable, '-c', NEWCOMER], stdin=subprocess.PIPE)
            try:
                begin, end = watch(STAY)
            finally:
                newcomer.communicate(b'')
            lost.append((int(end[1][COUNTS[1]]) - int(begin[1][COUNTS[1]])) / rate)
    held = [each for each in lost if each > HELD]
    print(f'\n{count} newcomers: states unanswered for {sum(lost) / count:.3f} s on average, for '
          f'over {HELD:g} s by {len(held)}, at most {max(lost):.3f} s')
    return timing.finish()


@contextmanager
def flight(rate: float, priority: int) -> Iterator[
        tuple[Callable[[float], tuple[Report, Report]], Children]]:
    """Run both nodes on one core; yield a function for reports of an interval, and the nodes."""
    seen: list[Report] = []

    def look(message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == 'plant_simulator: plant':
                stamp = message.header.stamp
                seen.append((stamp.sec + stamp.nanosec * 1e-9,
                             {each.key: each.value for each in status.values}))

    def watch(seconds: float) -> tuple[Report, Report]:
        begin = seen[-1]
        wait(node, children, lambda: seen[-1][0] - begin[0] > seconds - 0.5, seconds)
        return begin, seen[-1]

    with tempfile.TemporaryDirectory() as folder, Children(Path(folder)) as children:
        pace = ['-p', f'priority:={priority}']
        with on_one_core():
            children.start('plant_simulator', *pace, '-p', f'publish_rate:={rate}')
            children.start('lqr_node', *pace)
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        try:
            node = rclpy.create_node('bench_real_time')
            node.create_subscription(DiagnosticArray, '/diagnostics', look, 10)
            wait(node, children, lambda: bool(seen) and int(seen[-1][1]['commands taken']) > rate)
            watch(SETTLE)
            yield watch, children
        finally:
            rclpy.shutdown()


@contextmanager
def on_one_core() -> Iterator[None]:
    """Run child processes on one core, as `taskset` does."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


@contextmanager
def bare_timers(cores: Iterable[int] = (), tick: float = TICK, priority: int = 0
                ) -> Iterator[list[float]]:
    """Yield a list that afterwards has the delays [s] of timers on each core."""
    late: list[float] = []
    timers = [subprocess.Popen(
        [sys.executable, '-c', TIMER, str(core), str(tick), str(priority)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for core in cores or sorted(os.sched_getaffinity(0))]
    try:
        yield late
    finally:
        for timer in timers:
            late += map(float, timer.communicate('')[0].split())


def wait(node: Node, children: Children, condition: Callable[[], bool],
         seconds: float = 0.0) -> None:
    """Spin until a condition holds."""
    deadline = time.monotonic() + START + seconds
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
