# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
One loop on three hosts: discovery by multicast and by static peers, losses, delays and a cut.

The hosts are network namespaces of this machine: the plant and its observer on the first, lqr_node
on the second, trajectory_server on the third.
"""

import timing  # isort: skip - before numpy

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os
from statistics import quantiles
import sys
import time
from typing import Any

import _hosts
from _machine import Stalls, still, told
from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.msg import Command, State
from obc_ros.ros.messages import read_nanoseconds
from obc_ros.ros.service_qos import BURST
from obc_ros.srv import DesignLqr
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

RATE = 100.0      # [Hz] of the states
TIMEOUT = 0.5     # [s] without a state, or without a command, until the nodes go to rest
START = (0.1, -0.1, 0.0, 0.0, 0.0, 0.0)
BAD = {'loss': 0.05, 'delay': 0.02, 'jitter': 0.005}
GOOD = {'loss': 0.0, 'delay': 0.0, 'jitter': 0.0, 'cut': False}
CUT = 3.0         # [s]
NEAR = 0.2        # largest |x| of a stabilised plant
NODES = {
    'plant_simulator': (f'publish_rate:={RATE}', f'command_timeout:={TIMEOUT}',
                        f'x0:={list(START)}', 'noise.px:=0.003', 'noise.py:=0.003'),
    # the design accounts for the network: a period and twice its delay
    'lqr_node': (f'state_timeout:={TIMEOUT}', 'design:=sampled', f'sample_time:={1 / RATE}',
                 'delay:=0.05'),
    'trajectory_server': ('workers:=1',)}


class Watch:
    """An observer on the host of the plant: states, commands, and a client of the third host."""

    def __init__(self) -> None:
        self._context = rclpy.Context()
        self._context.init(args=[])
        self._node = rclpy.create_node('watch', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self.states: list[tuple[int, Sequence[float]]] = []
        self.commands: list[tuple[int, int]] = []
        deep = QoSProfile(depth=1000)
        self._node.create_subscription(State, 'state', self._on_state, deep)
        self._node.create_subscription(Command, 'command', self._on_command, deep)
        self._client = self._node.create_client(
            DesignLqr, 'trajectory_server/design_lqr', qos_profile=BURST)
        self.asked: list[tuple[float, Any]] = []
        self._told: dict[str, str] = {}
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_report, 10)

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _on_state(self, message: State) -> None:
        self.states.append((read_nanoseconds(message.header.stamp), message.x))

    def _on_command(self, message: Command) -> None:
        self.commands.append((read_nanoseconds(message.header.stamp), time.time_ns()))

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._told.update({each.key: each.value for each in status.values})

    def told(self, key: str) -> int:
        """Return a number in the diagnostics, limited to 1."""
        return min(1, int(float(self._told.get(key, '0'))))

    def spin(self, duration: float, ask: float = 0.0) -> None:
        """Spin for `duration` [s]; request a regulator of the third host every `ask` seconds."""
        end, due = time.monotonic() + duration, time.monotonic()
        while (now := time.monotonic()) < end:
            if ask and now >= due:
                due = now + ask
                request = DesignLqr.Request(system='aircraft')
                request.weights.qx, request.weights.qu = [1.0] * 6, [1.0] * 2
                self.asked.append((now, self._client.call_async(request)))
            self._executor.spin_once(timeout_sec=0.005)

    def finds(self, timeout: float) -> float | None:
        """Return the time [s] until commands and the server are discovered, or None."""
        begin = time.monotonic()
        while not (self.commands and self._client.service_is_ready()):
            if time.monotonic() > begin + timeout:
                return None
            self.spin(0.05)
        return time.monotonic() - begin

    def forget(self) -> None:
        """Clear the observed states and commands."""
        self.states.clear()
        self.commands.clear()

    def figures(self) -> dict[str, Any]:
        """Return the figures since `forget`."""
        sent = {stamp for stamp, _ in self.states}
        first = {stamp: at for stamp, at in reversed(self.commands) if stamp in sent}
        late = sorted((at - stamp) * 1e-6 for stamp, at in first.items()) or [0.0, 0.0]
        percent = quantiles(late, n=100) if len(late) > 1 else late * 99
        return {'states': len(self.states), 'answered': len(first) / max(1, len(sent)),
                'left': sorted(sent - set(first)),
                'median': percent[49], 'late': percent[98],
                'largest': max((max(map(abs, x)) for _, x in self.states), default=0.0)}


@contextmanager
def loop(wire: bool, **environment: str) -> Iterator[tuple[_hosts.Network, Watch]]:
    """Start three hosts with a node on each."""
    network = _hosts.Network(3, wire)
    # no shared memory: these hosts share /dev/shm
    os.environ.update(environment, FASTDDS_BUILTIN_TRANSPORTS='UDPv4')
    processes = [network.start(host, [sys.executable, '-P', '-m', f'obc_ros.nodes.{node}',
                                      '--ros-args',
                                      *(word for each in parameters for word in ('-p', each))])
                 for host, (node, parameters) in zip(network.hosts, NODES.items(), strict=True)]
    network.enter(network.hosts[0])
    watch = Watch()
    try:
        yield network, watch
    finally:
        watch.close()
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait()
        network.close()


def trial(found: dict[str, Any], name: str, watch: Watch, seconds: float) -> None:
    """Run the loop for a time and keep its figures."""
    watch.forget()
    watch.asked.clear()
    begin = time.monotonic()
    watch.spin(seconds, ask=0.2)
    figures = watch.figures()
    answered = sum(future.done() for _, future in watch.asked)
    found[name] = {**figures, 'rate': figures['states'] / (time.monotonic() - begin),
                   'requests': f'{answered} of {len(watch.asked)}'}


def without(figures: dict[str, Any], stalls: list[tuple[float, float]]) -> float:
    """Return the share of states without a command, excluding stalls of the machine."""
    ahead = time.time() - time.monotonic()   # of the monotonic clock
    left = [at for at in (stamp * 1e-9 - ahead for stamp in figures['left'])
            if not still(stalls, at, at + 1 / RATE)]
    return len(left) / max(1, figures['states'])


def clean(found: dict[str, Any], seconds: float, settle: float) -> None:
    """Measure with a network without losses: veth and a bridge."""
    for name, environment in (
            ('multicast', {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}),
            ('static peers', {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                              'ROS_STATIC_PEERS': '10.0.0.1;10.0.0.2;10.0.0.3'})):
        with loop(wire=False, **environment) as (_, watch):
            after = watch.finds(30.0)
            print(f'  by {name} the hosts discover each other in '
                  f'{"no time" if after is None else f"{after:.1f} s"}')
            timing.require(f'time of discovery by {name} [s]', after or 1e9, 20.0)
            watch.spin(settle)
            trial(found, name, watch, seconds)
            timing.require(f'{name}: states without a command', 1 - found[name]['answered'], 0.01)


def private(seconds: float) -> None:
    """Check that by default no data leaves a host."""
    os.environ.pop('ROS_STATIC_PEERS', None)
    with loop(wire=True, ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST') as (network, watch):
        found = watch.finds(seconds)
        timing.require('with LOCALHOST: UDP frames that leave a host', network.set()['udp'], 0)
        timing.require('with LOCALHOST: hosts that discover each other', found is not None, 0)


def bad(found: dict[str, Any], seconds: float, settle: float) -> None:
    """Measure with losses and delays, and with a cut."""
    with loop(wire=True, ROS_AUTOMATIC_DISCOVERY_RANGE='SUBNET') as (network, watch):
        if watch.finds(30.0) is None:
            raise SystemExit('the hosts do not discover each other')
        watch.spin(settle)
        trial(found, 'wire', watch, seconds)
        network.set(**BAD)
        trial(found, 'bad wire', watch, seconds)
        waiting = watch.asked.copy()
        counts = network.set(**{**GOOD, 'cut': True})
        print(f'  the network lost {counts["lost"]} of {2 * counts["udp"]} UDP frames')
        trial(found, 'cut', watch, CUT)
        waiting += watch.asked
        network.set(**GOOD)
        begin = time.monotonic()
        watch.forget()
        while not watch.figures()['answered'] and time.monotonic() < begin + 30.0:
            watch.spin(0.01)
        timing.require('time from the end of the cut to an answered state [s]',
                       time.monotonic() - begin, 5.0)
        watch.spin(settle)
        trial(found, 'after it', watch, seconds)
        timing.require('requests lost in the cut and with losses',
                       sum(not future.done() for _, future in waiting), 0)
        timing.require('stale states missed by lqr_node', 1 - watch.told('stale'), 0)
        timing.require('missing commands not noticed by the plant',
                       1 - watch.told('times without commands'), 0)


def main() -> int:
    """Measure and print; return the exit status."""
    why = _hosts.enter()
    args = timing.arguments(__doc__ or '', seconds=20.0, settle=10.0, clean=1)
    if why:
        print(f'  skipped: several hosts ({why})')
        return timing.finish()
    stalls, found = Stalls(), dict[str, Any]()
    if args.clean:
        clean(found, args.seconds, args.settle)
    private(4.0)
    bad(found, args.seconds, args.settle)
    timing.table(
        f'three hosts, {RATE:g} states a second, {args.seconds:g} s each',
        ('', 'states/s', 'answered', 'median [ms]', '99 % [ms]', 'largest |x|', 'requests'),
        [(name, f'{each["rate"]:.1f}', f'{each["answered"]:.4f}', f'{each["median"]:.2f}',
          f'{each["late"]:.2f}', f'{each["largest"]:.2g}', each['requests'])
         for name, each in found.items()])
    seen = stalls.end()
    print(f'  {told(seen)}')
    for name in ('bad wire', 'after it'):
        timing.require(f'{name}: largest |x|', found[name]['largest'], NEAR)
    timing.require('after it: states without a command', without(found['after it'], seen), 0.01)
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())
