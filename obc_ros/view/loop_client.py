# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The ROS side of the page: it reads a loop in a thread of its own, and calls its services.

Subscriptions are best effort: a page that falls behind never delays a publisher.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from functools import partial
import math
import queue
import re
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.action import SolveOptimalControl
from obc_ros.cli.recording import LATCHED
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Command, Estimate, LqrDesign, OptimalControlProblem, State, Trajectory
from obc_ros.ros.execution.executor import limit_leaving
from obc_ros.ros.execution.subscription_thread import Apart
from obc_ros.ros.service_qos import BURST
from obc_ros.view.disturbances import Disturbances
from obc_ros.view.telemetry import (
    describe_plant,
    describe_uncertainty,
    fits_names,
    FollowedPath,
    Frame,
    Plant,
    read_mode,
    SetPoint,
    ShownMode,
    STOPPED,
    Uncertainty,
)
from rcl_interfaces.msg import Log, Parameter, ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
import rclpy.parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

PERIOD = 1.0 / 45.0  # [s] between two looks at the topics: each frame of the page has news
PARAMETER_EVENTS = QoSProfile(depth=100)
QUEUE = QoSProfile(depth=64, reliability=ReliabilityPolicy.BEST_EFFORT)
PLANT_NODE = 'plant_simulator'
CONTROLLERS = ('lqr_node', 'mpc_node')   # the first previews weights and follows references

LINES = 500     # of the log
LINE = 1000     # characters of a line of the log
DISCOVERED = 3.0   # [s] in which a service is discovered
ANSWERS = 10.0  # [s] in which a service responds; a plan has its own limit
CHANGES = 60.0  # [s] in which parameters are set: mpc_node plans first
SAMPLES = 60    # of a prediction
NEWS = 3.0      # [s] between diagnostics, of which there is one a second
FRESH = 500_000_000   # [ns] between a state and the estimate whose covariance is shown
# What lqr_node reports when it does not follow the last reference.
ENDED = re.compile('a reference was rejected|no reference is followed')
AGE = 0.2       # [s] that a state waits for its command in the measurement of the latency


class Request:
    """A problem for trajectory_server; `phase` is what is tried now, in words."""

    def __init__(self, problem: OptimalControlProblem, time_limit: float) -> None:
        self.goal = SolveOptimalControl.Goal(problem=problem, time_limit=time_limit)
        self.phase, self.is_cancelled = '', False
        self.handle: Any = None   # of the goal, once the server has the request

    def cancel(self) -> None:
        """Ask for the end; the client passes it on once the server has the request."""
        self.is_cancelled = True


