# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The view of a plant: its body, the set point, its trail, and its frame if that is wanted.

Messages are made only while somebody subscribes. Without subscribers a timer looks for one, twice
a second. This is done in the thread of the executor; another one publishes the states.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module, util
import math
from time import monotonic
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, PoseStamped, TransformStamped
from nav_msgs.msg import Path
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import LqrDesign
from obc_ros.nodes.views.bodies import BodyMarkers, InputMarkers, PlanarPose, SetPointMarkers
from obc_ros.nodes.views.scene import PlaneMap, Scene
from obc_ros.ros.conversions import BASE, ODOM
from obc_ros.ros.execution.callback_guards import guard_callbacks
from obc_ros.ros.messages import make_stamp
from obc_ros.ros.service_qos import LATCHED_QOS, STEADY
from rclpy.node import Node
from rclpy.publisher import Publisher

FASTEST = 30.0      # [Hz] largest rate of the markers
LONGEST_TRAIL = 500   # poses
TF_MESSAGES = 'tf2_msgs'   # not among the wheels of ROS 2
IDLE_PERIOD = 0.5          # [s] between two looks for subscribers
TRAIL_PERIOD = 0.2  # [s] between two poses of the trail: a path of 100 poses takes 1 ms to publish
STEP = 1e-3         # [m] least distance between two poses of the trail


@dataclass(frozen=True)
class Moment:
    """A published state: stamp [ns], simulated time [s], x (n,), and the acting input u (m,)."""

    stamp: int
    time: float
    x: Array
    u: Array


def check_view(system: System, settings: Any) -> None:
    """Raise StatementError if the frame of the plant is wanted, and cannot be published."""
    if not settings.publish_tf:
        return
    if not (system.plane and {'px', 'py', 'theta'} <= set(system.state_names)):
        raise StatementError(f'publish_tf: the states of {system.name} '
                             f'({", ".join(system.state_names)}) are not a pose in a plane')
    if util.find_spec(TF_MESSAGES) is None:
        raise StatementError('publish_tf: the package tf2_msgs is missing; install it '
                             '(ros-$ROS_DISTRO-tf2-msgs), or leave publish_tf out')


def make_transform(pose: Pose, stamp: Time) -> Any:
    """Return the transform from the body at a pose to odom."""
    message = TransformStamped(child_frame_id=BASE)
    message.header.frame_id, message.header.stamp = ODOM, stamp
    position, translation = pose.position, message.transform.translation
    translation.x, translation.y, translation.z = position.x, position.y, position.z
    message.transform.rotation = pose.orientation
    return message


class PlantView:
    """The view of the plant of a node; `observe` returns the last published state."""

    def __init__(self, node: Node, system: System, settings: Any,
                 observe: Callable[[], Moment]) -> None:
        self._observe = observe
        self._plane = PlaneMap(system.state_names, system.plane)
        self._design: LqrDesign | None = None
        if not self._plane.has_places:
            return
        self._scene = Scene(node, 'markers', 1)
        self._path = node.create_publisher(Path, 'trail', 1)
        self._frames: Publisher | None = None
        if settings.publish_tf:
            kind = import_module('tf2_msgs.msg').TFMessage
            self._frames = node.create_publisher(kind, 'tf', 100)   # as tf2_ros does
        self.adopt(system, settings)
        node.create_subscription(LqrDesign, 'lqr_node/design', self._take, LATCHED_QOS)
        self._timer = node.create_timer(
            IDLE_PERIOD, self._publish, clock=STEADY)
        guard_callbacks(node, self._timer, 'view of the plant')

    def adopt(self, system: System, settings: Any) -> None:
        """Show a plant with other parameters, or something else of it."""
        if not self._plane.has_places:
            return
        self._settings = settings
        self._body = BodyMarkers(system, self._plane, 'body')
        self._input = InputMarkers(system, self._plane)
        self._set_point = SetPointMarkers(system, self._plane)
        if self._design is not None:
            self._set_point.take(self._design)
        self._trail: deque[PoseStamped] = deque(maxlen=settings.trail_length)
        self._since, self._due = -math.inf, 0.0

    def _take(self, design: LqrDesign) -> None:
        self._design = design
        self._set_point.take(design)

    def _publish(self) -> None:
        wanted = self._settings.markers
        markers = wanted and self._scene.is_watched
        trail = wanted and bool(self._trail.maxlen) and self._path.get_subscription_count() > 0
        frame = self._frames is not None and self._frames.get_subscription_count() > 0
        idle = TRAIL_PERIOD if trail else IDLE_PERIOD
        period = 1.0 / self._settings.marker_rate if markers or frame else idle
        self._timer.timer_period_ns = round(period * 1e9)
        if not wanted:
            self._scene.clear()
        if not trail:
            self._trail.clear()
        if not (markers or trail or frame):
            return
        moment = self._observe()
        place = self._plane.locate(moment.x)
        if not all(map(math.isfinite, (*place, *moment.u))):
            return
        stamp = make_stamp(moment.stamp)
        if markers:
            self._scene.show([
                *self._body.fill(place, moment.u, stamp),
                *self._input.fill(place, moment.u, stamp), *self._set_point.fill(place, stamp)])
        if frame and self._frames is not None:
            self._frames.publish(self._frames.msg_type(
                transforms=[make_transform(self._plane.pose(*place), stamp)]))
        if trail and (now := monotonic()) >= self._due:
            self._due = now + TRAIL_PERIOD
            self._extend(place, moment.time, stamp)

    def _extend(self, place: PlanarPose, time: float, stamp: Time) -> None:
        """Add a pose to the trail, which begins anew after a reset, and publish it."""
        if time < self._since:
            self._trail.clear()
        self._since = time
        pose = self._plane.pose(*place)
        last = self._trail[-1].pose.position if self._trail else None
        if last is None or math.dist(
                (last.x, last.y, last.z),
                (pose.position.x, pose.position.y, pose.position.z)) >= STEP:
            each = PoseStamped(pose=pose)
            each.header.frame_id, each.header.stamp = ODOM, stamp
            self._trail.append(each)
        path = Path(poses=list(self._trail))
        path.header.frame_id, path.header.stamp = ODOM, stamp
        self._path.publish(path)
