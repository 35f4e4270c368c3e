# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Node estimator_node: estimates the state of a plant from measurements of its outputs.

Topics and services: docs/interfaces.md. Parameters: see `estimator_settings.Settings`.

The filter is that of `core.estimation`. After ``measurement_timeout`` without a measurement no
estimate is published, so that the controller acts as for a lost state.
"""

from collections import Counter
from functools import partial
from itertools import islice
import sys
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.core.estimation.delayed_filter import DelayedFilter
from obc_ros.core.text.errors import ObcError, StatementError
from obc_ros.msg import Command, Estimate, LqrDesign, Measurement, State
from obc_ros.nodes.estimator_messages import (
    EstimateMessages,
    estimator_status,
    fill_noise,
    suggest_noise,
    Traffic,
    UNUSABLE,
)
from obc_ros.nodes.estimator_settings import (
    EstimatorCandidate,
    judge_estimator_settings,
    Settings,
)
from obc_ros.ros.conversions import OdometryMap
from obc_ros.ros.diagnostics import Diagnostics
from obc_ros.ros.execution.callback_guards import guard_callbacks
from obc_ros.ros.execution.executor import run
from obc_ros.ros.execution.subscription_thread import Apart
from obc_ros.ros.messages import read_nanoseconds
from obc_ros.ros.parameters.node_parameters import Parameters
from obc_ros.ros.service_qos import LATCHED_QOS, STEADY
from obc_ros.ros.throttled_log import ThrottledLog
from obc_ros.srv import SuggestNoise
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

BACKLOG = 100       # messages to publish
UNREAD = 1000       # messages that wait for the next estimate


class EstimatorNode(Node):  # type: ignore[misc] # rclpy's classes are untyped
    """The node; see the module's text."""

    def __init__(self, **options: Any) -> None:
        super().__init__('estimator_node', allow_undeclared_parameters=True, **options)
        self._log = ThrottledLog(self)
        self._table = Parameters(
            self, Settings, judge_estimator_settings, self._adopt, opening=str)
        self._adopted = candidate = self._table.candidate
        settings = candidate.settings
        self._filter = DelayedFilter(
            candidate.kalman, candidate.x0, candidate.P0, candidate.u0, settings.longest_lag,
            outputs=candidate.outputs)
        self._map, self._messages = OdometryMap(candidate.system), EstimateMessages(
            candidate.system)
        self._received = self._published = self._restarts = self._future = 0
        self._last: int | None = None       # stamp of the last estimate [ns]
        self._arrived = self._ahead = 0     # [ns] local time of the last measurement, its stamp
        self._used_at = 0                   # minus that; local time of the last one in use
        self._reported = Traffic()
        self._states = self.create_publisher(State, 'state', BACKLOG)
        self._estimates = self.create_publisher(Estimate, '~/estimate', BACKLOG)
        self._odom = self.create_publisher(
            Odometry, 'odom', BACKLOG) if self._map.complete else None
        self._diagnostics = Diagnostics(self, needs_clock=True)
        # The executor needs more time for a message than the filter. It does not get the events
        # of these subscriptions either: unread messages wake it through them.
        group = Apart() if settings.rate else None
        self._sources = [
            (self.create_subscription(kind, topic, take, UNREAD, callback_group=group), take)
            for kind, topic, take in ((Measurement, 'measurement', self._on_measurement),
                                      (Command, 'command', self._on_command))]
        self._regulator: LqrDesign | None = None
        self.create_subscription(LqrDesign, 'lqr_node/design', self._on_design, LATCHED_QOS)
        self.create_service(SuggestNoise, '~/suggest_noise', self._on_suggest_noise)
        self.create_service(SuggestNoise, '~/suggest_weights', self._on_suggest_weights)
        if settings.rate:
            guard_callbacks(self, self.create_timer(1.0 / settings.rate, self._on_time),
                            'estimates')
        self.create_timer(1.0, self._diagnose, clock=STEADY)

    def _on_time(self) -> None:
        for source, take in self._sources:
            with (handle := source.handle):
                waiting = iter(partial(handle.take_message, source.msg_type, False), None)
                for message, _ in islice(waiting, UNREAD):
                    take(message)
        self._publish()

    def _on_measurement(self, message: Measurement) -> None:
        stamp, now = read_nanoseconds(message.header.stamp), self.get_clock().now().nanoseconds
        self._received, self._arrived, self._ahead = self._received + 1, now, stamp - now
        limit = self._adopted.settings.stamp_timeout
        if limit and self._ahead > limit * 1e9:
            self._future += 1
            self._log.warn_once('a measurement from the future was dropped: its stamp is '
                                f'{1e-9 * self._ahead:.3g} s after the local time')
            return
        try:
            used = self._filter.measure(stamp, message.names, message.y)
        except StatementError as error:
            self._log.warn_once(str(error))
            return
        if used:
            self._used_at = now
            if not self._adopted.settings.rate:
                self._publish()

    def _on_command(self, message: Command) -> None:
        delay = round(self._adopted.settings.input_delay * 1e9)
        try:
            self._filter.command(read_nanoseconds(message.header.stamp) + delay, message.u)
        except StatementError as error:
            self._log.warn_once(str(error))

    def _on_design(self, message: LqrDesign) -> None:
        self._regulator = message

    def _on_suggest_weights(self, request: SuggestNoise.Request,
                            response: SuggestNoise.Response) -> SuggestNoise.Response:
        self.get_logger().warning(
            '~/suggest_weights is now ~/suggest_noise; the former name ends with the next version',
            once=True)
        return self._on_suggest_noise(request, response)

    def _on_suggest_noise(self, request: SuggestNoise.Request,
                          response: SuggestNoise.Response) -> SuggestNoise.Response:
        try:
            fill_noise(response, suggest_noise(request, self._adopted, self._regulator))
        except ObcError as error:
            response.success, response.message = False, str(error)
        return response

    def _age(self, now: int) -> float | None:
        """Return the age of the newest measurement in use [s]; None: there is none."""
        newest, limit = self._filter.newest, self._adopted.settings.stamp_timeout
        if newest is None:
            return None
        age = 1e-9 * (now - (newest if limit else self._used_at))
        return 0.0 if -limit <= age < 0.0 else age   # a difference of the clocks

    def _publish(self) -> None:
        """Publish the present estimate, unless it is too old or not later than the last one."""
        newest, settings = self._filter.newest, self._adopted.settings
        now = self.get_clock().now().nanoseconds
        if newest is None:
            return
        if settings.stamp_timeout and now - newest > settings.measurement_timeout * 1e9:
            self._log.warn_once('the newest measurement is older than '
                                f'{settings.measurement_timeout:g} s: no estimate is published '
                                'until a newer one arrives')
            return
        stamp = max(now, newest) if settings.rate and settings.stamp_timeout else newest
        try:
            self._announce_restart()
            if self._last is not None and stamp <= self._last:
                return
            mean = self._filter.estimate(stamp)
        except ObcError as error:
            self._log.warn_once(str(error))
            return
        self._messages.fill_state(mean, self._restarts, settings.frame_id)
        self._states.publish(self._messages.state)
        if self._estimates.get_subscription_count():
            self._messages.fill_estimate(mean, self._filter)
            self._estimates.publish(self._messages.estimate)
        if self._odom is not None and self._odom.get_subscription_count():
            odometry = self._map.message(np.sqrt(np.maximum(mean.P.diagonal(), 0.0)))
            odometry.header = self._messages.state.header
            self._map.fill(odometry, mean.x, self._adopted.system.f(mean.x, self._filter.u))
            self._odom.publish(odometry)
        self._last, self._published = stamp, self._published + 1

    def _announce_restart(self) -> None:
        """Log that the filter has begun anew; its next estimate may be earlier than the last."""
        restarts = self._filter.counts['restarts']
        if restarts > self._restarts:
            self._log.warning('restart', f'restart {restarts} of the filter: '
                              f'{self._filter.reason}; the estimate jumps')
            self._restarts, self._last = restarts, None

    def _adopt(self, candidate: EstimatorCandidate) -> None:
        self._adopted = candidate
        self._filter.adopt(candidate.kalman, candidate.x0, candidate.P0, candidate.outputs)
        self.get_logger().info(str(candidate))

    def _warn_of_best_effort(self) -> None:
        for source, _ in self._sources:
            for each in self.get_publishers_info_by_topic(source.topic_name):
                if each.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
                    self._log.warn_once(
                        f'{each.node_name} publishes {source.topic_name} with best effort: its '
                        'messages do not arrive, reliable ones would')

    def _diagnose(self) -> None:
        self._warn_of_best_effort()
        now = self.get_clock().now()
        counts = Counter({**self._filter.counts, 'future': self._future})
        if any(counts[kind] for kind in UNUSABLE):
            self._log.warn_once('entries of measurements that are not finite, or beyond the '
                                'precision of double numbers, were dropped')
        traffic = Traffic(self._received, self._published, counts,
                          1e-9 * (now.nanoseconds - self._arrived), 1e-9 * self._ahead,
                          self._age(now.nanoseconds))
        status = estimator_status(self.get_fully_qualified_name()[1:], self._adopted,
                                  self._filter, traffic, self._reported)
        self._reported = traffic
        self._diagnostics.publish([status], now.to_msg(), self._adopted.settings.hardware_id,
                                  self._adopted.system.name)


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run(EstimatorNode)


if __name__ == '__main__':
    sys.exit(main())
