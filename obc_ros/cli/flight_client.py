# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The client side of a loop: listens to it, records it, and asks its nodes for changes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.cli.processes import Children
from obc_ros.cli.recording import CLOCK, LATCHED, read_stamp, Recorder
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Command, LqrDesign, State, Trajectory
from obc_ros.ros.executor import limit_leaving
from rcl_interfaces.msg import Log, Parameter, ParameterEvent
from rcl_interfaces.srv import SetParametersAtomically
import rclpy
from rclpy.executors import SingleThreadedExecutor
import rclpy.parameter
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger


@dataclass
class Samples:
    """Messages of one stamped topic: as they came, and when they were published [ns]."""

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
    A ROS node that watches and commands a running loop, for one recording.

    What depends on the clock on the wall goes to `journal`, if there is one.

    Raises what `Children.check` raises while it waits, so that a dead node ends every wait.
    """

    def __init__(self, children: Children, recorder: Recorder, journal: Recorder | None = None
                 ) -> None:
        self._children = children
        self._recorder = recorder
        self._journal = journal or recorder
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node('obc_demo', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.states, self.commands = Samples(), Samples()
        self.designs: list[LqrDesign] = []
        self.said: list[Log] = []
        self._record()

    def _record(self) -> None:
        node, recorder = self.node, self._recorder
        recorder.subscribe(node, 'state', State, self.states.append)
        recorder.subscribe(node, 'command', Command, self.commands.append)
        recorder.subscribe(node, 'lqr_node/design', LqrDesign, self._on_design, qos=LATCHED)
        recorder.subscribe(node, 'reference', Trajectory, qos=LATCHED)
        recorder.subscribe(node, 'odom', Odometry)
        journal = self._journal
        journal.subscribe(node, '/clock', Clock, qos=CLOCK)
        journal.subscribe(node, '/diagnostics', DiagnosticArray)
        journal.subscribe(node, '/parameter_events', ParameterEvent)
        journal.subscribe(node, '/rosout', Log, self._on_log, qos=LATCHED)
        recorder.now = journal.now = lambda: self.states.stamp[-1] if self.states.stamp else 0
        self.publisher = node.create_publisher(Trajectory, 'reference', LATCHED)
        self._pauser = node.create_client(SetBool, 'plant_simulator/pause')
        self._stepper = node.create_client(Trigger, 'plant_simulator/step')

    def _on_design(self, data: bytes, published: int) -> None:
        self.designs.append(deserialize_message(data, LqrDesign))

    def _on_log(self, data: bytes, published: int) -> None:
        self.said.append(deserialize_message(data, Log))

    def close(self) -> None:
        """End the node."""
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

    def wait(self, condition: Callable[[], bool], what: str, timeout: float = 20.0,
             progress: Callable[[], None] = lambda: None) -> None:
        """Listen until a condition holds; no later than `timeout` [s], or fail saying `what`."""
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
                    raise ObcError(f'waited {timeout:g} s in vain for {what}')

    def call(self, kind: Any, name: str, request: Any, timeout: float = 30.0) -> Any:
        """Call a service and return its answer."""
        client = self.node.create_client(kind, name)
        try:
            return self._ask(client, request, timeout)
        finally:
            self.node.destroy_client(client)

    def _ask(self, client: Any, request: Any, timeout: float = 30.0) -> Any:
        self.wait(client.service_is_ready, f'the service {client.srv_name}', timeout)
        answer = client.call_async(request)
        self.wait(answer.done, f'the answer of {client.srv_name}', timeout)
        return answer.result()

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> tuple[bool, str]:
        """Set parameters of a node in one transaction; return whether, and if not why."""
        request = SetParametersAtomically.Request(parameters=[
            Parameter(name=name, value=_value(value)) for name, value in values.items()])
        result = self.call(
            SetParametersAtomically, f'{node}/set_parameters_atomically', request).result
        return result.successful, result.reason

    def hears(self, topic: str) -> bool:
        """Return whether somebody publishes a topic."""
        return bool(self.node.count_publishers(topic))

    def pause(self, wanted: bool) -> float:
        """Stop the simulated time, or let it go on; return it [s]."""
        return _time(self._ask(self._pauser, SetBool.Request(data=wanted)).message)

    def begin(self, real_time: bool) -> None:
        """Have the first state answered: time goes on in real time, in lockstep it stands."""
        if real_time:
            self.pause(False)
        due, reset = 0.0, None

        def answered() -> bool:
            nonlocal due, reset
            if reset and not reset.done():
                return False
            if not (real_time or self.commands.stamp) and time.monotonic() > due:
                # The plant may have heard an answer that nobody else did.
                reset = resetter.call_async(Trigger.Request())
                due = time.monotonic() + 0.5
                return False
            return bool(self.commands.stamp)

        resetter = self.node.create_client(Trigger, 'plant_simulator/reset')
        self.wait(resetter.service_is_ready, 'the plant')
        self.wait(answered, 'the first command')
        self.node.destroy_client(resetter)

    def reach(self, moment: float) -> None:
        """
        Stop the simulated time of a plant in lockstep at a moment [s], the state then answered.

        Who pauses a plant in flight does so a little earlier or later each time; the last states
        before the moment are asked for one by one.
        """
        now = self.pause(True)
        while True:
            due = round(now * 1e9)
            self.wait(lambda due=due: self.states.stamp[-1] >= due  # type: ignore[misc]
                      and self.commands.stamp[-1:] >= [due], f'the answer at {now:g} s')
            if now >= moment - 1e-9:
                return
            now = self._step()

    def _step(self, timeout: float = 20.0) -> float:
        """Advance the paused plant, once it is answered, by one state; return its time [s]."""
        deadline = time.monotonic() + timeout
        while not (answer := self._ask(self._stepper, Trigger.Request())).success:
            if time.monotonic() > deadline:
                raise ObcError(f'the plant does not go on: {answer.message}')
        return _time(answer.message)

    def history(self) -> tuple[Array, Array, Array, Array]:
        """Return t [s], x of all states and t [s], u of all commands, from the first state on."""
        start = self.states.stamp[0]
        return (*_arrays(self.states, State, 'x', start),
                *_arrays(self.commands, Command, 'u', start))

    def latencies(self) -> Array:
        """Return the time [s] from each state to its first command, both when published."""
        states = dict(zip(self.states.stamp, self.states.published, strict=True))
        commands = dict(zip(reversed(self.commands.stamp), reversed(self.commands.published),
                            strict=True))
        return np.array([(commands[stamp] - published) * 1e-9
                         for stamp, published in states.items() if stamp in commands])

    def missed(self) -> int:
        """Return how many states, from the first answered to the last, have no command."""
        answered = set(self.commands.stamp)
        if not answered:
            return len(self.states.stamp)
        first, last = min(answered), max(answered)
        return sum(first <= stamp <= last and stamp not in answered
                   for stamp in self.states.stamp)


def _time(message: str) -> float:
    """Return the simulated time [s] that a plant tells in words: ... t = 1.5 s."""
    return float(message.rpartition('t = ')[2].split()[0])


def _arrays(samples: Samples, kind: Any, name: str, start: int) -> tuple[Array, Array]:
    rows = [getattr(deserialize_message(data, kind), name) for data in samples.data]
    return (np.array(samples.stamp) - start) * 1e-9, np.array(rows)


def _value(value: Any) -> Any:
    if isinstance(value, (list, tuple, np.ndarray)):
        value = [float(number) for number in value]
    return rclpy.parameter.Parameter('value', value=value).to_parameter_msg().value
