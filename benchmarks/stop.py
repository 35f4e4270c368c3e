# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Time from a request of ``~/stop`` to the input at rest and to the response, over DDS.

Both controllers are stopped during each request that takes long: a change of weights, a trial
design, suggested weights, a reference of many samples, an activation, a plan to be executed; and,
as the floor, during none. ``--stops N`` sets how often each is stopped. The figures are those of
this machine under its present load.
"""

from collections.abc import Callable
from pathlib import Path
import random
import sys
import tempfile
import time
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
from obc_ros.cli.processes import Children, isolate, reserve_domain
from obc_ros.msg import Command, State, Trajectory
from obc_ros.srv import PlanMotion, SuggestWeights, TryDesign
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

STOPS = 200
RATE = 50.0                                # [Hz] of the states
X = [0.05, 0.02, 0.0, 0.0, 0.0, 0.0]       # off the set point: the law does not command rest
REST = np.array([0.0, 4.0 * 9.8])
PATIENCE = 60.0                            # [s]
ALLOWED = 0.02                             # [s] at the 99th percentile
LIMITS = '[-20.0, 20.0, 0.0, 80.0]'


class Bench:
    """A source of states around a controller, and its services."""

    def __init__(self, name: str) -> None:
        self.node = rclpy.create_node('stop_bench')
        self._name, self._count = name, 0
        self.is_active = True
        self.commands: list[tuple[float, np.ndarray]] = []
        self._states = self.node.create_publisher(State, 'state', 1)
        self._references = self.node.create_publisher(Trajectory, 'reference', QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        self.node.create_subscription(Command, 'command', self._take, 10)
        self.node.create_timer(1.0 / RATE, self._send)
        self._clients: dict[str, Any] = {}

    def _send(self) -> None:
        message = State(x=X)
        message.header.stamp = self.node.get_clock().now().to_msg()
        self._states.publish(message)

    def _take(self, message: Command) -> None:
        self.commands.append((time.monotonic(), np.array(message.u)))

    def spin_until(self, condition: Callable[[], Any], what: str) -> None:
        """Spin until a condition holds."""
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(what)
            rclpy.spin_once(self.node, timeout_sec=0.005)

    def ask(self, kind: Any, name: str, request: Any = None) -> Any:
        """Send a request; return the future. A name without a node is of the controller."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(
                kind, f'/{name}' if '/' in name else f'/{self._name}/{name}')
            self.spin_until(self._clients[name].service_is_ready, name)
        return self._clients[name].call_async(request or kind.Request())

    def is_following(self) -> bool:
        """Return whether the last command is one of the law."""
        return bool(self.commands) and np.abs(self.commands[-1][1] - REST).max() > 1e-3

    def stop(self) -> tuple[float, float]:
        """
        Stop the loop; return the times [s] to the input at rest and to the response.

        While the node is not active there is no command; then only the response counts.
        """
        is_active = self.is_active
        self.commands.clear()
        begun, answered = time.monotonic(), self.ask(Trigger, 'stop')
        rest: list[float] = []
        response: list[float] = []

        def done() -> bool:
            if not rest and self.commands and not self.is_following():
                rest.append(next(at for at, u in self.commands if np.abs(u - REST).max() < 1e-9))
            if not response and answered.done():
                response.append(time.monotonic())
            return bool(response and (rest or not is_active))

        self.spin_until(done, 'a stop')
        return (rest or response)[0] - begun, response[0] - begun

    def do_nothing(self) -> None:
        """Ask for nothing: the floor."""

    # Requests that take long

    def set_weights(self) -> Any:
        """Change a weight to another value each time."""
        self._count += 1
        value = Parameter('Qx', value=[1.0 + 1e-3 * self._count, *[1.0] * 5])
        return self.ask(SetParameters, 'set_parameters', SetParameters.Request(
            parameters=[value.to_parameter_msg()]))

    def try_design(self) -> Any:
        """Try other weights."""
        self._count += 1
        request = TryDesign.Request()
        request.weights.qx = [1.0 + 1e-3 * self._count, *[1.0] * 5]
        return self.ask(TryDesign, 'try_design', request)

    def suggest_weights(self) -> Any:
        """Ask for weights."""
        return self.ask(SuggestWeights, 'suggest_weights')

    def follow_reference(self) -> None:
        """Publish a reference of many samples that holds the set point later."""
        t = np.linspace(0.0, 100.0, 5001)
        message = Trajectory(
            t=t.tolist(), x=np.zeros(6 * t.size).tolist(), u=np.tile(REST, t.size).tolist())
        message.header.stamp.sec = self.node.get_clock().now().to_msg().sec + 1000
        self._references.publish(message)

    def plan(self) -> Any:
        """Ask trajectory_server for a motion that lqr_node is to follow."""
        return self.ask(PlanMotion, 'trajectory_server/plan', PlanMotion.Request(
            system='aircraft', goal=[0.5, 0.0, 0.0, 0.0, 0.0, 0.0], objective='quadratic',
            final_time=2.0, execute=True))

    def activate_again(self) -> Any:
        """Deactivate the node, and ask for its activation."""
        self.spin_until(self._change(Transition.TRANSITION_DEACTIVATE).done, 'deactivation')
        self.is_active = False
        return self._change(Transition.TRANSITION_ACTIVATE)

    def _change(self, number: int) -> Any:
        return self.ask(ChangeState, 'change_state', ChangeState.Request(
            transition=Transition(id=number)))


