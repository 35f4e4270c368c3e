# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Node mpc_node: control with limits, by a plan that is computed again at each state.

Topics and services: docs/interfaces.md. Parameters: see `settings.Settings`. The loop is in
`controller_node`.

At a state the command of the plan made for this instant is sent; then a process of its own plans
from the state that is predicted for the next instant. Without a new plan the present one is
followed to its end, then the regulator with the limits, as `on_unplanned` says.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
import math
import sys
from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
import numpy as np
from obc_ros.core.closed_loop.laws import free_drift
from obc_ros.core.text.errors import ObcError, StatementError
from obc_ros.msg import Trajectory
from obc_ros.nodes.control.controller_node import CHECK_PERIOD, ControllerNode
from obc_ros.nodes.mpc.plans import make_plan, make_plan_message, PlanMonitor
from obc_ros.nodes.mpc.settings import (
    find_solver_priority,
    judge_mpc_settings,
    MpcCandidate,
    Settings,
)
from obc_ros.ros.execution.executor import run
from obc_ros.ros.messages import read_nanoseconds
from obc_ros.ros.service_qos import STEADY
from obc_ros.workers.steps.step_supervisor import STEP_PATIENCE, StepLink, StepSupervisor
from obc_ros.workers.wire import pack, Packet
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.task import Future

READY = 30.0     # [s] that a process may take to prepare a changed problem
FIRST = 20.0     # [s] that the first plan may take
LAST_STATE = 1.0  # [s] age of the state from which the first plan begins, at most
ATTEMPT = 0.1    # [s] between two attempts of a node that starts itself; doubled after a refusal
LONGEST = 2.0    # [s]


