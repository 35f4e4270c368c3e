# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Node lqr_node: state feedback u = ue - K (x - xe), designed from the weights in its parameters.

Topics and services: docs/interfaces.md. Parameters: see `settings.Settings`. The loop is in
`controller_node`.
"""

from copy import copy
from dataclasses import replace
import sys
from time import time_ns
from typing import Any

from obc_ros.core.lqr.design.reference_checks import check
from obc_ros.core.lqr.design.reference_tracking import Course, read_course
from obc_ros.core.lqr.design.report import change
from obc_ros.core.lqr.weight_search import StepSpecifications, suggest
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import ObcError, quote, RefusedReferenceError, StatementError
from obc_ros.msg import LqrDesign, Trajectory
from obc_ros.nodes.control.controller_node import ControllerNode, design_message, OVERRIDES
from obc_ros.nodes.lqr.prediction import explain_idleness, explain_miss, foresee
from obc_ros.nodes.lqr.settings import (
    apply_request,
    describe_ending,
    judge_lqr_settings,
    LqrCandidate,
    Settings,
)
from obc_ros.ros.execution.executor import run
from obc_ros.ros.messages import flatten_doubles, read_nanoseconds, set_stamp
from obc_ros.ros.service_qos import LATCHED_QOS
from obc_ros.srv import FollowReference, PredictState, SuggestWeights, TryDesign
from rclpy.qos_overriding_options import QoSOverridingOptions


class LqrNode(ControllerNode):
    """The node; see the module's text."""

    def __init__(self, **options: Any) -> None:
        super().__init__('lqr_node', Settings, **options)

    def _prepare(self) -> None:
        self._courses: tuple[Course, ...] = ()
        self._accepted: Trajectory | None = None   # by the service, and not yet on the topic

    def _create_topics(self, settings: Settings) -> None:
        super()._create_topics(settings)
        self._created = time_ns()
        self._references = self.create_subscription(
            Trajectory, 'reference', self._on_reference, copy(LATCHED_QOS),
            callback_group=self._desk.changes,
            qos_overriding_options=QoSOverridingOptions(OVERRIDES))

    def _create_services(self) -> None:
        super()._create_services()
        for kind, name, callback in (
                (TryDesign, '~/try_design', self._on_try_design),
                (SuggestWeights, '~/suggest_weights', self._on_suggest_weights),
                (PredictState, '~/predict_state', self._on_predict_state)):
            self.create_service(kind, name, callback, callback_group=self._desk.group)
        self.create_service(FollowReference, '~/follow_reference', self._on_follow_reference,
                            callback_group=self._desk.changes)

    def _shared_topics(self) -> list[str]:
        return [self._references.topic_name]

    def _judge(self, settings: Settings) -> LqrCandidate:
        candidate = judge_lqr_settings(settings, self._courses_of(settings))
        self._check_states(candidate)
        return candidate

    def _courses_of(self, settings: Settings) -> tuple[Course, ...]:
        """Return the references to follow: none after a change of the set point."""
        now = self._adopted and self._adopted.settings
        if now and (now.setpoint, now.setpoint_input) != (
                settings.setpoint, settings.setpoint_input):
            return ()
        return self._courses

    def _adopt(self, candidate: LqrCandidate) -> None:
        self._courses = self._courses_of(candidate.settings)
        super()._adopt(candidate)

    def _forget(self) -> None:
        self._courses, self._accepted = (), None

    async def _on_reference(self, message: Trajectory, info: Any) -> None:
        """Follow a reference; one without samples ends the one that is followed."""
        accepted, self._accepted = self._accepted, None
        if accepted is not None and all(getattr(message, name) == getattr(accepted, name)
                                        for name in ('header', 'system', 't', 'x', 'u')):
            return   # trajectory_server publishes what was accepted
        try:
            self._check_age(message, info)
            await self._follow(message, is_judged_ahead=False)
        except ObcError as error:
            self._note_refused(str(error))

    async def _on_follow_reference(self, request: FollowReference.Request,
                                   response: FollowReference.Response
                                   ) -> FollowReference.Response:
        try:
            if request.reference.t and (reason := explain_idleness(self._loop)):
                raise StatementError(reason)
            response.message = await self._follow(request.reference, is_judged_ahead=True)
        except ObcError as error:
            response.message = str(error)
            self._note_refused(response.message)
        else:
            response.success, self._accepted = True, request.reference
        return response

    async def _follow(self, message: Trajectory, is_judged_ahead: bool) -> str:
        courses, candidate = await self._desk.run(
            lambda: self._judge_reference(message, is_judged_ahead), is_change=True)
        if reason := self._loop.offer(candidate.control):
            raise RefusedReferenceError(reason)
        self._courses, self._adopted = courses, candidate
        sentence = (f'a reference of {courses[-1].reference.duration:g} s, '
                    f'{describe_ending(courses[-1], candidate)}' if courses else
                    'no reference is followed')
        self._log.info('reference', sentence)
        return sentence

    async def _on_predict_state(self, request: PredictState.Request,
                                response: PredictState.Response) -> PredictState.Response:
        stamp = read_nanoseconds(request.stamp)
        try:
            found = await self._desk.run(
                lambda: foresee(self._loop, self._adopted, stamp))
        except ObcError as error:
            response.message = str(error)
            return response
        set_stamp(response.header.stamp, found.stamp)
        response.header.frame_id, response.names = self._frame, list(self._adopted.control.names)
        response.x, response.u, response.at_rest = found.x, found.u, found.at_rest
        response.success, response.message = True, found.sentence
        return response

    def _check_age(self, message: Trajectory, info: Any) -> None:
        """Reject a reference that begins at once if it was published before the node began."""
        sent = info['source_timestamp'] if info else 0
        if message.t and not read_nanoseconds(message.header.stamp) and 0 < sent < self._created:
            raise StatementError(
                f'it was published {(self._created - sent) * 1e-9:.3g} s before this node '
                'started, and has no stamp: publish it again')

    def _judge_reference(self, message: Trajectory, is_judged_ahead: bool
                         ) -> tuple[tuple[Course, ...], LqrCandidate]:
        """Return the references to follow after a message, and their control; at the desk."""
        followed = self._loop.reference
        courses = read_courses(
            message, self._adopted.design.plant.system, self._frame,
            tuple(each for each in self._courses if each.reference is followed))
        candidate = judge_lqr_settings(self._table.settings, courses)
        if courses:
            control = candidate.control
            check(courses[-1], candidate.design, control.limits, control.legs[-1].allowed)
            if is_judged_ahead and (reason := explain_miss(self._loop, candidate)):
                raise RefusedReferenceError(f'predicted for its beginning: {reason}')
        return courses, candidate

    def _note_refused(self, reason: str) -> None:
        self._monitor.refused(f'reference: {reason}')
        self._log.warning('reference', f'a reference was rejected: {reason}')

    async def _on_try_design(self, request: TryDesign.Request, response: TryDesign.Response
                             ) -> TryDesign.Response:
        try:
            response.design = await self._desk.run(lambda: self._tried(
                apply_request(request.weights, self._table.settings)))
        except ObcError as error:
            response.message = str(error)
        else:
            response.success, response.message = True, response.design.sentence
        return response

    async def _on_suggest_weights(self, request: SuggestWeights.Request,
                                  response: SuggestWeights.Response) -> SuggestWeights.Response:
        try:
            await self._desk.run(lambda: self._suggest(request, response))
        except ObcError as error:
            response.success, response.message = False, str(error)
        return response

    def _suggest(self, request: SuggestWeights.Request, response: SuggestWeights.Response) -> None:
        """Fill a response with weights and their design; at the desk."""
        plant = self._adopted.design.plant
        found = suggest(
            plant.A, plant.B,
            StepSpecifications(request.rise_time, request.overshoot, tuple(request.peak_input)),
            x_max=tuple(request.x_max), u_max=tuple(request.u_max),
            inputs=plant.system.input_names)
        response.success, response.message = found.success, found.message
        response.qx = flatten_doubles(found.best.weights.Qx)
        response.qu = flatten_doubles(found.best.weights.Qu)
        for name in ('scale', 'rise_time', 'overshoot', 'peak_input'):
            setattr(response, f'table_{name}', flatten_doubles(
                [getattr(each, name) for each in found.table]))
        response.design = self._tried({
            'weights': 'matrices', 'cross': (),
            'stability': 0.0, 'Qx': tuple(response.qx), 'Qu': tuple(response.qu)})

    def _tried(self, values: dict[str, Any]) -> LqrDesign:
        """Return the design of the present settings with other values."""
        candidate = self._judge(replace(self._table.settings, **values))
        made = change(self._adopted.design, candidate.design,
                      self._loop.preview(candidate.control))
        return design_message(candidate.design, made, self._loop.error, candidate.note)


def read_courses(message: Trajectory, system: System, frame: str, followed: tuple[Course, ...]
                 ) -> tuple[Course, ...]:
    """
    Return the references to follow after a message, in the order of their beginnings.

    :param message: the new reference; without samples: no reference.
    :param frame: frame of its states; empty: not known.
    :param followed: the one that is followed, if any: it goes on until the new one begins.
    :raises StatementError: if the message is not a reference for the system.
    """
    if not message.t and not message.x and not message.u:
        return ()
    if message.system not in ('', system.name):
        raise StatementError(f"system = '{quote(message.system)}': wanted {system.name}")
    given = message.header.frame_id
    if given and frame and given != frame:
        raise StatementError(f"frame_id = '{quote(given)}': wanted the frame of the states, "
                             f"'{quote(frame)}'")
    stamp = read_nanoseconds(message.header.stamp)
    new = read_course(system, (message.state_names, message.input_names), message.t, message.x,
                      message.u, message.interpolation, stamp or None)
    return (*followed, new)


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run(LqrNode)


if __name__ == '__main__':
    sys.exit(main())
