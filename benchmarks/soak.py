# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Two loops at 200 Hz for ``--seconds`` (1800 for half an hour), tuned continuously.

With ``--pace 2`` changes, requests and kills are twice as frequent.

In the steady loop no process ends: its memory must not grow, and every request and every change
must get the correct response, none a rejection for lack of time. In the troubled loop a process is
killed every few seconds and started again: the loop must be complete within the time of a few
announcements and of a few starts of a bare node, which are timed beside the two loops, without
counting stalls of the machine. No process may remain.
"""

import timing  # isort: skip - before numpy

from collections import Counter
from collections.abc import Callable
import itertools
import os
import random
import signal
from statistics import median
import subprocess
import sys
from threading import Thread
import time
from typing import Any

from _machine import children, memory, Stalls, still, told, zombies
from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.cli.processes import die_with_parent, isolate, reserve_domain
from obc_ros.msg import Command
from obc_ros.ros.service_qos import BURST
from obc_ros.srv import DesignLqr
from rcl_interfaces.srv import SetParametersAtomically
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

RATE = 200.0
NODES = {
    'plant_simulator': ('-p', f'publish_rate:={RATE}', '-p', 'command_timeout:=0.5',
                        '-p', 'noise.px:=0.001'),
    'lqr_node': ('-p', 'state_timeout:=0.3'),
    'trajectory_server': ('-p', 'workers:=1')}
VICTIMS = ('worker', None, *NODES)  # None: a bare node is started beside the loops
BARE = "import rclpy; rclpy.init(); rclpy.create_node('bare')"  # the least that a node does
CHANGE, ASK, KILL, LOOK = 0.25, 0.05, 5.0, 1.0  # [s] periods
BACK = 3.0       # [s] until a loop is complete again: three announcements of each participant,
STARTS = 4.0     # and as many starts of a bare node
GROWTH = 1.03    # factor of the memory of a process, from a fifth of the time on
MOST = 20        # requests under way; a client that floods an overloaded server measures nothing
TOLD = 3         # incorrect responses of each kind that are printed in full
UNANSWERED = 0.03  # share of states of the steady loop; a process that starts takes the processor


def start(*arguments: str) -> subprocess.Popen[bytes]:
    """Start Python. Linux shares the processor among sessions: all nodes get equal shares."""
    return subprocess.Popen(
        [sys.executable, '-P', *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True, preexec_fn=die_with_parent)


class Loop:
    """The three nodes in a namespace."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        for node in NODES:
            self.start(node)

    def start(self, node: str) -> None:
        """Start a node, in place of one that has ended."""
        self.running[node] = start('-m', f'obc_ros.nodes.{node}', '--ros-args', '-r',
                                   f'__ns:=/{self.name}', *NODES[node])

    def kill(self, victim: str) -> None:
        """Kill a node and start it again, or the workers of the server, which restarts them."""
        if victim == 'worker':
            for pid in children(self.running['trajectory_server'].pid):
                os.kill(pid, signal.SIGKILL)
            return
        self.running[victim].kill()
        self.running[victim].wait()
        self.start(victim)

    def end(self) -> list[str]:
        """End the nodes; return those that did not end on SIGINT with status 0."""
        for process in self.running.values():
            process.send_signal(signal.SIGINT)
        wrong = []
        for node, process in self.running.items():
            try:
                wrong += [node] if process.wait(5.0) else []
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                wrong.append(node)
        return wrong


