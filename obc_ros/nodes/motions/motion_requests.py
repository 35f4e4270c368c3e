# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Requests to plan a motion, ``~/plan`` of trajectory_server: see docs/problems.md.

All times are those of the stamps of the states, so that a simulation may run at any speed.
"""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from time import monotonic
from typing import Any

from obc_ros.core.closed_loop.clock import NS
from obc_ros.core.text.errors import quote
from obc_ros.msg import Trajectory
from obc_ros.nodes.motions.present_state import load_plants, PlanStart, PresentState
from obc_ros.ros import messages
from obc_ros.ros.messages import make_stamp
from obc_ros.ros.service_qos import BURST, LATCHED_QOS, STEADY
from obc_ros.ros.throttled_log import ThrottledLog
from obc_ros.srv import FollowReference, PredictState
from obc_ros.workers.pool import SHORTEST
from obc_ros.workers.wire import Packet
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future


class LqrClient:
    """The services of the lqr_node in the namespace of a node."""

    def __init__(self, node: Node) -> None:
        self._node, self._group = node, ReentrantCallbackGroup()   # with the callback that waits
        self._prediction, self._following = (
            node.create_client(service, name, qos_profile=BURST, callback_group=self._group)
            for service, name in ((PredictState, 'lqr_node/predict_state'),
                                  (FollowReference, 'lqr_node/follow_reference')))
        self.prediction, self.following = (   # names
            str(each.service_name) for each in (self._prediction, self._following))

    @property
    def is_there(self) -> bool:
        """Return whether both services are offered."""
        return all(each.service_is_ready() for each in (self._prediction, self._following))

    async def predict(self, stamp: int, timeout: float) -> Any:
        """Return the response for a stamp [ns]; None: there is none within `timeout` [s]."""
        request = PredictState.Request(stamp=make_stamp(stamp))
        return await self._call(self._prediction, request, timeout)

    async def follow(self, plan: Trajectory, timeout: float) -> Any:
        """Return the response to a reference; None: there is none within `timeout` [s]."""
        return await self._call(self._following, FollowReference.Request(reference=plan), timeout)

    async def _call(self, client: Client, request: Any, timeout: float) -> Any:
        done: Future = Future()

        def end(answer: Any) -> None:
            if not done.done():
                done.set_result(answer)

        asked = client.call_async(request)
        asked.add_done_callback(lambda _: end(asked.result()))
        timer = self._node.create_timer(timeout, lambda: end(None), self._group, STEADY)
        answer = await done
        self._node.destroy_timer(timer)
        client.remove_pending_request(asked)
        return answer


@dataclass
class PlannedMotion:
    """
    A plan that has been asked for.

    :ivar begin: stamp of its t = 0 [ns]; None: any.
    :ivar frame: frame of its positions; empty: not known.
    :ivar notes: clauses that the message of the answer ends with.
    """

    packet: Packet
    begin: int | None
    frame: str
    notes: list[str]


Ask = Callable[[Any, float, Mapping[str, Any]], Awaitable[Packet]]


class MotionRequests:
    """
    The requests of a node to plan a motion.

    :param node: its clock is used for states without a valid stamp.
    :param ask: returns the answer of a worker to a request within a time [s]; a mapping has what
        the message does not contain.
    """

    def __init__(self, node: Node, source: str, log: ThrottledLog, ask: Ask) -> None:
        self._node, self._log, self._ask = node, log, ask
        self._state, self._lqr = PresentState(node, source, log), LqrClient(node)
        self._reference = node.create_publisher(Trajectory, 'reference', LATCHED_QOS)
        self._took: dict[tuple[str, str], int] = {}   # [ns] by system and objective

    async def answer(self, request: Any, response: Any, settings: Any, limit: float) -> None:
        """
        Plan a motion, and have it followed if that is asked for.

        :param request: changed in place.
        :param settings: the parameters of trajectory_server.
        :param limit: time for everything [s].
        :raises ObcError: if there is no state to begin at, or a plant of a file has a wrong
            parameter.
        """
        until, key = monotonic() + limit, (request.system, request.objective)
        has_start = bool(request.start)
        for _ in range(2):
            asked = self._now()
            begin = asked + _lead(settings) + (
                int(min(request.deadline, limit) / NS) or self._took.get(key, 0))
            motion = await self._plan(request, settings, until, None if has_start else begin)
            messages.fill_answer(response, motion.packet)
            if not response.success:
                return
            await self._conclude(request, response, motion, settings, until)
            if motion.begin is None:
                return
            now = self._now()
            self._took[key] = max(0, now - asked)
            if response.success or asked <= now <= motion.begin:
                return

    async def _plan(self, request: Any, settings: Any, until: float, begin: int | None
                    ) -> PlannedMotion:
        """Return a plan from the start of a request, or from where the plant will be [ns]."""
        more = _name_plant(request, settings.systems)
        start, note, moves = None, '', False
        if begin is not None:
            start, note, moves = await self._predict(request, begin, settings)
            request.start, more['start_names'] = start.x, list(start.names)
        packet = await self._ask(request, max(until - monotonic(), SHORTEST), more)
        return PlannedMotion(packet, begin if moves else None, start.frame if start else '',
                      [note] if note else [])

    async def _conclude(self, request: Any, response: Any, motion: PlannedMotion,
                        settings: Any, until: float) -> None:
        """Complete the response with a solved plan, and have it followed if that is asked for."""
        header = response.trajectory.header
        header.frame_id = motion.frame
        if motion.begin is not None:
            header.stamp = make_stamp(motion.begin)
            if (late := (self._now() - motion.begin) * NS) > 0.0:
                self._reject(response, 'timed_out',
                             f'too late: the plant moves, and it came {late:.3g} s after its '
                             f'beginning (plan_lead = {settings.plan_lead:g} s)')
                return
        if request.execute and response.status == 'feasible' and not settings.execute_feasible:
            self._reject(response, 'cancelled', 'not executed: it has no certificate of '
                         'optimality (execute_feasible = false)')
        elif request.execute:
            await self._execute(response, motion, settings, until)
        if response.success:
            response.message = '; '.join([response.message, *motion.notes])

    async def _predict(self, request: Any, begin: int, settings: Any
                       ) -> tuple[PlanStart, str, bool]:
        """Return the start for a stamp [ns], a note, and whether it holds for that stamp only."""
        self._state.check(settings.state_timeout)
        if not self._lqr.is_there:
            note = f'nobody offers {self._lqr.prediction}'
        else:
            answer = await self._lqr.predict(begin, settings.state_timeout)
            if answer is not None and answer.success:
                start = PlanStart(answer.x, answer.names, answer.header.frame_id)
                return start, '', not answer.at_rest
            note = (f'{self._lqr.prediction} has not answered within {settings.state_timeout:g} s'
                    if answer is None else
                    f'lqr_node predicts no state ({quote(answer.message, 500)})')
        start = self._state.read(request, settings.state_timeout, load_plants(settings.systems))
        return start, f'{note}: the plan begins at the last state', False

    async def _execute(self, response: Any, motion: PlannedMotion, settings: Any,
                       until: float) -> None:
        """Have lqr_node follow a plan; without one, publish it."""
        # Without any state the plan has a start of its own, and the plant may come later.
        if self._state.has_arrived and (
                missing := self._state.explain_absence(settings.state_timeout)):
            self._reject(response, 'cancelled', f'not executed: {missing}')
            return
        plan: Trajectory = response.trajectory
        if motion.begin is None:
            plan.header.stamp = make_stamp(self._now() + _lead(settings))
        if not self._lqr.is_there:
            motion.notes.append(
                f'nobody offers {self._lqr.following}: the plan is published on '
                f'{self._reference.topic_name}, and nobody has accepted it')
            self._publish(plan)
            return
        begun, begin = self._now(), self._now() + _lead(settings)
        answer = await self._lqr.follow(plan, max(until - monotonic(), settings.state_timeout))
        if (motion.begin is None and answer is not None and not answer.success
                and self._now() > begin):
            # Its gains took longer than `plan_lead`. The plant rests: the plan may begin later.
            took = self._now() - begun
            plan.header.stamp = make_stamp(self._now() + took + _lead(settings))
            answer = await self._lqr.follow(plan, max(until - monotonic(), settings.state_timeout))
        if answer is not None and answer.success:
            motion.notes.append(f'lqr_node: {quote(answer.message, 500)}')
            self._publish(plan)
        elif answer is not None:
            self._reject(response, 'cancelled',
                         f'not executed: lqr_node rejected it: {quote(answer.message, 2000)}')
        else:
            self._reject(response, 'cancelled', f'{self._lqr.following} has not answered: whether '
                         'lqr_node follows it is not known')

    def _reject(self, response: Any, status: str, reason: str) -> None:
        done = 'is solved' if response.status == 'solved' else 'meets all constraints'
        message = f'the plan {done}, but {reason}'
        self._log.warning('refused', f'a request to ~/plan was rejected: {quote(message, 500)}')
        response.success, response.status, response.message = False, status, message

    def _publish(self, plan: Trajectory) -> None:
        self._reference.publish(plan)
        self._log.info('reference', f'a plan of {plan.t[-1]:.4g} s for {plan.system} is published '
                       f'on {self._reference.topic_name}')

    def _now(self) -> int:
        """Return the stamp of the last state [ns]; without a valid one, the time of the node."""
        stamp = self._state.stamp()
        return self._node.get_clock().now().nanoseconds if stamp is None else stamp


def _lead(settings: Any) -> int:
    return int(round(settings.plan_lead / NS))


def state_plan(request: Any, systems: tuple[str, ...]) -> dict[str, Any]:
    """Return the problem of a request with a start that was answered, as in a file."""
    from obc_ros.core.tasks.motion_planning import state_motion  # CasADi: 0.3 s
    from obc_ros.workers.solving import read_motion
    packet = messages.read_request('plan', request)
    packet.plain.update(_name_plant(request, systems))
    return state_motion(read_motion(packet))


def _name_plant(request: Any, systems: tuple[str, ...]) -> dict[str, Any]:
    plant = load_plants(systems).get(request.system)
    return {} if plant is None else {'plant': plant}
