# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A crowd of clients at one trajectory_server, then one client with many requests in a row.

Each client asks for a regulator or a trajectory, and asks again when it has its answer. Every
answer is compared with the closed form; none may be lost, and the memory stays flat.
"""

import timing  # isort: skip - before numpy

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
import math
from statistics import quantiles
import subprocess
import sys
import time
from typing import Any

from _machine import children, memory, Stalls, told, zombies
from obc_ros.cli.processes import free_domain, isolate
from obc_ros.msg import FinalTime, NamedExpression, OptimalControlProblem
from obc_ros.nodes.crowds import BURST
from obc_ros.srv import DesignLqr, SolveOptimalControl
import rclpy
from rclpy.executors import SingleThreadedExecutor

DESIGN, SOLVE = 'design_lqr', 'solve'
TYPES = {DESIGN: DesignLqr, SOLVE: SolveOptimalControl}
GROWTH = 1.05   # memory at the end against that after a tenth of the requests
PATIENCE = 60.0  # [s] without any answer: the rest is lost


def design(k: int) -> DesignLqr.Request:
    """Return the request for dx/dt = x + u with the weight k: K = 1 + sqrt(1 + k)."""
    request = DesignLqr.Request(a=[1.0], b=[1.0])
    request.weights.qx, request.weights.qu = [float(k)], [1.0]
    return request


def transfer(k: int) -> SolveOptimalControl.Request:
    """Return the least effort from rest at 0 to rest at k in 1 s: its cost is 12 k^2."""
    expressions = {'p': 'v', 'v': 'u'}
    return SolveOptimalControl.Request(problem=OptimalControlProblem(
        states=['p', 'v'], inputs=['u'], running_cost='u**2', final_time=FinalTime(value='1'),
        dynamics=[NamedExpression(name=n, expression=e) for n, e in expressions.items()],
        initial_state=[NamedExpression(name=n, expression='0') for n in expressions],
        terminal_constraints=[f'p - {k}', 'v']))


def is_right(kind: str, k: int, answer: Any) -> bool:
    """Return whether an answer is that of the closed form."""
    if not answer.success:
        return False
    if kind == DESIGN:
        return math.isclose(answer.design.k[0], 1.0 + math.sqrt(1.0 + k), rel_tol=1e-9)
    return math.isclose(answer.objective, 12.0 * k**2, rel_tol=1e-6)


class Crowd:
    """Clients of one server."""

    def __init__(self, node: Any, clients: int, kind: str) -> None:
        self._node, self._kind = node, kind
        self._clients = [node.create_client(
            TYPES[kind], f'/trajectory_server/{kind}', qos_profile=BURST)
            for _ in range(clients)]
        self._numbers = count(1)
        self.latencies: list[float] = []
        self.outcomes: Counter[str] = Counter()

    def close(self) -> None:
        """Destroy the clients."""
        for client in self._clients:
            self._node.destroy_client(client)

    def run(self, executor: SingleThreadedExecutor, requests: int, pid: int) -> list[float]:
        """Ask until all requests are answered, or none is any more; return memory [MiB]."""
        while not all(client.service_is_ready() for client in self._clients):
            executor.spin_once(timeout_sec=0.1)
        self._left = requests
        for client in self._clients:
            self._ask(client)
        sizes, seen, last = [], -1, time.monotonic()
        while (done := self.outcomes.total()) < requests:
            executor.spin_once(timeout_sec=0.1)
            if done != seen:
                seen, last = done, time.monotonic()
                if done % max(1, requests // 100) == 0:
                    sizes.append(sum(map(memory, (pid, *children(pid)))))
            elif time.monotonic() > last + PATIENCE:
                break
        self.outcomes['lost'] += requests - self.outcomes.total()
        return sizes

    def _ask(self, client: Any) -> None:
        if not self._left:
            return
        self._left -= 1
        k, begin = next(self._numbers) % 100 + 1, time.monotonic()
        future = client.call_async((design if self._kind == DESIGN else transfer)(k))

        def on_answer(future: Any) -> None:
            self.latencies.append(time.monotonic() - begin)
            right = is_right(self._kind, k, future.result())
            self.outcomes['right' if right else 'wrong'] += 1
            self._ask(client)

        future.add_done_callback(on_answer)


@contextmanager
def server() -> Iterator[tuple[Any, SingleThreadedExecutor, int]]:
    """Run a server and a node beside it."""
    with free_domain() as domain:
        isolate(domain)
        process = subprocess.Popen(
            [sys.executable, '-m', 'obc_ros.nodes.trajectory_server', '--ros-args',
             '-p', 'workers:=2', '-p', 'queue_length:=1000'],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        rclpy.init()
        node = rclpy.create_node('crowd')
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        try:
            yield node, executor, process.pid
        finally:
            executor.shutdown()
            node.destroy_node()
            rclpy.shutdown()
            process.terminate()
            process.wait()


def main() -> int:
    """Measure and report."""
    args = timing.arguments(__doc__ or '', clients=100, requests=10_000)
    trials = [(args.clients, DESIGN, args.requests), (args.clients, SOLVE, args.requests // 5),
              (1, DESIGN, args.requests), (1, SOLVE, args.requests // 5)]
    rows, stalls = [], Stalls()
    with server() as (node, executor, pid):
        for clients, kind, requests in trials:
            crowd, begin = Crowd(node, clients, kind), time.monotonic()
            sizes = crowd.run(executor, requests, pid)
            elapsed = time.monotonic() - begin
            crowd.close()
            early, late = sizes[len(sizes) // 10], sizes[-1]
            percent = quantiles(crowd.latencies, n=100)
            name = f'{clients} clients, {kind}'
            rows.append((name, requests, crowd.outcomes['right'], f'{requests / elapsed:.0f}',
                         f'{1e3 * percent[49]:.1f}', f'{1e3 * percent[98]:.1f}',
                         f'{early:.0f}', f'{late:.0f}'))
            timing.require(f'{name}: lost', crowd.outcomes['lost'], 0)
            timing.require(f'{name}: wrong', crowd.outcomes['wrong'], 0)
            timing.require(f'{name}: growth of memory', late / early, GROWTH)
        timing.require('zombies', len(zombies(children(pid))), 0)
    timing.table('one trajectory_server, two workers', (
        '', 'requests', 'right', 'answers/s', 'latency 50 % [ms]', '99 % [ms]',
        'MiB early', 'MiB late'), rows)
    print(f'  {told(stalls.end())}')
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())
