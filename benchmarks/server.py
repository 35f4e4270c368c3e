# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The trajectory server under load: latency, precision of limits, many clients, many requests.

The clients are processes with ten nodes each; the server runs on an unused domain.
"""

import timing  # isort: skip - before numpy

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
import os
from pathlib import Path
from statistics import median
import subprocess
import sys
import tempfile
import time
from typing import Any, NoReturn

from _endless import endless
from _machine import children
from obc_ros.action import SolveOptimalControl
from obc_ros.cli.client import Client
from obc_ros.cli.processes import APPEARS, Children, isolate, reserve_domain
from obc_ros.core.ocp.statement import build_problem
from obc_ros.msg import LqrWeights
from obc_ros.ros import messages
from obc_ros.ros.service_qos import BURST
from obc_ros.srv import DesignLqr
from obc_ros.srv import SolveOptimalControl as Solve
from obc_ros.workers import requests
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor

PROCESSES, NODES, EACH = 10, 10, 20  # processes, clients in each, and requests of each client
IN_A_ROW = 10_000
WARM = 1_000                         # requests without growth of the memory
PROMISE = 0.2                        # [s] tolerance of time limits and cancellations
REPEATS = 9


def regulator() -> DesignLqr.Request:
    """Return the request for the regulator of a double integrator."""
    return DesignLqr.Request(a=[0.0, 1.0, 0.0, 0.0], b=[0.0, 1.0],
                             weights=LqrWeights(qx=[1.0, 0.0], qu=[1.0]))


def scalar() -> Solve.Request:
    """Return the request for Example 2.2."""
    return request({
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'x + u'},
        'running_cost': 'u**2/2', 'terminal_cost': 'x**2/2', 'initial_state': {'x': 1},
        'final_time': {'free': False, 'value': 1}})


def request(mapping: dict[str, Any]) -> Solve.Request:
    """Return the request for the problem of a statement."""
    problem = build_problem(mapping)
    return Solve.Request(problem=messages.build_problem_message(mapping, problem.guess))


class Caller:
    """A client of one service that calls it repeatedly."""

    def __init__(self, client: Client, service: Any, name: str, asked: Any) -> None:
        self._client, self._asked = client, asked
        self._service = client.node.create_client(service, f'{client.server}/{name}')
        client.wait(self._service.service_is_ready, lambda: True)

    def __call__(self) -> Any:
        """Return the response to the request."""
        future = self._service.call_async(self._asked)
        self._client.wait(future.done, lambda: True)
        return future.result()


def latency(client: Client) -> None:
    """Compare a design with the shortest service call, and a solve with a solve in process."""
    asked = GetParameters.Request(names=['workers'])
    design = Caller(client, DesignLqr, 'design_lqr', regulator())
    plain = messages.read_request('solve', scalar())
    plain.plain['cache_size'] = 8
    solve = Caller(client, Solve, 'solve', scalar())

    def in_process() -> object:
        return requests.answer('solve', plain, 60.0, lambda *_: False)

    times = timing.measure({
        'get_parameters (baseline)': Caller(client, GetParameters, 'get_parameters', asked),
        'design_lqr': design, 'solve': solve, 'the same solve in process': in_process,
    }, clock=time.perf_counter, least=0.1)
    timing.times_table('one request after another', times, 'get_parameters (baseline)')


def precision(client: Client) -> None:
    """Measure the delays of time limits and of cancellations."""
    late = []
    for _ in range(REPEATS):
        asked = request(endless())
        asked.time_limit = 0.5
        begun = time.monotonic()
        response = Caller(client, Solve, 'solve', asked)()
        late.append(time.monotonic() - begun - asked.time_limit)
        assert response.status == 'timed_out', response.message
    cancelled = [cancel(client) for _ in range(REPEATS)]
    timing.table('precision', ('', 'median', 'most'), [
        (name, f'{median(values):.3f} s', f'{max(values):.3f} s')
        for name, values in (('delay of the time limit', late), ('cancelled after', cancelled))])
    timing.require('delay of the time limit [s]', max(late), PROMISE)
    timing.require('cancelled after [s]', max(cancelled), PROMISE)


def cancel(client: Client) -> float:
    """Return the time [s] to cancel a solve that has begun."""
    action = ActionClient(
        client.node, SolveOptimalControl, f'{client.server}/solve_optimal_control')
    client.wait(action.server_is_ready, lambda: True)
    heard: list[Any] = []
    sent = action.send_goal_async(
        SolveOptimalControl.Goal(problem=request(endless()).problem), heard.append)
    client.wait(lambda: any(each.feedback.phase != 'queued' for each in heard), lambda: True)
    result = sent.result().get_result_async()
    begun = time.monotonic()
    sent.result().cancel_goal_async()
    client.wait(result.done, lambda: True)
    took = time.monotonic() - begun
    action.destroy()
    return took


def crowd() -> None:
    """Have a hundred clients send requests at once; each must get all responses."""
    begun = time.monotonic()
    clients = [subprocess.Popen([sys.executable, __file__, '--client'], stdout=subprocess.PIPE,
                                text=True) for _ in range(PROCESSES)]
    waits: list[float] = []
    for client in clients:
        waits += map(float, client.communicate(timeout=600.0)[0].split())
    count = PROCESSES * NODES * EACH
    waits.sort()
    timing.table(f'{PROCESSES * NODES} clients at once, {EACH} requests each', (
        'answered', 'median', '99 %', 'all in'), [(
            f'{len(waits)} of {count}', f'{median(waits):.3f} s',
            f'{waits[len(waits) * 99 // 100]:.3f} s', f'{time.monotonic() - begun:.1f} s')])
    timing.require('requests without response', count - len(waits), 0)


def be_client() -> NoReturn:
    """Send requests as ten clients at once, and print the time of each response."""
    rclpy.init()
    executor = SingleThreadedExecutor()
    asked: list[Callable[[], Any]] = []
    for index in range(NODES):
        node = rclpy.create_node(f'client_{index}')
        executor.add_node(node)
        for service, name, question in ((DesignLqr, 'design_lqr', regulator()),
                                        (Solve, 'solve', scalar())):
            client = node.create_client(service, f'/trajectory_server/{name}', qos_profile=BURST)
            client.wait_for_service()
            asked.append(partial(client.call_async, question))
    for turn in range(EACH):
        begun = time.monotonic()
        futures = [ask() for ask in asked[turn % 2::2]]
        took: dict[int, float] = {}
        while len(took) < len(futures) and time.monotonic() - begun < 60.0:
            executor.spin_once(timeout_sec=1.0)
            for index, future in enumerate(futures):
                if future.done() and index not in took and future.result().success:
                    took[index] = time.monotonic() - begun
        print(*took.values(), flush=True)
    os._exit(0)  # a node that leaves with others blocks for ever once in some 100 cases


def endurance(client: Client, server: int) -> None:
    """Send ten thousand requests in a row; memory must not grow and no process may remain."""
    design = Caller(client, DesignLqr, 'design_lqr', regulator())
    solve = Caller(client, Solve, 'solve', scalar())
    begun, unanswered, memory = time.monotonic(), 0, []
    for index in range(IN_A_ROW):
        unanswered += not (design if index % 10 else solve)().success
        if index % WARM == WARM - 1:
            memory.append(sum(map(resident, family(server))))
    timing.table(f'{IN_A_ROW} requests in a row', ('all in', 'memory after each thousand [MB]'), [
        (f'{time.monotonic() - begun:.0f} s', ' '.join(f'{each:.0f}' for each in memory))])
    timing.require('requests without response', unanswered, 0)
    timing.require('growth of memory after the first thousand', memory[-1] / memory[0] - 1.0, 0.05)
    timing.require('processes beyond the server and its workers', len(family(server)) - 4, 0)


def family(server: int) -> list[int]:
    """Return the process ids of the server and its children."""
    return [server, *children(server)]


def resident(pid: int) -> float:
    """Return the resident memory [MB] of a process."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * 4096 / 1e6


def main() -> int:
    """Measure and print; return 0 if all requirements hold."""
    timing.arguments(__doc__)
    with ExitStack() as stack:
        isolate(stack.enter_context(reserve_domain()))
        children = stack.enter_context(Children(Path(stack.enter_context(
            tempfile.TemporaryDirectory()))))
        children.start('trajectory_server')
        context = rclpy.Context()
        rclpy.init(args=[], context=context)
        client = Client(context, children.check)
        client.find(APPEARS)
        latency(client)
        precision(client)
        crowd()
        endurance(client, children.pids()['trajectory_server'])
        client.close()
    return timing.finish()


if __name__ == '__main__':
    if '--client' in sys.argv:
        be_client()
    sys.exit(main())