class Soak:
    """The process that tunes, sends requests, kills processes and measures."""

    def __init__(self, seed: int = 1) -> None:
        self._node = rclpy.create_node('soak')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._draw = random.Random(seed)
        self.steady, self.troubled = Loop('steady'), Loop('troubled')
        self.counts: Counter[str] = Counter()
        self.open: Counter[str] = Counter()  # requests without a response
        self.told: dict[tuple[str, str], float] = {}
        self.sizes: dict[str, list[float]] = {node: [] for node in NODES}
        self.back: list[tuple[float, float]] = []  # when the loop was broken and complete again
        self.starts: list[float] = []  # durations [s] of the starts of a bare node
        self.wrong: list[str] = []
        self._ended: dict[int, float] = {}  # zombies, and since when
        self._killed = self._heard = 0.0
        self._victims = itertools.cycle(VICTIMS)
        node = self._node
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_report, 1000)
        node.create_subscription(Command, '/troubled/command', self._on_command, 10)
        self._tuner = node.create_client(
            SetParametersAtomically, '/steady/lqr_node/set_parameters_atomically',
            qos_profile=BURST)
        self._designer = node.create_client(
            DesignLqr, '/steady/trajectory_server/design_lqr', qos_profile=BURST)

    def close(self) -> list[str]:
        """End all; return the nodes that did not end correctly."""
        wrong = [f'{loop.name}/{node}' for loop in (self.steady, self.troubled)
                 for node in loop.end()]
        self._executor.shutdown()
        self._node.destroy_node()
        return wrong

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.partition(':')[0]
            for each in status.values:
                if each.value.replace('.', '', 1).isdigit():
                    self.told[name, each.key] = float(each.value)

    def _on_command(self, message: Command) -> None:
        # the first command for a state, not one of rest, ends the outage
        now = time.monotonic()
        if self._killed and now > self._killed + 0.05 and now - self._heard < 0.02:
            self.back.append((self._killed, now))
            self._killed = 0.0
        self._heard = now

    def ready(self) -> None:
        """Wait until both loops are closed."""
        deadline = time.monotonic() + 60.0
        while not (self._tuner.service_is_ready() and self._designer.service_is_ready()
                   and self._heard and self.told.get(('steady/lqr_node', 'rate [Hz]'))):
            self._executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > deadline:
                raise SystemExit('the loops do not start')

    def run(self, seconds: float, pace: float) -> None:
        """Perform the actions, each with its period over `pace`."""
        duties: list[tuple[float, Callable[[], None]]] = [
            (CHANGE / pace, self._change), (ASK / pace, self._ask), (KILL / pace, self._kill),
            (LOOK, self._look)]
        begin = time.monotonic()
        due = [begin + period for period, _ in duties]
        while (now := time.monotonic()) < begin + seconds:
            for k, (period, act) in enumerate(duties):
                if now >= due[k]:
                    due[k] = max(due[k] + period, now)
                    act()
            self._executor.spin_once(timeout_sec=max(0.0, min(due) - time.monotonic()))
        end = time.monotonic() + 10.0
        while (self.open.total() or self._killed) and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.1)
        if self._killed:
            self.back.append((self._killed, time.monotonic()))

    def _send(self, client: Any, request: Any, right: Callable[[Any], bool], what: str) -> None:
        if self.open[what] >= MOST:
            self.counts['held back'] += 1
            return
        self.open[what] += 1
        self.counts[what] += 1

        def on_answer(future: Any) -> None:
            self.open[what] -= 1
            answer = future.result()
            if not right(answer):
                kind = 'refused' if 'the queue is full' in str(answer) else 'wrong'
                self.counts[kind] += 1
                if self.counts[kind] <= TOLD:
                    self.wrong.append(f'{what}, {kind}: {request}: {answer}'[:1000])

        client.call_async(request).add_done_callback(on_answer)

    def _change(self) -> None:
        refused = self._draw.random() < 0.2
        values = [10.0 ** self._draw.uniform(-1.0, 1.0) for _ in range(6)]
        values[0] *= -1.0 if refused else 1.0
        request = SetParametersAtomically.Request(
            parameters=[Parameter('Qx', value=values).to_parameter_msg()])
        self._send(self._tuner, request,
                   lambda answer: answer.result.successful != refused, 'changes')

    def _ask(self) -> None:
        weight = self._draw.uniform(0.1, 10.0)
        request = DesignLqr.Request(a=[1.0], b=[1.0])
        request.weights.qx, request.weights.qu = [weight], [1.0]
        wanted = 1.0 + (1.0 + weight) ** 0.5
        self._send(self._designer, request, lambda answer: answer.success and abs(
            answer.design.k[0] - wanted) < 1e-9 * wanted, 'requests')

    def _kill(self) -> None:
        if self._killed:  # it is not complete yet
            return
        victim = next(self._victims)
        if victim is None:
            Thread(target=self._start_bare).start()
            return
        self.counts['kills'] += 1
        self.troubled.kill(victim)
        self._killed = time.monotonic() if victim in ('plant_simulator', 'lqr_node') else 0.0

    def _start_bare(self) -> None:
        begin = time.monotonic()
        start('-c', BARE).wait()
        self.starts.append(time.monotonic() - begin)

    def _look(self) -> None:
        for node, process in self.steady.running.items():
            self.sizes[node].append(memory(process.pid))
        ours = [os.getpid(), *(process.pid for loop in (self.steady, self.troubled)
                               for process in loop.running.values())]
        now = time.monotonic()
        left = zombies(pid for each in ours for pid in children(each))
        self._ended = {pid: self._ended.get(pid, now) for pid in left}
        self.counts['zombies'] += any(now - since > 10.0 for since in self._ended.values())


