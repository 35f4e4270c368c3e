# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""An lqr_node between a publisher of states and a subscriber to its commands."""

from collections.abc import Callable, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from numpy.typing import NDArray
from obc_ros.msg import Command, LqrDesign, State, Trajectory
from probes import Probe
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from scipy.linalg import solve_continuous_are
import support

Array = NDArray[np.float64]

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
HOVER = np.array([0.0, 4 * 9.8])


class Bench:
    """The node in a process of its own, with publishers and subscriptions around it."""

    def __init__(self, spawn: support.Spawner, probe: Probe, qos: Any = 10,
                 message: type = State, topic: str = 'state', sink: type = Command,
                 commands: str = 'command', **parameters: Any) -> None:
        self.probe = probe
        given = {key.replace('__', '.'): value for key, value in parameters.items()}
        given.setdefault('state_timeout', 0.0)   # a loaded machine sends states late
        if commands == 'command':
            given = {**support.DEMO, **given}
        given.setdefault('stamp_timeout', 0.0)   # stamps begin at 0
        self.process = spawn('lqr_node', given)
        self.designs: list[LqrDesign] = probe.listen(LqrDesign, '/lqr_node/design', LATCHED)
        self.commands: list[Any] = probe.listen(sink, commands)
        self.reports: list[DiagnosticArray] = probe.listen(DiagnosticArray, '/diagnostics')
        self.publisher = probe.publisher(message, topic, qos)
        probe.wait_for(lambda: self.designs, what='a design')
        probe.wait_for(lambda: probe.node.count_publishers(commands), what='its commands')
        self.stamp = 0

    def send(self, x: Sequence[float], stamp: float | None = None, frame: str = '') -> int:
        """Publish a state and return its stamp [ns]: the last one plus 10 ms if none is given."""
        self.stamp = self.stamp + 10_000_000 if stamp is None else round(stamp * 1e9)
        message = State(x=list(map(float, x)))
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.stamp, 10**9)
        self.publisher.publish(message)
        return self.stamp

    def answer(self, x: Sequence[float], stamp: float | None = None, frame: str = '') -> Array:
        """Publish a state until it is answered, and return the command (m,)."""
        sent, seen = self.send(x, stamp, frame), len(self.commands)
        command = self.probe.wait_for(
            lambda: next((each for each in self.commands[seen:] if nanoseconds(each) == sent),
                         None), what=f'the answer to {list(x)}')
        return np.array(command.u)

    def ask(self, x: Sequence[float]) -> Array:
        """Return the command of a node that may not be connected yet."""
        found: list[Any] = []

        def answered() -> bool:
            sent, seen = self.send(x), len(self.commands)
            self.probe.spin_for(0.05)
            found.extend(each for each in self.commands[seen:] if nanoseconds(each) == sent)
            return bool(found)

        self.probe.wait_for(answered, what=f'the answer to {list(x)}')
        return np.array(found[0].u)

    def set(self, **values: Any) -> Any:
        """Set one parameter, or several at once; return the result."""
        if len(values) == 1:
            return self.probe.set_parameters('/lqr_node', **values)[0]
        return self.probe.set_parameters_atomically('/lqr_node', **values)

    def design(self, revision: int) -> LqrDesign:
        """Return the design with a revision, from `~/design`."""
        return self.probe.wait_for(
            lambda: next((each for each in self.designs if each.revision == revision), None),
            what=f'revision {revision}')

    def report(self, part: str, condition: Callable[[Any, dict[str, str]], Any]) -> Any:
        """Return the next diagnostic status of a part that meets a condition."""
        self.reports.clear()
        found: list[Any] = []

        def reported() -> bool:
            for array in self.reports:
                for status in array.status:
                    values = {each.key: each.value for each in status.values}
                    if status.name == f'lqr_node: {part}' and condition(status, values):
                        found.append(status)
            return bool(found)

        self.probe.wait_for(reported, what=f'a report of {part}')
        return found[0]


class Heard:
    """
    Record the stamps [ns] of states and commands of a loop, and how many belong together.

    Pairs are counted on arrival: a search through all messages at each turn would take longer and
    longer until the probe falls behind. Both topics have queues of the same length, so a probe
    that falls behind still loses states and commands alike.
    """

    def __init__(self, probe: Probe, namespace: str = '') -> None:
        """Listen to the topics of a namespace, such as ``/vehicle1``."""
        self.clear()
        topics = f'{namespace}/state' if namespace else 'state', (
            f'{namespace}/command' if namespace else 'command')
        probe.node.create_subscription(State, topics[0], self._on_state, 10)
        probe.node.create_subscription(Command, topics[1], self._on_command, 10)

    def clear(self) -> None:
        """Discard everything recorded so far."""
        self.states: set[int] = set()
        self.commands: set[int] = set()
        self.answers = 0
        self.x: Sequence[float] = ()   # the last state

    def _on_state(self, message: State) -> None:
        stamp, self.x = nanoseconds(message), message.x
        # Either message may arrive first.
        self.answers += stamp in self.commands and stamp not in self.states
        self.states.add(stamp)

    def _on_command(self, message: Command) -> None:
        stamp = nanoseconds(message)
        self.answers += stamp in self.states and stamp not in self.commands
        self.commands.add(stamp)


def nanoseconds(message: Any) -> int:
    """Return the stamp of a message [ns]."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def matrix(values: Sequence[float], rows: int) -> Array:
    """Return a row-major field as a matrix."""
    return np.array(values).reshape(rows, -1)


def riccati_gain(design: LqrDesign, Qx: Array, Qu: Array) -> Array:
    """Return the gain by scipy's Riccati solver for the plant that a design reports."""
    A, B = matrix(design.a, len(design.xe)), matrix(design.b, len(design.xe))
    return np.linalg.solve(Qu, B.T @ solve_continuous_are(A, B, Qx, Qu))


def reference(t: Any, x: Any, u: Any, stamp: float = 0.0, **fields: Any) -> Trajectory:
    """Return a reference as a message."""
    message = Trajectory(t=list(t), x=np.ravel(x).tolist(), u=np.ravel(u).tolist(), **fields)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
    return message