class LoopClient:
    """A client of the nodes of one loop: its plant, and the design in use and who published it."""

    def __init__(self, namespace: str = '') -> None:
        self.plant: Plant | None = None
        self.design: LqrDesign | None = None
        self.controller = CONTROLLERS[0]
        self._prediction: Sequence[Sequence[float | None]] = ()
        self._uncertain: tuple[int, Uncertainty | None] = (0, None)
        self._held: tuple[Any, SetPoint | None] = None, None   # and of what it is
        self._disturbances = Disturbances()
        self._plant_read = 0, 0.0, 1.0   # diagnostics of the plant: count, time [s], its rate
        self._frame: Frame | None = None
        self._time = 0.0
        self._given: FollowedPath | None = None
        self._published = self._ended = 0   # of references [ns]
        self._lines: deque[tuple[int, str]] = deque(maxlen=LINES)
        self._numbered = 0
        self._sent: dict[int, int] = {}
        self._latency = float('nan')
        self._u: Sequence[float] = ()
        self._jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._solver: ActionClient | None = None
        self._waiting: list[Callable[[], None]] = []
        self._clients: dict[str, Any] = {}
        self._modes: dict[str, tuple[ShownMode, float]] = {}   # and when it was read
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context)
        self._node = rclpy.create_node(
            'obc_view', namespace=namespace, context=self._context, use_global_arguments=False,
            start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._subscribe()
        self._running = True
        self._thread = threading.Thread(target=self._run, name='loop', daemon=True)
        self._thread.start()

    def _subscribe(self) -> None:
        apart, node = Apart(), self._node
        self._taken = [
            (node.create_subscription(kind, topic, lambda _: None, QUEUE, callback_group=apart),
             act) for kind, topic, act in (
                (Estimate, 'estimator_node/estimate', self._on_estimate),
                (Trajectory, 'mpc_node/plan', self._on_prediction),
                (State, 'state', self._on_state), (Command, 'command', self._on_command))]
        for name in CONTROLLERS:
            node.create_subscription(
                LqrDesign, f'{name}/design', partial(self._on_design, name), LATCHED)
        node.create_subscription(Trajectory, 'reference', self._on_reference, LATCHED)
        node.create_subscription(Log, '/rosout', self._on_log, LATCHED)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, QUEUE)
        node.create_subscription(
            ParameterEvent, '/parameter_events', self._on_parameters, PARAMETER_EVENTS)
        for name in CONTROLLERS:   # discovered before somebody needs them
            self._clients[f'{name}/stop'] = node.create_client(
                Trigger, f'{name}/stop', qos_profile=BURST)

    def close(self) -> None:
        """Leave the graph."""
        self._running = False
        self._executor.wake()
        self._thread.join()
        with limit_leaving():
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.try_shutdown()

    def take_frame(self) -> Frame | None:
        """Return the newest frame; None if it was taken before."""
        frame, self._frame = self._frame, None
        return frame

    @property
    def reference(self) -> FollowedPath | None:
        """Return the reference that lqr_node follows, whoever has published it."""
        followed = self.is_lqr and self._published > self._ended
        return self._given if followed else None

    @property
    def is_lqr(self) -> bool:
        """Return whether the controller previews weights and follows references."""
        return self.controller == CONTROLLERS[0]

    @property
    def mode(self) -> ShownMode:
        """Return the mode of the controller; without recent diagnostics a reason only."""
        mode, read = self._modes.get(self.controller, (None, 0.0))
        if mode is None:
            return ShownMode('', f'no diagnostics of {self.controller} yet')
        if time.monotonic() - read < NEWS:
            return mode
        return ShownMode('', f'no diagnostics of {self.controller} any more; the last mode was '
                    f'{mode.sentence}')

    def list_lines(self, after: int = 0) -> list[tuple[int, str]]:
        """Return the lines of the log with numbers above `after`."""
        return [each for each in tuple(self._lines) if each[0] > after]

    def _run(self) -> None:
        due = time.monotonic()
        while self._running:
            try:
                due = self._turn(due)
            except Exception as error:  # of any kind: no message may end the page
                self._add_line(f'obc view: {type(error).__name__}: {error}')
                time.sleep(PERIOD)

    def _turn(self, due: float) -> float:
        """Do what waits; look at the topics if it is `due` [s], and return when it is next."""
        with suppress(queue.Empty):
            while True:
                self._jobs.get_nowait()()
        now = time.monotonic()
        if now >= due:
            self._take()
            waiting, self._waiting = self._waiting, []
            for job in waiting:
                job()
            due = max(due + PERIOD, now)
        self._executor.spin_once(timeout_sec=max(0.0, due - time.monotonic()))
        return due

    def _take(self) -> None:
        for subscription, act in self._taken:
            with subscription.handle:
                while (taken := subscription.handle.take_message(
                        subscription.msg_type, False)) is not None:
                    act(*taken)

    def _on_state(self, message: State, info: Mapping[str, int]) -> None:
        stamp = _read_stamp(message)
        self._time = 1e-9 * stamp
        self._sent[stamp] = info['source_timestamp']
        while len(self._sent) > 2 * QUEUE.depth:
            self._sent.pop(next(iter(self._sent)))
        held, (estimated, uncertainty) = self._find_held(), self._uncertain
        self._frame = Frame(
            1e-9 * stamp, message.x, self._u, held.locate(message.x) if held else (),
            held.measure_cost(message.x) if held else float('nan'), self._latency,
            self._prediction, uncertainty if abs(stamp - estimated) < FRESH else None,
            self._disturbances.find(1e-9 * stamp))

    def _find_held(self) -> SetPoint | None:
        """Return the set point; of a loop that follows a reference it is the end of that."""
        design, reference = of = self.design, self.reference
        if of != self._held[0]:
            end = reference.find_end(self.plant) if reference and self.plant else []
            self._held = of, SetPoint(design, end) if design else None
        return self._held[1]

    def _on_estimate(self, message: Estimate, _: Mapping[str, int]) -> None:
        known = describe_uncertainty(self.plant, message) if self.plant else None
        self._uncertain = _read_stamp(message), known

    def _on_prediction(self, path: Trajectory, _: Mapping[str, int]) -> None:
        if self.plant is not None:
            self._prediction = FollowedPath(1e-9 * _read_stamp(path), path).pack(
                self.plant, SAMPLES, inputs=True)

    def _on_command(self, message: Command, info: Mapping[str, int]) -> None:
        self._u = message.u
        if (begun := self._sent.get(_read_stamp(message))) is not None:
            late = 1e-9 * (info['source_timestamp'] - begun)
            if 0.0 <= late < AGE:
                self._latency = late

    def _on_design(self, controller: str, design: LqrDesign) -> None:
        if not fits_names(design):
            self._add_line('obc view: a design was dropped: its arrays do not fit its names')
            return
        if controller != self.controller:
            self.controller, self._prediction = controller, ()
        if self.design and self.design.system == design.system and list(
                design.xe) != list(self.design.xe):   # this ends references
            self._given = None
        plant = describe_plant(design)
        self.plant = self.plant if plant == self.plant else plant
        self.design = design

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        prefix = self._node.get_namespace().strip('/')
        names = {'/'.join(filter(None, (prefix, f'{each}: commands'))): each
                 for each in CONTROLLERS}
        for status in array.status:
            if status.name in names:
                self._modes[names[status.name]] = read_mode(status), time.monotonic()
            elif status.name == f'{self._find_plant_name()}: plant':
                self._read_plant({each.key: each.value for each in status.values})

    def _find_plant_name(self) -> str:
        return '/'.join(filter(None, (self._node.get_namespace().strip('/'), PLANT_NODE)))

    def _read_plant(self, values: Mapping[str, str]) -> None:
        try:
            now, rate, epoch = (float(values[key]) for key in (
                'simulated time [s]', 'simulated seconds a second',
                'stamp at simulated time 0 [s]'))
        except (KeyError, ValueError):   # of another node
            return
        if math.isfinite(now + rate + epoch):
            self._plant_read = self._plant_read[0] + 1, now, rate
            self._disturbances.epoch = epoch

    def _on_parameters(self, event: ParameterEvent) -> None:
        if event.node == f'/{self._find_plant_name()}':
            self._disturbances.change({
                each.name: rclpy.parameter.parameter_value_to_python(each.value)
                for each in (*event.new_parameters, *event.changed_parameters)},
                [each.name for each in event.deleted_parameters])

    def _on_reference(self, path: Trajectory, info: Mapping[str, int]) -> None:
        begin = 1e-9 * _read_stamp(path) or self._time
        self._given = FollowedPath(begin, path) if len(path.t) else None
        self._published = info['source_timestamp']

    def _on_log(self, line: Log) -> None:
        if line.name.endswith('lqr_node') and ENDED.match(line.msg):
            self._ended = max(self._ended, 10**9 * line.stamp.sec + line.stamp.nanosec)
        level = {30: 'warning: ', 40: 'error: ', 50: 'fatal: '}.get(int(line.level), '')
        clock = time.strftime('%H:%M:%S', time.localtime(line.stamp.sec))
        self._add_line(f'{clock} {line.name}: {level}{line.msg}')

    def _add_line(self, line: str) -> None:
        self._numbered += 1
        self._lines.append((self._numbered, line[:LINE]))

    async def call(self, kind: Any, service: str, request: Any, timeout: float = ANSWERS) -> Any:
        """Return the response of a service; ObcError if there is none within `timeout` [s]."""
        answer: Future[Any] = Future()
        deadline = time.monotonic() + DISCOVERED
        self._submit(lambda: self._ask(kind, service, request, answer, deadline))
        try:
            return await asyncio.wait_for(asyncio.wrap_future(answer), timeout)
        except TimeoutError as error:
            raise ObcError(f'{service} has not responded within {timeout:g} s') from error

    def _ask(self, kind: Any, service: str, request: Any, answer: 'Future[Any]',
             deadline: float) -> None:
        client = self._clients.get(service)
        if client is None:
            client = self._clients[service] = self._node.create_client(
                kind, service, qos_profile=BURST)
        if client.service_is_ready():
            client.call_async(request).add_done_callback(lambda done: _finish(answer, done))
        elif time.monotonic() < deadline:   # it is being discovered
            self._waiting.append(lambda: self._ask(kind, service, request, answer, deadline))
        else:
            answer.set_exception(ObcError(f'there is no service {service}: is the node running?'))

    def _submit(self, job: Callable[[], None]) -> None:
        self._jobs.put(job)
        self._executor.wake()

    async def trigger(self, service: str) -> str:
        """Call a service without arguments; return what its node says, or why it does not."""
        try:
            return str((await self.call(Trigger, service, Trigger.Request())).message)
        except ObcError as error:
            return str(error)

    async def stop(self) -> str:
        """Stop each controller of the loop; return what they say."""
        found = [name for name in CONTROLLERS if self._clients[f'{name}/stop'].service_is_ready()]
        return '; '.join(await asyncio.gather(*map(self._stop, found or [self.controller])))

    async def _stop(self, controller: str) -> str:
        try:
            response = await self.call(Trigger, f'{controller}/stop', Trigger.Request())
        except ObcError as error:
            return str(error)
        if response.success:   # diagnostics follow within a second
            self._modes[controller] = ShownMode(STOPPED, 'by ~/stop'), time.monotonic()
        return f'{controller}: {response.message}'

    async def solve(self, request: Request) -> Any:
        """Return the result of trajectory_server; ObcError if it does not take the request."""
        answer: Future[Any] = Future()
        deadline = time.monotonic() + DISCOVERED
        self._submit(lambda: self._send(request, answer, deadline))
        return await asyncio.wrap_future(answer)

    def _send(self, request: Request, answer: 'Future[Any]', deadline: float) -> None:
        if self._solver is None:
            self._solver = ActionClient(
                self._node, SolveOptimalControl, 'trajectory_server/solve_optimal_control',
                goal_service_qos_profile=BURST, result_service_qos_profile=BURST,
                cancel_service_qos_profile=BURST, feedback_sub_qos_profile=BURST)
        if self._solver.server_is_ready():
            self._solver.send_goal_async(
                request.goal, lambda news: setattr(request, 'phase', str(news.feedback.phase))
            ).add_done_callback(lambda sent: self._follow(request, sent.result(), answer))
        elif time.monotonic() < deadline:
            self._waiting.append(lambda: self._send(request, answer, deadline))
        else:
            answer.set_exception(ObcError('no trajectory_server runs in this loop'))

    def _follow(self, request: Request, handle: Any, answer: 'Future[Any]') -> None:
        if not handle.accepted:
            answer.set_exception(ObcError('trajectory_server has rejected the request'))
            return
        request.handle = handle
        result = handle.get_result_async()
        result.add_done_callback(lambda done: _finish(answer, done, lambda found: found.result))
        self._waiting.append(lambda: self._attend(request, answer))

    def _attend(self, request: Request, answer: 'Future[Any]') -> None:
        """Cancel a request, or end it if the server disappears."""
        if answer.done():
            return
        if request.is_cancelled and request.handle is not None:
            request.handle.cancel_goal_async()
            request.handle = None
        if self._solver is not None and not self._solver.server_is_ready():
            _fail(answer, 'trajectory_server does not run any more')
            return
        self._waiting.append(lambda: self._attend(request, answer))

    async def get_parameters(self, node: str, names: Sequence[str]) -> dict[str, Any]:
        """Return the values of parameters of a node; those that it does not have are left out."""
        response = await self.call(GetParameters, f'{node}/get_parameters',
                                   GetParameters.Request(names=list(names)))
        return {name: rclpy.parameter.parameter_value_to_python(value)
                for name, value in zip(names, response.values, strict=False) if value.type}

    async def load_disturbances(self) -> None:
        """Read which disturbances the plant has now; later changes arrive by themselves."""
        names = [name for group in ('disturbance', 'noise')
                 for name in await self.list_parameters(PLANT_NODE, group)]
        self._disturbances.take(await self.get_parameters(PLANT_NODE, names))

    async def find_plant_time(self) -> tuple[float, float]:
        """Return the simulated time [s] of the plant, and its seconds a second; ObcError: none."""
        # The stamps of the states may be those of a clock, and a pause or a reset moves them.
        count, deadline = self._plant_read[0], time.monotonic() + NEWS
        while self._plant_read[0] == count:
            if time.monotonic() > deadline:
                raise ObcError(f'no diagnostics of {PLANT_NODE}: its time is not known')
            await asyncio.sleep(PERIOD)
        return self._plant_read[1:]

    async def list_parameters(self, node: str, prefix: str) -> list[str]:
        """Return the names of the parameters of a node in a group."""
        response = await self.call(ListParameters, f'{node}/list_parameters',
                                   ListParameters.Request(prefixes=[prefix], depth=0))
        return list(map(str, response.result.names))

    async def set_parameters(self, node: str, values: Mapping[str, Any]) -> tuple[bool, str]:
        """Set parameters of a node as one; return success and the reason."""
        rows = [Parameter(name=name, value=rclpy.parameter.Parameter(
            name, value=value).to_parameter_msg().value) for name, value in values.items()]
        response = await self.call(SetParametersAtomically, f'{node}/set_parameters_atomically',
                                   SetParametersAtomically.Request(parameters=rows), CHANGES)
        return bool(response.result.successful), str(response.result.reason)


def _finish(answer: 'Future[Any]', done: Any,
            read: Callable[[Any], Any] = lambda found: found) -> None:
    if done.exception() is not None:
        _fail(answer, str(done.exception()))
    else:
        with suppress(InvalidStateError):   # the page does not wait any more
            answer.set_result(read(done.result()))


def _fail(answer: 'Future[Any]', why: str) -> None:
    with suppress(InvalidStateError):
        answer.set_exception(ObcError(why))


def _read_stamp(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)