class MpcNode(ControllerNode):
    """The node; see the module's text."""

    STEPS = 'obc_ros.workers.steps.receding_steps'   # what the process prepares problems with

    def __init__(self, **options: Any) -> None:
        super().__init__('mpc_node', Settings, **options)

    def _prepare(self) -> None:
        self._plans = PlanMonitor()
        self._first: Future | None = None       # of the answer to the request of a first plan
        self._late = 0.0                        # when that is given up
        self._answers: deque[Packet] = deque()  # to it, from the thread of the supervisor
        self._heard: tuple[Sequence[float], float] = (), -math.inf   # a state, and when
        self._published, self._is_listening = 0.0, False
        self._beginning: Packet | None = None   # the first plan, before it is followed
        self._attempted, self._pause = 0.0, ATTEMPT
        # For which stamps [ns] plans were asked, and in which run of the law.
        self._asked: deque[tuple[int, int]] = deque(maxlen=8)
        self._steps = StepSupervisor(self._on_reply, self._on_ready, self._on_solver_news)
        self._known = self.create_guard_condition(
            self._take_terminal_set, callback_group=self._desk.group)
        self._answered = self.create_guard_condition(
            self._take_first, callback_group=self._desk.group)

    def _create_topics(self, settings: Settings) -> None:
        super()._create_topics(settings)
        self._period = round(1e9 / settings.rate)
        self._plans.period = 1.0 / settings.rate
        self._plan_topic = self.create_publisher(Trajectory, '~/plan', QoSProfile(depth=1))
        self._steps.use(self._adopted.link)
        self._steps.start()
        self._thread.start()   # it only listens until the node is active
        self._is_listening = True

    def _start_itself(self) -> None:
        self.trigger_configure()
        # Simulated time may not run before the first command.
        self._idle_reason = 'it starts'
        self.create_timer(ATTEMPT, self._attempt, clock=STEADY,
                          callback_group=MutuallyExclusiveCallbackGroup())

    async def _attempt(self) -> None:
        """Try to become active, unless somebody has decided otherwise."""
        if not self._idle_reason or self._is_active or (
                monotonic() - self._attempted < self._pause):
            return
        reason = await self._plan_first()
        if not self._idle_reason or self._is_active:   # in the meantime
            return
        if reason != self._idle_reason:
            self._pause = ATTEMPT
            self._idle_reason = reason
            if reason:
                self.get_logger().info(f'not active yet: {reason}')
        if reason:
            self._attempted, self._pause = monotonic(), min(2.0 * self._pause, LONGEST)
        else:
            self.trigger_activate()

    # Changes

    def _judge(self, settings: Settings) -> MpcCandidate:
        candidate, now = judge_mpc_settings(settings), self._adopted
        self._check_states(candidate)
        if now and pack(candidate.problem) == pack(now.problem):
            same = replace(candidate, link=now.link)
            return same if now.ready is None else same.with_terminal_set(now.ready)
        link = StepLink(self.STEPS, candidate.problem, find_solver_priority(settings.priority))
        candidate = replace(candidate, link=link)
        if not self._is_active:
            return candidate
        try:   # the present plan is followed meanwhile
            candidate = candidate.with_terminal_set(
                link.wait_until_ready(READY, self._desk.is_cancelled))
            if (x := self._loop.x) is not None:
                link.call({'kind': 'first', 'present': self._find_excess(candidate.problem)},
                          {'x': np.array(x)}, FIRST, self._desk.is_cancelled)
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

    async def _take_terminal_set(self) -> None:
        link = self._steps.link
        if link is None or link.ready is None or self._adopted.ready is not None:
            return
        self._adopted = self._adopted.with_terminal_set(link.ready)
        self._loop.adopt(self._adopted.control)
        await self._publish_design()

    # States, in their thread

    def _answer(self, message: Any, info: Any) -> None:
        if self._is_active and self._beginning is None:
            super()._answer(message, info)
            x = self._loop.x
            if x is not None and x is not self._heard[0]:
                self._heard = x, monotonic()   # for a plan after a deactivation
            return
        now = monotonic()
        if not self._is_own_source(info, now) or (
                message.header.frame_id != self._frame and not self._is_frame(
                    message.header.frame_id, now)):
            return
        x = self._read_finite(message)
        if not self._is_active:
            self._heard = (x, now) if x else self._heard
            return
        if x and self._beginning is not None:
            self._follow_first(self._beginning, read_nanoseconds(message.header.stamp), x)
        super()._answer(message, info)

    def _read_finite(self, message: Any) -> list[float]:
        """Return the state of a message; empty: it has another size, or is not finite."""
        try:
            x = list(self._read(message))
        except StatementError:
            return []
        return x if len(x) == len(self._adopted.control.names) and np.all(np.isfinite(x)) else []

    def _follow_first(self, plan: Packet, stamp: int, x: list[float]) -> None:
        """Let the checked first plan begin at a stamp [ns], beside x along the drift."""
        self._beginning = None
        control, first = self._adopted.control, plan.arrays['x'][0]
        drift = control.regulator.drift
        moved = np.subtract(free_drift(x, tuple(first), drift, control.limits.error), first)
        arrays = {**plan.arrays, 'x': plan.arrays['x'] + moved}
        self._loop.add_plan(make_plan(Packet({'stamp': stamp}, arrays), self._period, control),
                            self._loop.run)

    def _watch(self) -> float:
        return super()._watch() if self._is_active else CHECK_PERIOD

    def _look_ahead(self) -> None:
        """Ask for the plan of the next instant, from the state and the command of this one."""
        loop, half = self._loop, self._period // 2
        at, u = loop.due, loop.command
        if at is None or u is None or loop.is_stopped or loop.x is None or (
                self._asked and at == self._asked[-1][0] - self._period):
            return
        if self._asked and self._asked[-1][1] == loop.run and at >= self._asked[-1][0] - half:
            last = self._plans.last
            self._plans.counts['wanted'] += 1
            if last is None or int(last.plain['stamp']) < self._asked[-1][0]:
                self._plans.counts['missed'] += 1
        self._asked.append((at + self._period, loop.run))
        self._steps.ask({'kind': 'step', 'stamp': at + self._period},
                        {'x': np.array(loop.x), 'u': np.array(u)},
                        STEP_PATIENCE + self._adopted.problem.plain['deadline'])

    # Replies, in the thread of the supervisor

    def _on_reply(self, reply: Packet) -> None:
        if reply.plain.get('kind') == 'first':
            self._answers.append(reply)
            self._answered.trigger()
            return
        if 'refused' in reply.plain:
            self._plans.fail(reply.plain['refused'])
            return
        stamp = int(reply.plain['stamp'])
        run = next((run for asked, run in tuple(self._asked) if asked == stamp), None)
        plan = make_plan(reply, self._period, self._adopted.control)
        if run is not None and self._is_active and self._loop.add_plan(plan, run):
            self._plans.add(reply)
            self._show(reply)

    def _show(self, reply: Packet) -> None:
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
        if monotonic() - self._heard[1] > LAST_STATE:
            return f'no valid state on {self._states.topic_name} within {LAST_STATE:g} s'
        return ''

    async def _plan_first(self) -> str:
        """Return why no first plan passes its checks; empty: one does, and is stored."""
        if reason := self._find_obstacle():
            return reason
        if self._first is None:
            # All before the request: its answer may come at once.
            self._answers.clear()
            self._first, self._late = Future(), monotonic() + FIRST
            if not self._steps.ask({'kind': 'first'}, {'x': np.array(self._heard[0])}, FIRST):
                self._first = None
                return 'the solver process takes no request'
        reply = await self._first   # also of a request made before
        if reply is None:
            return f'the first plan was not made within {FIRST:g} s'
        if 'refused' in reply.plain:
            return str(reply.plain['refused'])
        self._beginning, self._plans.first = reply, reply.plain['words']
        return ''

    def _take_first(self) -> None:
        """Pass the answer to the request of a first plan to those who await it."""
        first = self._first
        if first is not None and (self._answers or monotonic() > self._late):
            self._first = None
            first.set_result(self._answers.popleft() if self._answers else None)

    async def _on_change_state(self, request: Any, response: Any) -> Any:
        wanted = request.transition
        activates = wanted.id == Transition.TRANSITION_ACTIVATE or wanted.label == 'activate'
        if activates and not self._is_active and (reason := await self._plan_first()):
            self._monitor.refused(f'activation: {reason}')
            self._log.warning('activate', f'not activated: {reason}')
        return await super()._on_change_state(request, response)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the control loop if a first plan has passed its checks."""
        if self._beginning is None:
            return TransitionCallbackReturn.FAILURE
        self._thread.stop()   # `on_activate` starts it again
        self._asked.clear()
        self._log.info('first plan', self._plans.first)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send the input at rest, and stop the control loop; the states are still listened to."""
        done = super().on_deactivate(state)
        self._beginning, self._idle_reason = None, ''   # somebody has decided it
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
        self._take_first()   # gives up one that does not come
        return [self._plans.status(self.get_fully_qualified_name()[1:], self._loop,
                                   self._steps.counts, self._steps.refusal)]


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run(MpcNode)


if __name__ == '__main__':
    sys.exit(main())