def report(soak: Soak, args: Any, stalls: list[tuple[float, float]], left: list[str]) -> None:
    """Print the figures and the requirements."""
    counts = soak.counts
    published = soak.told['steady/plant_simulator', 'states published']
    unanswered = soak.told['steady/plant_simulator', 'states unanswered']
    back = max((end - begin for begin, end in soak.back), default=0.0)
    moving = max((end - begin - still(stalls, begin, end) for begin, end in soak.back),
                 default=0.0)
    bare = median(soak.starts)
    timing.table(f'two loops at {RATE:g} Hz for {args.seconds:g} s', ('', ''), [
        ('states of the steady loop', f'{published:.0f}'),
        ('without a command', f'{unanswered:.0f}'),
        ('times held up', f'{soak.told["steady/plant_simulator", "times held up"]:.0f}'),
        ('changes of weights, a fifth of them to be rejected', counts['changes']),
        ('requests', counts['requests']),
        ('requests held back, as many were under way', counts['held back']),
        *((f'memory of {node} [MiB]', f'{sizes[len(sizes) // 5]:.1f} to {sizes[-1]:.1f}')
          for node, sizes in soak.sizes.items()),
        ('kills in the troubled loop', counts['kills']),
        ('longest time until it was complete again [s]', f'{back:.2f}'),
        ('the same without stalls of the machine [s]', f'{moving:.2f}'),
        ('start of a bare node beside it [s]', f'{bare:.2f}')])
    print(f'  {told(stalls)}')
    print(*(f'  {each}' for each in soak.wrong), sep='\n')
    timing.require('incorrect responses', counts['wrong'], 0)
    timing.require('requests rejected for lack of time', counts['refused'], 0)
    for what in ('requests', 'changes'):
        timing.require(f'{what} without a response', soak.open[what], 0)
    timing.require('share of states without a command', unanswered / published,
                   args.unanswered)
    timing.require('time until the troubled loop is complete [s]', moving,
                   args.back + STARTS * bare)
    timing.require('zombie processes', counts['zombies'], 0)
    for node, sizes in soak.sizes.items():
        timing.require(f'growth of {node}', sizes[-1] / sizes[len(sizes) // 5], GROWTH)
    timing.require(f'nodes that did not end correctly {left}', len(left), 0)


def main() -> int:
    """Run the test and print; return the exit status."""
    args = timing.arguments(
        __doc__ or '', seconds=60.0, pace=1.0, unanswered=UNANSWERED, back=BACK)
    with reserve_domain() as domain:
        isolate(domain)
        rclpy.init()
        soak = Soak()
        try:
            soak.ready()
            stalls = Stalls()
            soak.run(args.seconds, args.pace)
            stood = stalls.end()
        finally:
            left = soak.close()
            rclpy.shutdown()
    report(soak, args, stood, left)
    status = timing.finish()
    print(f'the soak {"FAILS" if status else "holds"}')
    return status


if __name__ == '__main__':
    sys.exit(main())
