# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A client of a closed loop: records its topics, calls its services, sets its parameters."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.cli.processes import APPEARS, Children
from obc_ros.cli.recording import CLOCK, LATCHED, read_stamp, Recorder
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Command, Estimate, LqrDesign, Measurement, State, Trajectory
from obc_ros.ros.execution.executor import limit_leaving
from rcl_interfaces.msg import Log, Parameter, ParameterEvent
from rcl_interfaces.srv import SetParametersAtomically
import rclpy
from rclpy.executors import SingleThreadedExecutor
import rclpy.parameter
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

SILENCE = 0.3  # [s] after which the pilot answers a state that waits for its command


@dataclass
class Samples:
    """Serialised messages of one stamped topic, their stamps and publication times [ns]."""

    data: list[bytes] = field(default_factory=list)
    stamp: list[int] = field(default_factory=list)
    published: list[int] = field(default_factory=list)

    def append(self, data: bytes, published: int) -> None:
        """Keep one serialised message."""
        self.data.append(data)
        self.stamp.append(read_stamp(data))
        self.published.append(published)


class Pilot:
    """
    A ROS node that records and commands a running loop.

    Topics that depend on the wall clock are recorded in `journal`, if it is given.

    With `rest`, the controller hears `state` of estimator_node, and the states of the plant are
    `true_state`. A plant in lockstep waits for a command at each state. If there is none, because
    there is no estimate yet or it was lost, the pilot repeats the last command, at first `rest`
    (m,).

    Methods that wait raise what `Children.check` raises: the end of a node ends every wait.

    :ivar states, heard: states of the plant, and those that the controller hears.
    :ivar estimates, measurements: empty without an estimator.
    :ivar told: values of the newest diagnostics by name, for each status by what follows the
        node's name.
    :ivar stood_in: number of states that the pilot has answered.
    """

    def __init__(self, children: Children, recorder: Recorder, journal: Recorder | None = None,
                 controller: str = 'lqr_node', rest: Sequence[float] = ()) -> None:
        self._children = children
        self._recorder = recorder
        self._journal = journal or recorder
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node('obc_demo', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.states, self.commands, self.odometry = Samples(), Samples(), Samples()
        self.estimates, self.measurements = Samples(), Samples()
        self.heard = Samples() if rest else self.states
        self.stood_in, self._rest, self._waiting = 0, list(rest), (0, 0.0)
        self.designs: list[LqrDesign] = []
        self.said: list[Log] = []
        self.told: dict[str, dict[str, str]] = {}
        self._record(controller)
        if rest:
            self._record_estimator()
            self._stand_in = self.node.create_publisher(Command, 'command', 1)
        else:
            recorder.subscribe(self.node, 'odom', Odometry, self.odometry.append)

    def _record(self, controller: str) -> None:
        node, recorder = self.node, self._recorder
        recorder.subscribe(node, 'state', State, self.heard.append)
        recorder.subscribe(node, 'command', Command, self.commands.append)
        recorder.subscribe(
            node, f'{controller}/design', LqrDesign, qos=LATCHED,
            listener=lambda data, _: self.designs.append(deserialize_message(data, LqrDesign)))
        recorder.subscribe(node, 'reference', Trajectory, qos=LATCHED)
        journal = self._journal
        journal.subscribe(node, '/clock', Clock, qos=CLOCK)
        journal.subscribe(node, '/diagnostics', DiagnosticArray, self._on_diagnostics)
        journal.subscribe(node, '/parameter_events', ParameterEvent)
        journal.subscribe(
            node, '/rosout', Log, qos=LATCHED,
            listener=lambda data, _: self.said.append(deserialize_message(data, Log)))
        recorder.now = journal.now = lambda: self.states.stamp[-1] if self.states.stamp else 0
        self.publisher = node.create_publisher(Trajectory, 'reference', LATCHED)
        self._paused = False
        self._pauser = node.create_client(SetBool, 'plant_simulator/pause')

    def _record_estimator(self) -> None:
        for topic, kind, samples in (('true_state', State, self.states),
                                     ('measurement', Measurement, self.measurements),
                                     ('estimator_node/estimate', Estimate, self.estimates)):
            self._recorder.subscribe(self.node, topic, kind, samples.append)

    def _on_diagnostics(self, data: bytes, published: int) -> None:
        for status in deserialize_message(data, DiagnosticArray).status:
            self.told[status.name.rpartition(': ')[2]] = {
                each.key: each.value for each in status.values}

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown()
        with limit_leaving():
            self.node.destroy_node()
            rclpy.shutdown(context=self._context)

    @property
    def now(self) -> float:
        """Return the time [s] of the last state since the first one."""
        stamp = self.states.stamp
        return (stamp[-1] - stamp[0]) * 1e-9 if stamp else 0.0

    @property
    def x(self) -> Array:
        """Return the last state."""
        return np.asarray(deserialize_message(self.states.data[-1], State).x)

    def wait(self, condition: Callable[[], bool], what: str, timeout: float = APPEARS,
             progress: Callable[[], None] = lambda: None) -> None:
        """Spin until a condition holds; raise an error that names `what` after `timeout` [s]."""
        deadline = time.monotonic() + timeout
        checked = 0.0
        while not condition():
            self._executor.spin_once(timeout_sec=0.001)
            self._recorder.drain()
            if self._journal is not self._recorder:
                self._journal.drain()
            if (now := time.monotonic()) - checked > 0.05:
                checked = now
                self._children.check()
                progress()
                if now > deadline:
                    raise ObcError(f'timeout: waited {timeout:g} s for {what}')

    def call(self, kind: Any, name: str, request: Any, timeout: float = 30.0) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(kind, name)
        try:
            return self._ask(client, request, timeout)
        finally:
            self.node.destroy_client(client)

    def _ask(self, client: Any, request: Any, timeout: float = 30.0) -> Any:
        self.wait(client.service_is_ready, f'the service {client.srv_name}', timeout)
        answer = client.call_async(request)
        self.wait(answer.done, f'the response of {client.srv_name}', timeout)
        return answer.result()

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> tuple[bool, str]:
        """Set parameters of a node in one transaction; return success and the reason."""
        request = SetParametersAtomically.Request(parameters=[
            Parameter(name=name, value=_value(value)) for name, value in values.items()])
        result = self.call(
            SetParametersAtomically, f'{node}/set_parameters_atomically', request).result
        return result.successful, result.reason

    def hears(self, topic: str) -> bool:
        """Return whether a topic has a publisher."""
        return bool(self.node.count_publishers(topic))

    def pause(self, wanted: bool) -> None:
        """Pause or resume the simulated time."""
        self._ask(self._pauser, SetBool.Request(data=wanted))
        self._paused = wanted

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Pause the simulated time, and resume it unless it was paused before."""
        before = self._paused
        self.pause(True)
        yield
        self.pause(before)

    def begin(self, real_time: bool) -> None:
        """
        Wait for the first command; the time runs in real time, and is paused in lockstep.

        With an estimator in lockstep there is no command before the time runs.
        """
        if self._rest and not real_time:
            return
        if real_time:
            self.pause(False)
        due = 0.0
        reset: Any = None   # the future of the last request

        def answered() -> bool:
            nonlocal due, reset
            if reset and not reset.done():
                return False
            if not (real_time or self.commands.stamp) and time.monotonic() > due:
                # The plant may have received a command that this node has missed.
                reset = resetter.call_async(Trigger.Request())
                due = time.monotonic() + 0.5
                return False
            return bool(self.commands.stamp)

        resetter = self.node.create_client(Trigger, 'plant_simulator/reset')
        self.wait(resetter.service_is_ready, 'the plant')
        self.wait(answered, 'the first command')
        self.node.destroy_client(resetter)

    def reach(self, moment: float, timeout: float, progress: Callable[[], None]) -> None:
        """Let a paused plant in lockstep go on until `moment` [s] and its command have come."""
        if self.now < moment - 1e-9:
            done, reason = self.set_parameters('plant_simulator', {'pause_at': moment})
            if not done:
                raise ObcError(f'the plant does not pause at t = {moment:g} s: {reason}')
            self.pause(False)
            self._paused = True   # by the plant, at that time
        due = self.states.stamp[0] + round(moment * 1e9)

        def go_on() -> None:
            self._answer_silence()
            progress()

        self.wait(lambda: self._has_all(due), f'the command at t = {moment:g} s', timeout, go_on)

    def _answer_silence(self) -> None:
        """Answer the state that the plant waits with, if it has waited for long."""
        stamp, now = self.states.stamp[-1], time.monotonic()
        if not self._rest or self.commands.stamp[-1:] >= [stamp]:
            return
        if stamp != self._waiting[0]:
            self._waiting = stamp, now
        elif now - self._waiting[1] > SILENCE:
            u = (deserialize_message(self.commands.data[-1], Command).u if self.commands.data
                 else self._rest)
            command = Command(u=u)
            command.header.stamp.sec, command.header.stamp.nanosec = divmod(stamp, 10**9)
            self._stand_in.publish(command)
            self.stood_in, self._waiting = self.stood_in + 1, (stamp, now)

    def _has_all(self, stamp: int) -> bool:
        """Return whether the messages of a state are recorded; some plants have no odometry."""
        return (self.states.stamp[-1] >= stamp and self.commands.stamp[-1:] >= [stamp]
                and (not self.odometry.stamp or self.odometry.stamp[-1] >= stamp))

    def history(self) -> tuple[Array, Array, Array, Array]:
        """Return t [s] and x of all states, t [s] and u of all commands; t = 0: first state."""
        start = self.states.stamp[0]
        return (*_arrays(self.states, State, 'x', start),
                *_arrays(self.commands, Command, 'u', start))

    def latencies(self) -> Array:
        """Return the time [s] from each heard state to its first command, both as published."""
        states = dict(zip(self.heard.stamp, self.heard.published, strict=True))
        commands = dict(zip(reversed(self.commands.stamp), reversed(self.commands.published),
                            strict=True))
        return np.array([(commands[stamp] - published) * 1e-9
                         for stamp, published in states.items() if stamp in commands])

    def missed(self) -> int:
        """Return the number of heard states without a command, from the first to the last one."""
        answered = set(self.commands.stamp)
        if not answered:
            return len(self.heard.stamp)
        first, last = min(answered), max(answered)
        return sum(first <= stamp <= last and stamp not in answered
                   for stamp in self.heard.stamp)


def _arrays(samples: Samples, kind: Any, name: str, start: int) -> tuple[Array, Array]:
    rows = [getattr(deserialize_message(data, kind), name) for data in samples.data]
    return (np.array(samples.stamp) - start) * 1e-9, np.array(rows)


def _value(value: Any) -> Any:
    if isinstance(value, (list, tuple, np.ndarray)):
        value = [float(number) for number in value]
    return rclpy.parameter.Parameter('value', value=value).to_parameter_msg().value
