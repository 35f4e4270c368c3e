# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The node of a controller: state feedback in a loop with watchdogs, and a lifecycle.

A separate thread computes the commands. What takes time runs in a third thread, the desk, and is
awaited, so that the executor answers ``~/stop`` at once. A change reaches the loop as one
assignment.

The module is long because a node is one class.
"""

from collections.abc import Sequence
from copy import copy
from time import monotonic, time_ns
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.srv import ChangeState
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.closed_loop.modes import Mode
from obc_ros.core.lqr.design.design import Design
from obc_ros.core.lqr.design.report import Change, change, report_fields
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.msg import LqrDesign, State
from obc_ros.nodes.control.command_sinks import Sink
from obc_ros.nodes.control.controller_settings import (
    ControllerCandidate,
    ControllerSettings,
    describe_opening,
    explain_former_limits,
)
from obc_ros.nodes.control.loop_monitor import LoopMonitor, predict_error
from obc_ros.nodes.control.topic_peers import find_faults, Source, SourceWatch
from obc_ros.ros import state_sources
from obc_ros.ros.conversions import make_body_reader
from obc_ros.ros.diagnostics import Diagnostics
from obc_ros.ros.execution.subscription_thread import Apart, OwnThread
from obc_ros.ros.execution.worker_thread import WorkerThread
from obc_ros.ros.messages import build_lqr_design, make_stamp, read_nanoseconds
from obc_ros.ros.parameters.node_parameters import Parameters
from obc_ros.ros.repeated_messages import RepeatedReader
from obc_ros.ros.service_qos import BEST_EFFORT, LATCHED_QOS, STEADY
from obc_ros.ros.throttled_log import ThrottledLog
from rclpy.duration import Duration
from rclpy.event_handler import EventHandler, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos_overriding_options import QoSOverridingOptions, QoSPolicyKind
from std_srvs.srv import Trigger

SINK = 1   # message: on a lossy network old commands, each sent again, would delay the new one
OVERRIDES = (QoSPolicyKind.DEADLINE, QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY,
             QoSPolicyKind.HISTORY, QoSPolicyKind.RELIABILITY)
INFINITE = 2**63 - 1  # [ns] as a QoS duration
FAREWELL = Duration(seconds=0.5)
CHECK_PERIOD = 0.5  # [s] between two checks in the thread of the states
_KINDS = {state_sources.FrameError: 'frame', state_sources.NamesError: 'names'}   # of drops


class ControllerNode(LifecycleNode):  # type: ignore[misc] # rclpy's classes are untyped
    """A controller; see the module's text."""

    def __init__(self, name: str, table: type[ControllerSettings], **options: Any) -> None:
        super().__init__(name, allow_undeclared_parameters=True, **options)
        self._is_active = False  # first: rclpy 9 also destroys a node with rejected parameters
        self._monitor, self._log = LoopMonitor(), ThrottledLog(self)
        self._desk, self._source = WorkerThread(self), SourceWatch()
        self._adopted: Any = None
        self._idle_reason = ''   # why the node is not active although it should be
        self._prepare()
        self._table: Parameters[Any, Any] = Parameters(
            self, table, self._judge, self._adopt, self._monitor.refused, describe_opening,
            explain_former_limits, self._desk)
        self._adopted, self._revision, self._change = self._table.candidate, 1, Change()
        self._loop = ControlLoop(self._adopted.control, Mode.INACTIVE)
        self._create_topics(self._table.settings)
        self._create_services()
        self._send_design(self._make_design())
        if self._table.settings.autostart:
            self._start_itself()

    # What a controller does in its own way

    def _prepare(self) -> None:
        """Create what `_judge` needs."""

    def _judge(self, settings: Any) -> ControllerCandidate:
        """Return the candidate of parameters, or raise ObcError."""
        raise NotImplementedError

    def _check_states(self, candidate: ControllerCandidate) -> None:
        if self._adopted and candidate.control.names != self._adopted.control.names:
            raise StatementError('the states of a running node cannot change: start another node')

    def _shared_topics(self) -> list[str]:
        return []

    def _start_itself(self) -> None:
        self.trigger_configure()
        self.trigger_activate()

    def _look_ahead(self) -> None:
        """Continue after a state, in its thread."""

    def _forget(self) -> None:
        """Forget the references, after ~/stop."""

    def _note_refused(self, reason: str) -> None:
        """Report a reference that the loop has rejected."""
        raise NotImplementedError

    def _statuses(self) -> list[DiagnosticStatus]:
        return []

    def _create_topics(self, settings: Any) -> None:
        system = self._adopted.design.plant.system
        overrides = QoSOverridingOptions(OVERRIDES)
        self._read = make_body_reader(settings.state_source, system)
        self._sink = Sink(settings.command_sink, system, settings.cmd_vel_stamped)
        self._frame, self._has_speed = settings.frame_id, settings.state_source == 'odom'
        self._look_at_clock()
        self._states = self.create_subscription(
            state_sources.SOURCES[settings.state_source], settings.state_source,
            lambda message: None, copy(BEST_EFFORT), callback_group=Apart(),
            qos_overriding_options=overrides)
        self._monitor.topic = self._states.topic_name
        self._commands = self.create_lifecycle_publisher(
            self._sink.type, settings.command_sink, SINK,
            qos_overriding_options=overrides)
        self._designs = self.create_publisher(LqrDesign, '~/design', LATCHED_QOS)
        self._diagnostics = Diagnostics(self, needs_clock=True)
        is_repeated = settings.state_source == 'state'
        self._repeated = RepeatedReader(State, 'x')
        self._thread = OwnThread(
            self, self._states, self._answer_raw if is_repeated else self._answer, self._watch,
            self._deadline_events(), settings.priority, is_raw=is_repeated)
        self._news = self.create_guard_condition(self._log_news)
        self._designed = self.create_guard_condition(
            self._publish_design, callback_group=self._desk.group)
        self.create_timer(1.0, self._diagnose, clock=STEADY)

    def _deadline_events(self) -> list[EventHandler]:
        deadline = self._states.qos_profile.deadline.nanoseconds
        if not 0 < deadline < INFINITE:
            return []
        handlers: list[EventHandler] = SubscriptionEventCallbacks(
            deadline=self._on_deadline, incompatible_qos=lambda _: None,  # `ros_graph` names it
            use_default_callbacks=False).create_event_handlers(
                self._states.callback_group, self._states.handle, self._states.topic_name)
        return handlers

    def _create_services(self) -> None:
        self.create_service(Trigger, '~/stop', self._on_stop)
        self.create_service(Trigger, '~/start', self._on_start)
        for service in self.services:
            if service.srv_type is ChangeState:
                self._change_state, service.callback = service.callback, self._on_change_state
                self._desk.move(service, self._desk.group)

    # States and commands, in the thread of the states

    def _answer_raw(self, data: bytes, info: Any) -> None:
        message = self._repeated.read(data)
        if message is not None:
            self._answer(message, info)
            return
        self._loop.drop('unreadable', f'a message on {self._monitor.topic} that is no State was '
                        'dropped', monotonic())
        self._news.trigger()

    def _answer(self, message: Any, info: Any) -> None:
        begun = monotonic()
        header, loop = message.header, self._loop
        if not self._is_own_source(info, begun):
            return
        if header.frame_id != self._frame and not self._is_frame(header.frame_id, begun):
            return
        try:
            x = self._read(message)
        except StatementError as error:
            kind = next((kind for of, kind in _KINDS.items() if isinstance(error, of)), 'finite')
            loop.drop(kind, f'a state was dropped: {error}', begun)
        else:
            clock = None if self._is_simulated else time_ns()
            speed = message.twist.twist.linear.x if self._has_speed else None
            u = loop.answer(read_nanoseconds(header.stamp), x, begun, clock, speed,
                            0 if self._has_speed else message.restarts)
            if u is not None:
                self._commands.publish(self._sink.message(u, header.stamp))
                self._monitor.latencies.append(monotonic() - begun)
            self._look_ahead()
        if loop.news or loop.events or loop.refused:
            self._news.trigger()

    def _watch(self) -> float:
        """Send the command for missing states; return the time to wait for the next state [s]."""
        now, loop = monotonic(), self._loop
        if (u := loop.overdue(now)) is not None:
            self._commands.publish(self._sink.message(u, self._time()))
        if loop.news:
            self._news.trigger()
        return min(CHECK_PERIOD, loop.wake() - now)

    def _is_own_source(self, info: Any, now: float) -> bool:
        """Return whether a state is of the publisher whose states are used."""
        number = info['publication_sequence_number']
        if self._source.is_next(number, now):
            return True
        found = self._source.identify(
            number, now, self._adopted.control.rules.state_timeout or CHECK_PERIOD)
        if found is Source.REPLACED:
            self._loop.replace_source()
        if found is Source.OTHER:
            self._loop.drop('source', f'a state of a second publisher on {self._monitor.topic} '
                            'was dropped', now)
            self._news.trigger()
        return found is not Source.OTHER

    def _is_frame(self, frame: str, now: float) -> bool:
        """Return whether a frame is `frame_id`, or without that the frame of the first state."""
        wanted = self._table.settings.frame_id
        if frame == wanted or not (wanted or self._frame):
            self._frame = frame
            return True
        self._loop.drop('frame', f"a state in the frame '{quote(frame)}' was dropped: wanted "
                                 f"'{quote(wanted or self._frame)}'", now)
        return False

    def _on_deadline(self, _: Any) -> None:
        self._loop.drop('deadline', f'a state on {self._states.topic_name} missed its deadline of '
                        f'{self._states.qos_profile.deadline.nanoseconds * 1e-9:g} s', monotonic())

    # Changes

    def _adopt(self, candidate: Any) -> None:
        before, self._adopted = self._adopted, candidate
        if candidate.settings.frame_id != before.settings.frame_id:
            self._frame = candidate.settings.frame_id
            self._forget()
            self._loop.reframe()
        if candidate.design.plant.system is not before.design.plant.system:
            self._sink = Sink(
                candidate.settings.command_sink, candidate.design.plant.system,
                candidate.settings.cmd_vel_stamped)
        if candidate.gains != before.gains:
            self._revision += 1
            self._change = change(
                before.design, candidate.design, self._loop.preview(candidate.control))
            self._designed.trigger()   # margins take time
        self._loop.adopt(candidate.control)   # it uses the control from the next state on

    async def _publish_design(self) -> None:
        self._send_design(await self._desk.run(self._make_design))

    def _make_design(self) -> LqrDesign:
        """Return the message of the design in use; its margins take time."""
        adopted, revision = self._adopted, self._revision
        message = design_message(adopted.design, self._change, self._loop.error, adopted.note)
        message.revision = revision
        return message

    def _send_design(self, message: LqrDesign) -> None:
        message.header.stamp = self._time()
        self._designs.publish(message)
        self._monitor.design = f'revision {message.revision}: {message.sentence}'
        self.get_logger().info(self._monitor.design)

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._loop.stop('by ~/stop')
        self._thread.wake()   # the input at rest leaves now, not with the next state
        self._desk.cancel('cancelled by ~/stop')
        self._forget()
        response.success = True
        response.message = (f'stopped at {list(self._adopted.control.rest)}; the set point is '
                            'held again after ~/start')
        self._log.warning('stop', f'~/stop: {response.message}')
        return response

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        response.message = (f'started again; it was stopped {self._loop.reason}'
                            if self._loop.is_stopped else 'it was not stopped')
        self._log.info('start', f'~/start: {response.message}')
        self._loop.start()
        return response

    # Lifecycle: rclpy manages publishers only

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Log the transition; the node is configured when it starts."""
        self._log.info('configure', f'configured; it was {state.label}')
        return super().on_configure(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Log the transition; nothing is released."""
        self._log.info('cleanup', f'cleaned up; it was {state.label}')
        return super().on_cleanup(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Log that a transition has failed."""
        self._log.warning('error', f'a transition failed; it was {state.label}')
        return super().on_error(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the control loop."""
        self._loop.activate()
        self._source = SourceWatch()
        self._is_active, self._idle_reason = True, ''
        done = super().on_activate(state)
        self._thread.start()
        self._log.info('activate', f'activated: the loop runs; it was {state.label}')
        return done

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send the input at rest, and stop the control loop."""
        self._rest()
        self._log.info('deactivate', f'deactivated: the loop is stopped; it was {state.label}')
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send the input at rest, and stop the control loop."""
        self._rest()
        self._log.info('shutdown', f'shut down; it was {state.label}')
        return super().on_shutdown(state)

    def _rest(self) -> None:
        if self._is_active:
            self._is_active = False
            self._thread.stop()
            rest = self._loop.deactivate()
            if rest is not None:
                self._commands.publish(self._sink.message(rest, self._time()))
                self._commands.wait_for_all_acked(FAREWELL)  # before the node is destroyed

    async def _on_change_state(self, request: Any, response: Any) -> Any:
        try:
            return self._change_state(request, response)
        except RuntimeError as error:  # RCLError: no such transition from here
            self._log.warning('transition', f'the transition was rejected: {error}')
            response.success = False
            return response

    def destroy_node(self) -> None:
        """Send the input at rest, and destroy the node."""
        self._rest()
        self._desk.close()
        super().destroy_node()
        # rclpy does not destroy it; while it exists others see the node in the graph.
        self._state_machine.destroy_when_not_in_use()

    # Reports

    def _time(self) -> Time:
        """Return the time of the node, simulated: not before the last state."""
        now = self.get_clock().now().nanoseconds
        if self._is_simulated:   # /clock is best effort, and may come later than the state
            now = max(now, self._loop.stamp or 0)
        return make_stamp(now)

    def _look_at_clock(self) -> None:
        self._is_simulated = bool(self.get_parameter('use_sim_time').value)

    def _log_news(self) -> None:
        loop = self._loop
        while loop.news:
            self.get_logger().warning(loop.news.popleft())
        while loop.events:
            self.get_logger().info(loop.events.popleft())
        while loop.refused:
            self._note_refused(loop.refused.popleft())

    def _diagnose(self) -> None:
        self._log_news()
        self._look_at_clock()
        for sentence in self._monitor.found(find_faults(
                self, [self._states.topic_name, self._commands.topic_name],
                self._shared_topics())):
            self.get_logger().warning(sentence)
        error = self._loop.error
        statuses = self._monitor.statuses(
            self.get_fully_qualified_name()[1:], self._loop, self._revision, self._is_active,
            None if error is None else self._adopted.design.cost_to_go(error),
            self._idle_reason, predict_error(self._adopted.design.plant.system, self._loop))
        self._diagnostics.publish(
            [*statuses, *self._statuses()], self._time(), self._table.settings.hardware_id,
            self._adopted.design.plant.system.name, self._monitor.told)


def design_message(design: Design, made: Change, error: Sequence[float] | None, note: str = ''
                   ) -> LqrDesign:
    """Return the message of a design at x - xe = error, without stamp and revision."""
    message = build_lqr_design(report_fields(design, made, error))
    if note:
        message.sentence += f'; {note}'
    return message
