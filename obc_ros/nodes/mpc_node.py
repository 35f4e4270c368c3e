# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Node mpc_node: control with limits, by a plan that is computed again at each state.

Subscribes to ``state`` (State) or ``odom`` (nav_msgs/Odometry). Publishes ``command`` (Command, or
see `command_sinks`), ``~/plan`` (Trajectory), ``~/design`` (LqrDesign, transient local: the
regulator behind the plan) and ``/diagnostics``. Services: ``~/stop``, ``~/start``
(std_srvs/Trigger), and those of a lifecycle node. Parameters: see `settings.Settings`. The loop is
in `controller_node`.

At a state the command of the plan made for this instant is sent; then a process of its own plans
from the state that is predicted for the next instant. Without a new plan the present one is
followed to its end, then the regulator inside the terminal set, then `on_stale` acts.

With `priority`, the solver process has a real-time priority one less than that of the node's
threads. Where the system does not allow it, the log says so.
"""

from dataclasses import replace
from queue import Empty, SimpleQueue
import sys
from threading import Lock
from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from obc_ros.core.closed_loop.control import Control, Leg
from obc_ros.core.text.errors import ObcError, StatementError
from obc_ros.msg import Trajectory
from obc_ros.nodes.control.controller_node import CHECK_PERIOD, ControllerNode
from obc_ros.nodes.mpc.plan_legs import make_leg, select_legs
from obc_ros.nodes.mpc.plan_messages import make_plan_message
from obc_ros.nodes.mpc.plan_monitor import PlanMonitor
from obc_ros.nodes.mpc.settings import (
    find_solver_priority,
    judge_mpc_settings,
    MpcCandidate,
    Settings,
)
from obc_ros.ros.conversions import read_nanoseconds
from obc_ros.ros.executor import run
from obc_ros.workers.steps.step_link import StepLink
from obc_ros.workers.steps.step_supervisor import STEP_PATIENCE, StepSupervisor
from obc_ros.workers.wire import pack, Packet
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile

READY = 30.0     # [s] that a process may take to prepare a changed problem
FIRST = 20.0     # [s] that the first plan may take
LAST_STATE = 1.0  # [s] age of the state from which the first plan begins, at most
ATTEMPT = 0.1    # [s] between two looks of a node that starts itself


class MpcNode(ControllerNode):
    """The node; see the module's text."""

    STEPS = 'obc_ros.workers.steps.receding_steps'   # what the process prepares problems with

    def __init__(self, **options: Any) -> None:
        super().__init__('mpc_node', Settings, **options)

    def _prepare(self) -> None:
        self._plans = PlanMonitor()
        self._legs: tuple[Leg, ...] = ()
        self._lock = Lock()   # guards the plans: two threads change them
        self._first: SimpleQueue[Packet] = SimpleQueue()
        self._heard: tuple[list[float], float] | None = None
        self._published, self._is_listening = 0.0, False
        self._beginning: Packet | None = None   # the first plan, before it is followed
        self._waits = ''    # what activation waits for, as logged
        self._asked: int | None = None  # stamp [ns] for which a plan was asked
        self._steps = StepSupervisor(self._on_reply, self._on_ready, self._on_solver_news)
        self._known = self.create_guard_condition(self._take_terminal_set)

    def _create_topics(self, settings: Settings) -> None:
        super()._create_topics(settings)
        self._period = round(1e9 / settings.rate)
        self._plan_topic = self.create_publisher(Trajectory, '~/plan', QoSProfile(depth=1))
        self._steps.use(self._adopted.link)
        self._steps.start()
        self._thread.start()   # it only listens until the node is active
        self._is_listening = True

    def _start_itself(self) -> None:
        self.trigger_configure()
        # Simulated time may not run before the first command.
        self._attempts = self.create_timer(
            ATTEMPT, self._attempt, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _attempt(self) -> None:
        """Activate the node once: as soon as a plan can be made, or is known to be impossible."""
        reason = self._steps.refusal
        if not reason and (waits := self._find_obstacle()):
            if waits != self._waits:
                self._waits = waits
                self.get_logger().info(f'not active yet: {waits}')
            return
        self._attempts.cancel()
        if not self._is_active:
            self.trigger_activate()

    # Changes

    def _judge(self, settings: Settings) -> MpcCandidate:
        candidate, now = judge_mpc_settings(settings), self._adopted
        if now and candidate.control.names != now.control.names:
            raise StatementError('the states of a running node cannot change: start another node')
        if now and pack(candidate.problem) == pack(now.problem):
            same = replace(candidate, link=now.link)
            return same if now.ready is None else same.with_terminal_set(now.ready)
        link = StepLink(self.STEPS, candidate.problem, find_solver_priority(settings.priority))
        candidate = replace(candidate, link=link)
        if not self._is_active:
            return candidate
        try:   # the present plan is followed meanwhile
            candidate = candidate.with_terminal_set(link.wait_until_ready(READY))
            if (x := self._loop.x) is not None:
                link.call({'kind': 'first', 'present': self._find_excess(candidate.problem)},
                          {'x': np.array(x)}, FIRST)
        except ObcError:
            link.close()
            raise
        return candidate

    def _find_excess(self, problem: Packet) -> dict[str, float] | None:
        """Return by how much the last plan exceeds the limits; None: `problem` has others."""
        now, last = self._adopted.problem, self._plans.last
        is_same = (problem.plain['path_constraints'] == now.plain['path_constraints']
                   and all(np.array_equal(problem.arrays[name], now.arrays[name])
                           for name in ('x_lower', 'x_upper')))
        if not is_same:
            return None
        return {} if last is None else dict(last.plain['slack'])

    def _adopt(self, candidate: MpcCandidate) -> None:
        is_new = candidate.link is not self._adopted.link
        super()._adopt(candidate)
        if is_new and candidate.link is not None:
            self._steps.use(candidate.link)

    def _use(self, control: Control) -> None:
        with self._lock:   # the present plan goes on until one of the new problem arrives
            self._loop.adopt(replace(control, legs=self._legs))

    def _forget(self) -> None:
        with self._lock:
            self._legs = ()
            self._loop.adopt(self._adopted.control)

    def _take_terminal_set(self) -> None:
        """Use the terminal set of a prepared problem."""
        link = self._steps.link
        if link is None or link.ready is None or self._adopted.ready is not None:
            return
        self._adopted = self._adopted.with_terminal_set(link.ready)
        self._use(self._adopted.control)
        self._publish_design()

    # States, in their thread

    def _answer(self, message: Any) -> None:
        if self._is_active and self._beginning is None:
            super()._answer(message)
            return
        now = monotonic()
        if message.header.frame_id != self._frame and not self._is_frame(
                message.header.frame_id, now):
            return
        x = self._read_finite(message)
        if not self._is_active:
            self._heard = (x, now) if x else self._heard
            return
        if x and self._beginning is not None:
            self._follow_first(self._beginning, read_nanoseconds(message.header.stamp), x)
        super()._answer(message)

    def _read_finite(self, message: Any) -> list[float]:
        """Return the state of a message; empty: it has another size, or is not finite."""
        try:
            x = list(self._read(message))
        except StatementError:
            return []
        return x if len(x) == len(self._adopted.control.names) and np.all(np.isfinite(x)) else []

    def _follow_first(self, plan: Packet, stamp: int, x: list[float]) -> None:
        """Let the checked first plan begin at a stamp [ns], at x in the states that move."""
        self._beginning = None
        control = self._adopted.control
        moved = np.where(control.regulator.drift, x - plan.arrays['x'][0], 0.0)
        leg = make_leg(Packet({'stamp': stamp}, {**plan.arrays, 'x': plan.arrays['x'] + moved}),
                       self._period, control)
        with self._lock:
            self._legs = (leg,)
            self._loop.adopt(replace(control, legs=self._legs))

    def _watch(self) -> float:
        return super()._watch() if self._is_active else CHECK_PERIOD

    def _look_ahead(self, u: list[float] | None) -> None:
        """Ask for the plan of the next instant, from the state and the command of this one."""
        loop = self._loop
        if u is None or loop.stopped or loop.x is None or loop.stamp is None:
            return
        if self._asked is not None and self._is_now(self._asked):   # else that state was lost
            last = self._plans.last
            self._plans.counts['wanted'] += 1
            if last is None or not self._is_now(int(last.plain['stamp'])):
                self._plans.counts['missed'] += 1
        self._asked = loop.stamp + self._period
        self._steps.ask({'kind': 'step', 'stamp': self._asked},
                        {'x': np.array(loop.x), 'u': np.array(u)},
                        STEP_PATIENCE + self._adopted.problem.plain['deadline'])

    def _is_now(self, stamp: int) -> bool:
        """Return whether a stamp [ns] is that of the last state, up to half a period."""
        return abs(stamp - self._loop.stamp) <= self._period // 2

    # Replies, in the thread of the supervisor

    def _on_reply(self, reply: Packet) -> None:
        if reply.plain.get('kind') == 'first':
            self._first.put(reply)
            return
        if 'refused' in reply.plain:
            self._plans.fail(reply.plain['refused'])
            return
        loop = self._loop
        if loop.stopped or not self._is_active:
            return
        self._plans.add(reply)
        with self._lock:
            control = self._adopted.control
            self._legs = select_legs(
                self._legs, make_leg(reply, self._period, control), loop.stamp)
            loop.adopt(replace(control, legs=self._legs))
        self._show(reply)

    def _show(self, reply: Packet) -> None:
        """Publish a plan, at most at `plan_rate`."""
        rate, now = self._table.settings.plan_rate, monotonic()
        if rate and now - self._published >= 1.0 / rate:
            self._published = now
            self._plan_topic.publish(make_plan_message(
                reply, self._period, self._adopted.design.plant.system, self._frame))

    def _on_ready(self, _: Packet) -> None:
        self._known.trigger()

    def _on_solver_news(self, sentence: str) -> None:
        self._loop.news.append(sentence)
        self._news.trigger()

    # Lifecycle

    def _find_obstacle(self) -> str:
        """Return why no plan can be made now; empty: one can be tried."""
        if self._steps.refusal:
            return self._steps.refusal
        if self._adopted.ready is None or not self._steps.is_ready:
            return 'the solver process prepares the problem'
        if self._heard is None or monotonic() - self._heard[1] > LAST_STATE:
            return f'no valid state on {self._states.topic_name} within {LAST_STATE:g} s'
        return ''

    def _plan_first(self) -> str:
        """Return why no first plan passes its checks; empty: one does."""
        if reason := self._find_obstacle():
            return reason
        while not self._first.empty():
            self._first.get()
        if not self._steps.ask({'kind': 'first'}, {'x': np.array(self._heard[0])}, FIRST):
            return 'the solver process takes no request'
        try:
            reply = self._first.get(timeout=FIRST)
        except Empty:
            return f'the first plan was not made within {FIRST:g} s'
        if 'refused' in reply.plain:
            return str(reply.plain['refused'])
        self._beginning, self._plans.first = reply, reply.plain['words']
        return ''

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the control loop if a first plan passes its checks."""
        if reason := self._plan_first():
            self._monitor.refused(f'activation: {reason}')
            self._log.warning('activate', f'not activated: {reason}')
            return TransitionCallbackReturn.FAILURE
        self._thread.stop()   # `on_activate` starts it with another loop
        self._asked = None
        with self._lock:
            self._legs = ()
        self._log.info('first plan', self._plans.first)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send the input at rest, and stop the control loop; the states are still listened to."""
        done = super().on_deactivate(state)
        with self._lock:
            self._legs = ()
        self._thread.start()
        return done

    def destroy_node(self) -> None:
        """Send the input at rest, end the solver process, and destroy the node."""
        self._rest()
        if self._is_listening:   # not if a parameter was rejected at the start
            self._thread.stop()
        self._steps.stop()
        super().destroy_node()

    # Reports

    def _statuses(self) -> list[DiagnosticStatus]:
        return [self._plans.status(self.get_fully_qualified_name()[1:], self._loop,
                                   self._steps.counts, self._steps.refusal)]


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run(MpcNode)


if __name__ == '__main__':
    sys.exit(main())