def measure(name: str, stops: int, folder: Path) -> bool:
    """Measure the stops of a controller; return whether they are in time."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    bench, in_time = Bench(name), True
    kinds = ['do_nothing', 'set_weights', 'activate_again']
    if name == 'lqr_node':
        kinds += ['try_design', 'suggest_weights', 'follow_reference', 'plan']
    try:
        with Children(folder) as children:
            if name == 'lqr_node':
                children.start('trajectory_server', '-p', 'workers:=1')
            children.start(name, '-p', 'system:=aircraft', '-p', f'u_limits:={LIMITS}', '-p',
                           'transition_time:=0.0')
            bench.spin_until(bench.is_following, f'commands of {name}')
            for kind in kinds:
                found = np.array([_stop_during(bench, kind) for _ in range(stops)]) * 1e3
                for what, times in zip(('rest', 'response'), found.T, strict=True):
                    p50, p99 = np.percentile(times, (50, 99))
                    in_time &= bool(p99 <= 1e3 * ALLOWED)
                    print(f'{name:9} {kind:16} {what:9} p50 {p50:6.1f}  p99 {p99:6.1f}  '
                          f'max {times.max():6.1f} ms of {stops}', flush=True)
    finally:
        bench.node.destroy_node()
        rclpy.shutdown()
    return in_time


def _stop_during(bench: Bench, kind: str) -> tuple[float, float]:
    """Return the times [s] of one stop while a request is answered."""
    asked = getattr(bench, kind)()
    later = time.monotonic() + random.uniform(0.0, 0.05)
    bench.spin_until(lambda: time.monotonic() >= later, 'the next moment')
    found = bench.stop()
    if asked is not None:
        bench.spin_until(asked.done, kind)
    bench.is_active = True
    bench.spin_until(bench.ask(Trigger, 'start').done, 'a start')
    bench.spin_until(bench.is_following, 'commands after a start')
    return found


def main() -> int:
    """Print the figures; return 1 if a stop took too long."""
    stops = int(sys.argv[sys.argv.index('--stops') + 1]) if '--stops' in sys.argv else STOPS
    in_time = True
    with reserve_domain() as domain, tempfile.TemporaryDirectory() as folder:
        isolate(domain)
        for name in ('lqr_node', 'mpc_node'):
            in_time &= measure(name, stops, Path(folder))
    return 0 if in_time else 1


if __name__ == '__main__':
    sys.exit(main())
